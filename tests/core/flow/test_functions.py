import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from replay_kit.core.flow.functions import (
    DepthFunctions,
    HorizontalKernel,
    depth_weights,
    velocity_kernel,
)
from tests.reference.dense import hats
from tests.reference.estimator import kernel_3d

KERNEL = HorizontalKernel(9_000.0, 11_000.0, 0.2)
RNG = np.random.default_rng(3)
POINTS, NODES = RNG.uniform(-3e4, 3e4, (7, 2)), RNG.uniform(-3e4, 3e4, (5, 2))


def test_equals_the_block_written_out():
    ours = velocity_kernel(KERNEL, POINTS, NODES)
    for i, point in enumerate(POINTS):
        for j, node in enumerate(NODES):
            block = kernel_3d((*point, 0.0), (*node, 0.0), (9_000.0, 11_000.0, 1.0), 0.2)
            np.testing.assert_allclose(
                ours[np.ix_([i, 7 + i], [j, 5 + j])], block, rtol=1e-12, atol=1e-16
            )


LEVELS = np.array([2.5, 40.0, 120.0, 500.0])
HAT, GAUSSIAN = DepthFunctions("hat", 100.0), DepthFunctions("gaussian", 100.0)


@given(st.lists(st.floats(-10.0, 900.0), min_size=1, max_size=20), st.integers(1, 4))
def test_hats_are_linear_between_levels_and_constant_beyond_them(depths, count):
    levels = LEVELS[:count]
    depths += levels.tolist()
    found = depth_weights(HAT, np.array(depths), levels)
    np.testing.assert_allclose(found, [hats(depth, levels) for depth in depths], atol=1e-12)


@pytest.mark.parametrize("depth", [0.0, 2.5, 33.0, 499.0])
def test_gaussians_are_the_paper_s_and_constant_above_the_first_level(depth):
    expected = np.exp(-0.5 * ((max(depth, LEVELS[0]) - LEVELS) / 100.0) ** 2)
    (found,) = depth_weights(GAUSSIAN, np.array([depth]), LEVELS)
    np.testing.assert_allclose(found, expected, rtol=1e-13)
