"""The stream function on a lattice: values, divergence, translation, pickles."""

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
    np.testing.assert_allclose(
        LATTICE.velocity(points, LATENT), expected, atol=1e-13 * np.abs(LATENT).max() / 9e3
    )


def test_a_point_s_velocity_does_not_depend_on_its_neighbours():
    points = np.concatenate([NODES, NODES + 500.0])
    together = LATTICE.velocity(points, LATENT)
    alone = np.concatenate([LATTICE.velocity(point[None], LATENT) for point in points], axis=1)
    np.testing.assert_allclose(together, alone, atol=1e-17)


def test_latent_values_in_another_order_of_memory_are_the_same():
    wide = np.asfortranarray(np.hstack([LATENT, LATENT]))
    np.testing.assert_array_equal(
        LATTICE.velocity(NODES, wide[:, 3:]), LATTICE.velocity(NODES, LATENT)
    )


def test_the_kernel_of_two_nodes_is_the_product_of_the_lattice_s_functions():
    design = slow.matrix(LATTICE, NODES)
    width = np.array(LATTICE.widths)
    share = (
        (KERNEL.speed * KERNEL.length_east) ** 2
        * np.prod(np.array(LATTICE.spacing) / width)
        / np.pi
    )
    kernel = velocity_kernel(KERNEL, NODES, NODES)
    np.testing.assert_allclose(share * design @ design.T, kernel, atol=1e-6 * kernel.max())


def test_the_divergence_is_zero():
    points, step = RNG.uniform(-25e3, 25e3, (50, 2)), 1.0
    east, north = np.array([step, 0.0]), np.array([0.0, step])
    along_east = (
        LATTICE.velocity(points + east, LATENT)[0] - LATTICE.velocity(points - east, LATENT)[0]
    )
    along_north = (
        LATTICE.velocity(points + north, LATENT)[1] - LATTICE.velocity(points - north, LATENT)[1]
    )
    # a lattice line that comes into reach between the points would show as a step of some 1e-6
    assert np.median(np.abs(along_east + along_north)) < 1e-7 * np.median(np.abs(along_east))


def test_a_lattice_moved_with_its_points_has_the_same_velocities():
    moved = replace(LATTICE, origin=(LATTICE.origin[0] + 2.0**14, LATTICE.origin[1] - 2.0**13))
    there = moved.velocity(NODES + np.array([2.0**14, -(2.0**13)]), LATENT)
    np.testing.assert_allclose(
        there, LATTICE.velocity(NODES, LATENT), atol=1e-9 * np.abs(there).max()
    )


def test_it_covers_the_nodes_and_has_a_window_at_least():
    assert LATTICE.size == np.prod(LATTICE.shape)
    low, high = (
        np.array(LATTICE.origin),
        np.array(LATTICE.origin) + (np.array(LATTICE.shape) - 1) * LATTICE.spacing,
    )
    assert np.all(low < NODES.min(axis=0))
    assert np.all(high > NODES.max(axis=0))
    assert lattice_over(KERNEL, NODES[:1]).shape == (WINDOW, WINDOW)


def test_equal_lattices_have_one_key_also_after_a_pickle():
    again = pickle.loads(pickle.dumps(LATTICE))
    assert again == LATTICE
    assert again.key == lattice_over(KERNEL, NODES).key
    assert replace(LATTICE, shape=(99, 99)).key != LATTICE.key
