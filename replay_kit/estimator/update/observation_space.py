"""The posterior in observation space: exact, and cheap while the measured rows are fewer than the weights.

With all rows H (K, Z r), their whitened data z and the prior N(w0, P0):

    C = H P0 H' + I = L L',    f = L^-1 (z - H w0),    mean = w0 + P0 H' L^-T f,    P = P0 - (L^-1 H P0)' (L^-1 H P0).

A profile h appends to L the rows [x', chol(S)] with x = L^-1 H P0 h', S = I + h P0 h' - x'x, and to f its innovation
z - h w0 - x'f whitened by S. Nothing before it changes: all states of a run share one Cholesky factor, which grows at its end.
The effects of instrument errors of one unit on z are further columns of z and f.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.linalg.lapack

from replay_kit.core.arrays import Array
from replay_kit.core.flow.reduction import Reduction
from replay_kit.estimator.prior.hybrid import Prior
from replay_kit.estimator.update.compression import ProfileRows
from replay_kit.estimator.update.posterior import (
    Posterior,
    PredictedObservation,
    PriorCrossCovariance,
    gram,
    prior_cross_covariances,
    rank_k_update,
    tiled_product,
)
from replay_kit.estimator.update.subspace import directions, nonzero_mode_std

# Rows of L kept together: one product with earlier unknowns for all of them.
_PANEL_ROWS = 256


class GrowingCholesky:
    """Rows and the Cholesky factor of their covariance, which only grow at the end.

    A state owns the first ``n`` profiles. If the factor holds no others, they are extended in place; otherwise another state has already
    continued from this one, and a copy is extended. So no state ever changes, and a run of steps copies nothing.

    Attributes:
        basis: shape (capacity, 2, r), G of each profile.
        depth: shape (capacity, Z, Z), R of each, padded with rows of zeros where it has fewer than Z.
        slots: shape (2 Z capacity,), position of each row in (profile, component, row of R).
        forward: shape (2 Z capacity, 1 + b), f.
        ends: Number of rows after 0, 1, 2 ... profiles.
        panels: Panels of L, ``panel_profiles`` profiles each.
    """

    def __init__(self, n_levels: int, n_modes: int, capacity: int, n_columns: int) -> None:
        self.basis = np.zeros((capacity, 2, n_modes))
        self.depth = np.zeros((capacity, n_levels, n_levels))
        self.slots = np.zeros(2 * n_levels * capacity, dtype=np.intp)
        self.forward = np.zeros((2 * n_levels * capacity, n_columns))
        self.ends = [0]
        self.panels: list[tuple[Array, Array]] = []
        self.panel_profiles = max(1, _PANEL_ROWS // (2 * n_levels))

    def extended(self, n: int) -> "GrowingCholesky":
        """Return a factor that holds the first n profiles and room for one more: this one where possible, else a copy."""
        return self if n == len(self.ends) - 1 < len(self.basis) else self._copy(n)

    def rescaled(self, n: int, scale: float) -> "GrowingCholesky":
        """Return a factor of the first n profiles with rows and data multiplied by a number; L is the same."""
        new = self._copy(n)
        new.depth[:n] *= scale
        new.forward[: new.ends[n]] *= scale
        return new

    def _copy(self, n: int) -> "GrowingCholesky":
        _, n_levels, _ = self.depth.shape
        new = GrowingCholesky(n_levels, self.basis.shape[2], max(16, 2 * n), self.forward.shape[1])
        new.basis[:n], new.depth[:n] = self.basis[:n], self.depth[:n]
        rows = self.ends[n]
        new.slots[:rows], new.forward[:rows] = self.slots[:rows], self.forward[:rows]
        new.ends = self.ends[: n + 1]
        # full panels never change again
        full, rest = divmod(n, self.panel_profiles)
        new.panels = self.panels[:full]
        if rest:
            left, corner = self.panels[full]
            new.panels.append((left.copy(), corner.copy(order="F")))
        return new

    def append(self, rows: ProfileRows, error_scale: float, before: Array, lower: Array, forward: Array) -> None:
        """Append a profile: its rows over the scale; of L the part left of the diagonal, ``before``, and the diagonal block ``lower``."""
        n, start, k = len(self.ends) - 1, self.ends[-1], rows.r.shape[0]
        stop, n_levels = start + 2 * k, self.depth.shape[1]
        self.basis[n], self.depth[n, :k] = rows.basis, rows.r / error_scale
        self.slots[start:stop] = np.add.outer(n_levels * (2 * n + np.arange(2)), np.arange(k)).ravel()
        self.forward[start:stop] = forward
        if n % self.panel_profiles == 0:
            height = 2 * n_levels * self.panel_profiles
            self.panels.append((np.zeros((height, start)), np.zeros((height, height), order="F")))
        left, corner = self.panels[-1]
        first = self.ends[n - n % self.panel_profiles]
        inside = slice(start - first, stop - first)
        left[inside] = before[:, :first]
        corner[inside, : start - first] = before[:, first:]
        corner[inside, inside] = lower
        self.ends.append(stop)

    def solve(self, n: int, right: Array, solved: Array | None = None) -> Array:
        """Return L^-1 right, of the first n profiles.

        Args:
            n: Number of profiles.
            right: shape (K, m), or its last rows when the first are solved.
            solved: shape (., m), rows of the solution for the first full panels.
        """
        known = 0 if solved is None else len(solved)
        out = np.empty((known + len(right), right.shape[1]))
        if solved is not None:
            out[:known] = solved
        for left, corner, start, stop in self._panels(n):
            if start >= known:
                out[start:stop] = _solve(corner, right[start - known : stop - known] - tiled_product(left, out[:start]), 0)
        return out

    def solve_transposed(self, n: int, right: Array) -> Array:
        """Return L'^-1 right, of the first n profiles; ``right`` of shape (K, m)."""
        out = right.copy()
        for left, corner, start, stop in reversed(list(self._panels(n))):
            out[start:stop] = _solve(corner, out[start:stop], 1)
            out[:start] -= left.T @ out[start:stop]
        return out

    def _panels(self, n: int) -> Iterator[tuple[Array, Array, int, int]]:
        """Yield each panel's part left of its diagonal block, that block, and its first and last row."""
        for number, (left, corner) in enumerate(self.panels[: -(-n // self.panel_profiles)]):
            first = number * self.panel_profiles
            start, stop = self.ends[first], self.ends[min(first + self.panel_profiles, n)]
            yield left[: stop - start], corner[: stop - start, : stop - start], start, stop


def _solve(corner: Array, right: Array, transposed: int) -> Array:
    """Return the solution of a lower triangular system, or of its transpose; SciPy's own checks would take longer than the solution."""
    solution, info = scipy.linalg.lapack.dtrtrs(corner, right, lower=1, trans=transposed)
    assert info == 0
    return np.asarray(solution)


@dataclass(frozen=True, eq=False)
class ObservationSpacePosterior(Posterior):
    """The posterior in observation space.

    Attributes:
        factor: Rows and Cholesky factor, of which the first ``n`` profiles belong to this posterior.
        n: Number of profiles.
    """

    factor: GrowingCholesky
    n: int

    @property
    def n_rows(self) -> int:
        """Number of rows K."""
        return self.factor.ends[self.n]

    @property
    def forward(self) -> Array:
        """f, shape (K, 1 + b)."""
        return self.factor.forward[: self.n_rows]

    @property
    def shared_factor(self) -> Any:
        """The growing Cholesky factor."""
        return self.factor

    @staticmethod
    def information_vectors(posteriors: "Sequence[ObservationSpacePosterior]") -> Array:
        """Return H' L'^-1 f of posteriors of one factor, shape (m, Z, r); zeros below f leave L'^-1 f as it is without those rows."""
        last = max(posteriors, key=lambda posterior: posterior.n)
        forward = np.zeros((last.n_rows, len(posteriors)))
        for column, posterior in enumerate(posteriors):
            forward[: posterior.n_rows, column] = posterior.forward[:, 0]
        return last._to_weights(forward)

    def _to_weights(self, forward: Array) -> Array:
        """Return H' L'^-1 of columns, shape (K, m), in the shape (m, Z, r)."""
        factor, n, m, n_levels = self.factor, self.n, forward.shape[1], self.n_levels
        padded = np.zeros((m, n * 2 * n_levels))
        padded[:, factor.slots[: self.n_rows]] = factor.solve_transposed(n, forward).T
        by_level = np.matmul(padded.reshape(m, n, 2, n_levels), factor.depth[:n])
        by_profile = by_level.reshape(m, 2 * n, n_levels).swapaxes(1, 2).reshape(m * n_levels, 2 * n)
        return np.asarray(by_profile @ self.profile_basis).reshape(m, n_levels, self.profile_basis.shape[1])

    def bias_information(self) -> Array:
        """Return H' L'^-1 f of the instrument errors of one unit, shape (b, Z, r)."""
        return self._to_weights(self.forward[:, 1:])

    def covariance(self, levels: tuple[int, ...] | None = None) -> Array:
        """Return the covariance of some levels' weights, None for all, shape (L r, L r)."""
        cov, rows = self.prior.covariance(levels), self.whitened_cross(levels)
        rank_k_update(cov, rows, -rows)
        return cov

    def reduction(self) -> Reduction:
        """Return what the rows took from the prior's covariance of sums of levels."""

        def reduction(levels: tuple[int, ...]) -> Array:
            rows = self.whitened_cross(levels)
            rows = rows.reshape(len(rows), len(levels), rows.shape[1] // len(levels)).sum(axis=1)
            return np.asarray(rows.T @ rows)

        return reduction

    def taken(self, most: int) -> tuple[Array, Array] | None:
        """Return B, shape (s, r), and M, shape (Z s, Z s): the Gram matrix of L^-1 H in the directions; None with more than ``most``."""
        n_modes = self.factor.basis.shape[2]
        if self.n == 0:
            return np.empty((0, n_modes)), np.empty((0, 0))
        mode_std = nonzero_mode_std(self.prior)
        found = directions(self.profile_basis * mode_std)
        if len(found) > most:
            return None
        return found / mode_std, gram(self.rows_in((self.profile_basis * mode_std) @ found.T))

    def rows_in(self, inside: Array) -> Array:
        """Return L^-1 H in some directions, shape (K, Z s), of all G in them, shape (2 n, s)."""
        return self.factor.solve(self.n, self.design(inside))

    def covariance_of(self, design: Array) -> Array:
        """Return the covariance of combinations of the weights, shape (m, m); ``design`` of shape (m, Z, r)."""
        cross, m = self.prior.matvec(design), len(design)
        before = self.factor.solve(self.n, self._rows_times(cross, 0, self.n))
        return np.asarray(design.reshape(m, -1) @ cross.reshape(m, -1).T - before.T @ before)

    def whitened_cross(self, levels: tuple[int, ...] | None = None) -> Array:
        """Return the columns of L^-1 H P0 for some levels, None for all, shape (K, L r)."""
        at_levels = self.prior.matvec_modes(self.profile_basis, levels).swapaxes(0, 1)  # (2 n, Z, L, r)
        width = at_levels.shape[2] * at_levels.shape[3]
        return self.factor.solve(self.n, self._rows_of(at_levels.reshape(2 * self.n, self.n_levels, width)))

    def design(self, basis: Array) -> Array:
        """Return H with the modes expressed in other directions, shape (K, Z s).

        Args:
            basis: shape (2 n, s), all G in these directions.
        """
        n_levels = self.n_levels
        by_level = basis[:, None, None] * np.eye(n_levels)[..., None]  # (2 n, Z, Z, s)
        return self._rows_of(by_level.reshape(len(basis), n_levels, n_levels * basis.shape[1]))

    def rescaled(self, prior: Prior, factor: float) -> "ObservationSpacePosterior":
        """Return the same mean with the covariance multiplied by a factor, that of ``prior``."""
        return replace(self, prior=prior, factor=self.factor.rescaled(self.n, 1.0 / np.sqrt(factor)))

    def prefetch(self, profiles: Sequence[ProfileRows]) -> list[PriorCrossCovariance]:
        """Return the parts of coming predictions that do not depend on the order of assimilation: L is read once for all of them."""
        crosses = prior_cross_covariances(self.prior, profiles)
        n_solved = self.n - self.n % self.factor.panel_profiles
        solved = self.factor.solve(n_solved, self._rows_times(np.concatenate(crosses), 0, n_solved))
        parts = np.split(solved, np.cumsum([len(cross) for cross in crosses])[:-1], axis=1)
        return [PriorCrossCovariance(cross, part, n_solved) for cross, part in zip(crosses, parts, strict=True)]

    def predict(self, rows: ProfileRows, prefetched: PriorCrossCovariance) -> PredictedObservation[Posterior]:
        """Return the prediction of a profile's rows."""
        before = self.factor.solve(self.n, self._rows_times(prefetched.cross, prefetched.n_solved, self.n), prefetched.solved)
        cov = rows.matvec(prefetched.cross) - before.T @ before
        predicted = self.prior_prediction(rows) + before.T @ self.forward

        def update(lower: Array, whitened: Array, error_scale: float) -> "ObservationSpacePosterior":
            factor = self.factor.extended(self.n)
            factor.append(rows, error_scale, before.T / error_scale, lower, whitened)
            return replace(self, factor=factor, n=self.n + 1)

        return PredictedObservation(predicted[:, 0], predicted[:, 1:], 0.5 * (cov + cov.T), update)

    @property
    def profile_basis(self) -> Array:
        """G of all profiles, shape (2 n, r)."""
        return self.factor.basis[: self.n].reshape(2 * self.n, self.factor.basis.shape[2])

    def _rows_times(self, cross: Array, first: int, last: int) -> Array:
        """Return the rows of some profiles times the transpose of ``cross``, shape (m, Z, r): shape (., m)."""
        across = cross.transpose(1, 0, 2).reshape(-1, cross.shape[2])  # (Z m, r), levels first
        at_profiles = self.profile_basis[2 * first : 2 * last] @ across.T
        return self._rows_of(at_profiles.reshape(2 * (last - first), cross.shape[1], len(cross)), first)

    def _rows_of(self, at_profiles: Array, first: int = 0) -> Array:
        """Return rows, shape (., m), of values at each level for each profile's G from ``first`` on, shape (2 n, Z, m)."""
        n, n_levels = len(at_profiles) // 2, self.n_levels
        width = at_profiles.shape[2]
        by_profile = at_profiles.reshape(n, 2, n_levels, width)
        rows: Array = np.matmul(self.factor.depth[first : first + n, None], by_profile).reshape(2 * n * n_levels, width)
        return rows[self.factor.slots[self.factor.ends[first] : self.factor.ends[first + n]] - 2 * n_levels * first]


def initial(prior: Prior, bias_sensitivity: Array) -> ObservationSpacePosterior:
    """Return a prior as a posterior without rows.

    Args:
        prior: Gaussian of the weights.
        bias_sensitivity: shape (b, Z, r), change of its mean for each instrument error of one unit.
    """
    n_errors, n_levels, n_modes = bias_sensitivity.shape
    return ObservationSpacePosterior(prior, bias_sensitivity, GrowingCholesky(n_levels, n_modes, 16, 1 + n_errors), 0)
