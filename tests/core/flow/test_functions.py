"""Kernels, functions of depth and the stream function on a lattice, against sums written out."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from replay_kit.core.flow.functions import (
    WINDOW,
    DepthFunctions,
    HorizontalKernel,
    depth_weights,
    lattice_over,
    velocity_kernel,
)
from tests.reference import lattice as slow
from tests.reference.dense import hats
from tests.reference.estimator import kernel_3d

KERNEL = HorizontalKernel(9_000.0, 11_000.0, 0.2)
RNG = np.random.default_rng(3)
NODES = RNG.uniform([-30e3, -20e3], [30e3, 20e3], (40, 2))
LATTICE = lattice_over(KERNEL, NODES)
LATENT = RNG.standard_normal((LATTICE.size, 3))


def test_the_kernel_is_the_block_written_out_and_the_product_of_the_lattice_s_functions():
    kernel = velocity_kernel(KERNEL, NODES, NODES[:5])
    for i, point in enumerate(NODES):
        for j, node in enumerate(NODES[:5]):
            block = kernel_3d((*point, 0.0), (*node, 0.0), (9_000.0, 11_000.0, 1.0), 0.2)
            found = kernel[np.ix_([i, 40 + i], [j, 5 + j])]
            np.testing.assert_allclose(found, block, rtol=1e-12, atol=1e-16)
    cells = np.divide(LATTICE.spacing, LATTICE.widths)
    share = (KERNEL.speed * KERNEL.length_east) ** 2 * np.prod(cells) / np.pi
    product = slow.matrix(LATTICE, NODES) @ slow.matrix(LATTICE, NODES[:5]).T
    np.testing.assert_allclose(share * product, kernel, atol=1e-6 * kernel.max())
    assert lattice_over(KERNEL, NODES[:1]).shape == (WINDOW, WINDOW)


@pytest.mark.parametrize("count", [1, 5, 60])
def test_velocities_are_the_sums_of_the_gaussians_within_the_lattice_and_beyond(count):
    points = np.random.default_rng(count).uniform(-90e3, 90e3, (count, 2))
    expected = (slow.matrix(LATTICE, points) @ LATENT).reshape(2, count, 3)
    for latent in (LATENT, np.asfortranarray(np.hstack([LATENT, LATENT]))[:, 3:]):
        np.testing.assert_allclose(
            LATTICE.velocity(points, latent), expected, atol=1e-13 * np.abs(LATENT).max() / 9e3
        )


LEVELS = np.array([2.5, 40.0, 120.0, 500.0])


@given(st.lists(st.floats(-10.0, 900.0), min_size=1, max_size=20), st.integers(1, 4))
def test_hats_are_linear_between_levels_and_gaussians_the_paper_s(depths, count):
    levels = LEVELS[:count]
    depths = np.array(depths + levels.tolist())
    found = depth_weights(DepthFunctions("hat", 100.0), depths, levels)
    np.testing.assert_allclose(found, [hats(depth, levels) for depth in depths], atol=1e-12)
    off = np.clip(depths, LEVELS[0], LEVELS[-1])[:, None] - LEVELS
    found = depth_weights(DepthFunctions("gaussian", 100.0), depths, LEVELS)
    np.testing.assert_allclose(found, np.exp(-0.5 * (off / 100.0) ** 2), rtol=1e-12, atol=1e-300)
