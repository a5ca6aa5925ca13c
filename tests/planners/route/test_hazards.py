"""Rings against their slow twins, those of land and areas, and geometry without gaps: thin areas, long edges, slivers."""

from dataclasses import replace

import numpy as np
import pytest
from pyproj import Geod

from planners import NoGo
from planners.hazards.areas import no_go_rings
from planners.hazards.domain import Bathymetry, Region
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import to_local
from replay_kit.core.grid import Projection
from tests.planners.flow_samples import forbidden, still_flow
from tests.planners.route.all_rings import all_rings


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


@pytest.mark.parametrize(("row", "column"), [(3, 3), (0, 0), (6, 7)])
def test_a_cell_s_corners_are_halfway_to_its_neighbours_also_at_the_edge_of_the_grid(row, column):
    (ring,) = land(np.s_[row : row + 1, column : column + 1])
    here = np.array([GRID.east[row, column], GRID.north[row, column]])
    size = np.ptp(ring.corners, axis=0)
    np.testing.assert_allclose(ring.corners.mean(axis=0), here, atol=60.0)
    np.testing.assert_allclose(
        size, [np.diff(GRID.east, axis=1).mean(), np.diff(GRID.north, axis=0).mean()], rtol=0.02
    )


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


def test_a_hole_is_allowed_and_a_fence_forbids_what_an_area_allows():
    flow, points = still_flow(), np.array([[0.0, 0.0], [4.5e3, 0.0], [8e3, 0.0]])
    outer, inner = (forbidden(flow, -side, -side, side, side) for side in (6e3, 3e3))
    pond = replace(outer, holes=(inner.polygon,))
    for fence, sign in ((False, 1.0), (True, -1.0)):
        (ring,) = no_go_rings(flow.grid.projection, replace(pond, fence=fence))
        clear = sign * np.array([3e3, -1.5e3, 2e3])
        np.testing.assert_allclose(ring.clearance(points), clear, rtol=1e-3)
        np.testing.assert_array_equal(ring.forbids(points), clear < 0.0)
