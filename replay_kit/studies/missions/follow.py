"""An estimator that follows a mission, and figures of it beside the limits required of them."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
from scipy.special import chdtri

from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.observation import Innovation, Measurement
from replay_kit.estimator import Estimator
from replay_kit.studies.reports.tables import NAN, grouped, is_within

RMSE = "RMSE [m/s]"


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure of one mission, as a part of a whole, so that missions can be added up.

    Attributes:
        method: The estimator, or what was measured.
        name: What the figure is, with its unit.
        part: An error, a sum, a number of hits.
        whole: What it is a part of: another error, degrees of freedom, a number of trials; 1 for a plain number.
        at_least: Lower limit of part over whole; NaN for none.
        at_most: Upper limit; NaN for none.
    """

    method: str
    name: str
    part: float
    whole: float = 1.0
    at_least: float = NAN
    at_most: float = NAN


@dataclass(frozen=True, slots=True)
class MissionRow:
    """A figure over all missions.

    Attributes:
        study: Of ``job.STUDIES``.
        method: The estimator, or what was measured.
        figure: What it is, with its unit.
        value: Over all missions: the sum of the parts over the sum of the wholes.
        at_least: Lower limit of the value; NaN for none.
        at_most: Upper limit of the value; NaN for none.
        met: Whether the value keeps to its limits; None without limits.
        by_mission: The figure of each mission, truth after truth, seed after seed.
    """

    study: str
    method: str
    figure: str
    value: float
    at_least: float
    at_most: float
    met: bool | None
    by_mission: tuple[float, ...]


def error_figures(
    method: str, error: float, over: str, reference: float, at_most: float = NAN
) -> list[Figure]:
    """Return an error, and its ratio to a reference.

    Args:
        method: Whose error.
        error: RMSE [m/s].
        over: Name of the reference.
        reference: Its RMSE [m/s].
        at_most: Upper limit of the ratio; NaN for none.
    """
    return [
        Figure(method, RMSE, error),
        Figure(method, f"RMSE over {over}", error, reference, at_most=at_most),
    ]


def over_missions(study: str, missions: Sequence[Sequence[Figure]]) -> tuple[MissionRow, ...]:
    """Return each figure of a study over all missions that have it, in the order in which they first come.

    Args:
        study: Its name.
        missions: The figures of each.
    """
    alike = grouped(chain.from_iterable(missions), lambda one: (one.method, one.name))
    return tuple(_row(study, figures) for figures in alike.values())


def _row(study: str, figures: Sequence[Figure]) -> MissionRow:
    first = figures[0]
    value = _over(sum(figure.part for figure in figures), sum(figure.whole for figure in figures))
    low, high = (
        float(np.mean(limits))
        for limits in zip(*((figure.at_least, figure.at_most) for figure in figures), strict=True)
    )
    met = is_within(value, low, high) if math.isfinite(low) or math.isfinite(high) else None
    by_mission = tuple(_over(figure.part, figure.whole) for figure in figures)
    return MissionRow(study, first.method, first.name, value, low, high, met, by_mission)


def _over(part: float, whole: float) -> float:
    return float(part / whole) if whole else NAN


_BAND = (0.025, 0.975)


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """An estimator's way through a mission.

    Attributes:
        errors: RMSE [m/s], one each time.
        innovations: Of each measurement that could be used.
        state: The last.
    """

    errors: tuple[float, ...]
    innovations: tuple[Innovation, ...]
    state: Any

    def mean(self) -> float:
        """Return the mean error [m/s]."""
        return float(np.mean(self.errors))

    def not_accepted(self, but: frozenset[int] = frozenset()) -> int:
        """Return how many measurements were rejected or downweighted, without those of some times [ns, UTC]."""
        return sum(
            innovation.decision != "accepted" and innovation.time_ns not in but
            for innovation in self.innovations
        )

    def nis(self, method: str) -> list[Figure]:
        """Return the normalised innovation squared of all measurements, and the share of them inside their own 95 % band."""
        nis, dof = np.array([(innovation.nis, innovation.dof) for innovation in self.innovations]).T
        inside = (nis >= chdtri(dof, 1.0 - _BAND[0])) & (nis <= chdtri(dof, 1.0 - _BAND[1]))
        share = "measurements inside their 95 % band"
        return [
            Figure(method, "NIS per degree of freedom", float(nis.sum()), float(dof.sum())),
            Figure(method, share, float(inside.sum()), float(inside.size)),
        ]


def evaluated_after(count: int, evaluations: int) -> tuple[int, ...]:
    """Return the numbers of measurements after which to evaluate, evenly spread; the last is after all of them."""
    return tuple(sorted({round(count * (k + 1) / evaluations) for k in range(evaluations)} - {0}))


def follow(
    estimator: Estimator[Any],
    given: Sequence[Measurement],
    evaluations: int,
    error: Callable[[FlowEstimate, int], float],
) -> Followed:
    """Return an estimator's way through a mission.

    Args:
        estimator: One that takes profiles and mean currents.
        given: The measurements, in order of time.
        evaluations: How often the estimate is compared with the truth.
        error: Takes the estimate and the time of the last measurement [ns, UTC]; returns its RMSE [m/s].
    """
    state: Any = estimator.initial()
    errors, innovations = list[float](), list[Innovation]()
    when = evaluated_after(len(given), evaluations)
    for number, measurement in enumerate(given, start=1):
        state, innovation = estimator.step(state, measurement)
        if innovation.decision != "unusable":
            innovations.append(innovation)
        if number in when:
            # a measurement that was not used leaves the state at an earlier time
            errors.append(error(estimator.flow(state).at(measurement.time_ns), measurement.time_ns))
    return Followed(tuple(errors), tuple(innovations), state)
