"""The leading directions of many columns, from products of columns: the singular value decomposition of a matrix read in blocks of rows.

With A (2N, M), one column a slice, A'A = V S^2 V' is M x M whatever the grid's size, and U = A V S^-1. The first pass over blocks of nodes
adds up A'A, the second makes U, so A itself is never in memory. Squaring loses the directions below 1e-7 of the largest, which are taken
for rounding. What it costs the others in orthogonality, one Cholesky QR step restores: with U'U = L L', U <- U L'^-1 (Yamamoto et al.
2015, Electronic Transactions on Numerical Analysis 44, 306-326). Where slices outnumber the nodes' components, A A' is the smaller of the
two, and its eigenvectors are U. A small A is decomposed itself, which costs a fraction of a second.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from replay_kit.core.arrays import Array

# Singular values below this share of the largest: their squares are rounding of the largest one's.
_RANK = 1e-7
# The same where nothing is squared.
_EXACT_RANK = 1e-12
# Number of values up to which A is decomposed itself.
_SMALL = 500_000

#: Gives the slices block by block, anew each time it is called: which nodes, and the slices at them, shape (M, 2, n).
SliceBlocks = Callable[[], Iterable[tuple[slice, Array]]]


@dataclass(frozen=True, slots=True, eq=False)
class Decomposition:
    """The leading directions of slices.

    Attributes:
        vectors: shape (2N, r), orthonormal columns.
        singular_values: shape (min(M, 2N),), of all directions, decreasing.
        products: shape (M, r), of each slice with the vectors.
    """

    vectors: Array
    singular_values: Array
    products: Array


def decompose(
    blocks: SliceBlocks, n_slices: int, n_nodes: int, n_modes: int | None
) -> Decomposition:
    """Return the leading directions of slices; see the module.

    Args:
        blocks: The slices.
        n_slices: Number of slices M.
        n_nodes: Number of nodes N.
        n_modes: Number of directions; None for as many as the slices have.
    """
    if 2 * n_nodes * n_slices <= _SMALL:
        columns = _gathered(blocks, n_slices, n_nodes)
        vectors, values = exact_svd(columns, n_modes)
        products = columns.T @ vectors
        return Decomposition(vectors, values, products)
    of_slices = _by_nodes if n_slices > 2 * n_nodes else _by_slices
    vectors, values, products = of_slices(blocks, n_slices, n_nodes, n_modes)
    sign = _signs(vectors)
    return Decomposition(vectors * sign, values, products * sign)


def exact_svd(columns: Array, n_modes: int | None) -> tuple[Array, Array]:
    """Return the leading left singular vectors of a matrix, signs fixed, and all singular values."""
    u, s, _ = scipy.linalg.svd(columns, full_matrices=False, lapack_driver="gesdd")
    rank = int(np.sum(s > s[0] * _EXACT_RANK))
    return (u * _signs(u))[:, : min(n_modes or rank, rank)], s


def _gathered(blocks: SliceBlocks, n_slices: int, n_nodes: int) -> Array:
    """Return all slices as columns, shape (2N, M)."""
    by_component = np.empty((n_slices, 2, n_nodes))
    for nodes, block in blocks():
        by_component[:, :, nodes] = block
    return by_component.reshape(n_slices, -1).T


def _by_slices(
    blocks: SliceBlocks, n_slices: int, n_nodes: int, n_modes: int | None
) -> tuple[Array, Array, Array]:
    """Return vectors, singular values and products, by A'A."""
    gram = np.zeros((n_slices, n_slices), order="F")
    for _, block in blocks():
        gram = scipy.linalg.blas.dsyrk(
            1.0, block.reshape(n_slices, -1).T, beta=1.0, c=gram, trans=1, lower=1, overwrite_c=1
        )
    values, right = _leading(gram, n_modes)
    scale = values[: right.shape[1]]
    by_component = np.empty((2, n_nodes, scale.size))
    to_vectors = right / scale
    for nodes, block in blocks():
        by_component[:, nodes] = (block.reshape(n_slices, -1).T @ to_vectors).reshape(
            2, -1, scale.size
        )
    vectors = by_component.reshape(2 * n_nodes, -1)
    upper = np.asarray(np.linalg.cholesky(vectors.T @ vectors)).T
    inverse = scipy.linalg.solve_triangular(upper, np.eye(scale.size))
    return vectors @ inverse, values, (right * scale) @ inverse


def _by_nodes(
    blocks: SliceBlocks, n_slices: int, n_nodes: int, n_modes: int | None
) -> tuple[Array, Array, Array]:
    """Return the same by A A'."""
    columns = _gathered(blocks, n_slices, n_nodes)
    values, vectors = _leading(columns @ columns.T, n_modes)
    return vectors, values, columns.T @ vectors


def _leading(gram: Array, n_modes: int | None) -> tuple[Array, Array]:
    """Return the square roots of all eigenvalues, decreasing, and the leading eigenvectors; the lower half of ``gram`` is overwritten."""
    squares, vectors = scipy.linalg.eigh(
        gram, lower=True, overwrite_a=True, check_finite=False, driver="evd"
    )
    values = np.sqrt(np.maximum(squares[::-1], 0.0))
    rank = int(np.sum(values > _RANK * values[0]))
    return values, vectors[:, ::-1][:, : min(n_modes or rank, rank)]


def _signs(vectors: Array) -> Array:
    """Return the signs, shape (r,), that make the largest element of each vector positive."""
    largest = np.argmax(np.abs(vectors), axis=0)
    return np.asarray(np.sign(vectors[largest, np.arange(vectors.shape[1])]))
