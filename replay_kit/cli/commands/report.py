"""``report``: a result as one page for a browser."""

from pathlib import Path
from typing import Annotated

from replay_kit.cli.console import console_beside
from replay_kit.cli.options import HTML, TO_OUTPUTS, Replacing, argument, option


def report(
    result: Annotated[
        Path,
        argument(
            "RESULT.mcap",
            "A result of replay or plan; of a truncated one the readable part is shown.",
        ),
    ],
    /,
    *,
    out: Annotated[
        Path | None,
        option(
            "--out -o",
            "Self-contained HTML page. Default: the result's name with .html.",
            metavar="REPORT.html",
        ),
        HTML,
    ] = None,
    replacing: Annotated[Replacing, TO_OUTPUTS] = Replacing(),
) -> int:
    """Return 0, or 4 when part of the result was lost."""
    from replay_kit.show.text import print_lines
    from replay_kit.workflows.report import page_of
    from replay_kit.workflows.report import report as write_report

    page = out or page_of(result)
    size, contents = write_report(result, page, replacing.overwrite)
    print_lines(console := console_beside(), contents.notes)
    console.print(f"Report: {page} ({size / 1e6:.1f} MB); open it in a browser.", soft_wrap=True)
    return contents.exit_code
