"""``fetch``: the part of a forecast on a server that a replay needs, received beforehand."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from replay_kit.cli.console import console_beside, part_named, progress, write_json
from replay_kit.cli.options import (
    NETCDF,
    TO_INPUTS,
    TO_OUTPUTS,
    Answer,
    Ensemble,
    LogIfAny,
    flag,
    option,
)
from replay_kit.cli.settings import Settings, takes_settings
from replay_kit.core.errors import ConfigError
from replay_kit.core.paths import addresses_in, as_groups, check_paths

if TYPE_CHECKING:
    from rich.console import Console

    from replay_kit.config.run import RunConfig
    from replay_kit.workflows.replay.inputs.job import ReplayJob


@dataclass(frozen=True, slots=True, kw_only=True)
class Inputs:
    """What is fetched."""

    ensemble: Ensemble


@dataclass(frozen=True, slots=True, kw_only=True)
class Outputs(Answer):
    """What is written."""

    out: Annotated[
        Path | None,
        option(
            "--out -o",
            "Also copy the part of one address to a file, to be given to --ensemble anywhere.",
            metavar="FORECAST.nc",
        ),
        NETCDF,
    ] = None


@takes_settings("logs", "measurements", "forecast", "estimator.name", "estimator.preset", "time")
def fetch(
    *logs: LogIfAny,
    inputs: Annotated[Inputs, TO_INPUTS],
    outputs: Annotated[Outputs, TO_OUTPUTS] = Outputs(),
    settings: Settings,
    dry_run: Annotated[
        bool, flag("--dry-run", "Only report what would be received, and its size.")
    ] = False,
) -> int:
    """Return 0."""
    addresses = addresses_in(inputs.ensemble)
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
        request = request_of(ReplayJob(logs, inputs.ensemble), config)
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
    """Print what would be received, and return it for JSON."""
    from replay_kit.forecast.remote.fetch import cost_text
    from replay_kit.workflows.fetch import price

    rows = price(request)
    for row in rows:
        console.print(cost_text(row))
    return {"received": False, "addresses": rows}


def print_price(ensemble: tuple[Path, ...], config: "RunConfig", console: "Console") -> Any:
    """Print what addresses hold in the region that the settings state, and return it for JSON."""
    from replay_kit.workflows.fetch import request_of
    from replay_kit.workflows.replay.inputs.job import ReplayJob

    return _price(request_of(ReplayJob((), ensemble), config), console)


def local_forecasts(jobs: Sequence[tuple["ReplayJob", "RunConfig"]]) -> list["ReplayJob"]:
    """Return jobs whose forecasts are files: what is at an address is fetched, a box that jobs share once."""
    if not any(addresses_in(each) for job, _ in jobs for each in (job.ensemble, *job.against)):
        return [job for job, _ in jobs]
    # loads a client of servers
    from replay_kit.workflows.fetch import with_local_forecasts

    with progress():
        return with_local_forecasts(jobs)


def local_ensemble(
    ensemble: tuple[Path, ...], logs: tuple[Path, ...], config: "RunConfig"
) -> tuple[Path, ...]:
    """Return an ensemble as files: what is at an address is fetched."""
    if not addresses_in(ensemble):
        return ensemble
    from replay_kit.workflows.replay.inputs.job import ReplayJob

    (job,) = local_forecasts([(ReplayJob(logs, ensemble), config)])
    return tuple(path for group in as_groups(job.ensemble, "ensemble") for path in group)
