"""State of an estimate: mean and covariance of its unknowns.

The covariance is stored as P - G'G. Measurements add rows to G, which are folded into P once they are many, to avoid copies of P. Only the
lower triangle of P is used.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.linalg.blas import dsymm, dsyrk

from replay_kit.core.arrays import Array, replace

#: Rows of G from which on P is written again.
FOLDED = 64
_NS = 1e9


class Revised(NamedTuple):
    """Errors as the first measurements show them.

    Attributes:
        scale: Factor on the prior variance of members and local directions.
        further: Error of a measurement beyond the stated ones [m/s], another in each, as of tides in an estimate without.
        depth: Its correlation depth [m].
    """

    scale: float = 1.0
    further: float = 0.0
    depth: float = np.inf


#: Errors before any measurement.
AS_STATED = Revised()


@dataclass(frozen=True, slots=True, eq=False)
class Doubt:
    """Gate decisions on the first columns.

    Attributes:
        before: State before them; None before any.
        rejected: Whether a part of each was rejected.
        columns: Columns.
    """

    before: "State | None" = None
    rejected: tuple[bool, ...] = ()
    columns: tuple[Any, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Mean and covariance of the unknowns at one time.

    Attributes:
        x: shape (k,), mean.
        p: shape (k, k), lower triangle of the covariance before the gains, in Fortran order.
        gains: shape (m, k), G; the covariance is P - G'G.
        time_ns: Time of both [ns, UTC]; None before any observation.
        profiles: Number of profiles and means assimilated.
        centre: shape (F,), final prior mean of the members' unknowns; None until fixed.
        last: Last measurement with a usable value, see ``screening.Last``, to detect duplicates.
        rows: Number of rows of unit noise assimilated.
        square: Sum of squares of their values.
        measured: shape (Z,), whether levels lie among measured depths; None before any.
        doubt: Evidence against the prior variance; None if not recorded.
        revised: Errors as the first measurements show them.
        seen: By node, the sum of ``Layout.shared`` of measurements near it.
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
    revised: Revised = AS_STATED
    seen: Mapping[int, float] = field(default_factory=dict)

    @staticmethod
    def initial(size: int) -> "State":
        """Return the state before any observation: all unknowns with mean 0 and variance 1."""
        return State(np.zeros(size), np.asfortranarray(np.eye(size)), np.empty((0, size)))

    @property
    def scale(self) -> float:
        """Factor on the prior variance of members and local directions."""
        return self.revised.scale

    def products(self, rows: Array) -> Array:
        """Return rows, shape (m, k), times the covariance."""
        times_p = dsymm(1.0, self.p, rows.T, side=0, lower=1).T
        return np.asarray(times_p - (rows @ self.gains.T) @ self.gains)

    @property
    def covariance(self) -> Array:
        """Covariance, shape (k, k)."""
        lower = np.tril(self.folded().p)
        return lower + np.tril(lower, -1).T

    def folded(self, least: int = 1) -> "State":
        """Return the state with at least ``least`` rows of gains folded into P."""
        if len(self.gains) < least:
            return self
        p = dsyrk(-1.0, self.gains.T, beta=1.0, c=self.p, trans=0, lower=1)
        return self.with_moments(self.x, p)

    def with_moments(self, x: Array, p: Array) -> "State":
        """Return the state with another mean, shape (k,), and covariance, shape (k, k), of which the lower triangle is used."""
        return replace(self, x=x, p=np.asfortranarray(p), gains=self.gains[:0])


def conditioned(state: State, rows: Array, values: Array) -> State:
    """Return the state conditioned on rows of unit noise; ``rows`` of shape (m, k), ``values`` of shape (m,)."""
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
    """Return a state at a later time without observations: unknowns decay, and their variance returns to 1.

        x <- f x,    P <- f P f + 1 - f^2,    f = exp(-dt / tau).

    Args:
        state: State at an earlier time; a later one is returned unchanged.
        tau: shape (k,), decorrelation times [s]; inf for constants.
        time_ns: Later time [ns, UTC].
    """
    if state.time_ns is None or time_ns <= state.time_ns or not np.isfinite(tau).any():
        later = state.time_ns is None or time_ns > state.time_ns
        return replace(state, time_ns=time_ns) if later else state
    kept = np.exp(-(time_ns - state.time_ns) / _NS / tau)
    p = np.asfortranarray((state.p * kept[:, None]) * kept)
    p[np.diag_indices_from(p)] += 1.0 - kept**2
    after = state.with_moments(kept * state.x, p)
    least = float(kept.min())
    seen = {node: each * least for node, each in state.seen.items()}
    return replace(after, gains=state.gains * kept, time_ns=time_ns, seen=seen)
