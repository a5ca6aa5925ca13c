"""The one frame of tasks, methods and scores: figures of single cases, pooled over cases with an interval from resampling these."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.errors import EstimatorError
from replay_kit.core.evidence import bootstrap_interval
from replay_kit.studies.reports.tables import NAN, grouped, is_within

#: How cases are pooled: part over whole, its square root, or its exponential, of parts that are logarithms.
Pool = Literal["mean", "rms", "geometric"]
_FINISH: dict[str, Callable[[Array], Array]] = {
    "mean": np.asarray,
    "rms": np.sqrt,
    "geometric": np.exp,
}


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure of one case as a part of a whole, so that cases can be added up.

    Attributes:
        method: The estimator or program, or what was measured.
        name: What the figure is, with its unit.
        part: An error, a sum of squares, a number of hits.
        whole: What it is a part of: degrees of freedom, a number of trials; 1 for a plain number.
        at_least: Lower limit of the pooled figure; NaN for none.
        at_most: Upper limit; NaN for none.
        pool: How cases are pooled.
        after: Number of pings before it; None where it does not depend on them.
        task: Name of the task.
        case: Mission or truth; figures of one case are added up before cases are resampled.
    """

    method: str
    name: str
    part: float
    whole: float = 1.0
    at_least: float = NAN
    at_most: float = NAN
    pool: Pool = "mean"
    after: int | None = None
    task: str = ""
    case: str = ""


@dataclass(frozen=True, slots=True)
class Lost:
    """A case, or a method on it, that has no figures.

    Attributes:
        task: Name of the task.
        case: Mission or truth.
        reason: Why.
        method: Whose figures are missing, so that it is not comparable; empty where the case is missing for all.
        after: Number of pings; None where it does not depend on them.
    """

    task: str
    case: str
    reason: str
    method: str = ""
    after: int | None = None

    def __str__(self) -> str:
        of = f", {self.method}" if self.method else ""
        after = "" if self.after is None else f" after {self.after} pings"
        return f"{self.task}, {self.case}{of}{after}: {self.reason}"


@dataclass(frozen=True, slots=True)
class BenchRow:
    """A figure over all cases; a field is a column of the CSV and a key of the JSON.

    Attributes:
        task: Name of the task.
        method: The estimator or program.
        after: Number of pings; None where it does not depend on them.
        figure: What it is, with its unit.
        value: Over all cases.
        low: Lower end of its interval of 90 %, from resampling cases; NaN for a single case.
        high: Upper end.
        at_least: Lower limit of the value; NaN for none.
        at_most: Upper limit of the value; NaN for none.
        met: Whether the value keeps to its limits; None without limits.
        cases: Their names.
        by_case: The figure of each.
    """

    task: str
    method: str
    after: int | None
    figure: str
    value: float
    low: float
    high: float
    at_least: float
    at_most: float
    met: bool | None
    cases: tuple[str, ...]
    by_case: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class BenchResult:
    """All rows so far, and what they were computed on.

    Attributes:
        rows: By task, method and number of pings, in the order in which they came.
        lost: Cases and methods without figures, and answers that were missing.
        inputs: Options, and hashes of files, by name.
        unfinished: Whether more is to follow.
    """

    rows: tuple[BenchRow, ...]
    lost: tuple[str, ...] = ()
    inputs: Mapping[str, Any] = field(default_factory=dict)
    unfinished: bool = False


def of_case(figures: Iterable[Figure], task: str, case: str) -> list[Figure]:
    """Return figures as those of a task and a case."""
    return [replace(figure, task=task, case=case) for figure in figures]


def results_of(
    parts: Iterable[Sequence[Figure | Lost]], inputs: Mapping[str, Any]
) -> Iterator[BenchResult]:
    """Yield the result so far after each part, then the whole one.

    Raises:
        EstimatorError: Nothing has figures.
    """
    figures, lost = list[Figure](), list[Lost]()
    for part in parts:
        figures += [each for each in part if isinstance(each, Figure)]
        lost += [each for each in part if isinstance(each, Lost)]
        yield BenchResult(rows_of(figures, lost), tuple(map(str, lost)), inputs, unfinished=True)
    if not figures:
        raise EstimatorError(
            f"bench: nothing has a score; {lost[0] if lost else 'no case was given'}"
        )
    yield BenchResult(rows_of(figures, lost), tuple(map(str, lost)), inputs)


def rows_of(figures: Iterable[Figure], lost: Sequence[Lost] = ()) -> tuple[BenchRow, ...]:
    """Return each figure over all cases, in the order in which they first come.

    A method that is missing in one case has no row: its mean over the others would not be comparable.
    """
    missing = {(one.task, one.method, one.after) for one in lost if one.method}
    alike = grouped(figures, lambda one: (one.task, one.method, one.after, one.name))
    return tuple(_row(parts) for key, parts in alike.items() if key[:3] not in missing)


def _row(parts: Sequence[Figure]) -> BenchRow:
    first = parts[0]
    of_cases = grouped(parts, lambda one: one.case)
    sums = np.array(
        [
            (sum(one.part for one in each), sum(one.whole for one in each))
            for each in of_cases.values()
        ],
        dtype=np.float64,
    )
    value = float(_pooled(sums, first.pool))
    low = high = NAN
    if len(sums) > 1 and np.isfinite(sums).all():
        low, high = bootstrap_interval(lambda drawn: _pooled(sums[drawn], first.pool), len(sums))
    at_least, at_most = (
        float(np.mean([getattr(one, name) for one in parts])) for name in ("at_least", "at_most")
    )
    limited = math.isfinite(at_least) or math.isfinite(at_most)
    return BenchRow(
        first.task,
        first.method,
        first.after,
        first.name,
        value,
        low,
        high,
        at_least,
        at_most,
        is_within(value, at_least, at_most) if limited else None,
        tuple(of_cases),
        tuple(float(_pooled(each[None], first.pool)) for each in sums),
    )


def _pooled(sums: Array, pool: Pool) -> Array:
    """Return the figure of cases, shape (...), of their parts and wholes, shape (..., n, 2); NaN where there is no whole."""
    part, whole = np.moveaxis(sums.sum(axis=-2), -1, 0)
    return np.asarray(
        _FINISH[pool](np.divide(part, whole, out=np.full_like(part, NAN), where=whole != 0.0))
    )
