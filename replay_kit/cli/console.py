"""Where answers and progress go: terminal, pipe, file."""

import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rich.console import Console

from replay_kit.core.atomic import atomic_file
from replay_kit.core.errors import ReplayKitError
from replay_kit.core.paths import is_stream

# Columns of a pipe, which has no width of its own; COLUMNS in the environment is honoured before it.
_PIPE_WIDTH = 160


class InterruptedRunError(ReplayKitError):
    """Ctrl-C, with the file that is left behind."""

    exit_code = 130


@contextmanager
def part_named(out: Path) -> Iterator[None]:
    """Turn an interrupt into an error that names the partial file, when this run has written one."""
    part = out.with_name(out.name + ".part")
    before = _stamp(part)
    try:
        yield
    except KeyboardInterrupt:
        left = f"what was written so far is in {part}" if _stamp(part) not in (None, before) else "nothing was written yet"
        raise InterruptedRunError(f"interrupted; {left}") from None


def _stamp(path: Path) -> tuple[int, int] | None:
    """Return what distinguishes one writing of a file from another; None without the file."""
    if not path.exists():
        return None
    status = path.stat()
    return status.st_ino, status.st_mtime_ns


def wide_console(to_stderr: bool = False) -> Console:
    """Return a console on standard output or standard error, wide in a pipe so that lines stay whole."""
    stream = sys.stderr if to_stderr else sys.stdout
    # no markup: a unit in brackets is not a style
    width = None if stream.isatty() or "COLUMNS" in os.environ else _PIPE_WIDTH
    return Console(file=stream, highlight=False, markup=False, width=width)


def console_beside(*answers: Path | None) -> Console:
    """Return where tables and messages go: standard error when an answer takes standard output."""
    return wide_console(to_stderr=any(path is not None and str(path) == "-" for path in answers))


@contextmanager
def progress(what: str) -> Iterator[Callable[[int], None] | None]:
    """Show the messages done and their time on a terminal, nothing in a pipe."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = SpinnerColumn(), TextColumn("{task.description}"), TextColumn("{task.completed} messages"), TimeElapsedColumn()
    with Progress(*columns, console=Console(stderr=True), transient=True) as shown:
        task = shown.add_task(what, total=None)

        def advance(time_ns: int) -> None:
            moment = datetime.fromtimestamp(time_ns / 1e9, UTC).isoformat(timespec="seconds")
            shown.update(task, advance=1, description=f"{what} {moment}")

        yield advance


@contextmanager
def working(threads: int) -> Iterator[Callable[[int, int, str], None] | None]:
    """Hold BLAS to a number of threads, and show a bar of the work done on a terminal, nothing in a pipe."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=threads):
        if not sys.stderr.isatty():
            yield None
            return
        from rich.progress import Progress

        with Progress(console=Console(stderr=True), transient=True) as shown:
            task = shown.add_task("", total=None)
            yield lambda done, total, what: shown.update(task, completed=done, total=total, description=what)


def write_json(path: Path | None, answer: Mapping[str, Any]) -> None:
    """Write an answer as JSON, as ``write_text`` does."""
    if path is not None:
        write_text(path, json.dumps(answer, indent=1, allow_nan=False) + "\n")


def keep_json(path: Path | None, answer: Mapping[str, Any]) -> None:
    """Write the part so far of an answer that grows, for a run that may be killed; a pipe and standard output get the whole one only."""
    if path is not None and str(path) != "-" and not is_stream(path):
        write_json(path, answer)


def write_text(path: Path | None, text: str) -> None:
    """Write an answer: a file appears whole or not at all, a pipe or device is written as it is, ``-`` is standard output."""
    if path is None:
        return
    if str(path) == "-":
        sys.stdout.write(text)
    elif is_stream(path):
        path.write_text(text, encoding="utf-8")
    else:
        with atomic_file(path) as file:
            file.write(text.encode())
