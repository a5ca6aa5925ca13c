"""The posterior in observation space: exact, and cheap while the measured rows are fewer than the weights.

With all rows H (K, Z r), their whitened data z and the prior N(w0, P0):

    C = H P0 H' + I = L L',    f = L^-1 (z - H w0),    mean = w0 + P0 H' L^-T f,    P = P0 - (L^-1 H P0)' (L^-1 H P0).

A profile h appends to L the rows [x', chol(S)] with x = L^-1 H P0 h', S = I + h P0 h' - x'x, and to f its innovation
z - h w0 - x'f whitened by S. Nothing before it changes: all states of a run share one Cholesky factor, which grows at its end.
The effects of instrument errors of one unit on z are further columns of z and f.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array, replace
from replay_kit.core.flow.covariance import Reduction
from replay_kit.estimator.prior.hybrid import Prior
from replay_kit.estimator.update.growing_cholesky import GrowingCholesky
from replay_kit.estimator.update.posterior import (
    Posterior,
    PriorCrossCovariance,
    directions,
    gram,
    nonzero_mode_std,
    prior_cross_covariances,
    rank_k_update,
)
from replay_kit.estimator.update.rows import PredictedObservation, ProfileRows

# Profiles whose cross-covariances are kept: a dive has a few, after which its mean current takes all rows from the prior.
_FEW = 8


@dataclass(frozen=True, slots=True, eq=False)
class KnownCross:
    """The cross-covariances of the first profiles of a run with the weights, which a mean along a path needs again.

    Attributes:
        prior: The prior that they hold for.
        crosses: Of each profile, shape (2 k, Z, r), H P0.
    """

    prior: Prior
    crosses: tuple[Array, ...] = ()


@dataclass(frozen=True, eq=False)
class ObservationSpacePosterior(Posterior):
    """The posterior in observation space.

    Attributes:
        factor: Rows and Cholesky factor, of which the first ``n`` profiles belong to this posterior.
        n: Number of profiles.
        known: H P0 of the profiles while these are few; None otherwise.
    """

    factor: GrowingCholesky
    n: int
    known: KnownCross | None = None

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
        by_profile = (
            by_level.reshape(m, 2 * n, n_levels).swapaxes(1, 2).reshape(m * n_levels, 2 * n)
        )
        return np.asarray(by_profile @ self.profile_basis).reshape(
            m, n_levels, self.profile_basis.shape[1]
        )

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
        known = self.known
        if (
            levels is None
            and known is not None
            and known.prior is self.prior
            and len(known.crosses) == self.n > 0
        ):
            return self.factor.solve(
                self.n, np.concatenate(known.crosses).reshape(self.n_rows, self.n_weights)
            )
        at_levels = self.prior.matvec_modes(self.profile_basis, levels).swapaxes(
            0, 1
        )  # (2 n, Z, L, r)
        width = at_levels.shape[2] * at_levels.shape[3]
        return self.factor.solve(
            self.n, self._rows_of(at_levels.reshape(2 * self.n, self.n_levels, width))
        )

    def design(self, basis: Array) -> Array:
        """Return H with the modes expressed in other directions, shape (K, Z s).

        Args:
            basis: shape (2 n, s), all G in these directions.
        """
        n_levels = self.n_levels
        by_level = basis[:, None, None] * np.eye(n_levels)[..., None]  # (2 n, Z, Z, s)
        return self._rows_of(by_level.reshape(len(basis), n_levels, n_levels * basis.shape[1]))

    def rows_times(self, weights: Array) -> Array:
        """Return H times weights, shape (K,); ``weights`` of shape (Z, r)."""
        return self._rows_times(weights[None], 0, self.n)[:, 0]

    def rows_of(self, weights: Array) -> Array:
        """Return H times each of many weights, shape (K, m); ``weights`` of shape (m, Z, r)."""
        return self._rows_times(weights, 0, self.n)

    def rescaled(self, prior: Prior, factor: float) -> "ObservationSpacePosterior":
        """Return the same mean with the covariance multiplied by a factor, that of ``prior``."""
        return replace(
            self, prior=prior, factor=self.factor.rescaled(self.n, 1.0 / np.sqrt(factor))
        )

    def prefetch(self, profiles: Sequence[ProfileRows]) -> list[PriorCrossCovariance]:
        """Return the parts of coming predictions that do not depend on the order of assimilation: L is read once for all of them."""
        crosses = prior_cross_covariances(self.prior, profiles)
        n_solved = self.n - self.n % self.factor.panel_profiles
        solved = self.factor.solve(n_solved, self._rows_times(np.concatenate(crosses), 0, n_solved))
        parts = np.split(solved, np.cumsum([len(cross) for cross in crosses])[:-1], axis=1)
        return [
            PriorCrossCovariance(cross, part, n_solved)
            for cross, part in zip(crosses, parts, strict=True)
        ]

    def predict(
        self, rows: ProfileRows, prefetched: PriorCrossCovariance
    ) -> PredictedObservation[Posterior]:
        """Return the prediction of a profile's rows."""
        before = self.factor.solve(
            self.n,
            self._rows_times(prefetched.cross, prefetched.n_solved, self.n),
            prefetched.solved,
        )
        cov = rows.matvec(prefetched.cross) - before.T @ before
        predicted = self.prior_prediction(rows) + before.T @ self.forward

        def update(
            lower: Array, whitened: Array, error_scale: float
        ) -> "ObservationSpacePosterior":
            factor = self.factor.extended(self.n)
            factor.append(rows, error_scale, before.T / error_scale, lower, whitened)
            return replace(
                self,
                factor=factor,
                n=self.n + 1,
                known=self._known_with(prefetched.cross / error_scale),
            )

        return PredictedObservation(predicted, 0.5 * (cov + cov.T), update)

    def _known_with(self, cross: Array) -> KnownCross | None:
        """Return H P0 of the profiles and of another one; None where there are many, or some hold for another prior."""
        before = self.known or KnownCross(self.prior)
        if self.n >= _FEW or len(before.crosses) != self.n or before.prior is not self.prior:
            return None
        return KnownCross(self.prior, (*before.crosses, cross))

    @property
    def profile_basis(self) -> Array:
        """G of all profiles, shape (2 n, r)."""
        return self.factor.basis[: self.n].reshape(2 * self.n, self.factor.basis.shape[2])

    def _rows_times(self, cross: Array, first: int, last: int) -> Array:
        """Return the rows of some profiles times the transpose of ``cross``, shape (m, Z, r): shape (., m)."""
        across = cross.transpose(1, 0, 2).reshape(-1, cross.shape[2])  # (Z m, r), levels first
        at_profiles = self.profile_basis[2 * first : 2 * last] @ across.T
        return self._rows_of(
            at_profiles.reshape(2 * (last - first), cross.shape[1], len(cross)), first
        )

    def _rows_of(self, at_profiles: Array, first: int = 0) -> Array:
        """Return rows, shape (., m), of values at each level for each profile's G from ``first`` on, shape (2 n, Z, m)."""
        n, n_levels = len(at_profiles) // 2, self.n_levels
        width = at_profiles.shape[2]
        by_profile = at_profiles.reshape(n, 2, n_levels, width)
        rows: Array = np.matmul(self.factor.depth[first : first + n, None], by_profile).reshape(
            2 * n * n_levels, width
        )
        return rows[
            self.factor.slots[self.factor.ends[first] : self.factor.ends[first + n]]
            - 2 * n_levels * first
        ]


def initial(prior: Prior, bias_sensitivity: Array) -> ObservationSpacePosterior:
    """Return a prior as a posterior without rows.

    Args:
        prior: Gaussian of the weights.
        bias_sensitivity: shape (b, Z, r), change of its mean for each instrument error of one unit.
    """
    n_errors, n_levels, n_modes = bias_sensitivity.shape
    return ObservationSpacePosterior(
        prior, bias_sensitivity, GrowingCholesky(n_levels, n_modes, 16, 1 + n_errors), 0
    )
