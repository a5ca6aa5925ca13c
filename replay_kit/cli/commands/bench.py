"""``bench``: frozen tasks on real missions, twin surveys, simulated missions and plans; methods and programs in one table."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from replay_kit.cli.commands.ensemble import local_ensemble
from replay_kit.cli.commands.experiment import (
    ESTIMATOR,
    OneTruth,
    Outputs,
    check_outputs,
    run_study,
)
from replay_kit.cli.options import (
    INPUTS,
    SOURCES,
    TO_INPUTS,
    TO_OPTIONS,
    TO_OUTPUTS,
    Noise,
    Processes,
    option,
)
from replay_kit.cli.settings import Settings, takes_settings
from replay_kit.config.option import numbers
from replay_kit.core.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from replay_kit.config.run import RunConfig
    from replay_kit.core.grid import Ensemble as Members
    from replay_kit.estimator.evolving.filter import EvolvingEstimator
    from replay_kit.studies.bench.missions import Mission
    from replay_kit.studies.bench.run import BenchJob

Data = Annotated[
    Path,
    Parameter(
        name="DATA",
        help="Folder with the frozen missions, or logs of one mission; for the tasks on dives.",
        group=INPUTS,
        required=False,
    ),
]


@dataclass(frozen=True, slots=True, kw_only=True)
class Known(OneTruth):
    """The ensemble, where one is used, and its truths."""

    ensemble: Annotated[
        tuple[Path, ...],
        option("--ensemble", "Ensemble forecast, as of replay.", metavar="FILE..."),
        SOURCES,
    ] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Simulated:
    """What is measured of withheld truths."""

    pings: Annotated[
        str,
        option(
            "--pings",
            "Numbers of pings at which estimates are scored; of a simulated mission or an estimate that is planned on, the largest.",
            metavar="N1,N2,...",
        ),
    ] = "5,10,25,50,150,450"
    days: Annotated[
        float,
        option(
            "--days",
            "Duration of a simulated mission [days]; a truth that changes may end it sooner.",
            metavar="DAYS",
        ),
    ] = 20.0
    noise: Noise = 0.09
    plans: Annotated[int, option("--plans", "Missions planned, over all truths.", least=1)] = 100
    seeds: Annotated[
        int, option("--seeds", "Surveys or missions of each truth, with seeds 0 to N-1.", least=1)
    ] = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Asked(Simulated):
    """What is asked of whom."""

    task: Annotated[
        str | None,
        option(
            "--task",
            "Tasks: next-dive, planned-dive, deny-dive, deny-day, profile, deny-adcp on DATA; pings, outliers, bias, plans on an "
            "ensemble. "
            "Default: all on DATA, else pings.",
            metavar="T1,T2,...",
        ),
    ] = None
    methods: Annotated[
        str | None,
        option(
            "--methods",
            "Methods compared. On dives: estimate, process, by_depth, last_dive, mean_so_far, last_here, last_mean, zero, filter, "
            "forecast; of pings: default, paper, paper_cells, naive3d, nearest, ensemble_mean, etkf, letkf, gp. Default: all.",
            metavar="M1,M2,...",
        ),
    ] = None
    entry: Annotated[
        tuple[str, ...],
        option(
            "--entry",
            "Program that answers records of dives, one JSON line each; may be repeated.",
            metavar="NAME=COMMAND",
        ),
    ] = ()
    time_limit: Annotated[
        float, option("--time-limit", "Time limit of a program for each record [s].", metavar="S")
    ] = 10.0
    first: Annotated[
        int, option("--first", "First predicted dive of a mission that is scored.", least=1)
    ] = 3


@takes_settings(
    "logs", "measurements", "forecast", "estimator", "time", "gating", without=ESTIMATOR
)
def bench(
    *data: Data,
    known: Annotated[Known, TO_INPUTS] = Known(),
    asked: Annotated[Asked, TO_OPTIONS] = Asked(),
    settings: Settings,
    processes: Annotated[Processes, TO_OPTIONS] = Processes(),
    outputs: Annotated[Outputs, TO_OUTPUTS] = Outputs(),
) -> int:
    """Return 0."""
    read = [*data, *known.files, settings.file]
    config = settings.load()

    from replay_kit.studies.bench.page import FILES, report_of
    from replay_kit.studies.bench.run import run_bench

    check_outputs(read, outputs, FILES)
    job = _job(bool(data), known, asked)
    job.check()
    notes = list[str]()
    missions, estimator = _dives(data, known, config, notes) if job.dives else ((), None)
    members, truth, series = _simulated(known, config, job, notes)
    run_study(
        report_of,
        lambda advance: run_bench(
            missions, (estimator, members, series), truth, config, job, advance
        ),
        outputs,
        config,
        processes,
        notes,
    )
    return 0


def _job(has_dives: bool, known: Known, asked: Asked) -> "BenchJob":
    from replay_kit.studies.bench.dives import DiveJob
    from replay_kit.studies.bench.faults import FAULT_TASKS, FaultJob
    from replay_kit.studies.bench.plans import TASK as PLANS
    from replay_kit.studies.bench.plans import PlanJob
    from replay_kit.studies.bench.records import DIVE_TASKS
    from replay_kit.studies.bench.run import (
        DIVE_METHODS,
        BenchJob,
        chosen_methods,
        chosen_tasks,
    )
    from replay_kit.studies.bench.surveys import TASK, SurveyJob
    from replay_kit.studies.jobs import METHODS

    tasks = chosen_tasks(asked.task, has_dives)
    of_dives = tuple(task for task in tasks if task in DIVE_TASKS)
    faulty = tuple(task for task in tasks if task in FAULT_TASKS)
    pings = tuple(int(n) for n in numbers(asked.pings, "--pings"))
    on_ensemble = [task for task in tasks if task not in of_dives]
    if on_ensemble and not known.ensemble:
        raise ConfigError(f"bench: {on_ensemble[0]} needs an --ensemble")
    if TASK in tasks:
        known.check(f"bench {TASK}")
    if faulty and known.leave_out is None:
        raise ConfigError(f"bench: {faulty[0]} needs --leave-out")
    dives = surveys = faults = plans = None
    if of_dives:
        chosen = chosen_methods(asked.methods, DIVE_METHODS)
        dives = DiveJob(of_dives, chosen, _programs(asked.entry), asked.time_limit, asked.first)
    if TASK in tasks:
        methods = chosen_methods(asked.methods, METHODS)
        surveys = SurveyJob(known.leave_out, pings, asked.noise, asked.seeds, methods)
    if faulty:
        sizes = pings[-1], asked.days, asked.noise, asked.seeds
        faults = FaultJob(str(known.leave_out), faulty, *sizes)
    if PLANS in tasks:
        plans = PlanJob(known.leave_out, asked.plans, pings[-1], asked.noise)
    return BenchJob(dives, surveys, faults, plans)


def _programs(entries: tuple[str, ...]) -> dict[str, str]:
    pairs = [entry.partition("=") for entry in entries]
    for name, _, command in pairs:
        if not (name and command) or not name.replace("_", "a").replace("-", "a").isalnum():
            raise ConfigError(f"--entry: expected NAME=COMMAND, got '{name}={command}'")
    return {name: command for name, _, command in pairs}


def _dives(
    data: tuple[Path, ...], known: Known, config: "RunConfig", notes: list[str]
) -> "tuple[list[Mission], EvolvingEstimator | None]":
    """Return the missions, and the estimator where there is an ensemble; notes are added to."""
    from replay_kit.studies.bench.missions import frozen_missions, is_frozen, mission_of

    if len(data) == 1 and is_frozen(data[0]):
        if known.ensemble:
            raise ConfigError(
                "--ensemble: belongs to one mission; give its logs instead of the folder"
            )
        missions, absent = frozen_missions(data[0], config)
        notes += [f"{name} is not in the folder" for name in absent]
        return missions, None
    missions = [mission_of(list(data), config)]
    if not known.ensemble:
        return missions, None

    from replay_kit.estimator.evolving.build import build_evolving
    from replay_kit.workflows.replay.inputs.forecast import read_forecasts
    from replay_kit.workflows.replay.inputs.region import find_region
    from replay_kit.workflows.replay.inputs.scan import look_ahead

    if config.estimator.name != "reduced_basis" or config.estimator.preset != "default":
        raise ConfigError(
            "bench predicts dives with the project's own estimator and its default preset; leave name and preset out"
        )
    place_at, first_ns = look_ahead(data, config)
    ensemble = local_ensemble(known.ensemble, data, config)
    region = find_region(data, ensemble, config, first_ns, (), may_follow=False)
    forecasts = read_forecasts(ensemble, config, first_ns, place_at, region)
    notes += forecasts.notes
    return missions, build_evolving(forecasts.series, config.estimator, config.time, config.gating)


def _simulated(
    known: Known, config: "RunConfig", job: "BenchJob", notes: list[str]
) -> "tuple[Members | None, Members | None, Sequence[Members]]":
    """Return ensemble and truth of surveys and plans, and the forecast at its times of simulated missions, as far as they are needed.

    What is probably wrong with the ensemble, such as copies among its members, is added to the notes.
    """
    from replay_kit.forecast import read_series
    from replay_kit.forecast.members import WARNING

    members, truth = known.read(config.forecast) if job.surveys or job.plans else (None, None)
    series = read_series(known.ensemble, config.forecast) if job.faults else ()
    of_all = (note for one in (members, *series[:1]) if one is not None for note in one.notes)
    notes += dict.fromkeys(note for note in of_all if note.startswith(WARNING))
    return members, truth, series
