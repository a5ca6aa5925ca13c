"""Glider files opened, and those of one mission put together."""

import gzip
import io
import itertools
import re
import zlib
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.errors import LogError
from replay_kit.core.inputs import exceeds_claim, open_input
from replay_kit.logs.glider.dialects import Dialect, dialect_of
from replay_kit.logs.glider.missions import (
    FIRST_COLUMNS,
    GZIP_MAGIC,
    MISSION_NAMES,
    is_seaexplorer,
    mission_of,
)
from replay_kit.logs.glider.netcdf import Choose, NetcdfFile, Stored, as_number, open_netcdf
from replay_kit.logs.glider.rows import refuse_forecast

_HEAD = 1 << 12


@dataclass(frozen=True, slots=True, eq=False)
class GliderFile:
    """A file of a known dialect.

    Attributes:
        content: The variables that the dialect's reader uses.
        dialect: How it is written.
    """

    content: NetcdfFile
    dialect: Dialect


def open_glider_file(path: Path) -> GliderFile | None:
    """Return a file with its dialect; None for a NetCDF file of no known dialect.

    Raises:
        LogError: The file cannot be read.
    """
    read = open_seaexplorer if _is_text(path) else open_netcdf
    return _opened(path, read, lambda dialect, names: dialect.wanted(names))


def _opened(
    path: Path,
    read: Callable[[Path, Choose], NetcdfFile],
    wanted: Callable[[Dialect, Collection[str]], Collection[str]],
) -> GliderFile | None:
    found: list[Dialect | None] = []

    def choose(names: Collection[str], attributes: Mapping[str, Any]) -> Collection[str]:
        dialect = dialect_of(names, attributes)
        found.append(dialect)
        return [] if dialect is None else wanted(dialect, names)

    content = read(path, choose)
    return None if found[0] is None else GliderFile(content, found[0])


def _is_text(path: Path) -> bool:
    with open(path, "rb") as file:
        return is_seaexplorer(file.read(_HEAD))


def mission_key(path: Path) -> tuple[str, ...] | None:
    """Return the names of a file's dialect and missions, which all its profiles or parts share; None where a mission is one file.

    Raises:
        LogError: The file cannot be read.
    """
    refuse_forecast(path)
    if _is_text(path):
        return "seaexplorer", *mission_of(NetcdfFile(path, {}, {}, ()), "seaexplorer")
    file = _opened(
        path,
        open_netcdf,
        lambda _, names: [name for name in names if name.lower() in MISSION_NAMES],
    )
    if file is None:
        return (kind,) if (kind := surface_kind(path)) else None
    if not file.dialect.in_parts:
        return None
    return file.dialect.name, *mission_of(file.content, file.dialect.name)


def surface_kind(path: Path) -> str:
    """Return ``radar-totals`` or ``drifters`` for a NetCDF file of currents at the surface; empty for others.

    Raises:
        LogError: The file cannot be read.
    """
    from replay_kit.logs.surface.drifters import is_drifters
    from replay_kit.logs.surface.totals import dialect_of as totals_of

    names = open_netcdf(path, lambda names, attributes: []).names
    if totals_of(names) is not None:
        return "radar-totals"
    return "drifters" if is_drifters(names) else ""


_DATE = re.compile(r"(\d{2})/(\d{2})/(\d{4}) (\d{2}:\d{2}:\d{2}(?:\.\d{1,6})?)")
# Characters that are read at once, and of a line.
_BLOCK = 1 << 18
_EPOCH = {"units": "seconds since 1970-01-01"}


def open_seaexplorer(path: Path, choose: Choose) -> NetcdfFile:
    """Return the columns of a file that are chosen, as variables.

    A line that has not as many columns as the heading is left out; a field that is no number is missing.

    Raises:
        LogError: The file cannot be read.
    """
    variables: dict[str, Stored] = {}
    names: list[str] = []
    chosen: dict[str, int] = {}
    read: dict[str, list[NDArray[np.float64]]] = {}
    left_out = 0
    try:
        for lines in _blocks_of_lines(path):
            if not names:
                names = [name.strip() for name in lines.pop(0).split(";")]
                wanted = choose(names, {})
                chosen = {name: k for k, name in enumerate(names) if name and name in wanted}
                read = {name: [] for name in chosen}
            filled = [*filter(str.strip, lines)]
            rows = [fields for line in filled if len(fields := line.split(";")) == len(names)]
            left_out += len(filled) - len(rows)
            for name, k in chosen.items():
                parsed = _times if name.lower() in FIRST_COLUMNS else _numbers
                read[name].append(parsed([row[k] for row in rows]))
    except (OSError, EOFError, zlib.error) as error:
        raise LogError(
            f"{path}: cannot be read as a SeaExplorer's file: {error}; is the file whole?"
        ) from error
    for name, blocks in read.items():
        about = _EPOCH if name.lower() in FIRST_COLUMNS else {}
        variables[name] = Stored(np.concatenate(blocks), about, ("line",))
    return NetcdfFile(path, {"lines_left_out": left_out}, variables, tuple(filter(None, names)))


def _blocks_of_lines(path: Path) -> Iterator[list[str]]:
    """Yield the lines of a file, unpacked where it is compressed, some hundred thousand bytes at a time.

    Raises:
        OSError, EOFError, zlib.error: It cannot be read or unpacked, or has a line without end.
    """
    with open_input(path) as raw, ExitStack() as stack:
        compressed = raw.read(2) == GZIP_MAGIC
        raw.seek(0)
        packed = stack.enter_context(gzip.open(raw)) if compressed else raw
        text, rest = io.TextIOWrapper(packed, "utf-8-sig", "replace"), ""
        for number in itertools.count():
            # numbers in memory take up to four times the room of their text
            if why := exceeds_claim(path, 4 * number * _BLOCK):
                raise EOFError(why)
            if not (piece := text.read(_BLOCK)):
                break
            *lines, rest = (rest + piece).split("\n")
            if len(rest) > _BLOCK:
                raise EOFError("it has a line without end")
            if lines:
                yield lines
        yield [rest]


def _times(fields: list[str]) -> NDArray[np.float64]:
    """Return seconds since 1970 of dd/mm/yyyy hh:mm:ss; NaN where a field is no time."""
    matches = [_DATE.fullmatch(field.strip()) for field in fields]
    iso = [f"{m[3]}-{m[2]}-{m[1]}T{m[4]}" if m else "NaT" for m in matches]
    try:
        found = np.array(iso, "datetime64[ms]")
    except ValueError:
        found = np.array([_or_nat(text) for text in iso], "datetime64[ms]")
    return np.where(np.isnat(found), np.nan, found.astype(np.int64) / 1000.0)


def _or_nat(text: str) -> np.datetime64:
    try:
        return np.datetime64(text, "ms")
    except ValueError:
        return np.datetime64("NaT", "ms")


def _numbers(fields: list[str]) -> NDArray[np.float64]:
    try:
        return np.array([field or "nan" for field in fields], np.float64)
    except ValueError:
        return np.array([as_number(field) for field in fields])
