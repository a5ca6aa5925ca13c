"""Random missions among hazards: what is called reached crosses nothing when it is flown, and nor do the waypoint files, read back."""

from dataclasses import replace

import pytest

from planners import plan_mission, waypoints_of
from tests.planners.hazardous import harm_done, harm_of_files, random_mission
from tests.reference.vehicle import fly_commands


# 39 goes by an island to a goal over a shoal
@pytest.mark.parametrize(
    "seed", [0, 39, *(pytest.param(seed, marks=pytest.mark.full) for seed in range(1, 14))]
)
def test_what_is_called_reached_crosses_nothing_when_it_is_flown(seed: int):
    mission = random_mission(seed)
    plan = plan_mission(mission.flow, mission.request)
    assert plan.status == "reached"
    assert harm_done(mission, plan.track) is None
    assert harm_done(mission, fly_commands(mission.sea, plan)) is None
    few = waypoints_of(
        mission.flow, plan, no_go=mission.request.no_go, bathymetry=mission.request.bathymetry
    )
    harms = harm_of_files(mission, plan, few)
    assert (
        few.violation is not None
        or not few.arrives
        or all(harm == {None} for harm in harms.values())
    )


def test_dives_beside_an_island_are_as_deep_as_the_water_and_too_few_legs_end_short_of_the_goal():
    mission = random_mission(39)
    plan = plan_mission(mission.flow, mission.request)
    # the limit is that of the goal, 250 m, for the last leg alone
    assert len(plan.yo_depths) <= 8
    short = replace(mission.request, settings=replace(mission.request.settings, max_legs=3))
    ended = plan_mission(mission.flow, short)
    assert ended.status == "unreachable"
    assert harm_done(mission, ended.track) is None
