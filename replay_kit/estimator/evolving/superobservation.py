"""The state through time, and superobservations: profiles in quick succession, assimilated as one update.

All profiles of a superobservation are compared with one state, with covariance P, and count at its time. The superobservation keeps the
gain rows G of its update, after which the covariance is P - G'G. A profile with rows h of unit noise and innovation e adds

    G+ = L^-1 (h P - h G' G),    t+ = L^-1 (e - h G' t),    L L' = (h P - h G' G) h' + I,

and moves the mean by G+' t+: exactly the update by all rows at once, without another covariance. Rows of one instrument at 1 to 10 Hz are
nearly equal, so the gain rows have few directions, and are compressed to these. Nothing is averaged: places, depths and errors
may differ from profile to profile; only the forgetting within the window is neglected.

The state carries the open superobservation. So it does not depend on how many profiles are given at once, every state contains all profiles
so far, and a superobservation of any length takes bounded memory.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.linalg

from replay_kit.core.arrays import Array
from replay_kit.core.observation import Measurement, Observation
from replay_kit.estimator.update.biases import BiasScore
from replay_kit.estimator.update.gate import ConsistencyMonitor

_NS = 1e9
# Share of the largest singular value below which gain rows are rounding alone: the covariance changes by its square.
_RANK = 1e-10
# Gain rows are kept uncompressed up to this number; where they have more directions, up to twice the number of these.
_ROWS = 256
_NO_SCORE = BiasScore()


def compressed(rows: Array, innovation: Array) -> tuple[Array, Array]:
    """Return rows with the same Gram matrix and the same products with the innovation, one for each direction: shapes (s, n) and (s, c).

    Args:
        rows: shape (M, n).
        innovation: shape (M, c).
    """
    vectors, values, directions = scipy.linalg.svd(rows, full_matrices=False)
    kept = values > _RANK * values[0]
    return values[kept, None] * directions[kept], vectors[:, kept].T @ innovation


@dataclass(frozen=True, eq=False)
class Superobservation:
    """Profiles that count together, at the time of the first of them.

    Attributes:
        first_ns: Time of the first [ns, UTC].
        before: The state at the time for which they count, without them.
        means: shape (n, 1 + b), means after them.
        gain: shape (s, n), G.
        innovation: shape (s, 1 + b), t: whitened innovations of the rows and of each instrument error of one unit.
        bias_innovation: shape (k, 1 + b), with the Gram matrix of the t of all profiles with information on the instrument errors.
        scale_jacobian: Sum over the profiles; see ``biases.scale_jacobian``.
        inflation: Factor on the covariance after them.
        most: Number of gain rows up to which they are kept uncompressed.
    """

    first_ns: int
    before: "EvolvingState"
    means: Array
    gain: Array
    innovation: Array
    bias_innovation: Array
    scale_jacobian: float = 0.0
    inflation: float = 1.0
    most: int = _ROWS

    @staticmethod
    def opened(first_ns: int, before: "EvolvingState", inflation: float) -> "Superobservation":
        """Return a superobservation without a profile; the arguments are its attributes."""
        n, columns = before.means.shape
        nothing = np.empty((0, columns))
        return Superobservation(first_ns, before, before.means, np.empty((0, n)), nothing, nothing, inflation=inflation)

    def accepts(self, observation: Measurement, window: float) -> bool:
        """Return whether an observation belongs to it: a profile within the window [s] after its first one."""
        return isinstance(observation, Observation) and 0 <= observation.time_ns - self.first_ns <= window * _NS

    def updated(self, rows: Array, cross: Array, innovation: Array, scale_jacobian: float, bias_known: bool) -> "Superobservation":
        """Return the superobservation with one more profile.

        Args:
            rows: shape (m, n), of unit noise.
            cross: shape (m, n), the rows times the covariance before it.
            innovation: shape (m, 1 + b), relative to the state before it.
            scale_jacobian: See ``biases.scale_jacobian``.
            bias_known: Whether the profile has information on the instrument errors.
        """
        known = rows @ self.gain.T
        cross, innovation = cross - known @ self.gain, innovation - known @ self.innovation
        cov = cross @ rows.T
        lower = np.linalg.cholesky(0.5 * (cov + cov.T) + np.eye(len(rows)))
        both = scipy.linalg.solve_triangular(lower, np.hstack([cross, innovation]), lower=True)
        new_gain, whitened = both[:, : cross.shape[1]], both[:, cross.shape[1] :]
        gain, innovations, most = np.vstack([self.gain, new_gain]), np.vstack([self.innovation, whitened]), self.most
        if len(gain) > most:
            gain, innovations = compressed(gain, innovations)
            most = max(_ROWS, 2 * len(gain))
        of_biases = np.asarray(np.linalg.qr(np.vstack([self.bias_innovation, whitened]), mode="r")) if bias_known else self.bias_innovation
        return replace(
            self,
            means=self.means + new_gain.T @ whitened,
            gain=gain,
            innovation=innovations,
            bias_innovation=of_biases,
            scale_jacobian=self.scale_jacobian + scale_jacobian,
            most=most,
        )

    @cached_property
    def cov(self) -> Array:
        """Covariance after the profiles, shape (n, n); computed when first asked for, which happens for few states."""
        return np.asarray(self.inflation * (self.before.cov - self.gain.T @ self.gain))

    def cov_columns(self, columns: slice) -> Array:
        """Return columns of the covariance after the profiles, before it is inflated, shape (n, .)."""
        return np.asarray(self.before.cov[:, columns] - self.gain.T @ self.gain[:, columns])

    @property
    def bias_score(self) -> BiasScore:
        """Score of the instrument errors: the profiles share the error of one state and are scored together."""
        before, rows = self.before.bias_score, self.bias_innovation
        return before.updated(rows[:, 1:], rows[:, 0], np.eye(len(rows)), self.scale_jacobian) if len(rows) else before


@dataclass(frozen=True, slots=True, eq=False)
class EvolvingState:
    """The estimate at one time.

    Attributes:
        means: shape (n, 4): mean of the unknowns, and its sensitivity to heading, scale and shear errors of one unit outside the state.
        covariance: shape (n, n), or the superobservation from which it is computed when first asked for; read ``cov``.
        time_ns: Of the last observation used, or of the first profile of its superobservation [ns, UTC]; None before the first.
        monitor: Of the latest gate results.
        last: The last measurement offered.
        bias_score: Of systematic errors of the instrument.
        open_group: Superobservation that the next profile may join; None without. Whoever changes means or covariance closes it.
    """

    means: Array
    covariance: Array | Superobservation
    time_ns: int | None
    monitor: ConsistencyMonitor
    last: Measurement | None = None
    bias_score: BiasScore = _NO_SCORE
    open_group: Superobservation | None = None

    @property
    def cov(self) -> Array:
        """Covariance of the unknowns, shape (n, n)."""
        return self.covariance.cov if isinstance(self.covariance, Superobservation) else self.covariance

    @property
    def mean(self) -> Array:
        """Mean of the unknowns, shape (n,)."""
        return self.means[:, 0]
