"""How well each method estimates a withheld truth, against the number of pings it was given.

A seed draws places and noise; every method is given the same profiles in the same order, once, and its estimate is scored at each number of
pings: the estimator is online, so its estimate after n profiles is the one it would have had there been only n.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Observation
from replay_kit.core.progress import Progress, silent
from replay_kit.estimator import Estimator
from replay_kit.studies.jobs import (
    EXPECTED_FAILURES,
    Advance,
    check_counts,
    check_names,
    check_not_negative,
    check_positive,
    each_counted,
    reason_of,
)
from replay_kit.studies.reports.tables import grouped
from replay_kit.studies.scoring import METHODS, Score, bound, build_method, score
from replay_kit.studies.twins.adcp import random_observations
from replay_kit.studies.twins.field import build_field
from replay_kit.studies.twins.truths import Case, cases
from replay_kit.workflows.replay.scoring import ScoredPoints, scored_points

#: Figures of a row that are one number each.
FIGURES = ("rel_error", "rmse", "bound", "nis_per_dof", "coverage50", "coverage90", "crps")


@dataclass(frozen=True, slots=True)
class AccuracyJob:
    """What to compare, and on what measurements.

    Attributes:
        leave_out: ``all``, ``most-distant`` or members' positions from 0; None when a truth is given.
        pings: Numbers of pings at which estimates are scored, increasing.
        noise: Standard deviation of each component of each bin [m/s].
        seeds: Seeds 0 to seeds - 1 are run.
        methods: Of ``METHODS``.
    """

    leave_out: str | None = None
    pings: tuple[int, ...] = (5, 10, 25, 50, 150, 450)
    noise: float = 0.09
    seeds: int = 5
    methods: tuple[str, ...] = METHODS

    def check(self) -> None:
        """Raise ConfigError when an option is wrong."""
        check_names("--methods", self.methods, METHODS)
        check_counts(self.pings)
        check_positive(seeds=self.seeds)
        check_not_negative(noise=self.noise)


@dataclass(frozen=True, slots=True)
class AccuracyRow:
    """One method after one number of pings; a field is a column of the table and a key of the JSON.

    Attributes:
        method: Of ``METHODS``.
        pings: Number of pings given.
        rel_error: RMSE over the truth's RMS speed, mean over seeds.
        rel_error_by_seed: The same, seed by seed.
        rmse: Root mean square length of the error vector over the truth's wet grid points [m/s], mean over seeds.
        bound: Least RMSE that any flow in the method's span has [m/s]; NaN without a fixed span.
        nis_per_dof: Normalised innovation squared per degree of freedom, of every ping against the prediction made before it.
        coverage50: Share of components inside their 50 % interval.
        coverage90: Share of components inside their 90 % interval.
        crps: Mean continuous ranked probability score of a component [m/s].
        truth: Position of the member that was the truth, or ``mean`` over all, when several were left out in turn; None otherwise.
        failed: Why there are no figures; empty when there are.
    """

    method: str
    pings: int
    rel_error: float = math.nan
    rel_error_by_seed: tuple[float, ...] = ()
    rmse: float = math.nan
    bound: float = math.nan
    nis_per_dof: float = math.nan
    coverage50: float = math.nan
    coverage90: float = math.nan
    crps: float = math.nan
    truth: int | str | None = None
    failed: str = ""


@dataclass(frozen=True, slots=True)
class AccuracyResult:
    """All rows of a study, and what it was run on.

    Attributes:
        rows: By truth, then method and number of pings; means over truths come last.
        ensemble: Its file.
        truth: Its file, or the member left out, or the positions of several.
        modes: Limit on the basis flows of a level; None for all that exist.
        noise: [m/s].
        unfinished: Whether more rows were to follow when this was written.
    """

    rows: tuple[AccuracyRow, ...]
    ensemble: str
    truth: str
    modes: int | None
    noise: float
    unfinished: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class _Survey:
    """One truth measured: where estimates are scored, and the profiles of each seed."""

    case: Case
    at: ScoredPoints
    profiles: tuple[tuple[Observation, ...], ...]


def run_accuracy(
    ensemble: Ensemble,
    truth: Ensemble | None,
    config: EstimatorConfig,
    job: AccuracyJob,
    progress: Progress = silent,
) -> Iterator[AccuracyResult]:
    """Yield how well each method estimates a truth: the result so far after each method, then the whole one.

    Args:
        ensemble: All members.
        truth: An ensemble of one; None to leave members out.
        config: Of the default estimator; the other methods take the settings that apply to them.
        job: What to compare.
        progress: Called with profiles done, profiles in all, and what is being run.

    A method that fails for a reason of ``EXPECTED_FAILURES`` has rows that state it; the others go on.

    Raises:
        ConfigError: An option is wrong.
        ForecastError: The truth has no water.
        MeasurementError: No point of the truth lies in the region.
    """
    job.check()
    each = list(cases(ensemble, truth, job.leave_out))
    advance = Advance(len(each) * len(job.methods) * job.seeds * job.pings[-1], progress)
    in_turn = len(each) > 1
    rows: list[AccuracyRow] = []

    def result(unfinished: bool) -> AccuracyResult:
        name = str(job.leave_out) if in_turn else each[0].truth.source
        return AccuracyResult(
            tuple(rows), ensemble.source, name, config.modes, job.noise, unfinished
        )

    calls = (
        (method, survey, config, job.pings, advance)
        for survey in _surveys(each, job)
        for method in job.methods
    )
    steps = job.seeds * job.pings[-1]
    for (_, survey, *_), of_method in each_counted(_run_method, calls, advance, lambda *_: steps):
        rows += [replace(row, truth=survey.case.member if in_turn else None) for row in of_method]
        yield result(True)
    if in_turn:
        rows += _means(rows)
    yield result(False)


def _surveys(each: Sequence[Case], job: AccuracyJob) -> Iterator[_Survey]:
    for case in each:
        field, at = build_field(case.truth), scored_points(case.ensemble.grid, case.truth)
        profiles = tuple(
            random_observations(field, job.pings[-1], job.noise, seed) for seed in range(job.seeds)
        )
        yield _Survey(case, at, profiles)


def _run_method(
    method: str, survey: _Survey, config: EstimatorConfig, pings: Sequence[int], advance: Advance
) -> list[AccuracyRow]:
    """Return one row for each number of pings; where a seed failed before it, one that states why."""
    failed = ""
    by_seed: list[list[tuple[Score, float]]] = [[] for _ in survey.profiles]
    try:
        estimator = build_method(method, survey.case.ensemble, config)
        least = bound(estimator, survey.at)
    except EXPECTED_FAILURES as error:
        return [AccuracyRow(method, n, failed=reason_of(error)) for n in pings]
    for seed, (of_seed, scores) in enumerate(zip(survey.profiles, by_seed, strict=True)):
        try:
            # one by one, so that what was scored before a failure is kept
            for each in _run_seed(estimator, of_seed, pings, survey.at):
                advance(f"{survey.case.truth.source} {method} seed {seed}")
                scores += [each] if each is not None else []
        except EXPECTED_FAILURES as error:
            failed = failed or f"seed {seed}: {reason_of(error)}"
    whole = min(len(scores) for scores in by_seed)
    return [
        _row(method, n, least, [scores[k] for scores in by_seed])
        if k < whole
        else AccuracyRow(method, n, failed=failed)
        for k, n in enumerate(pings)
    ]


def _run_seed(
    estimator: Estimator[Any],
    observations: Sequence[Observation],
    counts: Sequence[int],
    at: ScoredPoints,
) -> Iterator[tuple[Score, float] | None]:
    """Yield after each ping None, or at the counts the score and the NIS per degree of freedom so far."""
    nis, dof = 0.0, 0
    for n, (state, innovation) in enumerate(
        estimator.steps(estimator.initial(), observations), start=1
    ):
        if innovation.accepted:
            nis, dof = nis + innovation.nis, dof + innovation.dof
        yield (
            (score(estimator.flow(state), at), nis / dof if dof else math.nan)
            if n in counts
            else None
        )


def _row(
    method: str, pings: int, least: float, by_seed: Sequence[tuple[Score, float]]
) -> AccuracyRow:
    scores, nis = zip(*by_seed, strict=True)
    means: dict[str, Any] = {
        field.name: float(np.mean([getattr(of_seed, field.name) for of_seed in scores]))
        for field in fields(Score)
    }
    errors = tuple(of_seed.rel_error for of_seed in scores)
    return AccuracyRow(
        method,
        pings,
        rel_error_by_seed=errors,
        bound=least,
        nis_per_dof=float(np.mean(nis)),
        **means,
    )


def _means(rows: Sequence[AccuracyRow]) -> list[AccuracyRow]:
    """Return the means over truths, seed by seed where there is one figure for each seed."""
    out = []
    for (method, pings), alike in grouped(rows, lambda row: (row.method, row.pings)).items():
        mean = AccuracyRow(method, pings, truth="mean")
        lost = [row for row in alike if row.failed]
        if lost:
            # a mean over the truths that are left would not be comparable with the other methods' means
            failed = f"failed on {len(lost)} of {len(alike)} truths, first on member {lost[0].truth}: {lost[0].failed}"
            out.append(replace(mean, failed=failed))
            continue
        figures: dict[str, Any] = {
            name: float(np.mean([getattr(row, name) for row in alike])) for name in FIGURES
        }
        by_seed = tuple(
            float(value) for value in np.mean([row.rel_error_by_seed for row in alike], axis=0)
        )
        out.append(replace(mean, rel_error_by_seed=by_seed, **figures))
    return out
