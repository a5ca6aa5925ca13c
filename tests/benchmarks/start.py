"""Processor time of beginnings, each in a process of its own: help, the import of the library, the first log opened."""

import os
import subprocess
import sys
from functools import partial

from tests.benchmarks.measure import Row, of_children, row, seconds
from tests.places import ROOT

_MAIN = "from replay_kit.cli import main; main()"
_OPEN = "import replay_kit; next(iter(replay_kit.open_log({log!r}).messages()))"
# processor time asked for [s]
_HELP, _IMPORT, _LOG = 0.4, 0.1, 0.5


def rows(tiny: bool) -> list[Row]:
    """Return the least processor time of each beginning over some repeats; once when tiny."""
    log = str(ROOT / "sample_logs" / "glider.mcap")
    lines = "--help", "--version", "replay --help", "plan --help"
    cases = [(f"replay-kit {line}", _MAIN, line.split(), _HELP) for line in lines]
    cases += [
        ("import replay_kit", "import replay_kit", [], _IMPORT),
        ("first log opened", _OPEN.format(log=log), [], _LOG),
    ]
    return [
        row(name, _least(code, words, 1 if tiny else 7), asked=asked, asked_s=asked)
        for name, code, words, asked in cases
    ]


def _least(code: str, words: list[str], repeats: int) -> float:
    """Return the least processor time [s] of a process that runs code with arguments."""
    run = partial(
        subprocess.run,
        [sys.executable, "-c", code, *words],
        env={**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "80"},
        cwd=ROOT,
        capture_output=True,
        check=False,
    )
    return seconds(run, repeats, of_children)[0]
