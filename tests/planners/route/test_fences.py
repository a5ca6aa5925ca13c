"""Fences that must not be left, and areas with holes."""

from dataclasses import replace

import numpy as np
import pytest

from planners import MissionSettings, plan_mission
from planners.hazards.areas import no_go_rings
from replay_kit.core.errors import PlanError
from tests.planners.flow_samples import forbidden, request_between, still_flow

FLOW = still_flow()
FRAME = FLOW.grid.projection
SETTINGS = MissionSettings(depth=300.0)
OUTER, INNER = (forbidden(FLOW, -s, -s, s, s, name="range") for s in (6e3, 3e3))
POND = replace(OUTER, holes=(INNER.polygon,))
POINTS = np.array([[0.0, 0.0], [4.5e3, 0.0], [8e3, 0.0]])


def test_a_hole_is_allowed_and_a_fence_forbids_what_an_area_allows():
    (area,) = no_go_rings(FRAME, POND)
    (fence,) = no_go_rings(FRAME, replace(POND, fence=True))
    assert area.forbids(POINTS).tolist() == [False, True, False]
    assert fence.forbids(POINTS).tolist() == [True, False, True]
    np.testing.assert_allclose(area.clearance(POINTS), [3e3, -1.5e3, 2e3], rtol=1e-3)
    np.testing.assert_allclose(fence.clearance(POINTS), [-3e3, 1.5e3, -2e3], rtol=1e-3)
    assert len(area.holes[0]) >= 4


def test_a_mission_stays_within_a_fence_that_its_shortest_way_leaves():
    # a bay open to the south, between the two ends
    corners = ((-8e3, -8e3), (8e3, -8e3), (8e3, 4e3), (2e3, 4e3), (2e3, -4e3), (-2e3, -4e3))
    corners = (*corners, (-2e3, 4e3), (-8e3, 4e3))
    places = [request_between(FLOW, corner, corner).start for corner in corners]
    polygon = tuple((place.longitude, place.latitude) for place in places)
    fence = replace(OUTER, polygon=polygon, fence=True)
    asked = request_between(FLOW, (-5e3, 2e3), (5e3, 2e3), settings=SETTINGS, no_go=(fence,))
    plan = plan_mission(FLOW, asked)
    assert plan.status == "reached"
    (ring,) = no_go_rings(FRAME, fence)
    assert not ring.forbids(plan.track[:, :2]).any()
    assert plan.duration > 1.3 * plan_mission(FLOW, replace(asked, no_go=())).duration


@pytest.mark.parametrize(("start", "goal"), [((0.0, 0.0), (8e3, 0.0)), ((8e3, 0.0), (0.0, 0.0))])
def test_a_fence_that_excludes_start_or_goal_is_refused(start, goal):
    asked = request_between(
        FLOW, start, goal, settings=SETTINGS, no_go=(replace(OUTER, fence=True),)
    )
    with pytest.raises(PlanError, match=r"is in a forbidden area: range"):
        plan_mission(FLOW, asked)


def test_a_mission_from_a_hole_to_outside_finds_no_way_and_one_within_it_does():
    within = request_between(FLOW, (-2e3, 0.0), (2e3, 0.0), settings=SETTINGS, no_go=(POND,))
    assert plan_mission(FLOW, within).status == "reached"
    out = request_between(FLOW, (0.0, 0.0), (9e3, 0.0), settings=SETTINGS, no_go=(POND,))
    plan = plan_mission(FLOW, out)
    assert plan.status == "unreachable"
    assert "closes every route" in plan.message


def test_a_fence_of_two_waters_is_refused():
    local = [(-4e3, -4e3), (4e3, 4e3), (4e3, -4e3), (-4e3, 4e3)]
    places = [request_between(FLOW, corner, corner).start for corner in local]
    bow = replace(OUTER, polygon=tuple((p.longitude, p.latitude) for p in places), fence=True)
    with pytest.raises(PlanError, match="encloses 2 separate waters"):
        no_go_rings(FRAME, bow)
