"""An estimator given the measurements of a mission, its estimate evaluated on the way."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

import numpy as np
from scipy.special import chdtri

from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.observation import Innovation, Measurement
from replay_kit.estimator import Estimator
from replay_kit.estimator.evolving import EvolvingState
from replay_kit.studies.missions.rows import Figure
from replay_kit.studies.twins.vehicle import DAY_NS

Value = TypeVar("Value")
_BAND = (0.025, 0.975)


@dataclass(frozen=True, slots=True, eq=False)
class Followed(Generic[Value]):
    """An estimator's way through a mission.

    Attributes:
        values: What was evaluated, one each time.
        innovations: Of each measurement that could be used.
        state: The last.
    """

    values: tuple[Value, ...]
    innovations: tuple[Innovation, ...]
    state: Any

    def mean(self: "Followed[float]") -> float:
        """Return the mean of the values."""
        return float(np.mean(self.values))

    def not_accepted(self, but: frozenset[int] = frozenset()) -> int:
        """Return how many measurements were rejected or downweighted, without those of some times [ns, UTC]."""
        return sum(
            innovation.decision != "accepted" and innovation.time_ns not in but
            for innovation in self.innovations
        )

    def nis(self, method: str, required: bool = False) -> list[Figure]:
        """Return how the innovations compare with their expected distribution.

        The normalised innovation squared of all measurements with its 95 % band for one mission, and the share of measurements that
        lie inside their own 95 % band.

        Args:
            method: Of the figures.
            required: Whether the band is a limit of the first.
        """
        nis, dof = np.array([(innovation.nis, innovation.dof) for innovation in self.innovations]).T
        low, high = (
            (float(chdtri(dof.sum(), 1.0 - end) / dof.sum()) for end in _BAND)
            if required
            else (np.nan, np.nan)
        )
        inside = (nis >= chdtri(dof, 1.0 - _BAND[0])) & (nis <= chdtri(dof, 1.0 - _BAND[1]))
        return [
            Figure(
                method, "NIS per degree of freedom", float(nis.sum()), float(dof.sum()), low, high
            ),
            Figure(
                method,
                "measurements inside their 95 % band",
                float(inside.sum()),
                float(inside.size),
            ),
        ]


def evaluated_after(count: int, evaluations: int) -> tuple[int, ...]:
    """Return the numbers of measurements after which to evaluate, evenly spread; the last is after all of them."""
    return tuple(sorted({round(count * (k + 1) / evaluations) for k in range(evaluations)} - {0}))


def follow(
    estimator: Estimator[Any],
    given: Sequence[Measurement],
    evaluations: int,
    evaluate: Callable[[FlowEstimate, int], Value],
    daily_inflation: float = 1.0,
) -> Followed[Value]:
    """Return an estimator's way through a mission.

    Args:
        estimator: One that takes profiles and mean currents.
        given: The measurements, in order of time.
        evaluations: How often the estimate is evaluated.
        evaluate: Takes the estimate and the time of the last measurement [ns, UTC].
        daily_inflation: Factor by which the covariance grows in a day, of an estimator with an ``EvolvingState``.
    """
    state: Any = estimator.initial()
    values: list[Value] = []
    innovations: list[Innovation] = []
    when = evaluated_after(len(given), evaluations)
    for number, measurement in enumerate(given, start=1):
        if daily_inflation != 1.0:
            state = _inflated(state, measurement.time_ns, daily_inflation)
        state, innovation = estimator.step(state, measurement)
        if innovation.decision != "unusable":
            innovations.append(innovation)
        if number in when:
            # a measurement that was not used leaves the state at an earlier time
            values.append(
                evaluate(estimator.flow(state).at(measurement.time_ns), measurement.time_ns)
            )
    return Followed(tuple(values), tuple(innovations), state)


def _inflated(state: EvolvingState, time_ns: int, daily: float) -> EvolvingState:
    """Return a state whose covariance has grown since the last measurement."""
    days = 0.0 if state.time_ns is None else (time_ns - state.time_ns) / DAY_NS
    return replace(state, cov=daily**days * state.cov)
