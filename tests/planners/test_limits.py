"""The vehicle's own depth limit, and areas that cover the start: refused by each planner before it searches."""

from dataclasses import replace

import pytest

from planners import (
    Glider,
    GlideSettings,
    MissionRequest,
    MissionSettings,
    NoGo,
    plan,
    plan_mission,
)
from replay_kit.core.errors import PlanError
from tests.planners.flow_samples import place, still_flow

FLOW = still_flow()
HERE, THERE = place(FLOW, -3e3, 0.0, 0.0), place(FLOW, 3e3, 0.0, 0.0)


def test_a_mission_s_dives_end_at_the_vehicle_s_limit() -> None:
    asked = MissionRequest(HERE, (THERE,), Glider(max_depth=200.0), MissionSettings(depth=300.0))
    with pytest.raises(
        PlanError,
        match="dives to 300 m are deeper than the vehicle's limit, 200 m; choose a lesser depth",
    ):
        plan_mission(FLOW, asked)
    # a limit below the deepest level is none
    with pytest.raises(PlanError, match="dives to 500 m are deeper than the deepest level, 400 m"):
        plan_mission(
            FLOW,
            replace(asked, vehicle=Glider(max_depth=1000.0), settings=MissionSettings(depth=500.0)),
        )


def test_a_glide_passes_no_deeper_than_the_vehicle_s_limit() -> None:
    settings = GlideSettings(max_depth=150.0)
    with pytest.raises(
        PlanError,
        match=r"goal at .*, 160 m is not between the surface and the vehicle's limit, 150 m",
    ):
        plan(FLOW, HERE, replace(THERE, depth=160.0), settings=settings)
    assert (
        plan(FLOW, HERE, replace(THERE, depth=140.0), settings=settings).track[:, 2].max()
        <= 150.0 + 1e-3
    )


def test_a_limit_is_a_depth() -> None:
    with pytest.raises(PlanError, match=r"a glider's max_depth is 0\.0; expected a number above 0"):
        Glider(max_depth=0.0)


@pytest.mark.parametrize(("east", "named"), [(-3e3, "start"), (3e3, "goal")])
def test_an_area_over_the_start_or_the_goal_is_refused(east: float, named: str) -> None:
    corners = (
        place(FLOW, east + x, y, 0.0)
        for x, y in ((-100.0, -100.0), (100.0, -100.0), (100.0, 100.0), (-100.0, 100.0))
    )
    area = NoGo(tuple((corner.longitude, corner.latitude) for corner in corners), "range")
    for turned in (area, replace(area, polygon=tuple((x - 360.0, y) for x, y in area.polygon))):
        with pytest.raises(
            PlanError, match=f"{named} is where the vehicle may not go: range; move it"
        ):
            plan_mission(
                FLOW,
                MissionRequest(
                    HERE, (THERE,), settings=MissionSettings(depth=300.0), no_go=(turned,)
                ),
            )
