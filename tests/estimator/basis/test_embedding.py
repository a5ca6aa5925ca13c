"""The fit of a flow to velocities at nodes: on a lattice and with the kernel's columns."""

import numpy as np
import pytest

from replay_kit.core.errors import EstimatorError
from replay_kit.core.flow.functions import HorizontalKernel, NodeKernel
from replay_kit.core.flow.lattice import lattice_over
from replay_kit.estimator.basis import embedding
from replay_kit.estimator.basis.embedding import embed, factored, solve, times
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


@pytest.mark.parametrize(("rows", "width", "size"), [(1, 3, 1), (7, 4, 1), (9, 3, 5), (4, 6, 8)])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_solutions_and_products_of_blocks_are_dense_ones(rows, width, size, dtype):
    rng, n = np.random.default_rng(rows), rows * size
    row = np.arange(n) // size
    dense = rng.uniform(-1.0, 1.0, (n, n)) * (np.abs(row[:, None] - row) < width)
    dense += dense.T + 4.0 * width * size * np.eye(n)
    band = np.zeros((rows, width, size, size), dtype)
    for i in range(rows):
        for d in range(min(width, rows - i)):
            band[i, d] = dense.reshape(rows, size, rows, size)[i + d, :, i]
    right, atol = rng.standard_normal((n, 5)), 1e-5 if dtype == np.float32 else 1e-13
    np.testing.assert_allclose(times(band, right[:, 0]), dense @ right[:, 0], rtol=1e3 * atol)
    solution = solve(factored(band.copy()), right)
    assert solution.dtype == dtype
    np.testing.assert_allclose(solution, np.linalg.solve(dense, right), atol=atol)
