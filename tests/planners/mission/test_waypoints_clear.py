"""Lists of waypoints keep out of areas and above the bottom: they are flown before they are written."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from planners import MissionRequest, MissionSettings, plan_mission, waypoints_of
from planners.route.hazards import no_go_rings
from replay_kit.core.geodesy import to_local
from tests.planners.flow_samples import place, still_flow, uniform_flow
from tests.planners.mission.test_bottom import bathymetry
from tests.planners.mission.test_mission import _area

FLOW = still_flow()
REQUEST = MissionRequest(
    place(FLOW, -7e3, 0.0, 0.0),
    (place(FLOW, 7e3, 0.0, 0.0),),
    settings=MissionSettings(depth=300.0),
)


@pytest.mark.full
def test_a_long_tolerance_does_not_lead_through_an_area():
    area = _area(FLOW, -1e3, -9e3, 1e3, 2e3)
    plan = plan_mission(FLOW, replace(REQUEST, no_go=(area,)))
    assert plan.status == "reached"
    blind, clear = (waypoints_of(FLOW, plan, 1e5, no_go=areas) for areas in ((), (area,)))
    assert (blind.times.size, blind.violation) == (1, None)
    assert clear.times.size > 1
    assert clear.violation is None
    ring = no_go_rings(FLOW.grid.projection, area)[0]
    places = np.vstack(
        [[-7e3, 0.0], np.column_stack(to_local(FLOW.grid.projection, *clear.surfacings.T))]
    )
    dense = np.vstack([np.linspace(a, b, 4000) for a, b in pairwise(places)])
    assert not ring.forbids(dense).any()
    through = np.linspace(
        places[0], np.column_stack(to_local(FLOW.grid.projection, *blind.surfacings.T))[-1], 4000
    )
    assert ring.forbids(through).any()


def test_waypoints_that_cannot_be_headed_for_in_safety_say_so_first():
    plan = plan_mission(FLOW, REQUEST)
    late = _area(FLOW, -1e3, -1e3, 1e3, 1e3)
    found = waypoints_of(FLOW, plan, no_go=(late,))
    assert found.violation is not None
    assert found.violation.what == "range"
    assert found.message.startswith("not safe: heading for the waypoints crosses range at 152.4")


@pytest.mark.full
def test_dives_to_a_waypoint_are_as_deep_as_the_shallowest_planned_on_the_way():
    sill = bathymetry(lambda x, y: np.where(np.abs(x - 152.5) < 0.02, 150.0, 900.0))
    plan = plan_mission(FLOW, replace(REQUEST, bathymetry=sill))
    assert {min(map(max, plan.yo_depths)), max(map(max, plan.yo_depths))} == {130.0, 300.0}
    few = waypoints_of(FLOW, plan, 1e5, bathymetry=sill)
    assert few.depths.tolist() == [130.0]
    assert few.violation is None


def test_waypoints_that_are_never_reached_are_not_called_safe_beside_an_area():
    # the plan's way is undone by a current of the vehicle's own speed
    plan, adverse = plan_mission(FLOW, REQUEST), uniform_flow(-0.3, 0.0)
    far = _area(FLOW, 12e3, 10e3, 13e3, 11e3)
    without, beside = (waypoints_of(adverse, plan, no_go=areas) for areas in ((), (far,)))
    assert without.violation is None
    assert beside.violation is not None
    assert "water that was not checked, as waypoint 1 is not reached in" in beside.message
    assert beside.violation.leg == len(beside.surfacings)
