"""Products of a covariance of weights that is the sum of a low-rank part and of one that is independent between vertical functions.

With rows T, shape (F, Z r), vertical functions v_q and covariances H_q of the modes' amplitudes it is T'T + sum_q v_q v_q' (x) H_q.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.flow.reduction import Reduction, hybrid_reduction


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
