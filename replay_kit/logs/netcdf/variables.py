"""Stored variables of columnar files; only requested ones are read.

NetCDF, classic or NetCDF-4, and text tables: CSV and SeaExplorer files, possibly compressed.
"""

import csv
import gzip
import io
import math
import mmap
import struct
import zlib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from itertools import chain, count, islice
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray
from scipy.io import netcdf_file

from replay_kit.core.arrays import Array
from replay_kit.core.errors import LogError
from replay_kit.core.files.inputs import (
    exceeds_claim,
    is_dimension,
    open_input,
    packed_fill,
    plain_attribute,
    unpacking,
)
from replay_kit.logs.opening import GZIP_MAGIC
from replay_kit.logs.reader import Told

_UNREADABLE = (
    OSError,
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    RuntimeError,
    ArithmeticError,
    MemoryError,
)
# attributes by which HDF5 knows dimensions
_OF_HDF5 = ("DIMENSION_LIST", "REFERENCE_LIST", "CLASS", "NAME")
_ITEM = 8  # bytes of a value in memory
_MAPPED = 1 << 24  # bytes of a file that is not read into memory whole


@dataclass(frozen=True, slots=True, eq=False)
class Stored:
    """Variable as stored, neither decoded nor masked.

    Attributes:
        values: Values of any shape and type.
        attributes: Attributes by name.
        dims: Names of its dimensions; empty if not named.
    """

    values: NDArray[Any]
    attributes: Mapping[str, Any]
    dims: tuple[str, ...] = ()

    @property
    def units(self) -> str:
        """Stated unit; empty without one."""
        return self.text("units")

    @property
    def standard(self) -> str:
        """Standard name; empty without one."""
        return self.text("standard_name")

    @property
    def extents(self) -> int:
        """Number of dimensions longer than one."""
        return sum(size > 1 for size in self.values.shape)

    def text(self, attribute: str) -> str:
        """Return an attribute as text; empty without one."""
        value = self.attributes.get(attribute, "")
        return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)

    def texts(self) -> list[str]:
        """Return the elements of a text or character array without padding; empty for other arrays."""
        values = self.values
        if values.dtype.kind != "S" or not values.size:
            return []
        if values.ndim and values.dtype.itemsize == 1:
            values = np.ascontiguousarray(values).view(f"S{values.shape[-1]}")
        return [text.decode("utf-8", "replace").strip("\0 ") for text in values.ravel().tolist()]

    def unpacked(self) -> Array:
        """Return the values, NaN where they are the fill value, with scale and offset applied."""
        if self.values.dtype.kind == "S":
            texts = self.values if self.values.dtype.itemsize > 1 else np.array(self.texts(), "S")
            try:
                return np.where(texts == b"", b"nan", texts).astype(np.float64)
            except ValueError:
                return np.array([as_number(text) for text in self.texts()])
        factor, offset = (
            float(np.ravel(self.attributes.get(name, default))[0])
            for name, default in (("scale_factor", 1.0), ("add_offset", 0.0))
        )
        values = np.array(self.values, np.float64)
        for name in ("_FillValue", "missing_value"):
            fill = np.ravel(self.attributes.get(name, np.nan))
            if fill.size and fill.dtype.kind in "iuf":
                stored = packed_fill(fill[0], self.values.dtype, factor, offset)
                values[values == float(stored)] = np.nan
        # zeros keep their sign
        plain = (factor, offset) == (1.0, 0.0)
        return values if plain else np.asarray(values * factor + offset)


def as_number(text: str) -> float:
    """Return text as a number; NaN if it is none."""
    try:
        return float(text)
    except ValueError:
        return float("nan")


#: Given a file's variables, of which no value is read yet, and its attributes: the names of those to read.
Choose = Callable[[Mapping[str, Stored], Mapping[str, Any]], Collection[str]]


@dataclass(frozen=True, slots=True, eq=False)
class NetcdfFile:
    """Variables of a file.

    Attributes:
        path: Path of the file.
        attributes: Global attributes, and those of the group ``Config``.
        variables: Variables read, by name, also of the group ``Data/Average``.
        names: Names of all variables of the file.
        sources: Files from which it was joined; empty for one file.
        told: Receives what is assumed of the file.
    """

    path: Path
    attributes: Mapping[str, Any]
    variables: Mapping[str, Stored]
    names: tuple[str, ...]
    sources: tuple[Path, ...] = ()
    told: Told = field(default_factory=Told)

    def note(self, said: str) -> None:
        """Add an assumption, as a sentence for the user."""
        self.told.notes.append(said)

    def has(self, *names: str) -> bool:
        """Return whether all these variables were read."""
        return all(name in self.variables for name in names)

    def array(self, name: str) -> Array:
        """Return a variable, NaN for fill values."""
        return self.variables[name].unpacked()

    def flat(self, name: str) -> Array:
        """Return a variable in one dimension; empty without one."""
        return self.array(name).ravel() if self.has(name) else np.empty(0)

    def scalar(self, name: str) -> float:
        """Return a scalar variable; NaN without one."""
        return float(np.append(self.flat(name), np.nan)[0])

    @property
    def dive_number(self) -> int | None:
        """Number of the dive of a basestation file; None for other files."""
        stated = self.attributes.get("dive_number", self.scalar("log_dive"))
        known = isinstance(stated, int | float | np.number) and np.isfinite(stated)
        return int(stated) if known else None


def open_netcdf(path: Path, choose: Choose, rows: slice = slice(None)) -> NetcdfFile:
    """Return the chosen variables of a file, loaded.

    Args:
        path: NetCDF file.
        choose: Selects the variables; variable-length texts are read as bytes.
        rows: Slice of the first dimension of variables with several dimensions.

    Raises:
        LogError: The file cannot be read as NetCDF.
    """
    try:
        with open_input(path) as file:
            classic = file.read(3) == b"CDF"
        return (_read_classic if classic else _read_hdf5)(path, choose, rows)
    except _UNREADABLE as error:
        raise LogError(
            f"{path}: cannot be read as NetCDF: {error}; is the file complete?"
        ) from error


def _read_hdf5(path: Path, choose: Choose, rows: slice) -> NetcdfFile:
    if (heap := endless_heap(path)) is not None:
        raise ValueError(f"the texts from byte {heap} on are damaged")
    # neither through xarray nor through h5netcdf, which look up the dimensions of each of the thousand variables: ten times as long
    with h5py.File(path, "r") as file, ExitStack() as stack:
        group = file.get("Data/Average", file)
        config = file.get("Config")
        attributes = ({} if config is None else _attributes(config)) | _attributes(file)
        held = {name: item for name in group if isinstance(item := group[name], h5py.Dataset)}
        about = {name: Stored(item, item.attrs) for name, item in held.items()}
        chosen = {name: held[name] for name in choose(about, attributes) if name in held}
        # a part of a chunk is unpacked with all of it
        claimed = sum(_ITEM * max(v.size, math.prod(v.chunks or ())) for v in chosen.values())
        if why := exceeds_claim(path, claimed):
            raise ValueError(why)
        stack.enter_context(unpacking(claimed))
        variables = {
            name: Stored(
                _stored(item, rows if item.ndim > 1 else ...),
                _attributes(item),
                _dims(group, name, item),
            )
            for name, item in chosen.items()
            if (item.dtype.kind in "iufbS" or h5py.check_string_dtype(item.dtype))
            and not is_dimension(item)
        }
    return NetcdfFile(path, attributes, variables, tuple(held))


def _attributes(item: Any) -> dict[str, Any]:
    attributes = item.attrs
    return {key: plain_attribute(attributes[key]) for key in attributes if key not in _OF_HDF5}


def _stored(item: h5py.Dataset, part: Any) -> NDArray[Any]:
    """Return a variable's values, variable-length texts as bytes."""
    if item.dtype.kind != "O":
        return np.asarray(item[part])
    return np.char.encode(np.asarray(item.asstr(errors="replace")[part], str), "utf-8")


def _dims(file: Any, name: str, item: Any) -> tuple[str, ...]:
    """Return the names of a variable's dimensions; a coordinate variable has its own name."""
    if "DIMENSION_LIST" in item.attrs:
        return tuple(
            file[refs[0]].name.rpartition("/")[2] if len(refs) else ""
            for refs in item.attrs["DIMENSION_LIST"]
        )
    return (name,) if item.ndim == 1 else ("",) * item.ndim


def _read_classic(path: Path, choose: Choose, rows: slice) -> NetcdfFile:
    # without a map of the file all values are read; the private mapping is the only one that tells attributes from methods
    with netcdf_file(path, "r", mmap=path.stat().st_size > _MAPPED) as file:
        attributes = {key: plain_attribute(value) for key, value in file._attributes.items()}
        # no view of the values themselves, which would hold the map open
        about = {
            name: Stored(np.broadcast_to(0.0, v.shape), v._attributes)
            for name, v in file.variables.items()
        }
        chosen = {*choose(about, attributes)}
        variables = {
            name: Stored(
                np.array(v.data[rows if v.data.ndim > 1 else ...]),
                dict(v._attributes),
                tuple(v.dimensions),
            )
            for name, v in file.variables.items()
            if name in chosen
        }
    return NetcdfFile(path, attributes, variables, tuple(about))


#: Signature, version and three zeros, which damage elsewhere leaves.
_BEGINS = b"GCOL\x01\x00\x00\x00"
_SIZE = struct.Struct("<8xQ")
#: Number, count of references, reserved bytes and size of an object, whose bytes follow.
_OBJECT = struct.Struct("<HH4xQ")


def endless_heap(path: Path) -> int | None:
    """Return the offset of a global heap on which the HDF5 library would loop forever [bytes]; None without one.

    Args:
        path: File that is not empty.
    """
    with open(path, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        at = data.find(_BEGINS)
        while at >= 0:
            if _is_endless(data, at):
                return at
            at = data.find(_BEGINS, at + 1)
    return None


def _is_endless(data: mmap.mmap, begin: int) -> bool:
    """Return whether the objects of a heap lead to free space of size zero, an endless loop."""
    if begin + _SIZE.size > len(data):
        return False
    end = min(begin + _SIZE.unpack_from(data, begin)[0], len(data))
    at = begin + _SIZE.size
    while at + _OBJECT.size <= end:
        number, _, size = _OBJECT.unpack_from(data, at)
        if number == 0 and size == 0:
            return True
        # the size of free space includes its head, and objects begin at multiples of eight bytes
        at += size if number == 0 else _OBJECT.size + (size + 7) // 8 * 8
    return False


# Rows that are read at once; letters of a value, of a line and of a piece of a file.
_ROWS, _LONGEST, _LONGEST_LINE = 50_000, 128, 1 << 14
_PIECE = 1 << 18
_NO_TABLE = (OSError, EOFError, ValueError, csv.Error, zlib.error)


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
        blocks, left_out = [np.empty((len(at), 0), "S1")], 0
        while some := list(islice(filter(None, table), _ROWS)):
            rows = [[row[k] for k in at] for row in some if len(row) == len(headings)]
            left_out += len(some) - len(rows)
            blocks.append(_block(rows, len(at)))
        cells = np.hstack(blocks)
        if delimiter != "," and b"," in cells.tobytes():
            # decimal commas
            cells = np.char.replace(cells, b",", b".")
        if exact and left_out:
            raise ValueError(f"{left_out} rows that are not as long as the names")
    except _NO_TABLE as error:
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
