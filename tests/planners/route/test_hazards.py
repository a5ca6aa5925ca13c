"""Rings against their slow twins, those of land and areas, and geometry without gaps: thin areas, long edges, slivers."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from pyproj import Geod

from planners import MissionRequest, MissionSettings, NoGo, plan_mission
from planners.hazards.areas import Ring, first_crossing, no_go_rings
from planners.hazards.bottom import Bathymetry
from planners.hazards.domain import Region
from planners.route.passage import mean_current, passage
from planners.task import task_of
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import to_local
from replay_kit.core.grid import Projection
from tests.planners.flow_samples import forbidden, place, still_flow
from tests.planners.route.all_rings import all_rings


def _rings():
    rng = np.random.default_rng(0)
    # corners in random order cross their own line
    return [
        Ring(rng.uniform(-1e3, 1e3, (n, 2)), outside, "area")
        for n in (3, 4, 5, 7)
        for outside in (False, True)
    ]


def _distance(corners, point):
    """Return the distance of a point from the nearest edge, edge by edge."""
    best = math.inf
    for begin, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = float((point - begin) @ (end - begin) / ((end - begin) @ (end - begin)))
        best = min(best, math.dist(point, begin + min(max(along, 0.0), 1.0) * (end - begin)))
    return best


def test_land_and_shallows_are_the_dry_cells_beside_water():
    grid = still_flow().grid
    wet = grid.wet.copy()
    wet[:, 2:5, 3:6] = False
    region = Region(replace(grid, wet=wet))
    edge, *land = all_rings(region, 300.0)
    # of nine cells the middle one is beside none that is wet
    assert (edge.outside, [ring.name for ring in land]) == (True, ["land"])
    nodes = np.column_stack([grid.east[2:5, 3:6].ravel(), grid.north[2:5, 3:6].ravel()])
    held = np.array([ring.forbids(nodes) for ring in land])
    assert held.sum(axis=0).tolist() == [1, 1, 1, 1, 0, 1, 1, 1, 1]
    bottom = np.where(wet[0], 500.0, np.nan)
    shallows = all_rings(
        Region(grid), 300.0, bathymetry=Bathymetry(grid.longitude, grid.latitude, bottom)
    )[1:]
    # of the four by four cells that have an unknown corner the inner four are beside none that is deep enough
    (shallow,) = shallows
    assert (shallow.name, len(shallow.holes)) == ("shallower than 320 m", 1)
    corner = np.array([grid.east[1, 2], grid.north[1, 2]])
    assert np.min(np.linalg.norm(shallow.corners - corner, axis=1)) < 1e-6
    with pytest.raises(PlanError, match="expected one shape"):
        all_rings(region, 300.0, bathymetry=Bathymetry(grid.longitude, grid.latitude, bottom[1:]))


GRID = still_flow((7, 8)).grid


def land(dry, levels=slice(None), depth=100.0):
    wet = GRID.wet.copy()
    wet[levels, *dry] = False
    edge, *rings = all_rings(Region(replace(GRID, wet=wet)), depth)
    assert edge.name.startswith("the edge")
    return rings


def test_what_is_dry_below_the_dives_is_no_land():
    assert land(np.s_[2:5, 1:5], slice(3, None), depth=100.0) == []
    (ring,) = land(np.s_[2:5, 1:5], slice(3, None), depth=300.0)
    assert (ring.name, len(ring.holes)) == ("land", 1)


@pytest.mark.parametrize(("row", "column"), [(3, 3), (0, 0), (6, 7)])
def test_a_cell_s_corners_are_halfway_to_its_neighbours_also_at_the_edge_of_the_grid(row, column):
    (ring,) = land(np.s_[row : row + 1, column : column + 1])
    here = np.array([GRID.east[row, column], GRID.north[row, column]])
    size = np.ptp(ring.corners, axis=0)
    np.testing.assert_allclose(ring.corners.mean(axis=0), here, atol=60.0)
    np.testing.assert_allclose(
        size, [np.diff(GRID.east, axis=1).mean(), np.diff(GRID.north, axis=0).mean()], rtol=0.02
    )


FLOW = still_flow()
FRAME = FLOW.grid.projection


@pytest.mark.parametrize("latitude", [-40.0, 60.0])
def test_both_meanings_of_a_long_edge_are_forbidden(latitude):
    # 5 degrees along a parallel: the shortest line runs kilometres nearer to the pole
    frame, ellipsoid = Projection(10.0, latitude), Geod(ellps="WGS84")
    equatorward = latitude - np.sign(latitude)
    area = NoGo(
        ((7.5, latitude), (12.5, latitude), (12.5, equatorward), (7.5, equatorward)), "range"
    )
    rings = no_go_rings(frame, area)
    shortest = ellipsoid.npts(7.5, latitude, 12.5, latitude, 1)[0][1]
    assert abs(shortest - latitude) > 0.02

    def forbidden(north):
        return any(
            bool(ring.forbids(np.column_stack(to_local(frame, [10.0], [north])))[0])
            for ring in rings
        )

    # a metre is 1e-5 degrees
    assert forbidden(latitude - 1e-5 * np.sign(latitude))
    assert forbidden(shortest - 1e-5 * np.sign(latitude))
    assert not forbidden(shortest + 1e-5 * np.sign(latitude))
    # longitudes of another turn mean the same area
    turned = replace(area, polygon=tuple((east + 360.0, north) for east, north in area.polygon))
    assert sum(ring.area.area for ring in no_go_rings(frame, turned)) == pytest.approx(
        sum(ring.area.area for ring in rings), rel=1e-12
    )


def _beside_a_sliver():
    """Return a mission past two areas with 80 m of water between them."""
    areas = (forbidden(FLOW, -1e3, -6e3, 1e3, -40.0), forbidden(FLOW, -1e3, 40.0, 1e3, 3e3))
    ends = place(FLOW, -6e3, 0.0), (place(FLOW, 6e3, 0.0),)
    return MissionRequest(*ends, settings=MissionSettings(depth=390.0), no_go=areas)


def test_a_route_leads_round_areas_with_a_sliver_between_them_and_through_no_edge_of_theirs():
    asked = _beside_a_sliver()
    task = task_of(FLOW, asked)
    route = passage(task, mean_current(task)).route
    assert route.arrives
    legs = np.array(list(pairwise(route.points)))
    drawn = [ring for ring in task.rings if ring.drawn]
    assert len(drawn) == 2
    assert first_crossing(drawn, legs, np.zeros(len(legs))) is None


@pytest.mark.full
def test_a_mission_leads_round_areas_with_a_sliver_between_them():
    asked = _beside_a_sliver()
    plan = plan_mission(FLOW, asked)
    drawn = [ring for area in asked.no_go for ring in no_go_rings(FRAME, area)]
    assert plan.status == "reached"
    assert (
        first_crossing(
            drawn, np.array(list(pairwise(plan.track[:, :2]))), np.zeros(len(plan.track) - 1)
        )
        is None
    )
