"""One run of the benchmark: the tasks that its inputs allow, their figures in one result."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import chain
from typing import Any

from replay_kit.config.run import RunConfig
from replay_kit.core.errors import ConfigError
from replay_kit.core.grid import Ensemble
from replay_kit.core.progress import Progress, silent
from replay_kit.estimator.evolving.filter import EvolvingEstimator
from replay_kit.studies.bench.dives import DiveJob, run_dives
from replay_kit.studies.bench.faults import FAULT_TASKS, FaultJob, run_faults
from replay_kit.studies.bench.frame import BenchResult, Figure, Lost, results_of
from replay_kit.studies.bench.methods import methods_of
from replay_kit.studies.bench.missions import Mission
from replay_kit.studies.bench.plans import TASK as PLAN_TASK
from replay_kit.studies.bench.plans import PlanJob, run_plans
from replay_kit.studies.bench.records import DIVE_TASKS
from replay_kit.studies.bench.surveys import TASK, SurveyJob, run_surveys
from replay_kit.studies.jobs import METHODS, check_names

TASKS = (*DIVE_TASKS, TASK, *FAULT_TASKS, PLAN_TASK)
#: Methods of tasks on dives.
DIVE_METHODS = tuple(methods_of(False, True) | methods_of(True, True))


@dataclass(frozen=True, slots=True)
class BenchJob:
    """What is run, of each kind of task; None for none.

    Attributes:
        dives: On real dives.
        surveys: On twin surveys.
        faults: On simulated missions with faults.
        plans: On missions planned on estimates.
    """

    dives: DiveJob | None = None
    surveys: SurveyJob | None = None
    faults: FaultJob | None = None
    plans: PlanJob | None = None

    def check(self) -> None:
        """Raise ConfigError when an option is wrong."""
        for job in (self.dives, self.surveys, self.faults, self.plans):
            if job is not None:
                job.check()


def chosen_tasks(named: str | None, has_dives: bool) -> tuple[str, ...]:
    """Return the tasks of ``--task``; without it those on dives where there are any, else the twin surveys.

    Raises:
        ConfigError: A name is no task, or a task on dives lacks data, or none is left for the data.
    """
    tasks = tuple(named.split(",")) if named else (DIVE_TASKS if has_dives else (TASK,))
    check_names("--task", tasks, TASKS)
    needs = [task for task in tasks if task in DIVE_TASKS]
    if bool(needs) != has_dives:
        raise ConfigError(
            f"bench: expected {'a folder or logs for ' + needs[0] if needs else 'a task on dives, as logs are given'}; the tasks are "
            f"{', '.join(TASKS)}"
        )
    return tasks


def chosen_methods(named: str | None, known: Sequence[str]) -> tuple[str, ...]:
    """Return those of ``--methods`` that a kind of task knows; all without it.

    Raises:
        ConfigError: A name is no method of any task, or none is of this kind.
    """
    if named is None:
        return tuple(known)
    names = tuple(named.split(","))
    check_names("--methods", names, dict.fromkeys((*DIVE_METHODS, *METHODS)))
    ours = tuple(name for name in names if name in known)
    check_names("--methods", ours, known)
    return ours


def run_bench(
    missions: Sequence[Mission],
    forecast: tuple[EvolvingEstimator | None, Ensemble | None, Sequence[Ensemble]],
    truth: Ensemble | None,
    config: RunConfig,
    job: BenchJob,
    progress: Progress = silent,
) -> Iterator[BenchResult]:
    """Yield the result so far after each task, method or mission, then the whole one.

    Args:
        missions: Of the tasks on dives.
        forecast: The estimator of the tasks on dives, the ensemble of surveys and plans, and the forecast at its times of the missions with
            faults, each where it is needed.
        truth: Of surveys and plans; None to leave members out.
        config: Settings of the estimators.
        job: What is run.
        progress: Called with steps done, steps in all, and what is being run.

    Raises:
        ConfigError: An option is wrong.
        EstimatorError: Nothing has a score.
    """
    job.check()
    estimator, members, series = forecast
    parts = list[Iterator[list[Figure | Lost]]]()
    if job.dives is not None:
        parts.append(run_dives(missions, estimator, job.dives, progress))
    if job.surveys is not None and members is not None:
        parts.append(run_surveys(members, truth, config.estimator, job.surveys, progress))
    if job.faults is not None:
        parts.append(run_faults(series, config, job.faults, progress))
    if job.plans is not None and members is not None:
        parts.append(run_plans(members, truth, config.estimator, job.plans, progress))
    source = members.source if members is not None else series[0].source if series else None
    inputs = {
        "ensemble": source,
        "truth": None if truth is None else truth.source,
        "missions": {each.name: _mission_json(each) for each in missions},
        "job": {name: value for name, value in asdict(job).items() if value is not None},
    }
    return results_of(chain.from_iterable(parts), inputs)


def _mission_json(mission: Mission) -> dict[str, Any]:
    means = sum(dive.mean is not None for dive in mission.dives)
    bins = sum(dive.depth.size for dive in mission.dives)
    files = {"files": mission.hashes}
    return {"dives": len(mission.dives), "mean_currents": means, "bins": bins, **files}
