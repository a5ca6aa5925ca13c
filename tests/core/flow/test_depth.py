import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from replay_kit.core.flow.depth import DepthFunctions, depth_weights

LEVELS = np.array([2.5, 40.0, 120.0, 500.0])
HAT, GAUSSIAN = DepthFunctions("hat", 100.0), DepthFunctions("gaussian", 100.0)


@given(st.lists(st.floats(-10.0, 900.0), min_size=1, max_size=20))
def test_hats_reproduce_linear_profiles_and_stay_constant_beyond_the_levels(depths):
    depth = np.array(depths)
    weights = depth_weights(HAT, depth, LEVELS)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(weights @ LEVELS, np.interp(depth, LEVELS, LEVELS), rtol=1e-12)


def test_hats_are_the_identity_at_the_levels():
    np.testing.assert_array_equal(depth_weights(HAT, LEVELS, LEVELS), np.eye(4))


def test_one_level_holds_everywhere():
    np.testing.assert_array_equal(
        depth_weights(HAT, np.array([0.0, 77.0]), np.array([10.0])), [[1.0], [1.0]]
    )


@pytest.mark.parametrize("depth", [2.5, 33.0, 499.0])
def test_gaussians_are_the_paper_s(depth):
    expected = [np.exp(-0.5 * ((depth - level) / 100.0) ** 2) for level in LEVELS]
    np.testing.assert_allclose(
        depth_weights(GAUSSIAN, np.array([depth]), LEVELS)[0], expected, rtol=1e-13
    )


def test_gaussians_are_constant_above_the_first_level():
    np.testing.assert_array_equal(
        depth_weights(GAUSSIAN, np.array([0.0]), LEVELS),
        depth_weights(GAUSSIAN, np.array([2.5]), LEVELS),
    )
