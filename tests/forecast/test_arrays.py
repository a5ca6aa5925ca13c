"""Functions of arrays: faces to centres, constant values, terrain-following levels, cells of other grids."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from replay_kit.forecast.grids.depths import reach
from replay_kit.forecast.grids.horizontal import columns_round
from replay_kit.forecast.variables import never_changing


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


@pytest.mark.parametrize(
    ("longitude", "count"),
    [
        (np.arange(0.0, 360.0, 5.0), 72),
        (np.arange(0.0, 366.0, 5.0) % 360.0, 72),
        (np.arange(180.0, -180.0, -5.0), 72),
        (np.arange(0.0, 354.0, 5.0), None),
        (np.array([10.0, 10.1, 10.2]), None),
        (np.tile(np.arange(0.0, 361.0, 5.0), (3, 1)), 72),
    ],
)
def test_how_many_columns_go_round(longitude, count):
    assert columns_round(longitude) == count
