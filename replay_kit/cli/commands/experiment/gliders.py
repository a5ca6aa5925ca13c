"""``experiment dives``, ``missions`` and ``planning``: real dives predicted, simulated missions, odds of plans."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

from replay_kit.cli.commands.experiment.study import (
    ESTIMATOR,
    OneTruth,
    Outputs,
    Report,
    check_outputs,
    parts,
    run_study,
)
from replay_kit.cli.commands.fetch import local_ensemble
from replay_kit.cli.options import (
    PART_OF_FORECAST,
    TO_INPUTS,
    TO_OPTIONS,
    TO_OUTPUTS,
    Ensemble,
    Log,
    Noise,
    Processes,
    option,
)
from replay_kit.cli.settings import Settings, takes_settings
from replay_kit.core.errors import ConfigError
from replay_kit.core.progress import Progress


@dataclass(frozen=True, slots=True, kw_only=True)
class Truths:
    """The ensemble and the members withheld from it."""

    ensemble: Ensemble
    leave_out: Annotated[
        str,
        option(
            "--leave-out", "Members that are withheld as truths, in turn.", metavar="K,K,...|all"
        ),
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class Missions:
    """What is flown."""

    study: Annotated[str | None, parts("outliers, bias")] = None
    pings: Annotated[int, option("--pings", "Number of pings of a mission.", least=1)] = 160
    days: Annotated[
        float,
        option(
            "--days",
            "Duration of a mission [d]; a truth that changes may end it sooner.",
            metavar="DAYS",
        ),
    ] = 20.0
    noise: Noise = 0.09
    seeds: Annotated[int, option("--seeds", "Number of missions for each truth.", least=1)] = 1


@takes_settings(*PART_OF_FORECAST, "estimator", "time", "gating", without=ESTIMATOR)
def missions(
    *,
    truths: Annotated[Truths, TO_INPUTS],
    flown: Annotated[Missions, TO_OPTIONS] = Missions(),
    settings: Settings,
    processes: Annotated[Processes, TO_OPTIONS] = Processes(),
    outputs: Annotated[Outputs, TO_OUTPUTS] = Outputs(),
) -> int:
    """Return 0."""
    read = [*truths.ensemble, settings.file]
    config = settings.load()

    from replay_kit.forecast import read_series
    from replay_kit.studies.missions import STUDIES, MissionJob, page, run_missions

    check_outputs(read, outputs, page.FILES)
    series = read_series(truths.ensemble, config.forecast)
    studies = STUDIES if flown.study is None else tuple(flown.study.split(","))
    job = MissionJob(truths.leave_out, studies, flown.pings, flown.days, flown.noise, flown.seeds)
    run_study(
        page.report_of,
        lambda advance: run_missions(series, config, job, advance),
        outputs,
        config,
        processes,
    )
    return 0


@takes_settings(
    "logs", "measurements", "forecast", "estimator", "time", "gating", without=ESTIMATOR
)
def dives(
    *logs: Log,
    ensemble: Ensemble,
    settings: Settings,
    processes: Annotated[Processes, TO_OPTIONS] = Processes(),
    outputs: Annotated[Outputs, TO_OUTPUTS] = Outputs(),
) -> int:
    """Return 0."""
    read = [*logs, *ensemble, settings.file]
    config = settings.load()

    from replay_kit.estimator.evolving import build_evolving
    from replay_kit.studies.dives import DivesResult, page, read_dives, run_dives
    from replay_kit.workflows.replay.inputs.forecast import read_forecasts
    from replay_kit.workflows.replay.inputs.region import find_region
    from replay_kit.workflows.replay.inputs.scan import look_ahead

    check_outputs(read, outputs, page.FILES)
    if config.estimator.name != "reduced_basis" or config.estimator.preset != "default":
        raise ConfigError(
            "experiment dives predicts with the project's own estimator and its default preset; leave name and preset out"
        )
    place_at, first_ns = look_ahead(logs, config)
    found = read_dives(list(logs), config)
    ensemble = local_ensemble(ensemble, logs, config)
    region = find_region(logs, ensemble, config, first_ns, (), may_follow=False)
    forecasts = read_forecasts(ensemble, config, first_ns, place_at, region)

    def results(advance: Progress) -> Iterator[DivesResult]:
        estimator = build_evolving(forecasts.series, config.estimator, config.time, config.gating)
        source = " ".join(map(str, ensemble))
        yield from run_dives(estimator, found, config, source, advance)

    run_study(page.report_of, results, outputs, config, processes, forecasts.notes)
    return 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Forecasts(OneTruth):
    """The ensemble and its truths."""

    leave_out: Annotated[
        str | None,
        option(
            "--leave-out",
            "Members that are withheld as truths. Default: 20 evenly spread.",
            metavar="K,K,...|all",
        ),
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Sizes:
    """How much is planned."""

    pairs: Annotated[
        int,
        option(
            "--pairs",
            "Number of missions, over all truths.",
            least=1,
        ),
    ] = 100
    pings: Annotated[int, option("--pings", "Number of pings of each estimate.", least=1)] = 450
    legs: Annotated[
        int, option("--legs", "Number of dives of the missions that goals are drawn with.", least=1)
    ] = 10
    fresh: Annotated[
        int, option("--fresh", "Number of fresh samples that odds are compared with.", least=1)
    ] = 500
    noise: Noise = 0.09
    seed: Annotated[int, option("--seed", "Seed of everything that is drawn.", least=0)] = 0


@takes_settings(*PART_OF_FORECAST, "estimator", without=ESTIMATOR)
def planning(
    *,
    truths: Annotated[Forecasts, TO_INPUTS],
    outputs: Annotated[Report, TO_OUTPUTS],
    sizes: Annotated[Sizes, TO_OPTIONS] = Sizes(),
    settings: Settings,
    processes: Annotated[Processes, TO_OPTIONS] = Processes(),
) -> int:
    """Return 0."""
    read = [*truths.files, settings.file]
    config = settings.load()

    from replay_kit.studies.planning import PlanningJob, page, run_planning

    job = PlanningJob(
        truths.leave_out,
        sizes.pairs,
        sizes.pings,
        sizes.noise,
        sizes.legs,
        fresh=sizes.fresh,
        seed=sizes.seed,
    )
    check_outputs(read, outputs, page.FILES)
    # before anything is read or made
    job.check()
    members, withheld = truths.read(config.forecast)
    run_study(
        page.report_of,
        lambda advance: run_planning(members, withheld, config.estimator, job, advance),
        outputs,
        config,
        processes,
    )
    return 0
