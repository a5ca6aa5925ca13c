"""Rings against their slow twins, corner by corner, and the rings of a region."""

import math
from dataclasses import replace

import numpy as np
import pytest

from planners.route.bottom import Bathymetry
from planners.route.hazards import Ring
from planners.route.region import region_of
from replay_kit.core.errors import PlanError
from tests.planners.flow_samples import still_flow
from tests.planners.route.all_rings import all_rings
from tests.reference import polygon


def _rings() -> list[Ring]:
    rng = np.random.default_rng(0)
    # corners in random order cross their own line
    return [
        Ring(rng.uniform(-1e3, 1e3, (n, 2)), outside, "area")
        for n in (3, 4, 5, 7)
        for outside in (False, True)
    ]


def _distance(corners: np.ndarray, point: np.ndarray) -> float:
    """Return the distance of a point from the nearest edge, edge by edge."""
    best = math.inf
    for begin, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = float((point - begin) @ (end - begin) / ((end - begin) @ (end - begin)))
        best = min(best, math.dist(point, begin + min(max(along, 0.0), 1.0) * (end - begin)))
    return best


@pytest.mark.parametrize("ring", _rings())
def test_a_ring_is_its_slow_twin_point_by_point(ring: Ring) -> None:
    points = np.random.default_rng(1).uniform(-1.2e3, 1.2e3, (200, 2))
    inside = np.array([polygon.inside(ring.corners.tolist(), point) for point in points.tolist()])
    away = np.array([_distance(ring.corners, point) for point in points])
    np.testing.assert_array_equal(ring.inside(points), inside)
    np.testing.assert_array_equal(ring.forbids(points), inside != ring.outside)
    np.testing.assert_allclose(
        ring.clearance(points), np.where(inside != ring.outside, -away, away), rtol=1e-10, atol=1e-9
    )
    np.testing.assert_allclose(
        np.linalg.norm(ring.nearest(points) - points, axis=1), away, rtol=1e-10, atol=1e-9
    )


def test_land_and_shallows_are_the_dry_cells_beside_water() -> None:
    grid = still_flow().grid
    wet = grid.wet.copy()
    wet[:, 2:5, 3:6] = False
    region = region_of(replace(grid, wet=wet))
    edge, *land = all_rings(region, 300.0)
    # of nine cells the middle one is beside none that is wet
    assert (edge.outside, len(land), {ring.name for ring in land}) == (True, 8, {"land"})
    nodes = np.column_stack([grid.east[2:5, 3:6].ravel(), grid.north[2:5, 3:6].ravel()])
    held = np.array([ring.forbids(nodes) for ring in land])
    assert held.sum(axis=0).tolist() == [1, 1, 1, 1, 0, 1, 1, 1, 1]
    bottom = np.where(wet[0], 500.0, np.nan)
    shallows = all_rings(
        region_of(grid), 300.0, bathymetry=Bathymetry(grid.longitude, grid.latitude, bottom)
    )[1:]
    # of the four by four cells that have an unknown corner the inner four are beside none that is deep enough
    assert (len(shallows), {ring.name for ring in shallows}) == (12, {"shallower than 320 m"})
    corner = np.array([grid.east[1, 2], grid.north[1, 2]])
    np.testing.assert_allclose(shallows[0].corners[0], corner, atol=1e-6)
    with pytest.raises(PlanError, match="expected one shape"):
        all_rings(region, 300.0, bathymetry=Bathymetry(grid.longitude, grid.latitude, bottom[1:]))
