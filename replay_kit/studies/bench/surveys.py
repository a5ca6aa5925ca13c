"""Twin surveys: how well each method estimates a withheld truth, against the number of pings it was given.

A seed draws places and noise; every method is given the same profiles in the same order, once, and its estimate is scored at each number of
pings: the estimator is online, so its estimate after n profiles is the one it would have had there been only n.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Observation
from replay_kit.core.progress import Progress, silent
from replay_kit.estimator import Estimator
from replay_kit.studies.bench.frame import Figure, Lost, of_case
from replay_kit.studies.jobs import (
    EXPECTED_FAILURES,
    METHODS,
    Advance,
    Score,
    bound,
    build_method,
    check_counts,
    check_names,
    check_not_negative,
    check_positive,
    each_counted,
    reason_of,
    score,
)
from replay_kit.studies.twins.adcp import random_observations
from replay_kit.studies.twins.field import build_field
from replay_kit.studies.twins.truths import Case, cases
from replay_kit.workflows.replay.scoring import ScoredPoints, scored_points

TASK = "pings"


@dataclass(frozen=True, slots=True)
class SurveyJob:
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


@dataclass(frozen=True, slots=True, eq=False)
class _Survey:
    """One truth measured: where estimates are scored, and the profiles of each seed."""

    case: Case
    at: ScoredPoints
    profiles: tuple[tuple[Observation, ...], ...]


def run_surveys(
    ensemble: Ensemble,
    truth: Ensemble | None,
    config: EstimatorConfig,
    job: SurveyJob,
    progress: Progress = silent,
) -> Iterator[list[Figure | Lost]]:
    """Yield how well each method estimates each truth. Cases are the truths, or the seeds of a single one.

    Args:
        ensemble: All members.
        truth: An ensemble of one; None to leave members out.
        config: Of the default estimator; the other methods take the settings that apply to them.
        job: What to compare.
        progress: Called with profiles done, profiles in all, and what is being run.

    Raises:
        ConfigError: An option is wrong.
        ForecastError: The truth has no water.
        MeasurementError: No point of the truth lies in the region.
    """
    job.check()
    each = list(cases(ensemble, truth, job.leave_out))
    steps = job.seeds * job.pings[-1]
    advance = Advance(len(each) * len(job.methods) * steps, progress)
    calls = (
        (method, survey, config, job.pings, len(each) > 1, advance)
        for survey in _surveys(each, job)
        for method in job.methods
    )
    for _, found in each_counted(_run_method, calls, advance, lambda *_: steps):
        yield found


def _surveys(each: Sequence[Case], job: SurveyJob) -> Iterator[_Survey]:
    for case in each:
        field, at = build_field(case.truth), scored_points(case.ensemble.grid, case.truth)
        profiles = tuple(
            random_observations(field, job.pings[-1], job.noise, seed) for seed in range(job.seeds)
        )
        yield _Survey(case, at, profiles)


def _run_method(
    method: str,
    survey: _Survey,
    config: EstimatorConfig,
    pings: Sequence[int],
    by_truth: bool,
    advance: Advance,
) -> list[Figure | Lost]:
    """Return the figures of each number of pings; where a seed failed before it, why."""
    truth, found = survey.case.truth.source, list[Figure | Lost]()
    try:
        estimator = build_method(method, survey.case.ensemble, config)
        least = bound(estimator, survey.at)
    except EXPECTED_FAILURES as error:
        return [Lost(TASK, truth, reason_of(error), method, n) for n in pings]
    for seed, of_seed in enumerate(survey.profiles):
        case, scored = truth if by_truth else f"seed {seed}", 0
        try:
            # one by one, so that what was scored before a failure is kept
            for each in _run_seed(estimator, of_seed, pings, survey.at):
                advance(f"{truth} {method} seed {seed}")
                if each is not None:
                    found += of_case(_figures(method, pings[scored], least, each), TASK, case)
                    scored += 1
        except EXPECTED_FAILURES as error:
            reason = f"seed {seed}: {reason_of(error)}"
            found += [Lost(TASK, truth, reason, method, n) for n in pings[scored:]]
    return found


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


def _figures(method: str, pings: int, least: float, found: tuple[Score, float]) -> list[Figure]:
    of_seed, nis = found
    named = {
        "relative error": of_seed.rel_error,
        "RMSE [m/s]": of_seed.rmse,
        "bound [m/s]": least,
        "NIS per degree of freedom": nis,
        "coverage 50 %": of_seed.coverage50,
        "coverage 90 %": of_seed.coverage90,
        "CRPS [m/s]": of_seed.crps,
    }
    return [Figure(method, name, value, after=pings) for name, value in named.items()]
