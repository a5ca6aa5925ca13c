"""The smoother: estimates from observations before and after a time, for analysis once a mission is over.

The filter runs forward, one observation after another, and keeps the gain of each. Backward, the adjoint l and its covariance A accumulate
the information of later observations (modified Bryson-Frazier; Bierman 1973, Automatica 9; Sage and Melsa 1971, section 9.5). With h the
rows over their error, S = h P h' + 1, K = P h' S^-1, innovation e and the transition f = exp(-dt / tau):

    through an observation:   l <- C' (l + g) - h' S^-1 e,    A <- C' A C + h' S^-1 h,    C = 1 - K h,
    through a time:           l <- f l,    A <- f A f,

and the state at a time is x - P l, with covariance P - P A P. No covariance is inverted. Where a scale error of the instrument is part of
the state, the filter moves the mean after an observation by -P g more, g that of the Jacobian (``ReducedBasisEstimator.gradient``).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg

from replay_kit.core.arrays import Array
from replay_kit.core.observation import Measurement
from replay_kit.estimator.estimator import ReducedBasisEstimator
from replay_kit.estimator.state import State
from replay_kit.estimator.update.assimilate import Update

_NS = 1e9


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """The update of the state by an observation.

    Attributes:
        time_ns: Time for which it counted [ns, UTC].
        rows: shape (m, k), h.
        gain: shape (m, k), K'.
        innovation: shape (m,), S^-1 e.
        precision: shape (m, m), S^-1.
        gradient: shape (k,), g.
    """

    time_ns: int
    rows: Array
    gain: Array
    innovation: Array
    precision: Array
    gradient: Array


@dataclass(frozen=True, slots=True, eq=False)
class Adjoint:
    """The information of later observations on a state.

    Attributes:
        mean: shape (k,), l.
        cov: shape (k, k), A.
        time_ns: Of the state [ns, UTC].
    """

    mean: Array
    cov: Array
    time_ns: int

    def at(self, tau: Array, time_ns: int) -> "Adjoint":
        """Return it for an earlier time; ``tau`` of shape (k,) [s]."""
        seconds = (self.time_ns - time_ns) / _NS
        if seconds == 0.0:
            return self
        kept = np.exp(-seconds / tau)
        return Adjoint(kept * self.mean, self.cov * np.outer(kept, kept), time_ns)

    def before(self, step: Step) -> "Adjoint":
        """Return the adjoint before an observation at its time, which is then one of the later ones."""
        mean = self.mean + step.gradient
        mean = mean - step.rows.T @ (step.gain @ mean + step.innovation)
        through = step.gain @ self.cov  # (m, k), K' A
        inner = through @ step.gain.T + step.precision
        crossed = step.rows.T @ through
        cov = self.cov - crossed - crossed.T + step.rows.T @ inner @ step.rows
        return Adjoint(mean, cov, step.time_ns)

    def smoothed(self, state: State) -> State:
        """Return a state, which contains observations up to its time, after the later ones."""
        p = state.covariance
        after = p - p @ self.cov @ p
        return state.with_moments(state.x - p @ self.mean, 0.5 * (after + after.T))


def smooth(
    estimator: ReducedBasisEstimator,
    observations: Iterable[Measurement],
    times_ns: Sequence[int],
    lag: float | None = None,
) -> list[State]:
    """Return the estimator's states at times, from the observations before and after them.

    Args:
        estimator: Its gate decides in the forward pass, as in a replay.
        observations: In the order of the forward pass; late ones count at the time for which they count there.
        times_ns: Times of the estimates [ns, UTC], in any order.
        lag: Fixed lag [s]: only observations up to this long after a time count for it; None counts all.
    """
    wanted, tau = sorted(set(times_ns)), estimator.observer.tau
    states, steps = _forward(estimator, observations, wanted)
    nothing = np.zeros(tau.size), np.zeros((tau.size, tau.size))
    smoothed: dict[int, State] = {}
    adjoint, left = (
        Adjoint(*nothing, max([*wanted, *(s.time_ns for s in steps)], default=0)),
        list(steps),
    )
    for time_ns in reversed(wanted):
        if lag is not None:
            adjoint = Adjoint(*nothing, time_ns + int(lag * _NS))
            left = [step for step in steps if step.time_ns <= adjoint.time_ns]
        while left and left[-1].time_ns > time_ns:
            adjoint = adjoint.at(tau, left[-1].time_ns).before(left.pop())
        adjoint = adjoint.at(tau, time_ns)
        smoothed[time_ns] = adjoint.smoothed(states[time_ns])
    return [smoothed[time_ns] for time_ns in times_ns]


def _forward(
    estimator: ReducedBasisEstimator, observations: Iterable[Measurement], wanted: Sequence[int]
) -> tuple[dict[int, State], list[Step]]:
    """Return the filter's states at wanted times, after the observations that counted up to each, and every update."""
    state, left = estimator.initial(), list(wanted)
    states: dict[int, State] = {}
    steps: list[Step] = []
    for observation in observations:
        before = state
        ((_, _, updates, state),) = estimator.blocks(state, [observation])
        for update in updates:
            if not any(judgement.accepted for judgement in update.judgements):
                continue
            # only an accepted observation ends the time before it: after a rejected one an earlier one may still come
            while left and left[0] < update.column.time_ns:
                states[left[0]] = estimator.predict(before, left[0])
                left.pop(0)
            steps.append(_step(update, estimator.gradient(update)))
    return states | {time_ns: estimator.predict(state, time_ns) for time_ns in left}, steps


def _step(update: Update, gradient: Array) -> Step:
    assert update.after is not None
    assert update.after.time_ns is not None
    both = np.column_stack([update.gain, update.whitened, np.eye(len(update.lower))])
    solved = scipy.linalg.solve_triangular(update.lower, both, lower=True, trans=1)
    n = update.gain.shape[1]
    inverse = scipy.linalg.solve_triangular(update.lower, np.eye(len(update.lower)), lower=True)
    rows = update.rows @ update.column.design
    return Step(
        update.after.time_ns, rows, solved[:, :n], solved[:, n], inverse.T @ inverse, gradient
    )
