"""The command line: parse, configure, one library call, exit code.

Exit codes: 0 done; 1 the run failed inside; 2 bad option or configuration; 3 input unusable; 4 finished, but something was lost;
5 a result could not be made again; 130 interrupted.
"""

import logging
import os
import sys
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from replay_kit import __version__
from replay_kit.cli.experiment import experiment
from replay_kit.cli.info import info
from replay_kit.cli.make import fit, synthesize, twin
from replay_kit.cli.options import (
    ClockOption,
    ConfigOption,
    IncludeInputsOption,
    JsonOption,
    LeadOption,
    LevelsOption,
    LevelStepOption,
    ModesOption,
    OnceCommand,
    OverwriteOption,
    RegionOption,
    RemapOption,
    console_beside,
    ends_in,
    forecast_part,
    part_named,
    place,
    progress,
    radius,
    remapped,
    write_json,
)
from replay_kit.cli.plan import plan
from replay_kit.cli.qc import qc
from replay_kit.config.run import load_config
from replay_kit.core.errors import ReplayKitError
from replay_kit.estimator.baselines import BASELINES
from replay_kit.results.summary import print_summary, to_json
from replay_kit.workflows.convert import convert as convert_logs
from replay_kit.workflows.convert import convert_json, print_converted
from replay_kit.workflows.paths import check_paths
from replay_kit.workflows.planning import planner_of
from replay_kit.workflows.replay import dry_run as dry
from replay_kit.workflows.replay.inputs import ReplayJob, check_outputs
from replay_kit.workflows.replay.replay import replay as replay_logs
from replay_kit.workflows.verify import print_verdict, verdict_json
from replay_kit.workflows.verify import verify as verify_result

# Without markup, or units in brackets such as [m/s] would be taken for styles and vanish from the help.
app = typer.Typer(
    name="replay-kit",
    help="What was the water doing, and where should the vehicle go next?",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.add_typer(experiment, name="experiment")

# The root of usage errors: click's own or the copy that newer typer carries, so it is found through a public name.
_UsageError: Any = next(base for base in typer.BadParameter.__mro__ if base.__name__ == "ClickException")


def main() -> None:
    """Run the command line and exit with its code."""
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(name)s: %(message)s")
    try:
        code = _run()
        sys.stdout.flush()
    except BrokenPipeError:
        # nobody reads on; the interpreter's last flush must not complain about it again
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 1
    except OSError as error:
        print(f"replay-kit: {error}", file=sys.stderr)
        code = 1
    sys.exit(code)


def _run() -> int:
    """Return the exit code of the command given; typer is kept from answering an interrupt itself, as it does so without a word."""
    try:
        code = app(standalone_mode=False)
    except _UsageError as error:
        error.show()
        return int(error.exit_code)
    except ReplayKitError as error:
        print(f"replay-kit: {error}", file=sys.stderr)
        return error.exit_code
    except (KeyboardInterrupt, typer.Abort):
        code = 130
    if code == 130:
        print("replay-kit: interrupted", file=sys.stderr)
    return code if isinstance(code, int) else 0


def _show_version(wanted: bool) -> None:
    if wanted:
        print(f"replay-kit {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and leave.")] = False,
) -> None:
    """What was the water doing, and where should the vehicle go next?"""


@app.command(cls=OnceCommand)
def replay(
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG...", help="Logs of one mission: MCAP, MAVLink .tlog, DataFlash .BIN, Seaglider NetCDF, raw ADCP (PD0, AD2CP)."
        ),
    ],
    ensemble: Annotated[
        Path, typer.Option("--ensemble", metavar="FILE", help="Ensemble forecast: CF NetCDF or Zarr with a member dimension.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="OUT.mcap", callback=ends_in(".mcap"), help="Result, for any MCAP viewer.")],
    config: ConfigOption = None,
    goal: Annotated[str | None, typer.Option("--goal", metavar="LON,LAT,DEPTH", help="Where to go next [degrees, degrees, m].")] = None,
    planner: Annotated[
        Literal["glide", "mission"] | None,
        typer.Option("--planner", help="To the goal: one glide, or a mission of dives planned anew at each surfacing."),
    ] = None,
    estimator: Annotated[str | None, typer.Option("--estimator", help=f"reduced_basis (ours), or {', '.join(BASELINES)}.")] = None,
    preset: Annotated[
        Literal["default", "paper"] | None, typer.Option("--preset", help="Estimator: the project's, or the paper's exactly.")
    ] = None,
    modes: ModesOption = None,
    region: RegionOption = None,
    levels: LevelsOption = None,
    level_step: LevelStepOption = None,
    lead: LeadOption = None,
    reference_time: Annotated[
        str | None, typer.Option("--reference-time", help="Start of the forecast, for a file of leads without one.")
    ] = None,
    place_ensemble: Annotated[bool, typer.Option("--place-ensemble", help="Move the ensemble's centre to the log's mean fix.")] = False,
    clock: ClockOption = None,
    start: Annotated[str | None, typer.Option("--start", help="First time used, ISO 8601 UTC.")] = None,
    end: Annotated[str | None, typer.Option("--end", help="Last time used, ISO 8601 UTC.")] = None,
    netcdf: Annotated[
        Path | None,
        typer.Option("--netcdf", metavar="GRID.nc", callback=ends_in(".nc"), help="Estimate and standard error on the grid, CF NetCDF."),
    ] = None,
    save_estimate: Annotated[
        Path | None, typer.Option("--save-estimate", metavar="FLOW.nc", callback=ends_in(".nc"), help="The estimate without loss.")
    ] = None,
    truth: Annotated[str | None, typer.Option("--truth", metavar="T.nc[#member]", help="Known truth to score against.")] = None,
    truth_radius: Annotated[
        float | None, typer.Option("--truth-radius", metavar="KM", help="Score only this near to the profiles [km].")
    ] = None,
    checkpoint: Annotated[
        Path | None, typer.Option("--checkpoint", metavar="FILE", help="Go on from here when the run was killed; deleted at the end.")
    ] = None,
    remap: RemapOption = None,
    include_inputs: IncludeInputsOption = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only say what would be used, and the memory and time expected.")] = False,
    json_file: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Replay logs through the current estimator: estimate, uncertainty and plan in one MCAP."""
    job = ReplayJob(
        logs=tuple(logs),
        ensemble=ensemble,
        out=out,
        goal=place(goal, "--goal"),
        netcdf=netcdf,
        save_estimate=save_estimate,
        truth=truth,
        truth_radius_km=radius(truth_radius),
        checkpoint=checkpoint,
        overwrite=overwrite,
        include_inputs=include_inputs,
    )
    check_outputs(job, also_read=[config], also_written=[json_file])
    times = {"reference_time": reference_time, "place": True if place_ensemble else None}
    settings = load_config(
        config,
        {
            "logs": {"clock": clock, "start": start, "end": end, "remap": remapped(remap)},
            "forecast": {**forecast_part(region, levels, level_step, lead), **times},
            "estimator": {"name": estimator, "preset": preset, "modes": modes},
            "planner": {"kind": planner},
        },
    )
    if dry_run:
        result = dry.dry_run(job, settings)
        dry.print_dry_run(result, console_beside(json_file))
        write_json(json_file, dry.dry_run_json(result))
        return
    with part_named(out), progress("replaying") as advance:
        summary, _ = replay_logs(job, settings, planner_of(settings.planner), advance)
    print_summary(summary, console_beside(json_file))
    write_json(json_file, to_json(summary))
    raise typer.Exit(summary.exit_code)


@app.command(cls=OnceCommand)
def verify(
    result: Annotated[Path, typer.Argument(metavar="OUT.mcap", help="A result of replay.")],
    inputs: Annotated[
        list[Path] | None,
        typer.Option("--inputs", metavar="DIR", help="Folder of logs and ensemble; else beside the result, then here."),
    ] = None,
    json_file: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Make a result again from its inputs and the configuration in it; name what differs, with exit 5."""
    check_paths([result], [json_file], overwrite)
    with progress("replaying") as advance:
        verdict = verify_result(result, inputs or [], planner_of, advance)
    print_verdict(verdict, console_beside(json_file))
    write_json(json_file, verdict_json(verdict))
    raise typer.Exit(0 if verdict.same else 5)


@app.command(cls=OnceCommand)
def convert(
    inputs: Annotated[
        list[Path],
        typer.Argument(
            metavar="IN...",
            help="Logs: MCAP, MAVLink .tlog, DataFlash .BIN, Seaglider NetCDF, raw ADCP (PD0, AD2CP); several are merged by time.",
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out", "-o", metavar="OUT.mcap|OUT.tlog", callback=ends_in(".mcap", ".tlog"), help="One log; its ending chooses the format."
        ),
    ],
    remap: RemapOption = None,
    json_file: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Convert logs to one MCAP or telemetry log, losing nothing that it can hold."""
    check_paths(inputs, [out, json_file], overwrite)
    settings = load_config(None, {"logs": {"remap": remapped(remap)}})
    with progress("converting") as advance:
        summary = convert_logs(inputs, out, overwrite, settings.logs, advance)
    print_converted(summary, console_beside(json_file))
    write_json(json_file, convert_json(summary))
    raise typer.Exit(4 if summary.losses else 0)


for command in (info, qc, fit, twin, synthesize, plan):
    app.command(cls=OnceCommand)(command)
