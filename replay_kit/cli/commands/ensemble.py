"""``fetch``, ``config``, ``synthesize`` and ``twin``: fetched forecasts, settings, synthetic data."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from replay_kit.cli.console import console_beside, part_named, progress, write_json
from replay_kit.cli.options import (
    FLAG,
    INPUTS,
    NETCDF,
    OUTPUTS,
    PART_OF_FORECAST,
    TO_OPTIONS,
    TO_OUTPUTS,
    Answer,
    Ending,
    Ensemble,
    LogIfAny,
    Noise,
    Replacing,
    option,
)
from replay_kit.cli.settings import Settings, annotated_toml, takes_settings
from replay_kit.core.errors import ConfigError
from replay_kit.core.files.paths import addresses_in, as_groups, check_paths, truth_path

if TYPE_CHECKING:
    from rich.console import Console

    from replay_kit.config.run import RunConfig
    from replay_kit.workflows.replay.inputs.job import ReplayJob


@dataclass(frozen=True, slots=True, kw_only=True)
class Copied(Answer):
    """Outputs of ``fetch``.

    Attributes:
        out: Also copy the part of one address to a file, to be given to --ensemble anywhere.
    """

    out: Annotated[Path | None, option("FORECAST.nc", alias="-o"), NETCDF] = None


@takes_settings("logs", "measurements", "forecast", "estimator.name", "estimator.preset", "time")
def fetch(
    *logs: LogIfAny,
    ensemble: Ensemble,
    outputs: Annotated[Copied, TO_OUTPUTS] = Copied(),
    settings: Settings,
    dry_run: Annotated[bool, FLAG] = False,
) -> int:
    """Return exit code 0.

    Args:
        dry_run: Only report the data to receive and their size.
    """
    addresses = addresses_in(ensemble)
    if not addresses:
        raise ConfigError(
            "--ensemble: expected an address, such as https://...; files need no fetching"
        )
    if outputs.out is not None and len(addresses) > 1:
        raise ConfigError(
            f"--out: expected one address, got {len(addresses)}; leave it out: all are kept in the folder forecast.cache"
        )
    check_paths([*logs, settings.file], [outputs.out, outputs.json_file], outputs.overwrite)
    config, console = settings.load(), console_beside(outputs.json_file)

    from replay_kit.forecast.remote.kept import record_of
    from replay_kit.workflows.fetch import copy_whole, request_of
    from replay_kit.workflows.fetch import fetch as fetch_request
    from replay_kit.workflows.replay.inputs.job import ReplayJob

    with progress():
        request = request_of(ReplayJob(logs, ensemble), config)
        if dry_run:
            write_json(outputs.json_file, _price(request, console))
            return 0
        found = fetch_request(request)
    for path in found.files:
        how = "received" if found.asked else "fetched before"
        console.print(f"{path}: {how}, {path.stat().st_size / 1e6:.4g} MB")
    if outputs.out is not None:
        with part_named(outputs.out):
            copy_whole(found.files[0], outputs.out)
        console.print(f"Copy: {outputs.out}")
    answer = [{"file": str(path), **(record_of(path) or {})} for path in found.files]
    write_json(outputs.json_file, {"received": found.asked, "files": answer})
    return 0


def _price(request: Any, console: "Console") -> dict[str, Any]:
    """Print the data to receive, and return them for JSON."""
    from replay_kit.forecast.remote.fetch import cost_text
    from replay_kit.workflows.fetch import price

    rows = price(request)
    for row in rows:
        console.print(cost_text(row))
    return {"received": False, "addresses": rows}


def print_price(ensemble: tuple[Path, ...], config: "RunConfig", console: "Console") -> Any:
    """Print the data at addresses in the region of the settings, and return them for JSON."""
    from replay_kit.workflows.fetch import request_of
    from replay_kit.workflows.replay.inputs.job import ReplayJob

    return _price(request_of(ReplayJob((), ensemble), config), console)


def local_forecast(job: "ReplayJob", config: "RunConfig") -> "ReplayJob":
    """Return a job whose forecasts are files; addresses are fetched."""
    if not any(map(addresses_in, (job.ensemble, *job.against))):
        return job
    # loads a client of servers
    from replay_kit.workflows.fetch import with_local_forecast

    with progress():
        return with_local_forecast(job, config)


def local_ensemble(
    ensemble: tuple[Path, ...], logs: tuple[Path, ...], config: "RunConfig"
) -> tuple[Path, ...]:
    """Return an ensemble as files; addresses are fetched."""
    if not addresses_in(ensemble):
        return ensemble
    from replay_kit.workflows.replay.inputs.job import ReplayJob

    job = local_forecast(ReplayJob(logs, ensemble), config)
    return tuple(path for group in as_groups(job.ensemble, "ensemble") for path in group)


def config(*sections: Annotated[str, Parameter(name="SECTION", group=INPUTS)]) -> int:
    """Return exit code 0.

    Args:
        sections: Tables such as planner. Default: all.
    """
    sys.stdout.write(annotated_toml(sections))
    return 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Files(Replacing):
    """Input and output of a synthetic log.

    Attributes:
        truth: The current that the vehicle moves in.
        out: The log.
    """

    truth: Annotated[str, option("FILE[#member]", group=INPUTS)]
    out: Annotated[Path, option("X.mcap", alias="-o"), Ending((".mcap",))]


@dataclass(frozen=True, slots=True, kw_only=True)
class Survey:
    """Motion and pings of the vehicle.

    Attributes:
        vehicle: A vessel surveys at random positions, a glider dives.
        pings: Number of ADCP pings.
        seed: The same seed gives the same bytes.
    """

    vehicle: Literal["vessel", "glider"] = "vessel"
    pings: Annotated[int, option(least=1)] = 450
    noise: Noise = 0.09
    seed: int = 0


@takes_settings(*PART_OF_FORECAST, file=False)
def twin(
    *,
    files: Annotated[Files, TO_OUTPUTS],
    survey: Annotated[Survey, TO_OPTIONS] = Survey(),
    settings: Settings,
) -> int:
    """Return exit code 0."""
    check_paths([truth_path(files.truth)], [files.out], files.overwrite)
    part = settings.load().forecast

    from replay_kit.forecast import read_truth
    from replay_kit.studies.twins.make import Twin, make_twin

    simulated = Twin(survey.vehicle, survey.pings, survey.noise, survey.seed)
    with progress() as advance:
        advance(0, 0, "moving the vehicle")
        made = make_twin(read_truth(files.truth, part), simulated, files.out, files.overwrite)
    console_beside(None).print(f"{files.out}: {survey.pings} pings over {made.hours:.1f} h")
    return 0


def synthesize(
    *,
    ensemble: Annotated[Path, option("E.nc", group=OUTPUTS), NETCDF],
    truth: Annotated[Path, option("T.nc", group=OUTPUTS), NETCDF],
    members: Annotated[int, option(least=2)] = 40,
    seed: int = 0,
    replacing: Annotated[Replacing, TO_OUTPUTS] = Replacing(),
) -> int:
    """Return exit code 0.

    Args:
        ensemble: File of the members.
        truth: File of one more member, the withheld truth.
        members: Number of members.
        seed: The same seed gives the same bytes.
    """
    check_paths([], [ensemble, truth], replacing.overwrite)

    from replay_kit.studies.twins.ensemble import write_ensemble

    with progress() as advance:
        advance(0, 0, "making the ensemble")
        write_ensemble(ensemble, truth, n_members=members, seed=seed, overwrite=replacing.overwrite)
    return 0
