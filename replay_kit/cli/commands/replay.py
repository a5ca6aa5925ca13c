"""``replay``: logs through the estimator to an estimate, its uncertainty and a plan."""

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from replay_kit.cli.commands.ensemble import local_forecast
from replay_kit.cli.commands.following import Following
from replay_kit.cli.console import console_beside, part_named, progress, write_json
from replay_kit.cli.options import (
    FLAG,
    MCAP,
    NETCDF,
    SOURCES,
    TO_INPUTS,
    TO_OPTIONS,
    TO_OUTPUTS,
    Answer,
    Ensemble,
    Log,
    Truth,
    option,
    place,
)
from replay_kit.cli.settings import Settings, takes_settings
from replay_kit.config.option import PLACES
from replay_kit.core.errors import ConfigError, ForecastError, MeasurementError
from replay_kit.core.files.paths import check_paths, truth_path

if TYPE_CHECKING:
    from rich.console import Console

    from replay_kit.config.run import RunConfig
    from replay_kit.core.plan import Place
    from replay_kit.results.outcome.outcome import Outcome
    from replay_kit.workflows.replay.inputs.job import ReplayJob


@dataclass(frozen=True, slots=True, kw_only=True)
class Inputs:
    """Inputs of ``replay``, and data to score against.

    Attributes:
        against: Competing forecast (file, folder or pattern); the summary reports which fits the log better. May be repeated.
        vehicles: Logs of one of several vehicles, which share the estimate; once for each vehicle. Default: as the logs state.
        goal: Goal [degrees, degrees, m]; NAME= sets one vehicle's.
    """

    ensemble: Ensemble
    against: Annotated[tuple[Path, ...], option("FILE"), SOURCES] = ()
    vehicles: Annotated[tuple[str, ...], option("NAME=LOG...", name="--as")] = ()
    goal: Annotated[tuple[str, ...], option("[NAME=]LON,LAT,DEPTH"), PLACES] = ()
    truth: Truth = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Outputs(Answer):
    """Outputs of ``replay``.

    Attributes:
        out: Result, for any MCAP viewer.
        netcdf: Estimate and standard error on the forecast's grid, CF NetCDF.
        save_estimate: Lossless estimate, for plan and scripts.
        checkpoint: State from which an interrupted run resumes.
        report: Also write the report, an HTML page named as the result.
    """

    out: Annotated[Path, option("OUT.mcap", alias="-o"), MCAP]
    netcdf: Annotated[Path | None, option("GRID.nc"), NETCDF] = None
    save_estimate: Annotated[Path | None, option("FLOW.nc"), NETCDF] = None
    checkpoint: Annotated[Path | None, option("FILE")] = None
    report: Annotated[bool, FLAG] = False

    @property
    def page(self) -> Path | None:
        """Page of the report; None without one."""
        return self.out.with_suffix(".html") if self.report else None


@takes_settings(
    *("logs", "measurements", "forecast", "estimator", "time"),
    *(
        f"planner.{key}"
        for key in ("kind", "speed", "depth", "radius", "bathymetry", "clearance", "samples")
    ),
)
def replay(
    *logs: Log,
    inputs: Annotated[Inputs, TO_INPUTS],
    outputs: Annotated[Outputs, TO_OUTPUTS],
    settings: Settings,
    following: Annotated[Following, TO_OPTIONS] = Following(),
    dry_run: Annotated[bool, FLAG] = False,
) -> int:
    """Return the exit code of the summary; 0 for a dry run.

    Args:
        dry_run: Only report which data would be used, and the expected memory and time.
    """
    following.check(
        {
            "--dry-run": dry_run,
            "--checkpoint": outputs.checkpoint,
            "--truth": inputs.truth,
            "--against": inputs.against,
        }
    )
    read, made = (
        (
            *logs,
            *inputs.ensemble,
            *inputs.against,
            truth_path(inputs.truth),
            settings.file,
            following.goal_file,
        ),
        (outputs.out, outputs.netcdf, outputs.save_estimate),
    )
    replaced = outputs.overwrite or following.goes_on(outputs.out)
    status = following.page(outputs.out) if following.follow else None
    check_paths(read, (*made, outputs.json_file, outputs.page, status), replaced)
    config = settings.load()

    # what takes long to load, after what is quickly refused
    from replay_kit.results.outcome.outcome import failed
    from replay_kit.workflows.planning.adapters import planner_of
    from replay_kit.workflows.replay.inputs.job import check_outputs
    from replay_kit.workflows.replay.replay import replay as replay_logs

    job = _job(logs, inputs, outputs)
    console = console_beside(outputs.json_file)
    if not following.follow:
        also_read = [settings.file, config.planner.bathymetry_path]
        check_outputs(job, also_read, also_written=[outputs.json_file])
    job = local_forecast(job, config)
    if following.follow:
        return following.run(job, config, console, outputs.page, outputs.json_file)
    if dry_run:
        return _dry_run(job, config, outputs, console)
    try:
        with part_named(outputs.out), progress() as advance:
            advance(0, 0, "reading the forecast")
            outcome, _ = replay_logs(job, config, planner_of, advance)
    except (MeasurementError, ForecastError) as error:
        write_json(outputs.json_file, error.answer or failed(error).to_json())
        raise
    _answer(outputs, outcome, console)
    return outcome.exit_code


def _named(inputs: Inputs) -> dict[str, tuple[Path, ...]]:
    """Return the logs of ``--as`` by vehicle name."""
    found: dict[str, tuple[Path, ...]] = {}
    for text in inputs.vehicles:
        name, equals, log = text.partition("=")
        if not (name and equals and log):
            raise ConfigError(f"--as: expected NAME=LOG, got '{text}'")
        found[name] = (*found.get(name, ()), Path(log))
    return found


def _goals(inputs: Inputs, names: Collection[str]) -> "dict[str, Place]":
    """Return the goals by vehicle name; that of all vehicles under an empty name."""
    found: dict[str, Place] = {}
    for text in inputs.goal:
        name, _, numbers = text.rpartition("=")
        if name in found or (name and name not in names):
            what = (
                f"--goal {name}: expected the name of a vehicle of --as, one of {', '.join(names) or 'none'}"
                if name not in found
                else f"--goal: expected one value, got {' and '.join(inputs.goal)}; give the option once"
            )
            raise ConfigError(what)
        found[name] = place(numbers, "--goal")
    return found


def _job(logs: tuple[Path, ...], inputs: Inputs, outputs: Outputs) -> "ReplayJob":
    from replay_kit.workflows.replay.inputs.job import ReplayJob, Vehicle

    named = _named(inputs)
    goals = _goals(inputs, named)
    given = [log for own in named.values() for log in own]
    if named and (unnamed := [str(log) for log in logs if log not in given]):
        raise ConfigError(
            f"{', '.join(unnamed)}: expected the logs of all vehicles after --as NAME=, as of {', '.join(named)}; name its vehicle"
        )
    return ReplayJob(
        logs=logs,
        ensemble=inputs.ensemble,
        against=inputs.against,
        out=outputs.out,
        goal=goals.get(""),
        vehicles=tuple(Vehicle(name, own, goals.get(name)) for name, own in named.items()),
        netcdf=outputs.netcdf,
        save_estimate=outputs.save_estimate,
        truth=inputs.truth,
        checkpoint=outputs.checkpoint,
        overwrite=outputs.overwrite,
        tell=console_beside(outputs.json_file).print,
    )


def _dry_run(job: "ReplayJob", config: "RunConfig", outputs: Outputs, console: "Console") -> int:
    """Report the data to be used; return the exit code."""
    from replay_kit.workflows.planning.adapters import planner_of
    from replay_kit.workflows.replay.inputs.checks import dry_run, dry_run_json

    with progress() as advance:
        advance(0, 0, "reading the forecast and the logs")
        result = dry_run(job, config, planner_of)
    console.print(f"{result}. Nothing was written.")
    write_json(outputs.json_file, dry_run_json(result))
    return 0


def _answer(outputs: Outputs, outcome: "Outcome", console: "Console") -> None:
    """Print the summary, and write the report and the JSON if they are asked for."""
    from replay_kit.show.summary import print_summary
    from replay_kit.workflows.status import read_status

    print_summary(read_status(outputs.out)[0], outcome, console, verbose=outputs.verbose)
    written = [outputs.out, outputs.netcdf, outputs.save_estimate]
    if outputs.page is not None:
        from replay_kit.workflows.report import report

        report(outputs.out, outputs.page, outputs.overwrite, outcome)
        written.append(outputs.page)
    wrote = f"Wrote      {', '.join(str(path) for path in written if path is not None)}"
    more = "" if outputs.verbose else " (-v: evidence, dives, notes)"
    console.print(wrote + more * (len(wrote + more) <= 80))
    write_json(outputs.json_file, outcome.to_json())
