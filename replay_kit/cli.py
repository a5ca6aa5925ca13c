"""The command line: parse, configure, one library call, exit code.

Exit codes: 0 done; 1 the run failed inside; 2 bad option or configuration; 3 input unusable; 4 finished, but something was lost;
130 interrupted.
"""

import json
import logging
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table
from threadpoolctl import threadpool_limits

import planners
from planners.region import locate, region_of
from replay_kit import __version__
from replay_kit.baselines import BASELINES
from replay_kit.config import PlannerConfig, RunConfig, load_config
from replay_kit.convert import convert as convert_logs
from replay_kit.errors import ConfigError, ReplayKitError
from replay_kit.experiments.accuracy import METHODS, AccuracyJob, print_accuracy, run_accuracy
from replay_kit.experiments.accuracy import to_json as accuracy_json
from replay_kit.flow import FlowEstimate
from replay_kit.forecast import read_ensemble, read_truth
from replay_kit.inspect import info_json, inspect_log, iso, print_info
from replay_kit.job import ReplayJob
from replay_kit.rehearse import print_rehearsal, rehearsal_json, rehearse
from replay_kit.replay import replay as replay_logs
from replay_kit.report import print_summary, to_json
from replay_kit.twin import make_twin, write_ensemble
from replay_kit.types import Place, Plan

experiment = typer.Typer(help="Studies: how well the estimator does, and against what.", no_args_is_help=True)
app = typer.Typer(
    name="replay-kit",
    help="What was the water doing, and where should the vehicle go next?",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

app.add_typer(experiment, name="experiment")

JsonOption = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Write the answer as JSON; - is standard output.")]
OverwriteOption = Annotated[bool, typer.Option("--overwrite", help="Replace outputs that exist. An input is never replaced.")]
ConfigOption = Annotated[Path | None, typer.Option("--config", metavar="TOML", help="Settings of the run; options given here win.")]
ClockOption = Annotated[Literal["log", "publish", "header"] | None, typer.Option("--clock", help="Which stamp orders the replay.")]
RegionOption = Annotated[str | None, typer.Option("--region", metavar="W,S,E,N", help="Part of the ensemble used [degrees].")]
LevelsOption = Annotated[str | None, typer.Option("--levels", metavar="Z1,Z2,...", help="Levels used [m]; the nearest are taken.")]
LeadOption = Annotated[float | None, typer.Option("--lead", help="Forecast period, in the file's unit; the nearest is taken.")]


@dataclass(frozen=True, slots=True)
class GlidePlanner:
    """The glide planner bound to a configuration: what ``replay`` asks of a planner."""

    settings: planners.GlideSettings

    @classmethod
    def of(cls, config: PlannerConfig) -> "GlidePlanner":
        """Return the planner of a configuration."""
        return cls(planners.GlideSettings(speed=config.speed, tolerance=config.tolerance, max_duration=config.max_duration))

    def plan(self, flow: FlowEstimate, start: Place, goal: Place, start_time_ns: int, warm: Plan | None) -> Plan:
        """Return the best glide found from start towards goal."""
        return planners.plan(flow, start, goal, settings=self.settings, start_time_ns=start_time_ns, warm=warm)

    def check(self, flow: FlowEstimate, goal: Place) -> None:
        """Raise PlanError when the goal is outside the region or on land."""
        locate(region_of(flow.grid), goal, "goal")

    def closest_approach(self, flow: FlowEstimate, plan: Plan) -> float:
        """Return how close [m] a plan passes its goal when it is flown in a flow."""
        _, _, closest_approach = planners.fly(flow, plan)
        return closest_approach


def main() -> None:
    """Run the command line and exit with its code."""
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(name)s: %(message)s")
    try:
        app(standalone_mode=True)
    except ReplayKitError as error:
        print(f"replay-kit: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
    except KeyboardInterrupt:
        print("replay-kit: interrupted; what was written so far is in OUT.part", file=sys.stderr)
        sys.exit(130)
    except BrokenPipeError:
        sys.exit(1)


def _show_version(wanted: bool) -> None:
    if wanted:
        print(f"replay-kit {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and leave.")] = False,
) -> None:
    """What was the water doing, and where should the vehicle go next?"""


@app.command()
def replay(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="Logs of one mission: MCAP, MAVLink .tlog, Seaglider NetCDF.")],
    ensemble: Annotated[
        Path, typer.Option("--ensemble", metavar="FILE", help="Ensemble forecast: CF NetCDF or Zarr with a member dimension.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="OUT.mcap", help="Result, for any MCAP viewer.")],
    config: ConfigOption = None,
    goal: Annotated[str | None, typer.Option("--goal", metavar="LON,LAT,DEPTH", help="Where to go next [degrees, degrees, m].")] = None,
    estimator: Annotated[str | None, typer.Option("--estimator", help=f"reduced_basis (ours), or {', '.join(BASELINES)}.")] = None,
    preset: Annotated[
        Literal["default", "paper"] | None, typer.Option("--preset", help="Estimator: the project's, or the paper's exactly.")
    ] = None,
    modes: Annotated[int | None, typer.Option("--modes", min=1, help="Basis flows a level.")] = None,
    region: RegionOption = None,
    levels: LevelsOption = None,
    lead: LeadOption = None,
    reference_time: Annotated[
        str | None, typer.Option("--reference-time", help="Start of the forecast, for a file of leads without one.")
    ] = None,
    place_ensemble: Annotated[bool, typer.Option("--place-ensemble", help="Move the ensemble's centre to the log's mean fix.")] = False,
    clock: ClockOption = None,
    start: Annotated[str | None, typer.Option("--start", help="First time used, ISO 8601 UTC.")] = None,
    end: Annotated[str | None, typer.Option("--end", help="Last time used, ISO 8601 UTC.")] = None,
    netcdf: Annotated[
        Path | None, typer.Option("--netcdf", metavar="GRID.nc", help="Estimate and standard error on the grid, CF NetCDF.")
    ] = None,
    save_estimate: Annotated[Path | None, typer.Option("--save-estimate", metavar="FLOW.nc", help="The estimate without loss.")] = None,
    truth: Annotated[str | None, typer.Option("--truth", metavar="T.nc[#member]", help="Known truth to score against.")] = None,
    truth_radius: Annotated[
        float | None, typer.Option("--truth-radius", metavar="KM", help="Score only this near to the profiles.")
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only say what would be used, and the memory and time expected.")] = False,
    json_file: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Replay logs through the current estimator: estimate, uncertainty and plan in one MCAP."""
    place = True if place_ensemble else None
    settings = load_config(
        config,
        {
            "logs": {"clock": clock, "start": start, "end": end},
            "forecast": {
                "region": _numbers(region, "--region", 4),
                "levels": _numbers(levels, "--levels"),
                "lead": lead,
                "reference_time": reference_time,
                "place": place,
            },
            "estimator": {"name": estimator, "preset": preset, "modes": modes},
        },
    )
    job = ReplayJob(
        logs=tuple(logs),
        ensemble=ensemble,
        out=out,
        goal=_place(goal, "--goal"),
        netcdf=netcdf,
        save_estimate=save_estimate,
        truth=truth,
        truth_radius_km=truth_radius,
        overwrite=overwrite,
    )
    if dry_run:
        rehearsal = rehearse(job, settings)
        print_rehearsal(rehearsal, _console(json_file))
        _write_json(json_file, rehearsal_json(rehearsal))
        return
    with _progress("replaying") as advance:
        summary, _ = replay_logs(job, settings, GlidePlanner.of(settings.planner), advance)
    print_summary(summary, _console(json_file))
    _write_json(json_file, to_json(summary))
    raise typer.Exit(summary.exit_code)


@app.command()
def info(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="Logs to look into.")],
    clock: ClockOption = None,
    json_file: JsonOption = None,
) -> None:
    """Say what is in a log and what it can be used for."""
    settings = load_config(None, {"logs": {"clock": clock}})
    found = [inspect_log(path, settings) for path in logs]
    console = _console(json_file)
    for log in found:
        print_info(log, console)
    _write_json(json_file, {"logs": [info_json(log) for log in found]})
    raise typer.Exit(4 if any(log.report.losses for log in found) else 0)


@app.command()
def convert(
    inputs: Annotated[list[Path], typer.Argument(metavar="IN...", help="Logs: Seaglider NetCDF, .tlog, MCAP; several are merged by time.")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="OUT.mcap", help="One MCAP with JSON messages.")],
    json_file: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Convert logs to one MCAP."""
    with _progress("converting") as advance:
        summary = convert_logs(inputs, out, overwrite, RunConfig().logs, advance)
    console = _console(json_file)
    table = Table("topic", "messages", title=str(out), title_justify="left")
    for topic, count in sorted(summary.messages.items()):
        table.add_row(topic, str(count))
    console.print(table)
    for path, loss in summary.losses:
        console.print(f"LOST: {path}: {loss.what} ({loss.bytes} bytes, from byte {loss.offset})", soft_wrap=True)
    for topic, count in summary.late.items():
        console.print(f"LOST: {count} x {topic}: later than the reorder window allows", soft_wrap=True)
    for topic, (count, why) in summary.undecodable.items():
        console.print(f"Cannot be decoded: {count} x {topic}: {why}", soft_wrap=True)
    _write_json(
        json_file,
        {
            "messages": dict(summary.messages),
            "late": dict(summary.late),
            "undecodable": {topic: {"count": count, "reason": why} for topic, (count, why) in summary.undecodable.items()},
            "losses": [{"file": path, "what": loss.what, "offset": loss.offset, "bytes": loss.bytes} for path, loss in summary.losses],
        },
    )
    raise typer.Exit(4 if summary.losses or summary.late else 0)


@app.command()
def twin(
    truth: Annotated[str, typer.Option("--truth", metavar="FILE[#member]", help="The truth the vehicle moves in.")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="X.mcap|X.tlog", help="The log; its ending chooses the format.")],
    vehicle: Annotated[
        Literal["vessel", "glider"], typer.Option("--vehicle", help="Survey at random positions, or a sawtooth glider.")
    ] = "vessel",
    pings: Annotated[int, typer.Option("--pings", min=1, help="ADCP pings.")] = 450,
    noise: Annotated[float, typer.Option("--noise", min=0.0, help="Standard deviation of a bin's component [m/s].")] = 0.09,
    seed: Annotated[int, typer.Option("--seed", help="The same seed gives the same bytes.")] = 0,
    region: RegionOption = None,
    levels: LevelsOption = None,
    lead: LeadOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Make a log by flying a vehicle with a simulated ADCP through a truth."""
    settings = load_config(
        None, {"forecast": {"region": _numbers(region, "--region", 4), "levels": _numbers(levels, "--levels"), "lead": lead}}
    )
    made = make_twin(read_truth(truth, settings.forecast), vehicle, pings, noise, seed, out, overwrite)
    _console(None).print(f"{out}: {made.pings} pings over {made.duration / 3600.0:.1f} h", soft_wrap=True)


@app.command()
def synthesize(
    ensemble: Annotated[Path, typer.Option("--ensemble", metavar="E.nc", help="Where the members go.")],
    truth: Annotated[Path, typer.Option("--truth", metavar="T.nc", help="Where one more, withheld, goes.")],
    members: Annotated[int, typer.Option("--members", min=2, help="Members.")] = 40,
    seed: Annotated[int, typer.Option("--seed", help="The same seed gives the same bytes.")] = 0,
    overwrite: OverwriteOption = False,
) -> None:
    """Make a synthetic ensemble (incompressible, eddying, baroclinic) and a truth withheld from it."""
    write_ensemble(ensemble, truth, n_members=members, seed=seed, overwrite=overwrite)


@experiment.command()
def accuracy(
    ensemble: Annotated[Path, typer.Option("--ensemble", metavar="E.nc", help="Ensemble forecast.")],
    truth: Annotated[str | None, typer.Option("--truth", metavar="T.nc[#member]", help="The truth to tell.")] = None,
    leave_out: Annotated[str | None, typer.Option("--leave-out", metavar="K|all|most-distant", help="Members withheld as truths.")] = None,
    lead: LeadOption = None,
    region: RegionOption = None,
    levels: LevelsOption = None,
    modes: Annotated[int | None, typer.Option("--modes", min=1, help="Basis flows a level; all when fewer exist.")] = None,
    pings: Annotated[str, typer.Option("--pings", metavar="N1,N2,...", help="Numbers of pings scored.")] = "5,10,25,50,150,450",
    noise: Annotated[float, typer.Option("--noise", min=0.0, help="Standard deviation of a bin's component [m/s].")] = 0.09,
    seeds: Annotated[int, typer.Option("--seeds", min=1, help="Seeds 0 to N-1.")] = 5,
    methods: Annotated[str, typer.Option("--methods", metavar="M1,M2,...", help="Estimators compared.")] = ",".join(METHODS),
    config: ConfigOption = None,
    json_file: JsonOption = None,
) -> None:
    """Compare estimators on twin surveys: error, calibration, against the number of pings."""
    settings = load_config(
        config,
        {
            "forecast": {"region": _numbers(region, "--region", 4), "levels": _numbers(levels, "--levels"), "lead": lead},
            "estimator": {"modes": modes},
        },
    )
    if (truth is None) == (leave_out is None):
        raise ConfigError("experiment accuracy: expected one of --truth and --leave-out")
    counts = tuple(int(n) for n in _numbers(pings, "--pings") or ())
    job = AccuracyJob(leave_out, counts, noise, seeds, tuple(methods.split(",")))
    members = read_ensemble(ensemble, settings.forecast)
    withheld = None if truth is None else read_truth(truth, settings.forecast)
    with threadpool_limits(limits=settings.output.threads), _bar() as advance:
        result = run_accuracy(members, withheld, settings.estimator, job, advance)
    print_accuracy(result, _console(json_file))
    _write_json(json_file, accuracy_json(result))


def _numbers(text: str | None, option: str, count: int | None = None) -> tuple[float, ...] | None:
    if text is None:
        return None
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if not values or (count is not None and len(values) != count):
        raise ConfigError(f"{option}: expected {count or 'some'} numbers with commas between them, got '{text}'")
    return values


def _place(text: str | None, option: str) -> Place | None:
    values = _numbers(text, option, 3)
    return None if values is None else Place(*values)


def _console(json_file: Path | None) -> Console:
    """Return where words go: standard error when the JSON takes standard output; wide in a pipe, so that lines stay whole."""
    to_stderr = json_file is not None and str(json_file) == "-"
    stream = sys.stderr if to_stderr else sys.stdout
    return Console(file=stream, highlight=False, width=None if stream.isatty() else 160)


@contextmanager
def _progress(what: str) -> Iterator[Callable[[int], None] | None]:
    """Show progress on a terminal, nothing in a pipe."""
    if not sys.stderr.isatty():
        yield None
        return
    columns = SpinnerColumn(), TextColumn("{task.description}"), TextColumn("{task.completed} messages"), TimeElapsedColumn()
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=None)

        def advance(time_ns: int) -> None:
            bar.update(task, advance=1, description=f"{what} {iso(time_ns)}")

        yield advance


@contextmanager
def _bar() -> Iterator[Callable[[int, int, str], None] | None]:
    """Show a bar of work done on a terminal, nothing in a pipe."""
    if not sys.stderr.isatty():
        yield None
        return
    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=None)
        yield lambda done, total, what: bar.update(task, completed=done, total=total, description=what)


def _write_json(path: Path | None, answer: Mapping[str, Any]) -> None:
    if path is None:
        return
    text = json.dumps(answer, indent=1, allow_nan=False) + "\n"
    if str(path) == "-":
        sys.stdout.write(text)
    else:
        path.write_text(text, encoding="utf-8")
