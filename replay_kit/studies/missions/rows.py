"""One figure of a study beside what is asked of it: the same value for the table, the CSV and the JSON."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

_NAN = float("nan")


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure of one mission, as a part of a whole, so that missions add up as they should.

    Attributes:
        study: Of ``job.STUDIES``.
        method: What estimated, or what was measured.
        name: What the figure is, with its unit.
        part: An error, a sum, a number of hits.
        whole: What it is a part of: another error, degrees of freedom, a number of trials; 1 for a plain number.
        at_least: What is asked; NaN for nothing.
        at_most: What is asked; NaN for nothing.
    """

    study: str
    method: str
    name: str
    part: float
    whole: float = 1.0
    at_least: float = _NAN
    at_most: float = _NAN


@dataclass(frozen=True, slots=True)
class MissionRow:
    """A figure over all missions.

    Attributes:
        study: Of ``job.STUDIES``.
        method: What estimated, or what was measured.
        figure: What it is, with its unit.
        value: Over all missions: the sum of the parts over the sum of the wholes.
        at_least: What is asked of the value; NaN for nothing.
        at_most: What is asked of the value; NaN for nothing.
        met: Whether the value is as asked; None where nothing is.
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


def over_missions(missions: Sequence[Sequence[Figure]]) -> tuple[MissionRow, ...]:
    """Return each figure over all missions that have it, in the order in which they first come.

    Args:
        missions: The figures of each.
    """
    alike: dict[tuple[str, str, str], list[Figure]] = {}
    for figures in missions:
        for figure in figures:
            alike.setdefault((figure.study, figure.method, figure.name), []).append(figure)
    return tuple(_row(figures) for figures in alike.values())


def _row(figures: Sequence[Figure]) -> MissionRow:
    first = figures[0]
    value = _over(sum(figure.part for figure in figures), sum(figure.whole for figure in figures))
    low, high = (float(np.mean([getattr(figure, name) for figure in figures])) for name in ("at_least", "at_most"))
    asked = math.isfinite(low) or math.isfinite(high)
    # a figure that is no number is not as asked
    met = not math.isnan(value) and not value < low and not value > high
    by_mission = tuple(_over(figure.part, figure.whole) for figure in figures)
    return MissionRow(first.study, first.method, first.name, value, low, high, met if asked else None, by_mission)


def _over(part: float, whole: float) -> float:
    return float(part / whole) if whole else _NAN
