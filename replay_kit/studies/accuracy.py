"""How well each method tells a withheld truth, against the number of pings it was given.

A seed draws places and noise; every method meets the same profiles in the same order, once, and is scored on the way at each number of
pings: the estimator is online, so what it says after n profiles is what it would say had there been only n.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from replay_kit.config.gating import GatingConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.errors import ConfigError
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Observation
from replay_kit.estimator import Estimator, build_estimator
from replay_kit.estimator.baselines import BASELINES, build_baseline
from replay_kit.estimator.basis.modes import LENGTH_IN_CELLS, cell_size
from replay_kit.studies.bound import bound
from replay_kit.studies.failures import EXPECTED_FAILURES, reason_of
from replay_kit.studies.pings import random_observations
from replay_kit.studies.scores import Score, score
from replay_kit.studies.truths import Case, cases
from replay_kit.studies.twins.field import build_field
from replay_kit.workflows.replay.scoring import ScoredPoints, scored_points

# ``paper_cells`` is the paper's estimator with its length in cells rather than in kilometres, for grids coarser than its own.
METHODS = ("default", "paper", "paper_cells", *(name for name in BASELINES if name != "depth_average"))
Progress = Callable[[int, int, str], None]
#: Figures of a row that are one number each.
FIGURES = ("rel_error", "rmse", "bound", "nis_per_dof", "coverage50", "coverage90", "crps")


@dataclass(frozen=True, slots=True)
class AccuracyJob:
    """What to compare, and on what measurements.

    Attributes:
        leave_out: ``all``, ``most-distant`` or a member's position from 0; None when a truth is given.
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
        truth: Position of the member that was the truth, or ``mean`` over all, when all were left out in turn; None otherwise.
        failed: Why there are no figures; empty when there are.
    """

    method: str
    pings: int
    rel_error: float
    rel_error_by_seed: tuple[float, ...]
    rmse: float
    bound: float
    nis_per_dof: float
    coverage50: float
    coverage90: float
    crps: float
    truth: int | str | None = None
    failed: str = ""


@dataclass(frozen=True, slots=True)
class AccuracyResult:
    """All rows of an experiment, and what it was run on.

    Attributes:
        rows: By truth, then method, then number of pings; means over truths come last.
        ensemble: Its file.
        truth: Its file, or the member left out, or ``all``.
        modes: Basis flows a level asked for; None for all that exist.
        noise: [m/s].
        unfinished: Whether more rows were to follow when this was kept.
    """

    rows: tuple[AccuracyRow, ...]
    ensemble: str
    truth: str
    modes: int | None
    noise: float
    unfinished: bool = False


def run_accuracy(
    ensemble: Ensemble,
    truth: Ensemble | None,
    config: EstimatorConfig,
    job: AccuracyJob,
    progress: Progress | None = None,
    keep: Callable[[AccuracyResult], None] = lambda result: None,
) -> AccuracyResult:
    """Return how well each method tells a truth.

    Args:
        ensemble: All members.
        truth: An ensemble of one; None to leave members out.
        config: Of the default estimator; the other methods take what applies to them.
        job: What to compare.
        progress: Called with profiles done, profiles in all, and what is being run.
        keep: Called with the result so far, after each method.

    A method that fails for a reason of ``EXPECTED_FAILURES`` has rows that say why; the others go on.

    Raises:
        ConfigError: An option is wrong.
        ForecastError: The truth has no water.
        MeasurementError: No point of the truth lies in the region.
    """
    _check(job)
    each = list(cases(ensemble, truth, job.leave_out))
    total = len(each) * len(job.methods) * job.seeds * job.pings[-1]
    done = 0

    def advance(what: str) -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, total, what)

    named = "all" if job.leave_out == "all" else each[0].truth.source
    rows: list[AccuracyRow] = []

    def result(unfinished: bool) -> AccuracyResult:
        return AccuracyResult(tuple(rows), ensemble.source, named, config.modes, job.noise, unfinished)

    for case in each:
        for of_method in _run_case(case, config, job, advance):
            rows += [replace(row, truth=case.member) for row in of_method] if job.leave_out == "all" else of_method
            keep(result(True))
    if job.leave_out == "all":
        rows += _means(rows, job)
    return result(False)


def build_method(name: str, ensemble: Ensemble, config: EstimatorConfig) -> Estimator[Any]:
    """Return the estimator that a method's name stands for.

    Raises:
        ConfigError: The name is unknown.
    """
    if name == "default":
        return build_estimator(ensemble, config.model_copy(update={"preset": "default"}), GatingConfig())
    if name == "paper":
        return build_estimator(ensemble, config.model_copy(update={"preset": "paper"}))
    if name == "paper_cells":
        length = LENGTH_IN_CELLS * float(np.sqrt(np.prod(cell_size(ensemble.grid))))
        return build_estimator(ensemble, config.model_copy(update={"preset": "paper", "length_horizontal": length}))
    return build_baseline(name, ensemble, config)


def _check(job: AccuracyJob) -> None:
    unknown = [name for name in job.methods if name not in METHODS]
    if unknown or not job.methods:
        raise ConfigError(f"--methods: expected some of {', '.join(METHODS)}, got {', '.join(job.methods) or 'none'}")
    if not job.pings or min(job.pings) < 1 or list(job.pings) != sorted(set(job.pings)):
        raise ConfigError(f"--pings: expected increasing numbers of at least 1, got {job.pings}")
    if job.seeds < 1 or not (math.isfinite(job.noise) and job.noise >= 0.0):
        raise ConfigError(f"accuracy: expected seeds >= 1 and noise >= 0, got seeds {job.seeds} and noise {job.noise}")


def _run_case(case: Case, config: EstimatorConfig, job: AccuracyJob, advance: Callable[[str], None]) -> Iterator[list[AccuracyRow]]:
    """Yield the rows of each method."""
    field, at = build_field(case.truth), scored_points(case.ensemble.grid, case.truth)
    profiles = [random_observations(field, job.pings[-1], job.noise, seed) for seed in range(job.seeds)]
    for method in job.methods:
        yield _run_method(method, case, config, job, at, profiles, advance)


def _run_method(
    method: str,
    case: Case,
    config: EstimatorConfig,
    job: AccuracyJob,
    at: ScoredPoints,
    profiles: Sequence[Sequence[Observation]],
    advance: Callable[[str], None],
) -> list[AccuracyRow]:
    """Return one row a number of pings; where a seed failed before it, one that says why."""
    least, failed = math.nan, ""
    by_seed: list[list[tuple[Score, float]]] = [[] for _ in profiles]
    try:
        estimator = build_method(method, case.ensemble, config)
        least = bound(estimator, at)
    except EXPECTED_FAILURES as error:
        return [_failed_row(method, n, reason_of(error)) for n in job.pings]
    for seed, (of_seed, scores) in enumerate(zip(profiles, by_seed, strict=True)):
        try:
            # one by one, so that what was scored before a failure is kept
            for each in _run_seed(estimator, of_seed, job.pings, at, partial(advance, f"{case.truth.source} {method} seed {seed}")):
                scores.append(each)
        except EXPECTED_FAILURES as error:
            failed = failed or f"seed {seed}: {reason_of(error)}"
    whole = min(len(scores) for scores in by_seed)
    return [
        _row(method, n, least, [scores[k] for scores in by_seed]) if k < whole else _failed_row(method, n, failed)
        for k, n in enumerate(job.pings)
    ]


def _failed_row(method: str, pings: int, failed: str, truth: str | None = None) -> AccuracyRow:
    nothing = math.nan
    return AccuracyRow(method, pings, nothing, (), nothing, nothing, nothing, nothing, nothing, nothing, truth, failed)


def _run_seed(
    estimator: Estimator[Any],
    observations: Sequence[Observation],
    counts: Sequence[int],
    at: ScoredPoints,
    advance: Callable[[], None],
) -> Iterator[tuple[Score, float]]:
    """Yield the score and the NIS per degree of freedom so far, at each number of pings."""
    nis, dof = 0.0, 0
    for n, (state, said) in enumerate(estimator.steps(estimator.initial(), observations), start=1):
        if said.accepted:
            nis, dof = nis + said.nis, dof + said.dof
        advance()
        if n in counts:
            yield score(estimator.flow(state), at), nis / dof if dof else math.nan


def _row(method: str, pings: int, least: float, by_seed: Sequence[tuple[Score, float]]) -> AccuracyRow:
    def mean(name: str) -> float:
        return float(np.mean([getattr(of_seed, name) for of_seed, _ in by_seed]))

    return AccuracyRow(
        method=method,
        pings=pings,
        rel_error=mean("rel_error"),
        rel_error_by_seed=tuple(of_seed.rel_error for of_seed, _ in by_seed),
        rmse=mean("rmse"),
        bound=least,
        nis_per_dof=float(np.mean([nis for _, nis in by_seed])),
        coverage50=mean("coverage50"),
        coverage90=mean("coverage90"),
        crps=mean("crps"),
    )


def _means(rows: Sequence[AccuracyRow], job: AccuracyJob) -> list[AccuracyRow]:
    """Return the means over truths, seed by seed where there is a figure a seed."""
    out = []
    for method in job.methods:
        for pings in job.pings:
            alike = [row for row in rows if row.method == method and row.pings == pings]
            lost = [row for row in alike if row.failed]
            if lost:
                # a mean over the truths that are left would be no match for the other methods' means
                failed = f"failed on {len(lost)} of {len(alike)} truths, first on member {lost[0].truth}: {lost[0].failed}"
                out.append(_failed_row(method, pings, failed, "mean"))
                continue
            figures = {name: float(np.mean([getattr(row, name) for row in alike])) for name in FIGURES}
            by_seed = tuple(float(value) for value in np.mean([row.rel_error_by_seed for row in alike], axis=0))
            out.append(AccuracyRow(method=method, pings=pings, rel_error_by_seed=by_seed, truth="mean", failed="", **figures))
    return out
