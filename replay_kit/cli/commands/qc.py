"""``qc``: the quality control of logs."""

from typing import Annotated

from replay_kit.cli.console import console_beside, progress, write_json
from replay_kit.cli.options import TO_OUTPUTS, Answer, Log
from replay_kit.cli.settings import Settings, takes_settings
from replay_kit.core.paths import check_paths


@takes_settings("logs", "measurements")
def qc(*logs: Log, settings: Settings, answer: Annotated[Answer, TO_OUTPUTS] = Answer()) -> int:
    """Return the exit code of the report."""
    check_paths([*logs, settings.file], [answer.json_file], answer.overwrite)
    config = settings.load()

    from replay_kit.workflows.qc.check import check_quality
    from replay_kit.workflows.qc.report import print_quality, quality_json

    with progress() as advance:
        report = check_quality(list(logs), config, lambda time_ns: advance(0, 0, "testing"))
    print_quality(report, console_beside(answer.json_file))
    write_json(answer.json_file, quality_json(report))
    return report.exit_code
