"""The command that looks into logs."""

from pathlib import Path
from typing import Annotated

import typer

from replay_kit.cli.options import ClockOption, ConfigOption, JsonOption, OverwriteOption, console_beside, ends_in, write_json, write_text
from replay_kit.config.run import load_config
from replay_kit.core.errors import ConfigError
from replay_kit.measurements import suggestions
from replay_kit.workflows.info.import_check import check_logs, import_check_json, print_import_check
from replay_kit.workflows.info.inspect import info_json, inspect_log, print_info
from replay_kit.workflows.paths import check_paths


def info(
    logs: Annotated[list[Path], typer.Argument(metavar="LOG...", help="Logs to look into.")],
    config: ConfigOption = None,
    ensemble: Annotated[
        Path | None,
        typer.Option("--ensemble", metavar="FILE", help="Check axes, signs, units, declination and depths against an ensemble forecast."),
    ] = None,
    clock: ClockOption = None,
    suggest: Annotated[
        Path | None,
        typer.Option(
            "--suggest",
            metavar="FILE.toml",
            callback=ends_in(".toml", stream=True),
            help="Write a first mapping of the topics that no known kind covers; - prints it.",
        ),
    ] = None,
    json_file: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Say what is in a log and what it can be used for."""
    if suggest is not None and json_file is not None and str(suggest) == str(json_file) == "-":
        raise ConfigError("--suggest and --json: only one of them can have standard output; give the other a file")
    check_paths([*logs, config, ensemble], [suggest, json_file], overwrite)
    settings = load_config(config, {"logs": {"clock": clock}})
    found = [inspect_log(path, settings) for path in logs]
    check = None if ensemble is None else check_logs(logs, ensemble, settings)
    console = console_beside(json_file, suggest)
    for log in found:
        print_info(log, console)
    if check is not None:
        print_import_check(check, console)
    if suggest is not None:
        write_text(suggest, suggestions({topic: sample for log in reversed(found) for topic, sample in log.unknown.items()}))
    answer = {"logs": [info_json(log) for log in found]}
    write_json(json_file, answer if check is None else {**answer, "import_check": import_check_json(check)})
    raise typer.Exit(4 if any(log.report.losses for log in found) else 0)
