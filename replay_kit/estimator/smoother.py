"""Smoother: estimates from observations before and after a time, for post-mission analysis.

The filter runs forward by observation and keeps the gains. Backward, the adjoint l and its covariance A accumulate the information of later
observations (modified Bryson-Frazier; Bierman 1973, Automatica 9; Sage and Melsa 1971, section 9.5). With h the rows over their error, S =
h P h' + 1, K = P h' S^-1, innovation e and the transition f = exp(-dt / tau):

    through an observation:   l <- C' (l + g) - h' S^-1 e,    A <- C' A C + h' S^-1 h,    C = 1 - K h, through a time:           l <- f l, A
    <- f A f,

and the state at a time is x - P l, with covariance P - P A P. No covariance is inverted. With an instrument's scale error in the state, the
filter adds -P g to the mean after an observation, with g the gradient of the Jacobian (``ReducedBasisEstimator.gradient``).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from replay_kit.core.arrays import Array, replace
from replay_kit.core.observation import Measurement
from replay_kit.estimator.estimator import ReducedBasisEstimator
from replay_kit.estimator.state import State
from replay_kit.estimator.update.assimilate import Update, lower_solved

_NS = 1e9


@dataclass(frozen=True, slots=True, eq=False)
class Adjoint:
    """Information of later observations on a state.

    Attributes:
        mean: shape (k,), l.
        cov: shape (k, k), A.
        time_ns: Time of the state [ns, UTC].
    """

    mean: Array
    cov: Array
    time_ns: int

    def at(self, tau: Array, time_ns: int) -> "Adjoint":
        """Return the adjoint at an earlier time; ``tau`` of shape (k,) [s]."""
        seconds = (self.time_ns - time_ns) / _NS
        if seconds == 0.0:
            return self
        kept = np.exp(-seconds / tau)
        return Adjoint(kept * self.mean, self.cov * np.outer(kept, kept), time_ns)

    def before(self, update: Update, gradient: Array) -> "Adjoint":
        """Return the adjoint before an observation at its time; ``gradient`` is g, shape (k,)."""
        # with S = A A': h' S^-1 is B' A^-1 with B = A^-1 h, and K' = A'^-1 G
        rows = lower_solved(update.lower, update.rows @ update.column.design)
        mean = self.mean + gradient
        mean = mean - rows.T @ (update.gain @ mean + update.whitened)
        through = update.gain @ self.cov
        crossed = rows.T @ through
        inner = through @ update.gain.T + np.eye(len(rows))
        cov = self.cov - crossed - crossed.T + rows.T @ inner @ rows
        return Adjoint(mean, cov, self.time_ns)

    def smoothed(self, state: State) -> State:
        """Return a state, with observations up to its time, updated by the later ones."""
        p = state.covariance
        after = p - p @ self.cov @ p
        return state.with_moments(state.x - p @ self.mean, 0.5 * (after + after.T))


def smooth(
    estimator: ReducedBasisEstimator, observations: Iterable[Measurement], times_ns: Sequence[int]
) -> list[State]:
    """Return the estimator's states at times from all observations.

    Args:
        estimator: Estimator; its gate applies in the forward pass, as in a replay.
        observations: Observations in the order of the forward pass; late ones count at the time used there.
        times_ns: Times of the estimates [ns, UTC], in any order.
    """
    wanted, tau = sorted(set(times_ns)), estimator.observer.tau
    states, updates = _forward(estimator, observations, wanted)
    last = max([*wanted, *(time_ns for time_ns, _ in updates)], default=0)
    adjoint, smoothed = Adjoint(np.zeros(tau.size), np.zeros((tau.size, tau.size)), last), {}
    for wanted_ns in reversed(wanted):
        while updates and updates[-1][0] > wanted_ns:
            time_ns, update = updates.pop()
            adjoint = adjoint.at(tau, time_ns).before(update, estimator.gradient(update))
        adjoint = adjoint.at(tau, wanted_ns)
        smoothed[wanted_ns] = adjoint.smoothed(states[wanted_ns])
    return [smoothed[time_ns] for time_ns in times_ns]


def _forward(
    estimator: ReducedBasisEstimator, observations: Iterable[Measurement], wanted: Sequence[int]
) -> tuple[dict[int, State], list[tuple[int, Update]]]:
    """Return the filter's states at wanted times, and every update with its time."""
    state, left = estimator.initial(), list(wanted)
    states, found = dict[int, State](), list[tuple[int, Update]]()
    for observation in observations:
        before = state
        ((_, _, updates, state),) = estimator.blocks(state, [observation])
        for update in updates:
            if not update.judgements.accepted.any():
                continue
            # only an accepted observation ends the time before it: after a rejected one an earlier one may still come
            while left and left[0] < update.column.time_ns:
                states[left[0]] = estimator.predict(before, left[0])
                left.pop(0)
            assert update.after is not None
            assert update.after.time_ns is not None
            found.append((update.after.time_ns, replace(update, after=None)))
    return states | {time_ns: estimator.predict(state, time_ns) for time_ns in left}, found
