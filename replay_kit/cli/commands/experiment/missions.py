"""``experiment missions``: gliders through members left out."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from replay_kit.cli.commands.experiment.truths import (
    ESTIMATOR,
    FOLDER,
    existing,
    folder,
    name_page,
    parts,
)
from replay_kit.cli.console import console_beside, keep_json, progress, write_json
from replay_kit.cli.options import (
    PART_OF_FORECAST,
    TO_INPUTS,
    TO_OPTIONS,
    TO_OUTPUTS,
    Answer,
    Ensemble,
    Noise,
    Processes,
    option,
)
from replay_kit.cli.settings import Settings, takes_settings
from replay_kit.core.paths import check_folder, check_paths


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

    study: Annotated[str | None, parts("time, relative, dac, outliers, bias, coverage")] = None
    pings: Annotated[int, option("--pings", "Number of pings of a mission.", least=1)] = 160
    days: Annotated[
        float,
        option(
            "--days",
            "Duration of a mission [days]; a truth that changes may end it sooner.",
            metavar="DAYS",
        ),
    ] = 20.0
    dives: Annotated[
        int,
        option(
            "--dives",
            "Number of dives of the missions that have depth-averaged currents alone.",
            least=1,
        ),
    ] = 30
    noise: Noise = 0.09
    seeds: Annotated[int, option("--seeds", "Number of missions for each truth.", least=1)] = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Outputs(Answer):
    """What is written."""

    out: Annotated[Path | None, folder("a page, CSV and JSON"), FOLDER] = None


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
    read, out = [*truths.ensemble, settings.file], outputs.out
    if out is not None:
        check_folder(out)
    check_paths(read, [outputs.json_file], outputs.overwrite)
    config = settings.load()

    from replay_kit.forecast import read_series
    from replay_kit.studies.missions import (
        FILES,
        STUDIES,
        MissionJob,
        print_missions,
        run_missions,
        to_json,
        write_missions,
    )
    from replay_kit.workflows.fleet.workers import calls_made_by

    check_paths(read, [*existing(out, FILES), outputs.json_file], outputs.overwrite)
    series = read_series(truths.ensemble, config.forecast)
    # the study of time needs a truth that changes
    usual = tuple(name for name in STUDIES if name != "time" or len(series) > 1)
    studies = usual if flown.study is None else tuple(flown.study.split(","))
    job = MissionJob(
        truths.leave_out, studies, flown.pings, flown.days, flown.dives, flown.noise, flown.seeds
    )
    with (
        calls_made_by(processes.scheduler, processes.workers),
        progress(config.output.threads) as advance,
    ):
        for result in run_missions(series, config, job, advance):
            if out is not None:
                out.mkdir(exist_ok=True)
                write_missions(out, result)
            keep_json(outputs.json_file, to_json(result))
    console = console_beside(outputs.json_file)
    print_missions(result, console)
    name_page(console, out)
    write_json(outputs.json_file, to_json(result))
    return 0
