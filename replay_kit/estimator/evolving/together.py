"""Super-observations: profiles that follow one another closely, as one update.

All profiles of a group are held against one state, with covariance P, and count at its time. The group keeps the gain rows G of its update,
with which the covariance after it is P - G'G. A profile with rows h of unit noise and innovation e adds

    G+ = L^-1 (h P - h G' G),    t+ = L^-1 (e - h G' t),    L L' = (h P - h G' G) h' + I,

and moves the mean by G+' t+: exactly the update by all rows at once, without another covariance. Rows of one instrument at 1 to 10 Hz are
nearly the same over and over, so the gain rows have few directions, and are kept as so many. Nothing is averaged: places, depths and errors
may differ from profile to profile; only what the state forgets within the window is not followed.

The state carries the group that is open. So a group does not depend on how many profiles are given at once, every state knows all profiles
so far, and a group of any length takes a bounded memory.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import scipy.linalg

from replay_kit.core.arrays import Array
from replay_kit.core.observation import Observation, PathMean
from replay_kit.estimator.update.biases import Evidence

if TYPE_CHECKING:
    from replay_kit.estimator.evolving.filter import EvolvingState

_NS = 1e9
# Of the largest singular value, below which gain rows hold rounding alone: the covariance changes by its square.
_RANK = 1e-10
# Gain rows that are kept as they came before they are compressed; where they have more directions, twice as many as those.
_ROWS = 256


def compressed(rows: Array, innovation: Array) -> tuple[Array, Array]:
    """Return rows with the same Gram matrix, and the same products with the innovation, one a direction: shapes (s, n) and (s, c).

    Args:
        rows: shape (M, n).
        innovation: shape (M, c).
    """
    vectors, values, directions = scipy.linalg.svd(rows, full_matrices=False)
    kept = values > _RANK * values[0]
    return values[kept, None] * directions[kept], vectors[:, kept].T @ innovation


@dataclass(frozen=True, eq=False)
class Group:
    """Profiles that count together, at the time of the first of them.

    Attributes:
        first_ns: Time of the first [ns, UTC].
        before: The state at the time for which they count, without them.
        means: shape (n, 1 + b), means after them.
        gain: shape (s, n), G.
        told: shape (s, 1 + b), t: innovations, and those of each instrumental error of one unit.
        spoken: shape (k, 1 + b), with the Gram matrix of the t of all profiles that say something of the instrument's errors.
        stretched: Sum over the profiles; see ``biases.stretch``.
        grown: Factor on the covariance after them.
        most: Number of gain rows up to which they are kept as they came.
    """

    first_ns: int
    before: "EvolvingState"
    means: Array
    gain: Array
    told: Array
    spoken: Array
    stretched: float = 0.0
    grown: float = 1.0
    most: int = _ROWS

    @staticmethod
    def opened(first_ns: int, before: "EvolvingState", grown: float) -> "Group":
        """Return a group without a profile; the arguments are as the attributes."""
        n, columns = before.means.shape
        return Group(first_ns, before, before.means, np.empty((0, n)), np.empty((0, columns)), np.empty((0, columns)), grown=grown)

    def takes(self, observation: Observation | PathMean, window: float) -> bool:
        """Return whether an observation counts with the group: a profile within the window [s] after its first one."""
        return isinstance(observation, Observation) and 0 <= observation.time_ns - self.first_ns <= window * _NS

    def with_profile(self, rows: Array, cross: Array, told: Array, stretched: float, speaks: bool) -> "Group":
        """Return the group with one more profile.

        Args:
            rows: shape (m, n), of unit noise.
            cross: shape (m, n), the rows times the covariance before the group.
            told: shape (m, 1 + b), innovations against the state before the group.
            stretched: See ``biases.stretch``.
            speaks: Whether the profile says something of the instrument's errors.
        """
        known = rows @ self.gain.T
        cross, told = cross - known @ self.gain, told - known @ self.told
        spread = cross @ rows.T
        lower = np.linalg.cholesky(0.5 * (spread + spread.T) + np.eye(len(rows)))
        both = scipy.linalg.solve_triangular(lower, np.hstack([cross, told]), lower=True)
        more, heard = both[:, : cross.shape[1]], both[:, cross.shape[1] :]
        gain, all_told, most = np.vstack([self.gain, more]), np.vstack([self.told, heard]), self.most
        if len(gain) > most:
            gain, all_told = compressed(gain, all_told)
            most = max(_ROWS, 2 * len(gain))
        return replace(
            self,
            means=self.means + more.T @ heard,
            gain=gain,
            told=all_told,
            spoken=np.asarray(np.linalg.qr(np.vstack([self.spoken, heard]), mode="r")) if speaks else self.spoken,
            stretched=self.stretched + stretched,
            most=most,
        )

    @cached_property
    def cov(self) -> Array:
        """Covariance after the profiles, shape (n, n); computed when first asked for, as few states of a group are asked."""
        return np.asarray(self.grown * (self.before.cov - self.gain.T @ self.gain))

    def cov_column(self, position: int) -> Array:
        """Return a column of the covariance after the profiles, before it is grown, shape (n,)."""
        return np.asarray(self.before.cov[:, position] - self.gain.T @ self.gain[:, position])

    @property
    def evidence(self) -> Evidence:
        """Of the instrument's errors: held against one state, the profiles share its error and are evidence together."""
        before, spoken = self.before.evidence, self.spoken
        if not len(spoken):
            return before
        return before.after(spoken[:, 1:], spoken[:, 0], np.eye(len(spoken)), self.stretched)
