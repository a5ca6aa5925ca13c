"""The command that shows the quality control of logs."""

from pathlib import Path
from typing import Annotated

import typer

from replay_kit.cli.options import (
    ClockOption,
    ConfigOption,
    JsonOption,
    OverwriteOption,
    RemapOption,
    console_beside,
    progress,
    remapped,
    write_json,
)
from replay_kit.config.run import load_config
from replay_kit.workflows.paths import check_paths
from replay_kit.workflows.qc.check import check_quality
from replay_kit.workflows.qc.report import print_quality, quality_json


def qc(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="Logs of one mission, merged by time.")],
    config: ConfigOption = None,
    clock: ClockOption = None,
    remap: RemapOption = None,
    json_file: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Show what each quality test makes of the ADCP's bins, and the dives of the track."""
    check_paths([*logs, config], [json_file], overwrite)
    settings = load_config(config, {"logs": {"clock": clock, "remap": remapped(remap)}})
    with progress("testing") as advance:
        report = check_quality(logs, settings, advance)
    print_quality(report, console_beside(json_file))
    write_json(json_file, quality_json(report))
    raise typer.Exit(report.exit_code)
