"""The fit of a flow to velocities at nodes: on a lattice and with the kernel's columns."""

import numpy as np
import pytest

from replay_kit.core.errors import EstimatorError
from replay_kit.core.flow.functions import HorizontalKernel, NodeKernel, lattice_over
from replay_kit.estimator.basis import embedding
from replay_kit.estimator.basis.embedding import embed
from tests.reference import lattice as slow

KERNEL = HorizontalKernel(20e3, 18e3, 0.3)
NUGGET = 1e-6


def nodes_of(columns: int, rows: int) -> np.ndarray:
    """Nodes on a sheared grid with a hole, as of a curvilinear forecast with an island."""
    i, j = (axis.ravel() for axis in np.meshgrid(np.arange(columns), np.arange(rows)))
    nodes = np.column_stack([10e3 * i + 2e3 * j, 9e3 * j])
    return nodes[np.hypot(i - columns / 2, j - rows / 2) > 1.5]


def velocities(nodes: np.ndarray) -> np.ndarray:
    """Divergence-free velocities of a few scales, and noise, shape (2N, 4)."""
    rng, (x, y) = np.random.default_rng(1), nodes.T / 60e3
    eddies = [
        np.concatenate([np.cos(k * y) * np.sin(k * x), -np.cos(k * x) * np.sin(k * y)])
        for k in (1.0, 2.0, 4.0)
    ]
    return np.column_stack([*eddies, rng.standard_normal(2 * len(nodes))])


@pytest.mark.parametrize("shape", [(9, 5), (5, 9)])
def test_coefficients_are_those_of_dense_normal_equations(shape):
    nodes = nodes_of(*shape)
    lattice, velocity = lattice_over(KERNEL, nodes), velocities(nodes)
    expected = slow.embed(lattice, nodes, velocity, NUGGET)
    np.testing.assert_allclose(
        embed(lattice, nodes, velocity, NUGGET), expected, atol=1e-6 * np.abs(expected).max()
    )


def test_the_flow_is_that_of_the_kernel_s_columns_also_between_nodes():
    nodes = nodes_of(14, 11)
    velocity, kernel = velocities(nodes), NodeKernel(KERNEL, nodes)
    points = np.random.default_rng(2).uniform(nodes.min(axis=0), nodes.max(axis=0), (200, 2))
    lattice = lattice_over(KERNEL, nodes)
    ours = lattice.velocity(points, embed(lattice, nodes, velocity, NUGGET))
    theirs = kernel.velocity(points, embed(kernel, nodes, velocity, NUGGET))
    error = np.linalg.norm(ours - theirs, axis=(0, 1)) / np.linalg.norm(theirs, axis=(0, 1))
    assert np.all(error < [1e-5, 1e-5, 1e-5, 1e-3])


def test_single_precision_is_refined_to_the_same(monkeypatch):
    nodes = nodes_of(14, 11)
    lattice, velocity = lattice_over(KERNEL, nodes), velocities(nodes)
    expected = lattice.velocity(nodes, embed(lattice, nodes, velocity, NUGGET))
    monkeypatch.setattr(embedding, "_DOUBLE", 0.0)
    single = lattice.velocity(nodes, embed(lattice, nodes, velocity, NUGGET))
    assert 0.0 < np.abs(single - expected).max() < 1e-4


def test_a_nugget_that_is_too_small_is_refused():
    nodes = nodes_of(9, 5)
    with pytest.raises(EstimatorError, match="set a larger"):
        embed(lattice_over(KERNEL, nodes), nodes, velocities(nodes), 0.0)
