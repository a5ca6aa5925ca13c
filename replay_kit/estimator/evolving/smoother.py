"""What the sea was like, from observations before and after: for analysis once a mission is over.

The filter runs forward and keeps what each observation did. Backward, the adjoint l and its covariance A gather what later observations say
(modified Bryson-Frazier; Bierman 1973, Automatica 9; Sage and Melsa 1971, section 9.5). With h the rows over their error, S = h P h' + I,
K = P h' S^-1, innovation e and the transition F:

    through an observation:   l <- C' l - h' S^-1 e,    A <- C' A C + h' S^-1 h,    C = I - K h,
    through a time:           l <- F' l,    A <- F' A F,

and the state at a time is x - P l, with covariance P - P A P. No covariance is inverted.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.observation import Innovation, Observation, PathMean
from replay_kit.estimator.evolving.filter import EvolvingEstimator, EvolvingState, Offered
from replay_kit.estimator.evolving.state import Layout

_NS = 1e9


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """What an observation did to the state.

    Attributes:
        time_ns: For when the filter counted it [ns, UTC]: never before an earlier step, also when the observation came late.
        rows: shape (m, n), h.
        gain: shape (m, n), K'.
        told: shape (m,), S^-1 e.
        precision: shape (m, m), S^-1.
    """

    time_ns: int
    rows: Array
    gain: Array
    told: Array
    precision: Array


@dataclass(frozen=True, slots=True, eq=False)
class Adjoint:
    """What later observations say of a state.

    Attributes:
        mean: shape (n,), l.
        cov: shape (n, n), A.
        time_ns: Of the state [ns, UTC].
    """

    mean: Array
    cov: Array
    time_ns: int

    def at(self, layout: Layout, time_ns: int) -> "Adjoint":
        """Return the same for an earlier time."""
        seconds = (self.time_ns - time_ns) / _NS
        if seconds == 0.0:
            return self
        kept = np.exp(-seconds / layout.scales)
        mean = layout.turned(kept * self.mean, -seconds)
        cov = layout.turned(layout.turned(self.cov * np.outer(kept, kept), -seconds).T, -seconds)
        return Adjoint(mean, cov, time_ns)

    def before(self, step: Step) -> "Adjoint":
        """Return the same with an observation at its time among the later ones."""
        mean = self.mean - step.rows.T @ (step.gain @ self.mean + step.told)
        through = step.gain @ self.cov  # (m, n), K' A
        inner = through @ step.gain.T + step.precision
        crossed = step.rows.T @ through
        return Adjoint(mean, self.cov - crossed - crossed.T + step.rows.T @ inner @ step.rows, step.time_ns)

    def smoothed(self, state: EvolvingState) -> EvolvingState:
        """Return a state, of observations up to its time, with the later ones."""
        cov = state.cov - state.cov @ self.cov @ state.cov
        means = state.means.copy()
        means[:, 0] -= state.cov @ self.mean
        return replace(state, means=means, covariance=0.5 * (cov + cov.T), group=None)


def smooth(
    estimator: EvolvingEstimator, observations: Iterable[Observation | PathMean], times_ns: Sequence[int], lag: float | None = None
) -> list[FlowEstimate]:
    """Return the current estimates at times, from the observations before and after them.

    Args:
        estimator: Of the sea through time; its gate decides forward, as in a replay.
        observations: In the order in which the filter is given them; late ones count when they count there.
        times_ns: Wanted times [ns, UTC], in any order.
        lag: Only observations up to so long after a time count for it [s]; None counts all.
    """
    wanted = sorted(set(times_ns))
    states, steps = _forward(estimator, observations, wanted)
    smoothed: dict[int, EvolvingState] = {}
    if lag is None:
        adjoint, left = _nothing(estimator, max([*wanted, *(step.time_ns for step in steps)], default=0)), list(steps)
        for time_ns in reversed(wanted):
            while left and left[-1].time_ns > time_ns:
                adjoint = adjoint.at(estimator.layout, left[-1].time_ns).before(left.pop())
            adjoint = adjoint.at(estimator.layout, time_ns)
            smoothed[time_ns] = adjoint.smoothed(states[time_ns])
    else:
        for time_ns in wanted:
            adjoint = _nothing(estimator, time_ns + int(lag * _NS))
            for step in reversed([step for step in steps if time_ns < step.time_ns <= adjoint.time_ns]):
                adjoint = adjoint.at(estimator.layout, step.time_ns).before(step)
            smoothed[time_ns] = adjoint.at(estimator.layout, time_ns).smoothed(states[time_ns])
    return [replace(estimator.flow(smoothed[time_ns]), later=None) for time_ns in times_ns]


def _nothing(estimator: EvolvingEstimator, time_ns: int) -> Adjoint:
    size = estimator.layout.size
    return Adjoint(np.zeros(size), np.zeros((size, size)), time_ns)


def _forward(
    estimator: EvolvingEstimator, observations: Iterable[Observation | PathMean], wanted: Sequence[int]
) -> tuple[dict[int, EvolvingState], list[Step]]:
    """Return the filter's states at wanted times, after the observations that counted up to each, and what every observation did."""
    state, left = estimator.initial(), list(wanted)
    states: dict[int, EvolvingState] = {}
    steps: list[Step] = []
    for observation in observations:
        offered = estimator.offered(state, observation)
        if isinstance(offered, Innovation):
            continue
        if offered.looked.believed:
            step = _step(offered)
            # only what counts ends the time before it: after a rejected observation an earlier one may still come
            while left and left[0] < step.time_ns:
                states[left[0]] = estimator.predicted(state, left[0])
                left.pop(0)
            steps.append(step)
        state, _ = estimator.taken(state, offered)
    return states | {time_ns: estimator.predicted(state, time_ns) for time_ns in left}, steps


def _step(offered: Offered) -> Step:
    rows = offered.seen.design / offered.looked.error_scale
    innovation = offered.looked.innovation / offered.looked.error_scale
    cross = rows @ offered.before.cov
    factor = scipy.linalg.cho_factor(cross @ rows.T + np.eye(len(rows)), lower=True)
    solved = scipy.linalg.cho_solve(factor, np.column_stack([cross, innovation, np.eye(len(rows))]))
    n = cross.shape[1]
    assert offered.before.time_ns is not None  # a prediction has a time
    return Step(offered.before.time_ns, rows, solved[:, :n], solved[:, n], solved[:, n + 1 :])
