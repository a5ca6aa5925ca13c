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
from typer.core import TyperCommand, TyperOption

from replay_kit.core.atomic import atomic_file
from replay_kit.core.errors import ConfigError, ReplayKitError
from replay_kit.core.plan import Place
from replay_kit.workflows.info.inspect import iso
from replay_kit.workflows.paths import is_stream

# Endings of folders' names that are those of files, which a command that writes a folder would not make.
_FILE_ENDINGS = (".mcap", ".tlog", ".nc", ".json", ".csv", ".geojson", ".toml")


def ends_in(*endings: str, stream: bool = False) -> Callable[[typer.CallbackParam, Path | None], Path | None]:
    """Return the callback of an output option that refuses a name whose ending does not fit what is written, before all work.

    A name without an ending fits where there is one format; where the ending chooses the format, it must be there. Upper case is the
    same as lower case. Without endings the output is a folder, and the ending of a file is refused.

    Args:
        endings: Possible endings in lower case, with their dots; a bare name such as ``targets`` has the ending ``.targets``.
        stream: Whether the output can be a pipe, a device, or ``-``, standard output. Others are written beside their name first and
            then renamed, which would replace a device by a file.

    Raises:
        ConfigError: By the callback.
    """
    kind = f"the name of a file that ends in {'one of ' if len(endings) > 1 else ''}{', '.join(endings)}"

    def check(param: typer.CallbackParam, path: Path | None) -> Path | None:
        if path is None or (endings and stream and (str(path) == "-" or is_stream(path))):
            return path
        ending, option = path.suffix.lower(), param.opts[0]
        if not endings:
            if ending in _FILE_ENDINGS:
                raise ConfigError(
                    f"{option}: expected the name of a folder, got '{path}' with the ending {path.suffix}; leave the ending out"
                )
        elif str(path) == "-" or is_stream(path):
            raise ConfigError(f"{option}: expected {kind}, got the stream '{path}'; this output cannot be written to a stream")
        elif not (ending in endings or f".{path.name.lower()}" in endings or (not ending and len(endings) == 1)):
            got = f"the ending {path.suffix}" if ending else "no ending"
            raise ConfigError(f"{option}: expected {kind}, got '{path}' with {got}; choose another name")
        return path

    return check


JsonOption = Annotated[
    Path | None,
    typer.Option("--json", metavar="FILE", callback=ends_in(".json", stream=True), help="Write the answer as JSON; - is standard output."),
]
OverwriteOption = Annotated[bool, typer.Option("--overwrite", help="Replace outputs that exist. An input is never replaced.")]
IncludeInputsOption = Annotated[bool, typer.Option("--include-inputs", help="Copy the logs' messages into the result, untouched.")]
RemapOption = Annotated[list[str] | None, typer.Option("--remap", metavar="OLD=NEW", help="Call a topic by another name; may be repeated.")]
ConfigOption = Annotated[Path | None, typer.Option("--config", metavar="TOML", help="Settings of the run; options given here win.")]
ClockOption = Annotated[Literal["log", "publish", "header"] | None, typer.Option("--clock", help="Which stamp orders the replay.")]
RegionOption = Annotated[str | None, typer.Option("--region", metavar="W,S,E,N", help="Part of the ensemble used [degrees].")]
LevelsOption = Annotated[str | None, typer.Option("--levels", metavar="Z1,Z2,...", help="Levels used [m]; the nearest are taken.")]
LevelStepOption = Annotated[int | None, typer.Option("--level-step", min=1, help="Every n-th level is used.")]
LeadOption = Annotated[
    float | None,
    typer.Option(
        "--lead",
        help="Forecast period in the file's unit; the nearest is taken. Default: all dated leads where the current changes in time, else "
        "the dated lead nearest to the log's first message; the last lead without a log, or where leads have no date.",
    ),
]
ModesOption = Annotated[str | None, typer.Option("--modes", metavar="N|all", help="Basis flows a level; fewer when fewer exist.")]
NoiseOption = Annotated[float, typer.Option("--noise", min=0.0, help="Standard deviation of a bin's component [m/s].")]


class InterruptedRunError(ReplayKitError):
    """Ctrl-C, with what was left behind in words."""

    exit_code = 130


class OnceCommand(TyperCommand):
    """A command that refuses an option with one value which is given several times; otherwise the last one would win in silence."""

    # Any: the class of the context that the base class names is private
    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Return the arguments left over, as the base class does.

        Raises:
            ConfigError: An option with one value is given several times.
        """
        parser = self.make_parser(ctx)
        single = {}
        for param in self.get_params(ctx):
            if isinstance(param, TyperOption) and param.nargs == 1 and not (param.multiple or param.is_flag or param.count):
                single[param.name] = max(param.opts, key=len)
                # collects the values that the usual action would overwrite
                parser.add_option(obj=param, opts=param.opts, dest=param.name, action="append", nargs=1)
        given, _, _ = parser.parse_args(args=list(args))
        for name, option in single.items():
            values = given.get(name, [])
            if len(values) > 1:
                raise ConfigError(
                    f"{option}: only one {option[2:]} is supported, got {len(values)}: {' and '.join(values)}; give the option once"
                )
        return super().parse_args(ctx, args)


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
