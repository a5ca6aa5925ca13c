"""The command line in this process: starting another takes longer than most commands do."""

import contextlib
import io
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from subprocess import CompletedProcess
from unittest import mock

import pytest
from cyclopts import CycloptsError

from replay_kit.cli.app import main, report, run
from replay_kit.core.errors import ReplayKitError


@dataclass(frozen=True)
class Outcome:
    """How a command ended: its exit code, what it printed, and the error that it ended with."""

    exit_code: int
    stdout: str
    stderr: str
    exception: CycloptsError | ReplayKitError | None

    @property
    def output(self) -> str:
        return self.stdout + self.stderr


def words_of(arguments: str | Sequence[str]) -> list[str]:
    """Return the words of a command line, which are given as they are or as a line."""
    return arguments.split() if isinstance(arguments, str) else list(arguments)


def invoke(arguments: str | Sequence[str], columns: int = 160) -> Outcome:
    """Run ``replay-kit`` with arguments, or a line of them, on a terminal of so many columns; errors that are not its own pass through."""
    words = words_of(arguments)
    out, err, exception = io.StringIO(), io.StringIO(), None
    with (
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        mock.patch.dict(os.environ, COLUMNS=str(columns)),
    ):
        try:
            code = run(words)
        except (CycloptsError, ReplayKitError) as error:
            code, exception = report(error), error
    return Outcome(code, out.getvalue(), err.getvalue(), exception)


def succeed(arguments: str | Sequence[str], columns: int = 160) -> Outcome:
    """Run ``replay-kit`` with arguments, or a line of them, which must end with exit code 0."""
    done = invoke(arguments, columns)
    assert done.exit_code == 0, done.output
    return done


def run_command(folder: Path, arguments: str | Sequence[str]) -> CompletedProcess[str]:
    """Run ``replay-kit`` as a process would in a folder, on a terminal of 160 columns; return its exit code and what it printed."""
    out, err, command = io.StringIO(), io.StringIO(), ["replay-kit", *words_of(arguments)]
    with (
        contextlib.chdir(folder),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        mock.patch.object(sys, "argv", command),
        mock.patch.dict(os.environ, COLUMNS="160"),
        pytest.raises(SystemExit) as end,
    ):
        main()
    # main always leaves so, with the code of what happened
    assert isinstance(end.value.code, int)
    return CompletedProcess(command, end.value.code, out.getvalue(), err.getvalue())
