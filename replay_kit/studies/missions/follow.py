"""An estimator led through a mission, looked at on the way."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

import numpy as np
from scipy.special import chdtri

from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.observation import Innovation, Measurement
from replay_kit.estimator import ReducedBasisEstimator
from replay_kit.estimator.evolving import EvolvingEstimator, EvolvingState
from replay_kit.studies.missions.rows import Figure

#: Those that take profiles and mean currents.
Own = EvolvingEstimator | ReducedBasisEstimator
Seen = TypeVar("Seen")
_DAY_NS = 86_400 * 10**9
_BAND = (0.025, 0.975)


@dataclass(frozen=True, slots=True, eq=False)
class Followed(Generic[Seen]):
    """What an estimator made of a mission.

    Attributes:
        looks: What was looked at, one each time.
        said: Of each measurement that could be used.
        state: The last.
    """

    looks: tuple[Seen, ...]
    said: tuple[Innovation, ...]
    state: Any

    def mean(self: "Followed[float]") -> float:
        """Return the mean of the looks."""
        return float(np.mean(self.looks))

    def nis(self, study: str, method: str, asked: bool = False) -> list[Figure]:
        """Return how the innovations compare with what was expected of them.

        The normalised innovation squared of all measurements with its 95 % band for one mission, and the share of measurements that
        lie inside their own 95 % band.

        Args:
            study: Of the figures.
            method: Of the figures.
            asked: Whether the band is asked for.
        """
        nis, dof = (np.array([getattr(said, name) for said in self.said]) for name in ("nis", "dof"))
        low, high = (float(chdtri(dof.sum(), 1.0 - end) / dof.sum()) for end in _BAND) if asked else (np.nan, np.nan)
        inside = (nis >= chdtri(dof, 1.0 - _BAND[0])) & (nis <= chdtri(dof, 1.0 - _BAND[1]))
        return [
            Figure(study, method, "NIS per degree of freedom", float(nis.sum()), float(dof.sum()), low, high),
            Figure(study, method, "measurements inside their 95 % band", float(inside.sum()), float(inside.size)),
        ]


def due(count: int, looks: int) -> tuple[int, ...]:
    """Return the numbers of measurements after which to look, evenly spread; the last is after all of them."""
    return tuple(sorted({round(count * (k + 1) / looks) for k in range(looks)} - {0}))


def follow(
    estimator: Own,
    given: Sequence[Measurement],
    looks: int,
    look: Callable[[FlowEstimate, int], Seen],
    grown_a_day: float = 1.0,
) -> Followed[Seen]:
    """Return what an estimator made of a mission.

    Args:
        estimator: Static, or through time.
        given: The measurements, in order of time.
        looks: How often it is looked at.
        look: Takes the estimate and the time of the last measurement [ns, UTC].
        grown_a_day: Factor by which the covariance grows in a day, of an estimator with an ``EvolvingState``.
    """
    state: Any = estimator.initial()
    seen: list[Seen] = []
    said: list[Innovation] = []
    when = due(len(given), looks)
    for number, measurement in enumerate(given, start=1):
        if grown_a_day != 1.0:
            state = _grown(state, measurement.time_ns, grown_a_day)
        state, innovation = estimator.step(state, measurement)
        if innovation.decision != "unusable":
            said.append(innovation)
        if number in when:
            # a measurement that was not used leaves the state at an earlier time
            seen.append(look(estimator.flow(state).at(measurement.time_ns), measurement.time_ns))
    return Followed(tuple(seen), tuple(said), state)


def _grown(state: EvolvingState, time_ns: int, a_day: float) -> EvolvingState:
    """Return a state whose covariance has grown since the last measurement."""
    days = 0.0 if state.time_ns is None else (time_ns - state.time_ns) / _DAY_NS
    return replace(state, covariance=a_day**days * state.cov, open_group=None)
