"""The chosen studies on one ensemble, as one value."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.grid import Ensemble
from replay_kit.studies.jobs.failures import EXPECTED_FAILURES, reason_of
from replay_kit.studies.planning.calls import Calls
from replay_kit.studies.planning.job import PlanningJob
from replay_kit.studies.planning.studies import STUDIES
from replay_kit.studies.planning.told import Told
from replay_kit.studies.planning.world import World, build_world

Progress = Callable[[int, int, str], None]


@dataclass(frozen=True, slots=True, eq=False)
class PlanningResult:
    """What studies have to say.

    Attributes:
        told: Study by study; those of the job that are missing were not done when this was kept.
        ensemble: Its file.
        truths: Their files, or the members left out in turn.
        n_members: Of the ensemble.
        levels: [m].
        job: What was asked for.
        modes: Most basis flows a level; None for all.
        seconds: Wall time of each study [s].
    """

    told: tuple[Told, ...]
    ensemble: str
    truths: tuple[str, ...]
    n_members: int
    levels: tuple[float, ...]
    job: PlanningJob
    modes: int | None
    seconds: Mapping[str, float]


def run_planning(
    ensemble: Ensemble,
    truth: Ensemble | None,
    config: EstimatorConfig,
    job: PlanningJob,
    calls: Calls,
    progress: Progress | None = None,
    keep: Callable[[PlanningResult], None] = lambda result: None,
) -> PlanningResult:
    """Return the studies asked for, on a truth or on each member left out in turn.

    Args:
        ensemble: All members.
        truth: An ensemble of one; None to leave members out.
        config: Everything but the preset.
        job: What to study.
        calls: The planner.
        progress: Called with steps done, steps in all, and what is being run.
        keep: Called with the result so far: without a study once the options are known to be right, then after each study.

    A study that fails for a reason of ``EXPECTED_FAILURES`` says why in its place; the others go on.

    Raises:
        ConfigError: An option is wrong.
    """
    job.check(STUDIES)
    total, done = sum(STUDIES[name].steps(job) for name in job.studies), 0

    def say(what: str, steps: int) -> None:
        nonlocal done
        if progress is not None:
            progress(done, total, what)
        done += steps

    world = build_world(ensemble, truth, config, job, calls, say)
    told: list[Told] = []
    seconds: dict[str, float] = {}
    truths = tuple(withheld.case.truth.source for withheld in world.truths)
    levels = tuple(float(level) for level in ensemble.grid.levels)

    def result() -> PlanningResult:
        return PlanningResult(tuple(told), ensemble.source, truths, ensemble.n_members, levels, job, config.modes, dict(seconds))

    keep(result())
    for name in job.studies:
        began = time.perf_counter()
        told.append(_told(name, world))
        seconds[name] = time.perf_counter() - began
        keep(result())
    return result()


def _told(name: str, world: World) -> Told:
    try:
        return STUDIES[name].run(world)
    except EXPECTED_FAILURES as error:
        return Told(name, name.capitalize(), (), words=(f"The study failed: {reason_of(error)}",), failed=reason_of(error))
