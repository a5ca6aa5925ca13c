"""Functions of arrays: faces to centres, constant values, terrain-following levels, cells of other grids."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from replay_kit.forecast.grids.depths import at_depths, reach
from replay_kit.forecast.grids.horizontal import bilinear, find_cells, region_block
from replay_kit.forecast.grids.s_levels import Terrain, stretched
from replay_kit.forecast.variables import never_changing, to_centres


def test_faces_to_centres_by_which_of_them_are_water():
    faces = np.array([[1.0, 3.0, 7.0, 100.0, 5.0]])
    valid = np.array([[True, True, True, False, False]])
    mean, wet = to_centres(faces, valid, -1)
    assert_array_equal(mean, [[2.0, 5.0, 7.0, 0.0]])
    assert_array_equal(wet, [[True, True, True, False]])
    turned, wet_turned = to_centres(faces.T, valid.T, -2)
    assert_array_equal(turned, mean.T)
    assert_array_equal(wet_turned, wet.T)


def test_zeros_are_land_from_the_sea_bed_up_and_packed_fills_everywhere():
    values = np.ones((2, 3, 1, 4))
    values[:, 1:, 0, 1] = 0.0
    values[:, 0, 0, 2] = 0.0
    values[:, :, 0, 3] = 0.0
    expected = [[False, False, False, True], [False, True, False, True], [False, True, False, True]]
    assert_array_equal(never_changing(values, [0.0])[:, 0], expected)
    # one member that moves makes water of it
    values[1, 2, 0, 1] = 1e-9
    assert_array_equal(never_changing(values, [0.0])[:, 0, 1], [False, False, False])
    # a level at rest everywhere is water at rest, but where all of the column is at rest
    values[:, 2] = 0.0
    assert_array_equal(never_changing(values, [0.0])[2, 0], [False, False, False, True])
    packed = np.full((2, 2, 1, 2), 0.34106)
    packed[1, 0, 0, 0] = 0.3411
    packed[:, 0, 0, 1] = np.float32(0.34106)
    assert_array_equal(never_changing(packed, [0.34106])[:, 0], [[False, True], [True, True]])


@pytest.mark.parametrize("transform", [1, 2])
def test_depths_of_terrain_following_levels_end_at_the_surface_and_the_sea_bed(transform):
    s = np.array([-1.0, -0.4, 0.0])[:, None, None]
    c = np.array([-1.0, -0.1, 0.0])[:, None, None]
    h, surface = np.array([[100.0, 200.0]]), np.array([[0.5, -1.0]])
    share = stretched(s, c, 20.0, h, transform)
    found, _ = Terrain("h", h, share[None], surface[None], "").of_member(0)
    assert_allclose(found[0], h, atol=1e-12)
    assert_allclose(found[-1], -surface, atol=1e-12)
    # by hand: z0 = 20 (-0.4 + 0.1) - 10 = -16, z = -16 + 0.5 (1 - 0.16); S = (-8 - 10) / 120, z = 0.5 + 100.5 S
    assert found[1, 0, 0] == pytest.approx(
        16.0 - 0.5 * 0.84 if transform == 1 else -0.5 + 100.5 * 0.15, rel=1e-12
    )


def test_values_at_depths_are_linear_between_levels_and_none_out_of_reach():
    depths = np.array([10.0, 30.0, 80.0])[:, None, None] * np.ones((3, 1, 2))
    values = (2.0 * depths)[None]
    within = np.array([[-np.inf, 10.0]]), np.array([[100.0, 40.0]])
    found = at_depths(values, depths, within, np.array([0.0, 20.0, 40.0, 90.0, 101.0]))[0, :, 0]
    assert_allclose(found[:, 0], [20.0, 40.0, 80.0, 160.0, np.nan])
    assert_allclose(found[:, 1], [np.nan, 40.0, 80.0, np.nan, np.nan])


@pytest.mark.parametrize(
    ("levels", "least", "greatest"),
    [
        ([5.0, 60.0, 150.0], -np.inf, 195.0),
        ([14.0, 16.0], -np.inf, 17.0),
        ([16.0, 18.0], 16.0, 19.0),
        # layers of 400 m have their levels in the middle
        ([200.0, 600.0, 1000.0], -np.inf, 1200.0),
        ([201.0, 600.0, 1000.0], 201.0, 1200.0),
        ([3994.0, 4300.0, 4574.0], 3994.0, 4711.0),
        ([0.0], -15.0, 15.0),
        ([4574.0], 4559.0, 4589.0),
    ],
)
def test_levels_reach_half_their_spacing_down_and_to_a_surface_that_is_near(
    levels, least, greatest
):
    assert_allclose(reach(np.array(levels)), [least, greatest], rtol=1e-5)
    # levels that move with the surface do for where they lie at rest
    moved = reach(np.array(levels) - 1.5, 1.5)
    assert_allclose(moved, [least - 3.0, greatest], rtol=1e-5)


def test_cells_of_a_turned_grid_and_values_in_them():
    i, j = np.meshgrid(np.arange(9.0), np.arange(7.0))
    place = ((i + 1j * j) * np.exp(0.6j)) * 4e3
    wanted = (
        (np.array([0.25, 3.5, 7.9, -0.5, 8.4]) + 1j * np.array([5.5, 0.0, 2.1, 3.0, 3.0]))
        * np.exp(0.6j)
    ) * 4e3
    at_j, at_i, inside = find_cells(place.real, place.imag, wanted.real, wanted.imag)
    assert_array_equal(inside, [True, True, True, False, False])
    assert_allclose(at_i[:3], [0.25, 3.5, 7.9], atol=1e-9)
    assert_allclose(at_j[:3], [5.5, 0.0, 2.1], atol=1e-9)
    values = (3.0 * i - 2.0 * j)[None]
    assert_allclose(
        bilinear(values, at_j, at_i, inside)[0], [-10.25, 10.5, 19.5, np.nan, np.nan], atol=1e-8
    )
    corners_j, corners_i = np.array([[0.0, 0.0, 6.0, 6.0], [0.0, 8.0, 0.0, 8.0]])
    at_corners = bilinear(values, corners_j, corners_i, np.ones(4, dtype=bool))[0]
    assert_array_equal(at_corners, 3.0 * corners_i - 2.0 * corners_j)
    values[0, 2, 8] = np.nan
    # nine tenths of the third point's weight was there
    assert_array_equal(
        np.isnan(bilinear(values, at_j, at_i, inside)[0]), [False, False, True, True, True]
    )


def test_a_seam_is_crossed_only_on_a_grid_that_goes_round():
    latitude = np.array([0.0, 1.0])
    globe = np.arange(0.0, 360.0, 10.0)
    for grid in ((globe, latitude), np.meshgrid(globe, latitude)):
        assert region_block(*grid, (-15.0, 0.0, 15.0, 1.0))[1].tolist() == [35, 0, 1]
    part = region_block(globe[:32], latitude, (-65.0, 0.0, 15.0, 1.0))
    assert_array_equal(part[1], np.arange(32))
    assert region_block(globe, latitude, (15.0, 5.0, 25.0, 6.0)) is None
