"""``fit``, ``synthesize`` and ``twin``: the prior fitted to an ensemble, a made ensemble, and the log of a vehicle in a truth."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from replay_kit.cli.commands.fetch import local_ensemble
from replay_kit.cli.console import console_beside, progress, write_json
from replay_kit.cli.options import (
    INPUTS,
    NETCDF,
    OUTPUTS,
    PART_OF_FORECAST,
    TO_OPTIONS,
    TO_OUTPUTS,
    Answer,
    Ending,
    Noise,
    Processes,
    Replacing,
    argument,
    flag,
    option,
)
from replay_kit.cli.settings import Settings, takes_settings
from replay_kit.core.paths import check_paths, truth_path


@dataclass(frozen=True, slots=True, kw_only=True)
class Outputs(Answer):
    """What is written."""

    out: Annotated[
        Path,
        option("--out -o", "Fitted settings, for --config.", metavar="TOML"),
        Ending((".toml",)),
    ]


@takes_settings(*PART_OF_FORECAST, "estimator.modes", file=False)
def fit(
    *ensemble: Annotated[
        Path,
        argument("ENSEMBLE", "Ensemble forecast: NetCDF files, Zarr stores, folders or patterns."),
    ],
    outputs: Annotated[Outputs, TO_OUTPUTS],
    settings: Settings,
    processes: Annotated[Processes, TO_OPTIONS] = Processes(),
    left_out: Annotated[
        int, option("--left-out", "Number of members left out in turn (cross-validation).", least=1)
    ] = 12,
) -> int:
    """Return 0."""
    check_paths(ensemble, [outputs.out, outputs.json_file], outputs.overwrite)
    config = settings.load()

    from replay_kit.forecast import read_ensemble
    from replay_kit.workflows.ensemble import fit_json, fit_prior, print_fit, write_fit
    from replay_kit.workflows.fleet.workers import calls_made_by

    members = read_ensemble(local_ensemble(ensemble, (), config), config.forecast)
    with calls_made_by(processes.scheduler, processes.workers), progress(config.output.threads):
        fitted = fit_prior(members, config.estimator, left_out)
    write_fit(fitted, outputs.out)
    print_fit(fitted, console_beside(outputs.json_file))
    write_json(outputs.json_file, fit_json(fitted))
    return 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Files(Replacing):
    """What the log is made of, and where it goes."""

    truth: Annotated[
        str,
        option(
            "--truth",
            "The current that the vehicle moves in.",
            metavar="FILE[#member]",
            group=INPUTS,
        ),
    ]
    out: Annotated[
        Path,
        option("--out -o", "The log; its ending chooses the format.", metavar="X.mcap|X.tlog"),
        Ending((".mcap", ".tlog")),
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class Survey:
    """What the vehicle does."""

    vehicle: Annotated[
        Literal["vessel", "glider"],
        option("--vehicle", "A vessel surveys at random positions, a glider dives."),
    ] = "vessel"
    pings: Annotated[int, option("--pings", "Number of ADCP pings.", least=1)] = 450
    interval: Annotated[
        float,
        option(
            "--interval", "Time from ping to ping of a glider [s], a multiple of 120.", metavar="S"
        ),
    ] = 600.0
    changing: Annotated[
        bool, flag("--changing", "The current changes through all leads or times of the truth.")
    ] = False
    noise: Noise = 0.09
    seed: Annotated[int, option("--seed", "The same seed gives the same bytes.")] = 0


@takes_settings(*PART_OF_FORECAST, file=False)
def twin(
    *,
    files: Annotated[Files, TO_OUTPUTS],
    survey: Annotated[Survey, TO_OPTIONS] = Survey(),
    settings: Settings,
) -> int:
    """Return 0."""
    check_paths([truth_path(files.truth)], [files.out], files.overwrite)
    part = settings.load().forecast

    from replay_kit.forecast import read_changing_truth, read_truth
    from replay_kit.studies.twins.make import Twin, make_twin
    from replay_kit.studies.twins.vehicle import EPOCH

    simulated = Twin(
        survey.vehicle, survey.pings, survey.noise, survey.seed, interval_s=survey.interval
    )
    with progress() as advance:
        advance(0, 0, "moving the vehicle")
        sea = (
            read_changing_truth(files.truth, part, EPOCH)
            if survey.changing
            else read_truth(files.truth, part)
        )
        made = make_twin(sea, simulated, files.out, files.overwrite)
    console_beside(None).print(
        f"{files.out}: {made.pings} pings over {made.duration / 3600.0:.1f} h"
    )
    return 0


def synthesize(
    *,
    ensemble: Annotated[
        Path, option("--ensemble", "File of the members.", metavar="E.nc", group=OUTPUTS), NETCDF
    ],
    truth: Annotated[
        Path,
        option(
            "--truth", "File of one more member, the withheld truth.", metavar="T.nc", group=OUTPUTS
        ),
        NETCDF,
    ],
    members: Annotated[int, option("--members", "Number of members.", least=2)] = 40,
    seed: Annotated[int, option("--seed", "The same seed gives the same bytes.")] = 0,
    replacing: Annotated[Replacing, TO_OUTPUTS] = Replacing(),
) -> int:
    """Return 0."""
    check_paths([], [ensemble, truth], replacing.overwrite)

    from replay_kit.studies.twins.ensemble import write_ensemble

    with progress() as advance:
        advance(0, 0, "making the ensemble")
        write_ensemble(ensemble, truth, n_members=members, seed=seed, overwrite=replacing.overwrite)
    return 0
