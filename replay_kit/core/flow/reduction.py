"""What rows in a few directions take from a prior's covariance, level by level, without the whole covariance.

With directions B (s, r) and a matrix M (Z s, Z s), the sum of some levels' weights, 1' w, loses X' M X with X = (I (x) B) P0 (1 (x) I).
A hybrid prior is P0 = T'T + sum_q v_q v_q' (x) H_q, so that with a_q the sum of v_q over the levels and T_1 that of the factor's columns

    X = (I (x) B) T' T_1 + sum_q a_q v_q (x) B H_q,

and with M in the functions v_q instead of levels, and its products with T, computed once, each sum of levels needs products of the
directions' size alone.
"""

from collections.abc import Callable
from typing import Protocol

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.flow.covariance import Levels

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
