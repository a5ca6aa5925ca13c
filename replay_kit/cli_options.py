"""What the commands share: options, the reading of their values, where answers and progress go."""

import json
import math
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from replay_kit.errors import ConfigError, ReplayKitError
from replay_kit.inspect import iso
from replay_kit.job import is_stream
from replay_kit.logs.atomic import atomic_file
from replay_kit.types import Place

JsonOption = Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Write the answer as JSON; - is standard output.")]
OverwriteOption = Annotated[bool, typer.Option("--overwrite", help="Replace outputs that exist. An input is never replaced.")]
IncludeInputsOption = Annotated[bool, typer.Option("--include-inputs", help="Copy the logs' messages into the result, untouched.")]
RemapOption = Annotated[list[str] | None, typer.Option("--remap", metavar="OLD=NEW", help="Call a topic by another name; may be repeated.")]
ConfigOption = Annotated[Path | None, typer.Option("--config", metavar="TOML", help="Settings of the run; options given here win.")]
ClockOption = Annotated[Literal["log", "publish", "header"] | None, typer.Option("--clock", help="Which stamp orders the replay.")]
RegionOption = Annotated[str | None, typer.Option("--region", metavar="W,S,E,N", help="Part of the ensemble used [degrees].")]
LevelsOption = Annotated[str | None, typer.Option("--levels", metavar="Z1,Z2,...", help="Levels used [m]; the nearest are taken.")]
LevelStepOption = Annotated[int | None, typer.Option("--level-step", min=1, help="Every n-th level is used.")]
LeadOption = Annotated[float | None, typer.Option("--lead", help="Forecast period, in the file's unit; the nearest is taken.")]
ModesOption = Annotated[str | None, typer.Option("--modes", metavar="N|all", help="Basis flows a level; fewer when fewer exist.")]
NoiseOption = Annotated[float, typer.Option("--noise", min=0.0, help="Standard deviation of a bin's component [m/s].")]


class InterruptedRunError(ReplayKitError):
    """Ctrl-C, with what was left behind in words."""

    exit_code = 130


def numbers(text: str | None, option: str, count: int | None = None) -> tuple[float, ...] | None:
    """Return the finite numbers of an option, with commas between them; None when it was not given.

    Raises:
        ConfigError: They are no numbers, or not as many as are expected.
    """
    if text is None:
        return None
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if not values or not all(map(math.isfinite, values)) or (count is not None and len(values) != count):
        raise ConfigError(f"{option}: expected {count or 'some'} numbers with commas between them, got '{text}'")
    return values


def remapped(pairs: list[str] | None) -> dict[str, str] | None:
    """Return the topics of options ``OLD=NEW``, old to new; None when none was given.

    Raises:
        ConfigError: One is no such pair, or an old name comes twice.
    """
    names = [pair.partition("=") for pair in pairs or ()]
    if not all(old and new for old, _, new in names) or len({old for old, _, _ in names}) < len(names):
        raise ConfigError(f"--remap: expected OLD=NEW, each old topic once, got {' '.join(pairs or ())}")
    return {old: new for old, _, new in names} or None


def place(text: str | None, option: str) -> Place | None:
    """Return the place of an option ``LON,LAT,DEPTH``; None when it was not given."""
    values = numbers(text, option, 3)
    return None if values is None else Place(*values)


def forecast_part(region: str | None, levels: str | None, level_step: int | None, lead: float | None) -> dict[str, Any]:
    """Return the settings ``[forecast]`` of the options that choose a part of the ensemble."""
    return {"region": numbers(region, "--region", 4), "levels": numbers(levels, "--levels"), "level_step": level_step, "lead": lead}


def radius(kilometres: float | None) -> float | None:
    """Return ``--truth-radius`` [km] when it is above 0 and finite.

    Raises:
        ConfigError: It is not.
    """
    # not an option's min, which lets 0 and nan pass
    if kilometres is not None and not 0.0 < kilometres < float("inf"):
        raise ConfigError(f"--truth-radius: expected a number of kilometres above 0, got {kilometres}")
    return kilometres


@contextmanager
def part_named(out: Path) -> Iterator[None]:
    """Turn an interrupt into an error that names the part file, when this run has written one."""
    part = out.with_name(out.name + ".part")
    before = _stamp(part)
    try:
        yield
    except KeyboardInterrupt:
        left = f"what was written so far is in {part}" if _stamp(part) not in (None, before) else "nothing was written yet"
        raise InterruptedRunError(f"interrupted; {left}") from None


def _stamp(path: Path) -> tuple[int, int] | None:
    """Return what tells one writing of a file from another; None without the file."""
    if not path.exists():
        return None
    status = path.stat()
    return status.st_ino, status.st_mtime_ns


def console_beside(*answers: Path | None) -> Console:
    """Return where words go: standard error when an answer takes standard output; wide in a pipe, so that lines stay whole."""
    to_stderr = any(path is not None and str(path) == "-" for path in answers)
    stream = sys.stderr if to_stderr else sys.stdout
    # no markup: a unit in brackets is no style
    return Console(file=stream, highlight=False, markup=False, width=None if stream.isatty() else 160)


@contextmanager
def progress(what: str) -> Iterator[Callable[[int], None] | None]:
    """Show progress on a terminal, nothing in a pipe."""
    if not sys.stderr.isatty():
        yield None
        return
    columns = SpinnerColumn(), TextColumn("{task.description}"), TextColumn("{task.completed} messages"), TimeElapsedColumn()
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=None)

        def advance(time_ns: int) -> None:
            bar.update(task, advance=1, description=f"{what} {iso(time_ns)}")

        yield advance


@contextmanager
def bar() -> Iterator[Callable[[int, int, str], None] | None]:
    """Show a bar of work done on a terminal, nothing in a pipe."""
    if not sys.stderr.isatty():
        yield None
        return
    with Progress(console=Console(stderr=True), transient=True) as shown:
        task = shown.add_task("", total=None)
        yield lambda done, total, what: shown.update(task, completed=done, total=total, description=what)


def write_json(path: Path | None, answer: Mapping[str, Any]) -> None:
    """Write an answer as JSON, as ``write_text`` does."""
    write_text(path, json.dumps(answer, indent=1, allow_nan=False) + "\n")


def keep_json(path: Path | None, answer: Mapping[str, Any]) -> None:
    """Write what there is of an answer that grows, for a run that may be killed; a pipe and standard output get the whole one only."""
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
