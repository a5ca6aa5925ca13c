"""Land as rings that a path keeps clear of: which cells have one, and where its corners lie."""

from dataclasses import replace

import numpy as np
import pytest

from planners.route.region import region_of
from tests.planners.flow_samples import still_flow
from tests.planners.route.all_rings import all_rings

GRID = still_flow((7, 8)).grid


def land(dry: tuple[slice, slice], levels: slice = slice(None), depth: float = 100.0):
    wet = GRID.wet.copy()
    wet[levels, *dry] = False
    edge, *rings = all_rings(region_of(replace(GRID, wet=wet)), depth)
    assert edge.name.startswith("the edge")
    return rings


def test_land_has_a_ring_for_each_cell_beside_water_and_none_inside():
    rings = land(np.s_[2:5, 1:5])
    # of three by four cells the two in the middle are beside land alone
    assert [ring.name for ring in rings] == ["land"] * 10
    points = np.column_stack([GRID.east.ravel(), GRID.north.ravel()])
    forbidden = np.any([ring.forbids(points) for ring in rings], axis=0).reshape(GRID.east.shape)
    expected = np.zeros_like(forbidden)
    expected[2:5, 1:5] = True
    expected[3, 2:4] = False
    np.testing.assert_array_equal(forbidden, expected)


def test_what_is_dry_below_the_dives_is_no_land():
    assert land(np.s_[2:5, 1:5], slice(3, None), depth=100.0) == []
    assert len(land(np.s_[2:5, 1:5], slice(3, None), depth=300.0)) == 10


@pytest.mark.parametrize(("row", "column"), [(3, 3), (0, 0), (6, 7)])
def test_a_cell_s_corners_are_halfway_to_its_neighbours_also_at_the_edge_of_the_grid(
    row: int, column: int
):
    (ring,) = land(np.s_[row : row + 1, column : column + 1])
    here = np.array([GRID.east[row, column], GRID.north[row, column]])
    size = np.ptp(ring.corners, axis=0)
    np.testing.assert_allclose(ring.corners.mean(axis=0), here, atol=60.0)
    np.testing.assert_allclose(
        size, [np.diff(GRID.east, axis=1).mean(), np.diff(GRID.north, axis=0).mean()], rtol=0.02
    )
