"""Columns of text tables as variables: CSV and SeaExplorer files, possibly compressed."""

import csv
import gzip
import io
import zlib
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from itertools import chain, count, islice
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.errors import LogError
from replay_kit.core.files.inputs import exceeds_claim, open_input
from replay_kit.logs.formats import GZIP_MAGIC
from replay_kit.logs.netcdf.variables import Choose, NetcdfFile, Stored, as_number

# Rows that are read at once; letters of a value, of a line and of a piece of a file.
_ROWS, _LONGEST, _LONGEST_LINE = 50_000, 128, 1 << 14
_PIECE = 1 << 18
_UNREADABLE = (OSError, EOFError, ValueError, csv.Error, zlib.error)


def open_text(path: Path, choose: Choose, exact: bool) -> NetcdfFile:
    """Return the chosen columns of a table as text; units may be in brackets or in a second header row.

    Args:
        path: Text table.
        choose: Selects the columns.
        exact: Whether all rows must be as long as the header. Otherwise shorter or longer lines, as in truncated SeaExplorer files, are
            counted and excluded.

    Raises:
        LogError: It cannot be read, or its rows have different lengths.
    """
    try:
        lines = _lines(path)
        first = next(lines, "")
        delimiter = max(",;\t", key=first.count)
        quoting: Any = csv.QUOTE_MINIMAL if exact else csv.QUOTE_NONE
        table = csv.reader(chain([first], lines), delimiter=delimiter, quoting=quoting)
        headings = [name_and_unit(cell) for cell in next(table)]
        named = {name: Stored(np.empty(0), {}) for name, _ in headings if name}
        chosen = {*choose(named, {})}
        at = [k for k, (name, _) in enumerate(headings) if name in chosen]
        # one or none has no getter of several
        take = itemgetter(*at) if len(at) > 1 else lambda row: [row[k] for k in at]
        blocks, left_out = [np.empty((len(at), 0), "S1")], 0
        while some := list(islice(filter(None, table), _ROWS)):
            rows = [*map(take, [row for row in some if len(row) == len(headings)])]
            left_out += len(some) - len(rows)
            blocks.append(_block(rows, len(at)))
        cells = np.hstack(blocks)
        if delimiter != "," and b"," in cells.tobytes():
            # decimal commas
            cells = np.char.replace(cells, b",", b".")
        if exact and left_out:
            raise ValueError(f"{left_out} rows that are not as long as the names")
    except _UNREADABLE as error:
        raise LogError(
            f"{path}: expected a table: names, perhaps units, rows as long; got: {error}; is the file complete?"
        ) from error
    begin = [np.isfinite([as_number(text) for text in row]).sum() for row in cells.T[:2]]
    in_row = exact and len(begin) == 2 and 2 * begin[0] < begin[1]
    variables = {}
    for k, texts in zip(at, cells, strict=True):
        name, unit = headings[k]
        unit = texts[0].decode() if in_row else unit
        attributes = {"units": unit} if unit not in ("", "UTC") else {}
        variables[name] = Stored(texts[int(in_row) :], attributes, ("row",))
    return NetcdfFile(path, {"lines_left_out": left_out}, variables, tuple(named))


def name_and_unit(heading: str) -> tuple[str, str]:
    """Return name and bracketed unit of a column."""
    name, _, unit = heading.strip().partition("[" if "[" in heading else "(")
    return name.strip(), unit.rstrip("]) ")


def _lines(path: Path) -> Iterator[str]:
    """Yield the decompressed lines of a file without comments.

    Raises:
        EOFError, ValueError: The decompressed size is implausible, or a line is too long.
    """
    with open_input(path) as raw, ExitStack() as stack:
        compressed = raw.read(2) == GZIP_MAGIC
        raw.seek(0)
        packed = stack.enter_context(gzip.open(raw)) if compressed else raw
        text, rest = io.TextIOWrapper(packed, "utf-8-sig", "replace", newline=""), ""
        for number in count():
            # a text in memory takes up to four times the room that it has in a file
            if why := exceeds_claim(path, 4 * number * _PIECE):
                raise EOFError(why)
            piece = text.read(_PIECE)
            lines = (rest + piece).split("\n")
            if max(map(len, lines)) >= _LONGEST_LINE:
                raise ValueError(f"a line of {_LONGEST_LINE} letters or more")
            rest = lines.pop() if piece else ""
            yield from (line for line in lines if line and line[0] != "#")
            if not piece:
                return


def _block(rows: Sequence[Sequence[str]], width: int) -> NDArray[np.bytes_]:
    """Return the columns of some rows of a table as text, shape (width, n).

    Raises:
        ValueError: A cell is too long for a value.
    """
    if max(map(len, chain.from_iterable(rows)), default=0) > _LONGEST:
        raise ValueError(f"a value of more than {_LONGEST} letters")
    try:
        # quickly, where all is ASCII
        return np.array(rows, "S").reshape(-1, width).T
    except UnicodeEncodeError:
        return np.char.encode(np.array(rows, str).reshape(-1, width).T, "utf-8")
