"""``replay``: logs through the estimator to an estimate, its uncertainty and a plan."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from replay_kit.cli.commands.ensemble import local_forecast
from replay_kit.cli.console import part_named, progress
from replay_kit.cli.options import (
    MCAP,
    NETCDF,
    SOURCES,
    TO_INPUTS,
    TO_OPTIONS,
    TO_OUTPUTS,
    Answer,
    Ensemble,
    Log,
    Switch,
    Truth,
    option,
    output,
    place,
)
from replay_kit.cli.settings import Settings, takes_settings
from replay_kit.config.option import PLACES
from replay_kit.core.errors import ConfigError, ForecastError, LogError, MeasurementError
from replay_kit.core.files.paths import check_paths, truth_path

if TYPE_CHECKING:
    from replay_kit.config.run import RunConfig
    from replay_kit.core.plan import Place
    from replay_kit.results.outcome.outcome import Outcome
    from replay_kit.workflows.follow.watch import FollowOptions
    from replay_kit.workflows.replay.inputs.job import ReplayJob


@TO_INPUTS
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


@TO_OUTPUTS
@dataclass(frozen=True, slots=True, kw_only=True)
class Outputs(Answer):
    """Outputs of ``replay``.

    Attributes:
        out: Result, for any MCAP viewer.
        netcdf: Estimate and standard error on the forecast's grid, CF NetCDF.
        save_estimate: Lossless estimate, for plan and scripts.
        checkpoint: State from which an interrupted run resumes.
        include_inputs: Copy the logs' messages unchanged into the result.
        report: Also write the report, an HTML page named as the result.
    """

    out: Annotated[Path, output("OUT.mcap"), MCAP]
    netcdf: Annotated[Path | None, option("GRID.nc"), NETCDF] = None
    save_estimate: Annotated[Path | None, option("FLOW.nc"), NETCDF] = None
    checkpoint: Annotated[Path | None, option("FILE")] = None
    include_inputs: Switch = False
    report: Switch = False


@TO_OPTIONS
@dataclass(frozen=True, slots=True, kw_only=True)
class Following:
    """Options for following growing logs.

    Attributes:
        follow: Replay new data as logs grow or folders fill, until Ctrl-C; see the README.
        interval: Polling interval of --follow [s].
        until_idle: Stop --follow after this long without new data [s]. Default: never.
        goal_file: File with the goal LON,LAT,DEPTH; it may be edited during --follow.
        notify: Shell command that receives each alarm of --follow as a JSON line on standard input.
    """

    follow: Switch = False
    # a look reads the names in a folder
    interval: Annotated[float, option(least=0.1, seconds=True)] = 60.0
    until_idle: Annotated[float | None, option("SECONDS", least=0.0, seconds=True)] = None
    goal_file: Annotated[Path | None, option("FILE")] = None
    notify: Annotated[str | None, option("COMMAND")] = None


# Settings of the plans that a replay makes on its way.
_OF_PLANNER = "kind speed depth radius bathymetry clearance samples"


@takes_settings(
    *("logs", "measurements", "forecast", "estimator", "time"),
    *(f"planner.{key}" for key in _OF_PLANNER.split()),
)
def replay(
    *logs: Log,
    inputs: Inputs,
    outputs: Outputs,
    settings: Settings,
    following: Following = Following(),
    dry_run: Switch = False,
) -> int:
    """Return the exit code of the summary; 0 for a dry run.

    Args:
        dry_run: Only report which data would be used, and the expected memory and time.
    """
    out, follow, goal_file = outputs.out, following.follow, following.goal_file
    wrong = (
        ("--dry-run", dry_run or None),
        ("--checkpoint", outputs.checkpoint),
        ("--truth", inputs.truth),
        ("--against", inputs.against or None),
    )
    need = (
        ("--until-idle", following.until_idle),
        ("--goal-file", goal_file),
        ("--notify", following.notify),
    )
    if given := [name for name, value in (wrong if follow else need) if value is not None]:
        what = "cannot be combined with --follow; omit one"
        raise ConfigError(
            f"{given[0]}: {what if follow else 'needs --follow; add it, or omit the option'}"
        )
    page = out.with_suffix(".html") if outputs.report else None
    states, status = out.with_name(f"{out.name}.follow"), out.with_suffix(".status.html")
    files = [*logs, *inputs.ensemble, *inputs.against, truth_path(inputs.truth), goal_file]
    made = [out, outputs.netcdf, outputs.save_estimate, outputs.json_file, page]
    # what is followed goes on
    goes_on = follow and (states / "mission").is_file()
    check_paths(
        [*files, settings.file], [*made, status if follow else None], outputs.overwrite or goes_on
    )
    config = settings.load()

    # what takes long to load, after what is quickly refused
    from replay_kit.results.outcome.outcome import failed_outcome
    from replay_kit.workflows.planning.adapters import planner_of
    from replay_kit.workflows.replay.inputs.job import check_outputs
    from replay_kit.workflows.replay.replay import replay as replay_logs

    job = _job(logs, inputs, outputs)
    if follow:
        from replay_kit.workflows.follow.watch import FollowOptions

        options = FollowOptions(
            states,
            status,
            following.interval,
            following.until_idle,
            goal_file,
            following.notify or "",
            page,
            job.tell,
        )
        return _follow(local_forecast(job, config), config, options, outputs)
    check_outputs(job, [settings.file, config.planner.bathymetry_path], [outputs.json_file])
    job = local_forecast(job, config)
    if dry_run:
        from replay_kit.workflows.replay.inputs.checks import dry_run as expected
        from replay_kit.workflows.replay.inputs.checks import dry_run_json

        with progress() as advance:
            advance(0, 0, "reading the forecast and the logs")
            result = expected(job, config, planner_of)
        outputs.console().print(f"{result}. Nothing was written.")
        outputs.write(dry_run_json(result))
        return 0
    try:
        with part_named(out), progress() as advance:
            advance(0, 0, "reading the forecast")
            outcome, _ = replay_logs(job, config, planner_of, advance)
    except (MeasurementError, ForecastError) as error:
        outputs.write(error.answer or failed_outcome(error).to_json())
        raise
    return _answer(outputs, outcome, page)


def _job(logs: tuple[Path, ...], inputs: Inputs, outputs: Outputs) -> "ReplayJob":
    from replay_kit.workflows.replay.inputs.job import ReplayJob, Vehicle

    named: dict[str, tuple[Path, ...]] = {}
    for text in inputs.vehicles:
        name, _, log = text.partition("=")
        if not (name and log):
            raise ConfigError(f"--as: expected NAME=LOG, got '{text}'")
        named[name] = (*named.get(name, ()), Path(log))
    # that of all vehicles under an empty name
    goals: dict[str, Place] = {}
    for text in inputs.goal:
        name, _, numbers = text.rpartition("=")
        if name in goals:
            raise ConfigError(
                f"--goal: expected one value, got {' and '.join(inputs.goal)}; give the option once"
            )
        if name and name not in named:
            raise ConfigError(
                f"--goal {name}: expected the name of a vehicle of --as, one of {', '.join(named) or 'none'}"
            )
        goals[name] = place(numbers, "--goal")
    given = [log for of_vehicle in named.values() for log in of_vehicle]
    if named and (unnamed := [str(log) for log in logs if log not in given]):
        raise ConfigError(
            f"{', '.join(unnamed)}: expected the logs of all vehicles after --as NAME=, as of {', '.join(named)}; name its vehicle"
        )
    return ReplayJob(
        logs,
        inputs.ensemble,
        outputs.out,
        goals.get(""),
        outputs.netcdf,
        outputs.save_estimate,
        inputs.truth,
        outputs.checkpoint,
        outputs.overwrite,
        outputs.include_inputs,
        against=inputs.against,
        vehicles=tuple(
            Vehicle(name, of_vehicle, goals.get(name)) for name, of_vehicle in named.items()
        ),
        tell=outputs.console().print,
    )


def _follow(
    job: "ReplayJob", config: "RunConfig", options: "FollowOptions", outputs: Outputs
) -> int:
    """Follow the logs of a job, and return the exit code of the last replay."""
    if options.goal_file is not None and (job.vehicles or job.goal is not None):
        raise ConfigError(
            "--goal-file: needs a single vehicle; give each its goal with --goal NAME=LON,LAT,DEPTH"
            if job.vehicles
            else "--goal-file: cannot be combined with --goal; omit one"
        )
    from replay_kit.workflows.follow.follow import follow
    from replay_kit.workflows.planning.adapters import planner_of

    outcome = follow(job, config, planner_of, options)
    if outcome is None:
        raise LogError(
            "no log that can be replayed has arrived; check the folder and the messages about its files"
        )
    return outputs.tell(outputs.out, outcome)


def _answer(outputs: Outputs, outcome: "Outcome", page: Path | None) -> int:
    """Print the summary, write the JSON and the report if they are asked for, and return the exit code."""
    code = outputs.tell(outputs.out, outcome)
    if page is not None:
        from replay_kit.workflows.report import report

        report(outputs.out, page, outputs.overwrite, outcome)
    written = outputs.out, outputs.netcdf, outputs.save_estimate, page
    wrote = f"Wrote      {', '.join(str(path) for path in written if path is not None)}"
    more = "" if outputs.verbose else " (-v: evidence, dives, notes)"
    outputs.console().print(wrote + more * (len(wrote + more) <= 80))
    return code
