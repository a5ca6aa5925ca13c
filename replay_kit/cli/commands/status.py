"""``status``: a result on one screen."""

import shutil
import sys
from pathlib import Path
from typing import Annotated

from replay_kit.cli import reporting
from replay_kit.cli.console import write_json
from replay_kit.cli.options import HTML, OUTPUTS, TO_OUTPUTS, Answer, argument, option
from replay_kit.core.errors import ConfigError
from replay_kit.core.paths import check_paths
from replay_kit.core.time import parse_time

# Columns of the screen, at most where a terminal is wider.
_WIDTH, _WIDEST = 80, 120


def status(
    result: Annotated[
        Path, argument("RESULT.mcap", "A result of replay, also of a running --follow.")
    ],
    /,
    *,
    html: Annotated[
        Path | None,
        option(
            "--html",
            "Also write it as a page that reloads itself.",
            metavar="PAGE.html",
            group=OUTPUTS,
        ),
        HTML,
    ] = None,
    now: Annotated[
        str | None,
        option(
            "--now",
            "Time relative to which ages are stated, ISO 8601 UTC, or 'clock'. Default: the end of the result.",
            metavar="TIME",
        ),
    ] = None,
    answer: Annotated[Answer, TO_OUTPUTS] = Answer(),
) -> int:
    """Return 0; alarms are shown, and are no failure."""
    check_paths([result], [html, answer.json_file], answer.overwrite or html is not None)
    moment = _moment(now)

    from replay_kit.workflows.status import read_status, write_page

    found = read_status(result, moment)
    if not reporting.current().quiet and str(answer.json_file) != "-":
        from replay_kit.show.status.brief import brief_text
        from replay_kit.show.status.text import status_text

        width = (
            min(shutil.get_terminal_size((_WIDTH, 24)).columns, _WIDEST)
            if sys.stdout.isatty()
            else _WIDTH
        )
        show = status_text if reporting.current().verbose else brief_text
        text = show(found, width)
        reporting.keep(text)
        sys.stdout.write(text)
    if html is not None:
        write_page(found, html)
    write_json(answer.json_file, found.figures)
    return 0


def _moment(text: str | None) -> int | None:
    """Return a time of an option [ns, UTC]; None without it."""
    if text is None:
        return None
    if text == "clock":
        import time

        return time.time_ns()
    try:
        return parse_time(text)
    except ConfigError as error:
        raise ConfigError(f"--now: {error}, or clock for the present time") from error
