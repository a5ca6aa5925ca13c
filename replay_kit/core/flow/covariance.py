"""The covariance of a flow's weights, which is asked for in parts: a whole one has (r Z)^2 elements, and an error at a depth needs few.

With w_j the weights of level j and a weight d_j for each level, the variance of a flow with modes g at a place is g C g' with

    C = cov(sum_j d_j w_j) = sum_j d_j (d_j - sum_{k != j} d_k) cov(w_j) + sum_{j > k} d_j d_k cov(w_j + w_k),

so the covariances of single levels and of sums of two levels, r x r each, serve all depths; hat functions overlap their neighbours only.
"""

import numpy as np
from scipy.linalg.lapack import dpotrf, dpstrf

from replay_kit.core.arrays import Array
from replay_kit.core.errors import EstimatorError

# Columns of a symmetric matrix that a quadratic form takes at once.
_BLOCK = 64

#: Levels whose weights are summed: one, or two.
Levels = tuple[int, ...]


def sums_for(weights: Array) -> tuple[list[Levels], Array]:
    """Return the sums of levels whose covariances give that at each depth, and the share of each of them in it, shape (D, T).

    Args:
        weights: shape (D, Z), of each level at each depth.
    """
    together = (weights != 0.0).astype(np.float64)
    pairs = np.argwhere(np.tril(together.T @ together, -1) > 0.0)
    single = np.flatnonzero(together.any(axis=0))
    sums: list[Levels] = [(int(j),) for j in single] + [(int(j), int(k)) for j, k in pairs]
    products = weights[:, pairs[:, 0]] * weights[:, pairs[:, 1]]
    own = weights**2
    for column in range(2):
        np.subtract.at(own.T, pairs[:, column], products.T)
    return sums, np.hstack([own[:, single], products])


def quadratic_form(rows: Array, symmetric: Array) -> Array:
    """Return the diagonal of rows C rows', shape (P,): by blocks of columns of C's lower half, hence half of the products.

    Args:
        rows: shape (P, r).
        symmetric: shape (r, r), C.
    """
    out = np.zeros(len(rows))
    for start in range(0, len(symmetric), _BLOCK):
        stop = start + _BLOCK
        below = 2.0 * symmetric[start:, start:stop]
        below[:_BLOCK] = symmetric[start:stop, start:stop]
        out += np.einsum("pr,pr->p", rows[:, start:] @ below, rows[:, start:stop])
    return out


def symmetric(matrix: Array) -> Array:
    """Return a matrix that is symmetric but for rounding, shape (n, n), with its lower half on both sides."""
    lower = np.tril(matrix)
    return np.asarray(lower + np.tril(matrix, -1).T)


def root_of(cov: Array) -> Array:
    """Return a factor F of a covariance, shape (n, n): F F' is the covariance, shape (n, rank).

    It is Cholesky's; with pivots (LAPACK's pstrf) where the covariance has not its full rank.

    Raises:
        EstimatorError: The covariance is not a number.
    """
    if not np.all(np.isfinite(cov)):
        raise EstimatorError(
            "the estimate's covariance is not a number everywhere, so that no sample of it can be drawn"
        )
    lower, fails = dpotrf(cov, lower=1)
    if not fails:
        return np.asarray(lower)
    lower, order, rank, _ = dpstrf(cov, lower=1)
    factor = np.empty_like(lower)
    factor[order - 1] = np.tril(lower)
    return np.asarray(factor[:, :rank])
