"""The state of an estimate: mean and covariance of its unknowns.

The covariance is kept as P - G'G. Measurements add rows to G, and P is written again once these are many: a measurement alone then costs
the products with P, and not a copy of it. Of P only the lower half has a meaning.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.linalg.blas import dsymm, dsyrk

from replay_kit.core.arrays import Array, replace

#: Rows of G from which on P is written again.
FOLDED = 64
_NS = 1e9


@dataclass(frozen=True, slots=True, eq=False)
class Doubt:
    """The first columns that were judged.

    Attributes:
        rejected: Of each whether something of it was rejected.
        columns: Those of which something was.
    """

    rejected: tuple[bool, ...] = ()
    columns: tuple[Any, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Mean and covariance of the unknowns at one time.

    Attributes:
        x: shape (k,), mean.
        p: shape (k, k), lower half of the covariance before the gains, in Fortran order.
        gains: shape (m, k), G; the covariance is P - G'G.
        time_ns: Of both [ns, UTC]; None before any observation.
        profiles: Number of profiles and means assimilated.
        centre: shape (F,), prior mean of the members' unknowns once it no longer changes; None until then.
        last: The last measurement with a usable value, as of ``screening.Last``; an equal one that follows is a duplicate.
        rows: Number of rows of unit noise assimilated.
        square: Sum of the squares of their values.
        measured: shape (Z,), levels among those whose depths were measured; None before any.
        doubt: What speaks against the prior's variance; None where nothing is kept of that.
        scale: Factor on the prior variance of members and local directions, as the first measurements showed it.
    """

    x: Array
    p: Array
    gains: Array
    time_ns: int | None = None
    profiles: int = 0
    centre: Array | None = None
    last: Any = None
    rows: int = 0
    square: float = 0.0
    measured: NDArray[np.bool_] | None = None
    doubt: "Doubt | None" = None
    scale: float = 1.0

    @staticmethod
    def initial(size: int) -> "State":
        """Return the state before any observation: every unknown has mean 0 and variance 1."""
        return State(np.zeros(size), np.asfortranarray(np.eye(size)), np.empty((0, size)))

    def products(self, rows: Array) -> Array:
        """Return rows, shape (m, k), times the covariance."""
        times_p = dsymm(1.0, self.p, rows.T, side=0, lower=1).T
        return np.asarray(times_p - (rows @ self.gains.T) @ self.gains)

    @property
    def covariance(self) -> Array:
        """The covariance, shape (k, k)."""
        lower = np.tril(self.folded().p)
        return lower + np.tril(lower, -1).T

    def folded(self, least: int = 1) -> "State":
        """Return the state with the gains in P where they have so many rows at least."""
        if len(self.gains) < least:
            return self
        p = dsyrk(-1.0, self.gains.T, beta=1.0, c=self.p, trans=0, lower=1)
        return self.with_moments(self.x, p)

    def with_moments(self, x: Array, p: Array) -> "State":
        """Return the state with another mean, shape (k,), and covariance, shape (k, k), of which the lower half counts."""
        return replace(self, x=x, p=np.asfortranarray(p), gains=self.gains[:0])


def conditioned(state: State, rows: Array, values: Array) -> State:
    """Return the state after rows of unit noise; ``rows`` of shape (m, k), ``values`` of shape (m,)."""
    cross = state.products(rows)
    lower = np.linalg.cholesky(cross @ rows.T + np.eye(len(rows)))
    both = np.column_stack([cross, values - rows @ state.x])
    solved = solve_triangular(lower, both, lower=True, check_finite=False)
    gains = np.concatenate([state.gains, solved[:, :-1]])
    after = replace(
        state,
        x=state.x + solved[:, :-1].T @ solved[:, -1],
        gains=gains,
        rows=state.rows + len(rows),
        square=state.square + float(values @ values),
    )
    return after.folded(FOLDED)


def predict(state: State, tau: Array, time_ns: int) -> State:
    """Return a state at a later time without observations in between: unknowns decay, and their variance returns to 1.

        x <- f x,    P <- f P f + 1 - f^2,    f = exp(-dt / tau).

    Args:
        state: At an earlier time; one at a later time is returned as it is.
        tau: shape (k,), decorrelation times [s]; inf for constants.
        time_ns: [ns, UTC].
    """
    if state.time_ns is None or time_ns <= state.time_ns or not np.isfinite(tau).any():
        later = state.time_ns is None or time_ns > state.time_ns
        return replace(state, time_ns=time_ns) if later else state
    kept = np.exp(-(time_ns - state.time_ns) / _NS / tau)
    p = np.asfortranarray((state.p * kept[:, None]) * kept)
    p[np.diag_indices_from(p)] += 1.0 - kept**2
    after = state.with_moments(kept * state.x, p)
    return replace(after, gains=state.gains * kept, time_ns=time_ns)
