"""The bottom: limits of cells, the exact test of profiles against them, areas whose edges are long, crossings of thin areas."""

from dataclasses import replace

import numpy as np
import pytest

from planners.hazards.areas import Ring, first_crossing
from planners.hazards.domain import Bathymetry, Bottom, DepthCells, Region, bottom_of
from tests.planners.flow_samples import still_flow
from tests.planners.route.all_rings import all_rings

GRID = still_flow().grid


def step(limit_east):
    """Return two cells of a kilometre: no limit of consequence in the west, a limit in the east."""
    east, north = np.meshgrid([0.0, 1e3, 2e3], [0.0, 1e3])
    return Bottom(
        (DepthCells(np.stack([east, north], axis=-1), np.array([[5e3, limit_east]]), None),), 20.0
    )


@pytest.mark.parametrize(
    ("begin", "end", "depths", "skin", "below"),
    [
        # the climb is at 100 m where it comes over the step, at 50 m at its end
        (500.0, 1500.0, (150.0, 50.0), 0.0, False),
        (500.0, 1500.0, (152.0, 50.0), 0.0, True),
        (1500.0, 500.0, (50.0, 152.0), 0.0, True),
        # it only touches the edge of the cell, at 200 m
        (500.0, 999.0, (0.0, 200.0), 0.0, False),
        (500.0, 1001.0, (0.0, 200.0), 0.0, True),
        # a path that may bend counts as wide as that
        (500.0, 998.0, (0.0, 200.0), 1.0, False),
        (500.0, 998.0, (0.0, 200.0), 3.0, True),
        # straight down
        (1500.0, 1500.0, (0.0, 100.0), 0.0, False),
        (1500.0, 1500.0, (0.0, 100.1), 0.0, True),
    ],
)
def test_a_profile_is_held_against_the_bottom_beneath_it(begin, end, depths, skin, below):
    path = np.array([[(begin, 500.0), (end, 500.0)]])
    assert step(100.0).is_below(path, np.array([depths]), np.array([skin])).tolist() == [below]


def test_limits_are_those_of_the_shallowest_cell_within_a_distance():
    bottom = step(100.0)
    points = np.array([[500.0, 500.0], [950.0, 500.0], [1500.0, 500.0], [5e3, 0.0]])
    assert bottom.limit_at(points).tolist() == [5e3, 5e3, 100.0, np.inf]
    assert bottom.limit_at(points, 60.0).tolist() == [5e3, 100.0, 100.0, np.inf]
    assert (bottom.shallowest, bottom.deepest) == (100.0, 5e3)
    assert [len(bottom.rings(depth)) for depth in (90.0, 100.0, 101.0, 6e3)] == [0, 0, 1, 0]


def test_the_lowest_wet_level_is_the_limit_without_a_bathymetry():
    wet = GRID.wet.copy()
    wet[2:, :, :4] = False
    wet[:, 0, 0] = False
    bottom = bottom_of(Region(replace(GRID, wet=wet)), None, 20.0)
    points = np.column_stack([GRID.east[[4, 4, 0], [2, 7, 0]], GRID.north[[4, 4, 0], [2, 7, 0]]])
    # levels are 5, 40, 110, 230 and 400 m
    assert bottom.limit_at(points).tolist() == [40.0, np.inf, -np.inf]
    everywhere = np.full(GRID.longitude.shape, 300.0)
    known = bottom_of(
        Region(replace(GRID, wet=wet)), Bathymetry(GRID.longitude, GRID.latitude, everywhere), 20.0
    )
    assert known.limit_at(points).tolist() == [110.0, 280.0, -np.inf]
    assert known.edge is None


def test_between_points_of_a_bathymetry_the_shallowest_of_four_holds():
    depth = np.full(GRID.longitude.shape, 500.0)
    depth[3, 4] = 100.0
    bottom = bottom_of(Region(GRID), Bathymetry(GRID.longitude, GRID.latitude, depth), 20.0)
    here = np.array([GRID.east[3, 4], GRID.north[3, 4]])
    assert bottom.limit_at(
        here + np.array([[9e2, 0.0], [-7e3, 0.0], [0.0, 8e3], [-12e3, 0.0]])
    ).tolist() == [80.0, 80.0, 80.0, 480.0]


def test_water_that_the_bathymetry_does_not_cover_is_forbidden():
    part = np.s_[:, :5]
    bathymetry = Bathymetry(
        GRID.longitude[part], GRID.latitude[part], np.full(GRID.longitude[part].shape, 900.0)
    )
    rings = all_rings(Region(GRID), 300.0, bathymetry=bathymetry)
    assert [ring.name for ring in rings] == [
        "the edge of the region that the forecast covers",
        "the edge of the bathymetry",
    ]
    places = np.array([[GRID.east[3, k], GRID.north[3, k]] for k in (2, 7)])
    assert rings[1].forbids(places).tolist() == [False, True]


def test_an_area_two_metres_wide_is_seen_and_where_it_is_crossed():
    thin = np.array([[0.0, 99.0], [0.0, 101.0], [500.0, 101.0], [500.0, 99.0]])
    turns = np.array([[200.0, -1e3], [200.0, -100.0], [200.0, 900.0], [900.0, 900.0]])
    path = np.stack([turns[:-1], turns[1:]], axis=1)
    ring = Ring(thin, False, "cable")
    found = first_crossing((ring,), path, np.zeros(3))
    assert found == ("cable", 1, pytest.approx(199.0 / 1000.0))
    beside = path + np.array([303.0, 0.0])
    assert first_crossing((ring,), beside, np.zeros(3)) is None
    assert first_crossing((ring,), beside, np.full(3, 4.0)) == ("cable", 1, 1.0)
    assert first_crossing((replace(ring, outside=True),), path, np.zeros(3)) == ("cable", 0, 0.0)
