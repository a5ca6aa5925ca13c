"""The command line in this process: starting another takes longer than most commands do."""

import contextlib
import io
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from subprocess import CompletedProcess
from unittest import mock

import pytest

from replay_kit.cli.app import main


def run_command(folder: Path, arguments: Sequence[str]) -> CompletedProcess[str]:
    """Run ``replay-kit`` with arguments in a folder, on a terminal of 160 columns; return its exit code and what it printed."""
    out, err, command = io.StringIO(), io.StringIO(), ["replay-kit", *arguments]
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
