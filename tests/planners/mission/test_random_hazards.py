"""Random missions among hazards: what is called reached crosses nothing when it is flown, and nor do its waypoints."""

import pytest

from planners import plan_mission, waypoints_of
from tests.planners.hazardous import flown_track, harm_done, random_mission


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.full) for seed in (5, 6, 12))])
def test_what_is_called_reached_crosses_nothing_when_it_is_flown(seed: int):
    mission = random_mission(seed)
    plan = plan_mission(mission.flow, mission.request)
    assert plan.status == "reached"
    assert harm_done(mission, plan.track) is None
    assert harm_done(mission, flown_track(mission, plan)) is None
    few = waypoints_of(mission.flow, plan, no_go=mission.request.no_go, bathymetry=mission.request.bathymetry)
    assert few.violation is None
