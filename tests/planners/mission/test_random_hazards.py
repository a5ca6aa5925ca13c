"""Random missions among hazards: what is called reached crosses nothing when it is flown, and nor do the waypoint files, read back."""

import pytest

from planners import plan_mission, waypoints_of
from tests.planners.hazardous import harm_done, harm_of_files, random_mission
from tests.reference.vehicle import fly_commands


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.full) for seed in range(2, 14))])
def test_what_is_called_reached_crosses_nothing_when_it_is_flown(seed: int):
    mission = random_mission(seed)
    plan = plan_mission(mission.flow, mission.request)
    assert plan.status == "reached"
    assert harm_done(mission, plan.track) is None
    assert harm_done(mission, fly_commands(mission.sea, plan)) is None
    few = waypoints_of(mission.flow, plan, no_go=mission.request.no_go, bathymetry=mission.request.bathymetry)
    assert few.violation is not None or set(harm_of_files(mission, plan, few).values()) == {None}
