"""``convert``: logs to one log."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from replay_kit.cli.console import console_beside, progress, write_json
from replay_kit.cli.options import TO_OUTPUTS, Answer, Ending, Log, option
from replay_kit.cli.settings import Settings, takes_settings
from replay_kit.core.paths import check_paths


@dataclass(frozen=True, slots=True, kw_only=True)
class Outputs(Answer):
    """What is written."""

    out: Annotated[
        Path,
        option("--out -o", "One log; its ending chooses the format.", metavar="OUT.mcap|OUT.tlog"),
        Ending((".mcap", ".tlog")),
    ]


@takes_settings("logs.remap", file=False)
def convert(*logs: Log, outputs: Annotated[Outputs, TO_OUTPUTS], settings: Settings) -> int:
    """Return 0, or 4 when something was lost."""
    check_paths(logs, [outputs.out, outputs.json_file], outputs.overwrite)
    config = settings.load()

    from replay_kit.workflows.convert import convert as convert_logs
    from replay_kit.workflows.convert import convert_json, print_converted

    with progress() as advance:
        summary = convert_logs(list(logs), outputs.out, outputs.overwrite, config.logs, advance)
    print_converted(summary, console_beside(outputs.json_file), outputs.verbose)
    write_json(outputs.json_file, convert_json(summary))
    return 4 if summary.losses else 0
