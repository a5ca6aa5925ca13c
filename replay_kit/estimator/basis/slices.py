"""Velocity slices of ensemble members at the nodes: length and speed scales, singular value decomposition.

All that a basis needs of an ensemble are sums over nodes, so members are read by blocks of grid rows. An ensemble on disk is never
in memory as a whole.

**Decomposition.** With A (2N, M), one column a slice, A'A = V S^2 V' is M x M whatever the grid's size, and U = A V S^-1. The first pass
over blocks of nodes adds up A'A, the second makes U, so A itself is never in memory. Squaring loses the directions below 1e-7 of the
largest, which count as rounding. One Cholesky QR step restores the orthogonality of the others: with U'U = L L', U <- U
L'^-1 (Yamamoto et al. 2015, Electronic Transactions on Numerical Analysis 44, 306-326). A small A, or one with more columns than rows, is
decomposed directly.

If fewer directions are requested, all below 2e-4 of the largest are dropped too. They are chance: members rounded to 1e-5 m/s have
others. As all span the localised covariance alike, however weak, they would change an estimate by several percent.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np
import scipy.linalg

from replay_kit.core.arrays import Array, Values, one_by_one
from replay_kit.core.grid import Ensemble, Grid

# Values of all members in a block of rows, 32 MB.
_BLOCK_VALUES = 4_000_000


def ensemble_slices(ensemble: Ensemble) -> Array:
    """Return the members' velocities at the nodes, shape (E, Z, 2N) [m/s]; see ``slice_blocks``."""
    blocks = [block for _, block in slice_blocks([ensemble])]
    return np.concatenate(blocks, axis=3).reshape(*blocks[0].shape[:2], -1)


def slice_blocks(series: Sequence[Ensemble]) -> Iterator[tuple[slice, Array]]:
    """Yield blocks of nodes and the members' velocities there, shape (T E, Z, 2, n) [m/s].

    Below the sea floor a column keeps the velocity of its deepest wet level, so that modes have no jump there; the grid's mask
    keeps such points out of every result.

    Args:
        series: Forecast at T times, same members and grid.
    """
    first, fields, whole = 0, len(series) * series[0].n_members, series[0].grid.wet
    step = max(1, _BLOCK_VALUES // (2 * fields * whole[:, 0].size))
    for start in range(0, whole.shape[1], step):
        wet = whole[:, start : start + step]
        rows = (ensemble.rows(start, start + step)[..., wet[0]] for ensemble in series)
        block = np.concatenate([np.moveaxis(each, 2, 1) for each in rows])
        for z in range(1, len(wet)):
            dry = ~wet[z][wet[0]]
            block[:, z, :, dry] = block[:, z - 1, :, dry]
        nodes = slice(first, first + block.shape[3])
        first = nodes.stop
        yield nodes, block


def surface_speed(*series: Ensemble) -> float:
    """Return the RMS velocity component over nodes, members and times at the first level [m/s]."""
    top = series[0].grid.wet[0]
    squares = [
        np.mean(member[:, 0, top] ** 2, dtype=float)
        for ensemble in series
        for member in one_by_one(ensemble.velocity)
    ]
    return float(np.sqrt(np.mean(squares)))


def cell_size(grid: Grid) -> tuple[float, float]:
    """Return the median spacing of grid points along both grid axes [m], the axis nearer to east-west first."""
    sizes = float(np.median(grid.steps(1))), float(np.median(grid.steps(0)))
    i_is_east = np.median(np.abs(np.diff(grid.east, axis=1))) >= np.median(
        np.abs(np.diff(grid.north, axis=1))
    )
    return sizes if i_is_east else sizes[::-1]


def correlation_length(*series: Ensemble) -> float:
    """Return the correlation length of the members' anomalies [m]: their standard deviation over that of their gradient.

    That is the scale of the correlation's parabola at zero distance (Daley 1991, Atmospheric Data Analysis, section 4.3), pooled over
    times, components, levels and both directions of the grid. It is at least one cell, the resolution of the grid.
    """
    square, *slopes = mean_squares(*series).tolist()
    cell, slope = float(np.sqrt(np.prod(cell_size(series[0].grid)))), np.mean(slopes)
    return max(cell, float(np.sqrt(square / slope))) if slope > 0.0 else cell


def mean_squares(*series: Ensemble, about_mean: bool = True) -> Array:
    """Return the mean squares of a velocity component [m^2/s^2] and of its slopes along both grid axes [1/s^2], shape (3,).

    Args:
        series: Members at each time, one at a time in memory.
        about_mean: Whether to subtract the ensemble mean.
    """
    grid, total, mean = series[0].grid, np.zeros(3), np.zeros((2, *series[0].grid.wet.shape))
    neighbours = grid.wet[:, 1:] & grid.wet[:, :-1], grid.wet[..., 1:] & grid.wet[..., :-1]
    # over the distance between neighbours in water; 0 where one is dry
    inverse = [both / grid.steps(axis) for axis, both in enumerate(neighbours)]
    count = len(series) * series[0].n_members

    def members() -> Iterator[Values]:
        return (member for ensemble in series for member in one_by_one(ensemble.velocity))

    for member in members() if about_mean else ():
        mean += member
    mean /= count
    for member in members():
        off = np.where(grid.wet, member - mean, 0.0)
        slopes = (np.diff(off, axis=axis - 2) * inverse[axis] for axis in (0, 1))
        total += [np.vdot(each, each) for each in (off, *slopes)]
    points = [np.count_nonzero(wet) for wet in (grid.wet, *neighbours)]
    return np.asarray(total / (2 * count * np.maximum(points, 1)))


# Singular values below this share of the largest: their squares are rounding of the largest one's.
_RANK = 1e-7
# The same where nothing is squared.
_EXACT_RANK = 1e-12
# The same where not all directions are asked for.
_CLEAR = 2e-4
# Number of values up to which A is decomposed itself.
_SMALL = 500_000

#: Gives the slices block by block, anew each time it is called: which nodes, and the slices at them, shape (M, 2, n).
SliceBlocks = Callable[[], Iterable[tuple[slice, Array]]]


def strongest_functions(fields: SliceBlocks, count: int) -> Array:
    """Return the vertical functions with most of the variance of fields, orthonormal rows, shape (K, Z).

    Args:
        fields: Blocks of slices, shape (F, Z, 2, n).
        count: Largest number K; the number of levels or more gives the levels themselves.
    """
    n_levels = next(iter(fields()))[1].shape[1]
    if count >= n_levels:
        return np.eye(n_levels)
    covariance = np.zeros((n_levels, n_levels))
    for _, block in fields():
        for field in block.reshape(len(block), n_levels, -1):
            covariance += field @ field.T
    return np.asarray(np.linalg.eigh(covariance)[1].T[: -count - 1 : -1])


def decompose(blocks: SliceBlocks, n_nodes: int, n_modes: int | None) -> tuple[Array, Array]:
    """Return the leading left singular vectors of slices, and their singular values; see the module.

    Args:
        blocks: Blocks of slices.
        n_nodes: Number of nodes N.
        n_modes: Largest number of directions; None for all of the slices.

    Returns:
        Orthonormal columns, shape (2N, r); singular values of all directions, decreasing, shape (min(M, 2N),).
    """
    n_slices = len(next(iter(blocks()))[1])
    if 2 * n_nodes * n_slices <= _SMALL or n_slices > 2 * n_nodes:
        vectors, values = exact_svd(gathered_slices(blocks, n_nodes), n_modes)
    else:
        vectors, values = _by_slices(blocks, n_nodes, n_modes)
        vectors *= _signs(vectors)
    clear = None if n_modes is None else int(np.sum(values > _CLEAR * values[0]))
    return vectors[:, :clear], values


def products(blocks: SliceBlocks, vectors: Array) -> Array:
    """Return the products of slices with vectors, shape (M, r); the vectors have shape (2N, r)."""
    by_component = vectors.reshape(2, -1, vectors.shape[1])
    parts = (
        _flat(block) @ by_component[:, nodes].reshape(-1, vectors.shape[1])
        for nodes, block in blocks()
    )
    return np.asarray(sum(parts))


def exact_svd(columns: Array, n_modes: int | None) -> tuple[Array, Array]:
    """Return the leading left singular vectors of a matrix, signs fixed, and all singular values."""
    u, s, _ = scipy.linalg.svd(columns, full_matrices=False, lapack_driver="gesdd")
    rank = int(np.sum(s > s[0] * _EXACT_RANK))
    return (u * _signs(u))[:, : min(n_modes or rank, rank)], s


def gathered_slices(blocks: SliceBlocks, n_nodes: int) -> Array:
    """Return all slices as columns, shape (2N, M)."""
    parts = sorted(blocks(), key=lambda each: each[0].start or 0)
    return np.concatenate([block for _, block in parts], axis=2).reshape(-1, 2 * n_nodes).T


def _by_slices(blocks: SliceBlocks, n_nodes: int, n_modes: int | None) -> tuple[Array, Array]:
    """Return the left singular vectors and all singular values, from A'A."""
    gram = sum(_flat(block) @ _flat(block).T for _, block in blocks())
    squares, right = scipy.linalg.eigh(gram, overwrite_a=True, check_finite=False, driver="evd")
    values = np.sqrt(np.maximum(squares[::-1], 0.0))
    rank = int(np.sum(values > _RANK * values[0]))
    right = right[:, ::-1][:, : min(n_modes or rank, rank)] / values[: min(n_modes or rank, rank)]
    by_component = np.empty((2, n_nodes, right.shape[1]))
    for nodes, block in blocks():
        by_component[:, nodes] = (_flat(block).T @ right).reshape(2, -1, right.shape[1])
    vectors = by_component.reshape(2 * n_nodes, -1)
    upper = np.linalg.cholesky(vectors.T @ vectors).T
    return vectors @ scipy.linalg.solve_triangular(upper, np.eye(len(upper))), values


def _flat(block: Array) -> Array:
    return block.reshape(len(block), -1)


def _signs(vectors: Array) -> Array:
    """Return the signs, shape (r,), that make the largest element of each vector positive."""
    largest = np.argmax(np.abs(vectors), axis=0)
    return np.asarray(np.sign(vectors[largest, np.arange(vectors.shape[1])]))
