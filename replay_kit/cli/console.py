"""Destination of answers and progress, level of output, and the file of ``--log``."""

import io
import os
import re
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from replay_kit.core.errors import ConfigError, ReplayKitError
from replay_kit.core.files.atomic import stored, write_whole
from replay_kit.core.files.paths import is_stream
from replay_kit.core.words.text import printable

if TYPE_CHECKING:
    from rich.console import Console

    from replay_kit.core.words.progress import Progress

# Columns of a pipe, which has no width of its own; COLUMNS in the environment is honoured before it.
PIPE_WIDTH = 160


@dataclass(frozen=True, slots=True)
class Reporting:
    """Settings of ``-q``, ``-v`` and ``--log``.

    Attributes:
        quiet: Print errors only; answers that go to files and to ``-`` are not printed and stay.
        verbose: Print whole tables.
        log: File to which every printed line is added.
    """

    quiet: bool = False
    verbose: bool = False
    log: Path | None = None


_DEFAULT = Reporting()
_CURRENT: ContextVar[Reporting] = ContextVar("reporting", default=_DEFAULT)


def current() -> Reporting:
    """Return the reporting settings of the running command."""
    return _CURRENT.get()


def begin(asked: Reporting) -> None:
    """Set the reporting of a command.

    Raises:
        ConfigError: The file of ``--log`` cannot be written.
    """
    _CURRENT.set(asked)
    try:
        keep("started")
    except OSError as error:
        _CURRENT.set(Reporting())
        raise ConfigError(
            f"--log: cannot write '{asked.log}': {error.strerror}; choose another file"
        ) from error


def keep(text: str) -> None:
    """Append lines with the time to the file of ``--log``, if any."""
    if (path := current().log) is not None and text.strip():
        now = datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
        with path.open("a", encoding="utf-8") as file:
            file.writelines(
                f"{now} {line.rstrip()}\n" for line in text.splitlines() if line.strip()
            )


#: Of the answers of ``--json``; it grows when a key changes its name or its meaning.
FORMAT_VERSION = 2

# Seconds between two looks of a progress line.
_LOOK = 0.1
# How colours are set on a terminal.
_STYLE = re.compile(r"\x1b\[[0-9;]*m")


class InterruptedRunError(ReplayKitError):
    """Interrupt by Ctrl-C; names the partial file."""

    exit_code = 130


@contextmanager
def part_named(out: Path) -> Iterator[None]:
    """Convert an interrupt into an error that names the partial file, if this run wrote one."""
    part = out.with_name(out.name + ".part")
    before = _stamp(part)
    try:
        yield
    except KeyboardInterrupt:
        left = (
            f"what was written so far is in {part}"
            if _stamp(part) not in (None, before)
            else "nothing was written yet"
        )
        raise InterruptedRunError(f"interrupted; {left}") from None


def _stamp(path: Path) -> tuple[int, int] | None:
    """Return the identity of a version of a file; None without the file."""
    if not path.exists():
        return None
    status = path.stat()
    return status.st_ino, status.st_mtime_ns


class _Kept(io.StringIO):
    """Stream that prints, unless quiet, and copies its text to the file of ``--log``."""

    def __init__(self, stream: TextIO) -> None:
        super().__init__()
        self._stream = stream

    def write(self, text: str) -> int:
        """Print and keep text."""
        keep(_STYLE.sub("", text))
        return len(text) if current().quiet else self._stream.write(text)

    def flush(self) -> None:
        """Flush the printed text."""
        self._stream.flush()

    def isatty(self) -> bool:
        """Return whether the output is a terminal."""
        return self._stream.isatty()


def console_beside(*answers: Path | None) -> "Console":
    """Return the console of tables and messages: standard output, or standard error if an answer uses that; wide in a pipe."""
    from replay_kit.show.text import SafeConsole

    stream = (
        sys.stderr if any(path is not None and str(path) == "-" for path in answers) else sys.stdout
    )
    width = None if stream.isatty() or "COLUMNS" in os.environ else PIPE_WIDTH
    # no markup: a unit in brackets is not a style, and a name between colons no picture
    return SafeConsole(file=_Kept(stream), highlight=False, markup=False, emoji=False, width=width)


@contextmanager
def progress(threads: int | None = None) -> "Iterator[Progress]":
    """Show progress and remaining time on a terminal; nothing in a pipe. The file of ``--log`` receives each stage.

    Args:
        threads: Limit of BLAS threads; None sets no limit.
    """
    from threadpoolctl import threadpool_limits

    from replay_kit.core.words.progress import shown_by, silent

    with threadpool_limits(limits=threads):
        if current().quiet or not sys.stderr.isatty():
            with shown_by(advance := _stages(silent)):
                yield advance
            return
        from rich.console import Console
        from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
        from rich.progress import Progress as Bars

        left = (TextColumn("for"), TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn())
        columns = (
            TextColumn("{task.description}", markup=False),
            BarColumn(20),
            TextColumn("{task.fields[share]}"),
            *left,
        )
        with Bars(*columns, console=Console(stderr=True), transient=True) as shown:
            task = shown.add_task("", total=None, share="")

            def show(done: float, total: float, what: str) -> None:
                nonlocal task
                if what.partition(":")[0] != shown.tasks[0].description.partition(":")[0]:
                    # a task that is reset keeps its length
                    shown.remove_task(task)
                    task = shown.add_task(what, total=total or None, share="")
                share = f"{100.0 * done / total:.0f} %" if total else ""
                shown.update(task, completed=done, description=what, share=share)

            with shown_by(advance := _stages(show)):
                yield advance


def _stages(show: "Progress") -> "Progress":
    """Return a function that shows a stage's first and last step and some between, and logs the stages.

    A stage of unknown length within one of known length is shown as its detail.
    """
    stage, due, share = "", 0.0, (0.0, 0.0)

    def advance(done: float, total: float, what: str) -> None:
        nonlocal stage, due, share
        what = printable(what)
        if total == 0 and share[0] < share[1]:
            (done, total), what = share, f"{stage}: {what}"
        share = done, total
        if what.partition(":")[0] != stage:
            stage, due = what.partition(":")[0], 0.0
            keep(stage)
        if (now := time.monotonic()) >= due or done == total:
            due = now + _LOOK
            show(done, total, what)

    return advance


def write_json(path: Path | None, answer: Mapping[str, Any]) -> None:
    """Write an answer as JSON with the version of its format, as ``write_text`` does."""
    if path is not None:
        import json

        write_text(
            path,
            json.dumps({"format_version": FORMAT_VERSION, **answer}, indent=1, allow_nan=False)
            + "\n",
        )


def keep_json(path: Path | None, answer: Mapping[str, Any]) -> None:
    """Write the partial answer of a run that may be killed; pipes and standard output receive only the complete one."""
    if path is not None and str(path) != "-" and not is_stream(path):
        write_json(path, answer)


def write_text(path: Path | None, text: str) -> None:
    """Write an answer: a file completely or not at all, a pipe or device directly, ``-`` to standard output.

    Raises:
        ReplayKitError: It cannot be written.
    """
    if path is None:
        return
    if str(path) == "-":
        sys.stdout.write(text)
    elif is_stream(path):
        with stored(path), path.open("w", encoding="utf-8") as stream:
            stream.write(text)
    else:
        write_whole(path, text)
