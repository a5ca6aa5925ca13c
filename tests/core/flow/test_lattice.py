"""The stream function on a lattice: values, whatever the order of memory, and pickles."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from replay_kit.core.flow.functions import HorizontalKernel, velocity_kernel
from replay_kit.core.flow.lattice import WINDOW, lattice_over
from tests.reference import lattice as slow

KERNEL = HorizontalKernel(9_000.0, 11_000.0, 0.2)
RNG = np.random.default_rng(5)
NODES = RNG.uniform([-30e3, -20e3], [30e3, 20e3], (40, 2))
LATTICE = lattice_over(KERNEL, NODES)
LATENT = RNG.standard_normal((LATTICE.size, 3))


@pytest.mark.parametrize("count", [1, 3, 5, 60])
def test_velocities_are_the_sums_of_the_gaussians_within_the_lattice_and_beyond(count):
    points = np.random.default_rng(count).uniform(-90e3, 90e3, (count, 2))
    expected = (slow.matrix(LATTICE, points) @ LATENT).reshape(2, count, 3)
    for latent in (LATENT, np.asfortranarray(np.hstack([LATENT, LATENT]))[:, 3:]):
        np.testing.assert_allclose(
            LATTICE.velocity(points, latent), expected, atol=1e-13 * np.abs(LATENT).max() / 9e3
        )


def test_the_kernel_of_two_nodes_is_the_product_of_the_lattice_s_functions():
    design, cells = slow.matrix(LATTICE, NODES), np.divide(LATTICE.spacing, LATTICE.widths)
    share = (KERNEL.speed * KERNEL.length_east) ** 2 * np.prod(cells) / np.pi
    kernel = velocity_kernel(KERNEL, NODES, NODES)
    np.testing.assert_allclose(share * design @ design.T, kernel, atol=1e-6 * kernel.max())


def test_it_covers_the_nodes_and_has_a_window_at_least():
    low = np.array(LATTICE.origin)
    assert np.all(low < NODES.min(axis=0))
    assert np.all(low + np.subtract(LATTICE.shape, 1) * LATTICE.spacing > NODES.max(axis=0))
    assert lattice_over(KERNEL, NODES[:1]).shape == (WINDOW, WINDOW)


def test_equal_lattices_have_one_key_also_after_a_pickle():
    again = pickle.loads(pickle.dumps(LATTICE))
    assert again == LATTICE
    assert again.key == lattice_over(KERNEL, NODES).key
    assert replace(LATTICE, shape=(99, 99)).key != LATTICE.key
