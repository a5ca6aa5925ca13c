"""The chosen studies on one ensemble, as one value."""

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.grid import Ensemble
from replay_kit.core.progress import Progress, silent
from replay_kit.studies.jobs import EXPECTED_FAILURES, Advance, reason_of
from replay_kit.studies.planning.arrivals import glides, missions
from replay_kit.studies.planning.job import PlanningJob, PlanningResult, StudyReport
from replay_kit.studies.planning.odds import odds
from replay_kit.studies.planning.world import FLOWS, World, build_world


@dataclass(frozen=True, slots=True)
class Study:
    """A study.

    Attributes:
        run: Makes it; calls ``world.advance`` once for each of its steps.
        steps: How many steps a job has.
    """

    run: Callable[[World], StudyReport]
    steps: Callable[[PlanningJob], int]


STUDIES: Mapping[str, Study] = {
    "glides": Study(glides, lambda job: len(FLOWS) * job.pairs),
    "missions": Study(missions, lambda job: len(FLOWS) * job.pairs),
    "odds": Study(odds, lambda job: job.pairs),
}


def run_planning(
    ensemble: Ensemble,
    truth: Ensemble | None,
    config: EstimatorConfig,
    job: PlanningJob,
    progress: Progress = silent,
) -> Iterator[PlanningResult]:
    """Yield the chosen studies so far, on a truth or on each member left out in turn.

    The first result is without a study and comes once the options are known to be right; each further one has one study more.

    Args:
        ensemble: All members.
        truth: An ensemble of one; None to leave members out.
        config: Everything but the preset.
        job: What to study.
        progress: Called with steps done, steps in all, and what is being run.

    A study that fails for a reason of ``EXPECTED_FAILURES`` states it in its report; the others go on.

    Raises:
        ConfigError: An option is wrong.
    """
    job.check(STUDIES)
    world = build_world(
        ensemble,
        truth,
        config,
        job,
        Advance(sum(STUDIES[name].steps(job) for name in job.studies), progress),
    )
    reports: list[StudyReport] = []
    seconds: dict[str, float] = {}
    truths = tuple(withheld.case.truth.source for withheld in world.truths)
    levels = tuple(float(level) for level in ensemble.grid.levels)

    def result() -> PlanningResult:
        return PlanningResult(
            tuple(reports),
            ensemble.source,
            truths,
            ensemble.n_members,
            levels,
            config.modes,
            job,
            dict(seconds),
        )

    yield result()
    for name in job.studies:
        began = time.perf_counter()
        try:
            reports.append(STUDIES[name].run(world))
        except EXPECTED_FAILURES as error:
            why = reason_of(error)
            reports.append(
                StudyReport(
                    name, name.capitalize(), (), findings=(f"The study failed: {why}",), failed=why
                )
            )
        seconds[name] = time.perf_counter() - began
        yield result()
