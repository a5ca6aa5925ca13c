"""``experiment missions``: gliders through members left out."""

from dataclasses import dataclass
from typing import Annotated

from replay_kit.cli.commands.experiment.study import (
    ESTIMATOR,
    Outputs,
    check_outputs,
    parts,
    run_study,
)
from replay_kit.cli.options import (
    PART_OF_FORECAST,
    TO_INPUTS,
    TO_OPTIONS,
    TO_OUTPUTS,
    Ensemble,
    Noise,
    Processes,
    option,
)
from replay_kit.cli.settings import Settings, takes_settings


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
            "Duration of a mission [days]; a truth that changes may end it sooner.",
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
