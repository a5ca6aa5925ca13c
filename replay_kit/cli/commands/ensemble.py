"""``fetch``, ``config``, ``synthesize`` and ``twin``: fetched forecasts, settings, synthetic data."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from replay_kit.cli.console import console_beside, part_named, progress
from replay_kit.cli.options import (
    INPUTS,
    MCAP,
    NETCDF,
    OUTPUTS,
    PART_OF_FORECAST,
    TO_OPTIONS,
    Answer,
    Ensemble,
    LogIfAny,
    Noise,
    Replacing,
    Switch,
    option,
    output,
)
from replay_kit.cli.settings import Settings, annotated_toml, takes_settings
from replay_kit.core.errors import ConfigError
from replay_kit.core.files.paths import addresses_in, truth_path

if TYPE_CHECKING:
    from replay_kit.config.run import RunConfig
    from replay_kit.workflows.replay.inputs.job import ReplayJob


@takes_settings("logs", "measurements", "forecast", "estimator.name", "estimator.preset", "time")
def fetch(
    *logs: LogIfAny,
    ensemble: Ensemble,
    out: Annotated[Path | None, output("FORECAST.nc"), NETCDF] = None,
    answer: Answer = Answer(),
    settings: Settings,
    dry_run: Switch = False,
) -> int:
    """Return exit code 0.

    Args:
        out: Also copy the part of one address to a file, to be given to --ensemble anywhere.
        dry_run: Only report the data to receive and their size.
    """
    addresses = addresses_in(ensemble)
    if not addresses:
        raise ConfigError(
            "--ensemble: expected an address, such as https://...; files need no fetching"
        )
    if out is not None and len(addresses) > 1:
        raise ConfigError(
            f"--out: expected one address, got {len(addresses)}; leave it out: all are kept in the folder forecast.cache"
        )
    answer.check([*logs, settings.file], out)
    config = settings.load()
    if dry_run:
        with progress():
            return print_price(ensemble, logs, config, answer)

    from replay_kit.forecast.remote.kept import record_of
    from replay_kit.workflows.fetch import copy_whole, request_of
    from replay_kit.workflows.fetch import fetch as fetch_request
    from replay_kit.workflows.replay.inputs.job import ReplayJob

    with progress():
        found = fetch_request(request_of(ReplayJob(logs, ensemble), config))
    console = answer.console()
    for path in found.files:
        how = "received" if found.asked else "fetched before"
        console.print(f"{path}: {how}, {path.stat().st_size / 1e6:.4g} MB")
    if out is not None:
        with part_named(out):
            copy_whole(found.files[0], out)
        console.print(f"Copy: {out}")
    files = [{"file": str(path), **(record_of(path) or {})} for path in found.files]
    answer.write({"received": found.asked, "files": files})
    return 0


def print_price(
    ensemble: tuple[Path, ...], logs: tuple[Path, ...], config: "RunConfig", answer: Answer
) -> int:
    """Print the data at addresses that logs need, or the region of the settings, also as JSON; return exit code 0."""
    from replay_kit.forecast.remote.fetch import cost_text
    from replay_kit.workflows.fetch import price, request_of
    from replay_kit.workflows.replay.inputs.job import ReplayJob

    rows = price(request_of(ReplayJob(logs, ensemble), config))
    for row in rows:
        answer.console().print(cost_text(row))
    answer.write({"received": False, "addresses": rows})
    return 0


def local_forecast(job: "ReplayJob", config: "RunConfig") -> "ReplayJob":
    """Return a job whose forecasts are files; addresses are fetched."""
    if not any(map(addresses_in, (job.ensemble, *job.against))):
        return job
    # loads a client of servers
    from replay_kit.workflows.fetch import with_local_forecast

    with progress():
        return with_local_forecast(job, config)


def config(*sections: Annotated[str, Parameter(name="SECTION", group=INPUTS)]) -> int:
    """Return exit code 0.

    Args:
        sections: Tables such as planner. Default: all.
    """
    sys.stdout.write(annotated_toml(sections))
    return 0


@TO_OPTIONS
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
    truth: Annotated[str, option("FILE[#member]", group=INPUTS)],
    out: Annotated[Path, output("X.mcap"), MCAP],
    survey: Survey = Survey(),
    replacing: Replacing = Replacing(),
    settings: Settings,
) -> int:
    """Return exit code 0.

    Args:
        truth: The current that the vehicle moves in.
        out: The log.
    """
    replacing.check([truth_path(truth)], out)
    part = settings.load().forecast

    from replay_kit.forecast import read_truth
    from replay_kit.studies.twins.make import Twin, make_twin

    simulated = Twin(survey.vehicle, survey.pings, survey.noise, survey.seed)
    with progress() as advance:
        advance(0, 0, "moving the vehicle")
        made = make_twin(read_truth(truth, part), simulated, out, replacing.overwrite)
    console_beside().print(f"{out}: {survey.pings} pings over {made.hours:.1f} h")
    return 0


def synthesize(
    *,
    ensemble: Annotated[Path, option("E.nc", group=OUTPUTS), NETCDF],
    truth: Annotated[Path, option("T.nc", group=OUTPUTS), NETCDF],
    members: Annotated[int, option(least=2)] = 40,
    seed: int = 0,
    replacing: Replacing = Replacing(),
) -> int:
    """Return exit code 0.

    Args:
        ensemble: File of the members.
        truth: File of one more member, the withheld truth.
        members: Number of members.
        seed: The same seed gives the same bytes.
    """
    replacing.check([], ensemble, truth)

    from replay_kit.studies.twins.ensemble import write_ensemble

    with progress() as advance:
        advance(0, 0, "making the ensemble")
        write_ensemble(ensemble, truth, n_members=members, seed=seed, overwrite=replacing.overwrite)
    return 0
