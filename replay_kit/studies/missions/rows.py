"""Figures of missions beside the limits required of them: the same values for the table, the CSV and the JSON."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from replay_kit.studies.reports.tables import NAN, is_within

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
    alike: dict[tuple[str, str], list[Figure]] = {}
    for figures in missions:
        for figure in figures:
            alike.setdefault((figure.method, figure.name), []).append(figure)
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
