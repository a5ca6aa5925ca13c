"""The smoother: estimates from observations before and after a time, for analysis once a mission is over.

The filter runs forward and keeps the gain of each observation. Backward, the adjoint l and its covariance A accumulate the information of
later observations (modified Bryson-Frazier; Bierman 1973, Automatica 9; Sage and Melsa 1971, section 9.5). With h the rows over their
error, S = h P h' + I, K = P h' S^-1, innovation e and the transition F:

    through an observation:   l <- C' (l + g) - h' S^-1 e,    A <- C' A C + h' S^-1 h,    C = I - K h,
    through a time:           l <- F' l,    A <- F' A F,

and the state at a time is x - P l, with covariance P - P A P. No covariance is inverted. Where a scale error of the instrument is part of
the state, the filter moves the mean after an observation by -P g more, g that of the Jacobian (``update/biases.py``); else g is zero.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.observation import Measurement
from replay_kit.estimator.evolving.filter import EvolvingColumn, EvolvingEstimator, rows_in
from replay_kit.estimator.evolving.state_space import EvolvingState, StateSpace
from replay_kit.estimator.update.superobservation import ColumnUpdate

_NS = 1e9


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """The update of the state by an observation.

    Attributes:
        time_ns: Time for which it counted [ns, UTC]: never before an earlier step, even if the observation came late.
        rows: shape (m, n), h.
        gain: shape (m, n), K'.
        innovation: shape (m,), S^-1 e.
        precision: shape (m, m), S^-1.
        gradient: shape (n,), g: see ``EvolvingEstimator.jacobian_gradient``.
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
        mean: shape (n,), l.
        cov: shape (n, n), A.
        time_ns: Of the state [ns, UTC].
    """

    mean: Array
    cov: Array
    time_ns: int

    def at(self, space: StateSpace, time_ns: int) -> "Adjoint":
        """Return the same for an earlier time."""
        seconds = (self.time_ns - time_ns) / _NS
        if seconds == 0.0:
            return self
        kept = np.exp(-seconds / space.scales)
        mean = space.rotated(kept * self.mean, -seconds)
        cov = space.rotated(space.rotated(self.cov * np.outer(kept, kept), -seconds).T, -seconds)
        return Adjoint(mean, cov, time_ns)

    def before(self, step: Step) -> "Adjoint":
        """Return the adjoint before an observation at its time, which is then one of the later ones."""
        mean = self.mean + step.gradient
        mean = mean - step.rows.T @ (step.gain @ mean + step.innovation)
        through = step.gain @ self.cov  # (m, n), K' A
        inner = through @ step.gain.T + step.precision
        crossed = step.rows.T @ through
        return Adjoint(
            mean, self.cov - crossed - crossed.T + step.rows.T @ inner @ step.rows, step.time_ns
        )

    def smoothed(self, state: EvolvingState) -> EvolvingState:
        """Return a state, which contains observations up to its time, after the later ones."""
        cov = state.cov - state.cov @ self.cov @ state.cov
        means = state.means.copy()
        means[:, 0] -= state.cov @ self.mean
        return replace(state, means=means, cov=0.5 * (cov + cov.T))


def smooth(
    estimator: EvolvingEstimator,
    observations: Iterable[Measurement],
    times_ns: Sequence[int],
    lag: float | None = None,
) -> list[FlowEstimate]:
    """Return the current estimates at times, from the observations before and after them; see ``smoothed_states``."""
    return [
        replace(estimator.flow(state), later=None)
        for state in smoothed_states(estimator, observations, times_ns, lag)
    ]


def smoothed_states(
    estimator: EvolvingEstimator,
    observations: Iterable[Measurement],
    times_ns: Sequence[int],
    lag: float | None = None,
) -> list[EvolvingState]:
    """Return the estimator's states at times, from the observations before and after them.

    Args:
        estimator: The estimator through time; its gate decides in the forward pass, as in a replay.
        observations: In the order of the forward pass; late ones count at the time for which they count there.
        times_ns: Times of the estimates [ns, UTC], in any order.
        lag: Fixed lag [s]: only observations up to this long after a time count for it; None counts all.
    """
    wanted = sorted(set(times_ns))
    states, steps = _forward(estimator, observations, wanted)
    smoothed: dict[int, EvolvingState] = {}
    if lag is None:
        adjoint, left = (
            _nothing(estimator, max([*wanted, *(step.time_ns for step in steps)], default=0)),
            list(steps),
        )
        for time_ns in reversed(wanted):
            while left and left[-1].time_ns > time_ns:
                adjoint = adjoint.at(estimator.state_space, left[-1].time_ns).before(left.pop())
            adjoint = adjoint.at(estimator.state_space, time_ns)
            smoothed[time_ns] = adjoint.smoothed(states[time_ns])
    else:
        for time_ns in wanted:
            adjoint = _nothing(estimator, time_ns + int(lag * _NS))
            for step in reversed(
                [step for step in steps if time_ns < step.time_ns <= adjoint.time_ns]
            ):
                adjoint = adjoint.at(estimator.state_space, step.time_ns).before(step)
            smoothed[time_ns] = adjoint.at(estimator.state_space, time_ns).smoothed(states[time_ns])
    return [smoothed[time_ns] for time_ns in times_ns]


def _nothing(estimator: EvolvingEstimator, time_ns: int) -> Adjoint:
    size = estimator.state_space.size
    return Adjoint(np.zeros(size), np.zeros((size, size)), time_ns)


def _forward(
    estimator: EvolvingEstimator, observations: Iterable[Measurement], wanted: Sequence[int]
) -> tuple[dict[int, EvolvingState], list[Step]]:
    """Return the filter's states at wanted times, after the observations that counted up to each, and every update."""
    state, left = estimator.initial(), list(wanted)
    states: dict[int, EvolvingState] = {}
    steps: list[Step] = []
    for observation in observations:
        screened = estimator.screened(state, (observation,))
        if not screened.used.size:
            continue
        at = estimator.group_column(state, screened)
        update = estimator.evaluated(state, at)
        if update.step is not None:
            step = _step(at, update.step, estimator.jacobian_gradient(update.scale_jacobian))
            # only an accepted observation ends the time before it: after a rejected one an earlier one may still come
            while left and left[0] < step.time_ns:
                states[left[0]] = estimator.predict(state, left[0])
                left.pop(0)
            steps.append(step)
        state = estimator.assimilated(screened, at, (state, update))[-1].after
    return states | {time_ns: estimator.predict(state, time_ns) for time_ns in left}, steps


def _step(at: EvolvingColumn, update: ColumnUpdate, gradient: Array) -> Step:
    rows, innovation = rows_in(at.design, update.rows), at.column.innovation(update.rows)[:, 0]
    both = np.column_stack([rows @ at.state.cov, innovation, np.eye(len(rows))])
    cross, solved = both[:, : -1 - len(rows)], scipy.linalg.cho_solve((update.lower, True), both)
    n = cross.shape[1]
    assert at.state.time_ns is not None  # a prediction has a time
    return Step(at.state.time_ns, rows, solved[:, :n], solved[:, n], solved[:, n + 1 :], gradient)
