"""Geometry without gaps: areas narrower than a path's steps, edges longer than a map is flat, slivers between areas."""

from itertools import pairwise

import numpy as np
import pytest
from pyproj import Geod

from planners import MissionRequest, MissionSettings, NoGo, plan_mission
from planners.mission.search.passage import passage_past_goals, water_of
from planners.mission.task import mission_task
from planners.route.hazards import first_crossing, no_go_rings
from replay_kit.core.geodesy import to_local
from replay_kit.core.grid import Projection
from tests.planners.flow_samples import place, still_flow
from tests.planners.mission.test_mission import _area

FLOW = still_flow()
FRAME = FLOW.grid.projection


@pytest.mark.parametrize("width", [0.5, 2.0, 4.0])
@pytest.mark.parametrize("angle", [0.0, 20.0, 85.0])
def test_an_area_metres_wide_is_crossed_however_far_apart_the_points_are(
    width: float, angle: float
) -> None:
    (ring,) = no_go_rings(FRAME, _area(FLOW, -0.5 * width, -3e3, 0.5 * width, 3e3))
    along = 200.0 * np.array([np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))])
    ends = np.array([-along - [3.0, 0.0], along - [3.0, 0.0]])
    assert not ring.forbids(ends).any()
    name, segment, share = first_crossing(
        [ring], np.array([[2.0 * ends[0], ends[0]], ends]), np.zeros(2)
    ) or ("", -1, -1.0)
    entry = (3.0 - 0.5 * width + along[0]) / (2.0 * along[0])
    assert (name, segment) == ("range", 1)
    assert share == pytest.approx(entry, abs=1e-3)
    assert (
        first_crossing([ring], ends[:, None] + [[-300.0, 0.0], [-200.0, 0.0]], np.zeros(2)) is None
    )


@pytest.mark.parametrize("latitude", [-40.0, 60.0])
def test_both_meanings_of_a_long_edge_are_forbidden(latitude: float) -> None:
    # 5 degrees along a parallel: the shortest line runs kilometres nearer to the pole
    frame, ellipsoid = Projection(10.0, latitude), Geod(ellps="WGS84")
    equatorward = latitude - np.sign(latitude)
    area = NoGo(
        ((7.5, latitude), (12.5, latitude), (12.5, equatorward), (7.5, equatorward)), "range"
    )
    rings = no_go_rings(frame, area)
    shortest = ellipsoid.npts(7.5, latitude, 12.5, latitude, 1)[0][1]
    assert abs(shortest - latitude) > 0.02

    def forbidden(north: float) -> bool:
        return any(
            bool(ring.forbids(np.column_stack(to_local(frame, [10.0], [north])))[0])
            for ring in rings
        )

    # a metre is 1e-5 degrees
    assert forbidden(latitude - 1e-5 * np.sign(latitude))
    assert forbidden(shortest - 1e-5 * np.sign(latitude))
    assert not forbidden(shortest + 1e-5 * np.sign(latitude))


def _beside_a_sliver() -> MissionRequest:
    """Return a mission past two areas with 80 m of water between them."""
    areas = (_area(FLOW, -1e3, -6e3, 1e3, -40.0), _area(FLOW, -1e3, 40.0, 1e3, 3e3))
    ends = place(FLOW, -6e3, 0.0, 0.0), (place(FLOW, 6e3, 0.0, 0.0),)
    return MissionRequest(*ends, settings=MissionSettings(depth=390.0), no_go=areas)


def test_a_route_leads_round_areas_with_a_sliver_between_them_and_through_no_edge_of_theirs() -> (
    None
):
    asked = _beside_a_sliver()
    task = mission_task(FLOW, asked)
    route = passage_past_goals(task, water_of(task), task.rings).route
    assert route.arrives
    legs = np.array(list(pairwise(route.points)))
    drawn = [ring for ring in task.rings if ring.drawn]
    assert len(drawn) == 2
    assert first_crossing(drawn, legs, np.zeros(len(legs))) is None


@pytest.mark.full
def test_a_mission_leads_round_areas_with_a_sliver_between_them() -> None:
    asked = _beside_a_sliver()
    plan, drawn = (
        plan_mission(FLOW, asked),
        [ring for area in asked.no_go for ring in no_go_rings(FRAME, area)],
    )
    assert plan.status == "reached"
    assert (
        first_crossing(
            drawn, np.array(list(pairwise(plan.track[:, :2]))), np.zeros(len(plan.track) - 1)
        )
        is None
    )
