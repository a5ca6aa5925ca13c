"""The covariance of a flow's weights, computed in parts: a whole one has (r Z)^2 elements, and an error at a depth needs few.

With w_j the weights of level j and a weight d_j for each level, the variance of a flow with modes g at a place is g C g' with

    C = cov(sum_j d_j w_j) = sum_j d_j (d_j - sum_{k != j} d_k) cov(w_j) + sum_{j > k} d_j d_k cov(w_j + w_k),

so the covariances of single levels and of sums of two levels, r x r each, serve all depths; hat functions overlap their neighbours only.

A hybrid covariance is the sum of a low-rank part and of one that is independent between vertical functions: with rows T, shape (F, Z r),
vertical functions v_q and covariances H_q of the modes' amplitudes it is P0 = T'T + sum_q v_q v_q' (x) H_q.

Measured rows in a few directions B (s, r) with a matrix M (Z s, Z s) reduce the covariance of a sum of levels, 1' w, by X' M X with
X = (I (x) B) P0 (1 (x) I). With a_q the sum of v_q over the levels and T_1 that of the factor's columns

    X = (I (x) B) T' T_1 + sum_q a_q v_q (x) B H_q,

and with M in the functions v_q instead of levels, and its products with T, computed once, each sum of levels needs products of the
directions' size alone.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

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
    out = matrix.copy()
    for start in range(0, len(out), _BLOCK):
        rows = slice(start, start + _BLOCK)
        out[:start, rows] = matrix[rows, :start].T
        lower = np.tril(matrix[rows, rows])
        out[rows, rows] = lower + np.tril(lower, -1).T
    return out


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
    # loads slowly, and what draws no samples needs none
    from scipy.linalg.lapack import dpotrf, dpstrf

    lower, fails = dpotrf(cov, lower=1)
    if not fails:
        return np.asarray(lower)
    lower, order, rank, _ = dpstrf(cov, lower=1)
    factor = np.empty_like(lower)
    factor[order - 1] = np.tril(lower)
    return np.asarray(factor[:, :rank])


#: Returns X' M X, shape (r, r), for a sum of levels.
Reduction = Callable[[Levels], Array]


class _Products(Protocol):
    """A covariance known by its products."""

    def matvec_modes(self, basis: Array, levels: Levels | None = None) -> Array:
        """Return the covariance of some levels' weights with ``basis``, shape (c, r), at each level: shape (Z, c, L, r)."""
        ...


def reduction_by_products(prior: _Products, directions: Array, matrix: Array) -> Reduction:
    """Return the reduction X' M X of any prior, X by its products.

    Args:
        prior: The prior.
        directions: shape (s, r), B.
        matrix: shape (Z s, Z s), M, symmetric.
    """

    def reduction(levels: Levels) -> Array:
        across = prior.matvec_modes(directions, levels).sum(axis=2).reshape(len(matrix), -1)
        return np.asarray(across.T @ matrix @ across)

    return reduction


def hybrid_reduction(
    factor: Array, vertical: Array, horizontal: Array, directions: Array, matrix: Array
) -> Reduction:
    """Return the reduction of a hybrid prior; see the module.

    Args:
        factor: shape (F, Z, r), T.
        vertical: shape (q, Z), v.
        horizontal: shape (g, r, r), H; functions from the g-th on have the last.
        directions: shape (s, r), B.
        matrix: shape (Z s, Z s), M, symmetric.
    """
    n_rows, n_levels, n_modes = factor.shape
    size, n_functions, n_groups = len(directions), len(vertical), len(horizontal)
    of_factor = (factor @ directions.T).reshape(n_rows, -1)  # (F, Z s)
    by_factor = of_factor @ matrix
    square = by_factor @ of_factor.T
    # columns, then rows, from levels to functions
    to_functions = np.einsum(
        "fzs,qz->fqs", by_factor.reshape(n_rows, n_levels, size), vertical, optimize=True
    )
    half = np.matmul(vertical, matrix.reshape(-1, n_levels, size)).reshape(n_levels, -1)
    in_functions = (vertical @ half).reshape(n_functions, size, n_functions, size)
    # of what is left, functions of one covariance are summed with their weights
    through = np.matmul(directions, horizontal).reshape(-1, n_modes)  # (g s, r)
    groups = np.minimum(np.arange(n_functions), n_groups - 1)

    def reduction(levels: Levels) -> Array:
        chosen = list(levels)
        share = np.zeros((n_groups, n_functions))
        share[groups, np.arange(n_functions)] = vertical[:, chosen].sum(axis=1)
        of_levels = factor[:, chosen].sum(axis=1)
        mixed = np.tensordot(share, in_functions, 1).reshape(-1, n_functions, size)
        core = np.matmul(share, mixed).reshape(n_groups * size, -1)
        crossed = np.matmul(share, to_functions).reshape(n_rows, -1) @ through
        half = of_levels.T @ (0.5 * square @ of_levels + crossed)
        return np.asarray(half + half.T + through.T @ (core @ through))

    return reduction


def indices_of(levels: tuple[int, ...] | None) -> slice | list[int]:
    """Return the index of some levels along their axis."""
    return slice(None) if levels is None else list(levels)


class HybridProducts:
    """The products of such a covariance; its parts are attributes of the class that inherits from this one.

    Attributes:
        factor: shape (F, Z, r), T.
        vertical: shape (q, Z), orthogonal rows, v.
        horizontal: shape (g, r, r), H; functions from the g-th on have the last.
    """

    __slots__ = ()

    factor: Array
    vertical: Array
    horizontal: Array

    def matvec(self, weights: Array) -> Array:
        """Return the covariance times each weight vector, shape (m, Z, r), in the same shape."""
        n_weights = self.factor.shape[1] * self.factor.shape[2]
        rows = self.factor.reshape(-1, n_weights)
        of_factor = ((weights.reshape(len(weights), n_weights) @ rows.T) @ rows).reshape(
            weights.shape
        )
        in_functions = (self.vertical @ weights).swapaxes(0, 1)  # (q, m, r)
        groups = [np.matmul(in_functions[part], of_modes) for part, of_modes in self._groups()]
        return np.asarray(
            of_factor
            + np.einsum(
                "qz,qmr->mzr",
                self.vertical,
                np.concatenate([in_functions[:0], *groups]),
                optimize=True,
            )
        )

    def matvec_modes(self, basis: Array, levels: tuple[int, ...] | None = None) -> Array:
        """Return the covariance of some levels' weights with ``basis``, shape (c, r), at each level: shape (Z, c, L, r)."""
        n_rows, n_levels, n_modes = self.factor.shape
        n_basis, chosen = basis.shape[0], indices_of(levels)
        factor = self.factor[:, chosen]
        n_chosen = factor.shape[1]
        at_basis = (self.factor @ basis.T).reshape(n_rows, n_levels * n_basis)
        of_factor = (at_basis.T @ factor.reshape(n_rows, n_chosen * n_modes)).reshape(
            n_levels, n_basis, n_chosen, n_modes
        )
        in_modes = np.matmul(basis, self.horizontal).reshape(
            len(self.horizontal), basis.size
        )  # (g, c r)
        pairs = self._pairs(slice(None), chosen).reshape(-1, n_levels * n_chosen)
        in_functions = (pairs.T @ in_modes).reshape(n_levels, n_chosen, n_basis, n_modes)
        of_factor += in_functions.transpose(0, 2, 1, 3)
        return np.asarray(of_factor)

    def mode_std(self) -> Array:
        """Return the standard deviation of each mode's weight, root mean square over levels, shape (r,)."""
        of_factor = np.einsum("fzr,fzr->r", self.factor, self.factor)
        # the squares of the functions of one covariance sum to one
        in_functions = np.einsum("grr->r", self.horizontal)
        return np.asarray(np.sqrt((of_factor + in_functions) / self.factor.shape[1]))

    def covariance(self, levels: tuple[int, ...] | None = None) -> Array:
        """Return the covariance of some levels' weights, None for all, as one matrix, shape (L r, L r)."""
        chosen = indices_of(levels)
        factor = self.factor[:, chosen]
        n_rows, n_levels, n_modes = factor.shape
        stacked = factor.reshape(n_rows, n_levels * n_modes)
        cov = stacked.T @ stacked
        block = cov.reshape(n_levels, n_modes, n_levels, n_modes)
        for pairs, of_modes in zip(self._pairs(chosen, chosen), self.horizontal, strict=True):
            block += np.multiply.outer(pairs, of_modes).transpose(0, 2, 1, 3)
        return cov

    def of_sum(self, levels: tuple[int, ...]) -> Array:
        """Return the covariance of the sum of some levels' weights, shape (r, r)."""
        factor, share = (
            self.factor[:, list(levels)].sum(axis=1),
            np.square(self.vertical[:, list(levels)].sum(axis=1)),
        )
        shares = np.array([share[part].sum() for part, _ in self._groups()])
        return np.asarray(factor.T @ factor + np.tensordot(shares, self.horizontal, 1))

    def reduction(self, directions: Array, matrix: Array) -> Reduction:
        """Return what rows in ``directions``, shape (s, r), with ``matrix``, shape (Z s, Z s), take from sums of levels."""
        return hybrid_reduction(self.factor, self.vertical, self.horizontal, directions, matrix)

    def _groups(self) -> Iterator[tuple[slice, Array]]:
        """Yield the functions that share a covariance of the modes' amplitudes, and that covariance."""
        last = len(self.horizontal) - 1
        for group, of_modes in enumerate(self.horizontal):
            yield slice(group, None if group == last else group + 1), of_modes

    def _pairs(self, levels: slice | list[int], others: slice | list[int]) -> Array:
        """Return the covariance between levels of one unit of each covariance of the modes' amplitudes, shape (g, L, M)."""
        rows, columns = self.vertical[:, levels], self.vertical[:, others]
        parts = [rows[part].T @ columns[part] for part, _ in self._groups()]
        return np.stack(parts) if parts else np.empty((0, rows.shape[1], columns.shape[1]))


@dataclass(frozen=True, slots=True, eq=False)
class HybridCovariance(HybridProducts):
    """Such a covariance on its own; the attributes are those of ``HybridProducts``."""

    factor: Array
    vertical: Array
    horizontal: Array
