"""Records of a DataFlash log, found a block at a time, and their declarations (FMT).

A record is the bytes a3 95, its type, and the fields that the FMT record of that type declares. There is no checksum: after bad bytes a
record counts only when another one begins, or the log ends, where it ends.

The letters are those of ArduPilot's ``libraries/AP_Logger/README.md``. Some imply a factor, which is applied; units and
multipliers (UNIT, MULT, FMTU) are not.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from replay_kit.core.errors import LogError
from replay_kit.logs.shared.blocks import Indices, ReadStatistics, chain, lose_gaps

#: A record begins with two magic bytes and its type.
HEAD = 3
FMT_TYPE = 0x80
_DTYPES: Mapping[str, str | tuple[str, int]] = {
    "a": ("<i2", 32),
    "b": "i1",
    "B": "u1",
    "g": "<f2",
    "h": "<i2",
    "H": "<u2",
    "i": "<i4",
    "I": "<u4",
    "f": "<f4",
    "d": "<f8",
    "n": "S4",
    "N": "S16",
    "Z": "S64",
    "c": "<i2",
    "C": "<u2",
    "e": "<i4",
    "E": "<u4",
    "L": "<i4",
    "M": "u1",
    "q": "<i8",
    "Q": "<u8",
}
#: Divisors of stored values: more exact than multiplying by a hundredth.
_DIVISORS: Mapping[str, float] = {"c": 100.0, "C": 100.0, "e": 100.0, "E": 100.0, "L": 1e7}
_FMT_BODY = np.dtype(
    [("type", "u1"), ("length", "u1"), ("name", "S4"), ("format", "S16"), ("columns", "S64")]
)


@dataclass(frozen=True, slots=True)
class Format:
    """One kind of record.

    Attributes:
        type: Its number.
        name: ``GPS``, ``BARO`` and so on.
        length: Bytes of a record, with its head.
        letters: One for each column.
        columns: Their names.
    """

    type: int
    name: str
    length: int
    letters: str
    columns: tuple[str, ...]

    @property
    def known(self) -> bool:
        """Whether the letters are known, and agree with the columns and the length: otherwise the records can only be skipped."""
        fits = (
            len(self.letters) == len(self.columns) == len(set(self.columns))
            and set(self.letters) <= _DTYPES.keys()
        )
        return fits and self.length == HEAD + self.dtype.itemsize

    @property
    def dtype(self) -> np.dtype[Any]:
        """The record after its head as a structured type; a FILE's pieces are bytes, not text."""
        kinds = [
            np.dtype("V64" if letter == "Z" and self.name == "FILE" else _DTYPES[letter])
            for letter in self.letters
        ]
        return np.dtype(list(zip(self.columns, kinds, strict=True)))


#: The format of formats.
FMT = Format(
    FMT_TYPE,
    "FMT",
    HEAD + _FMT_BODY.itemsize,
    "BBnNZ",
    ("Type", "Length", "Name", "Format", "Columns"),
)


def read_format(body: bytes) -> Format | None:
    """Return the format that an FMT record declares, or None when it is none: bytes that only look like one, or that are damaged.

    Args:
        body: The record after its head.
    """
    record = np.frombuffer(body, dtype=_FMT_BODY)[0]
    try:
        name, letters, columns = (
            record[key].split(b"\0", 1)[0].decode("ascii") for key in ("name", "format", "columns")
        )
    except UnicodeDecodeError:
        return None
    names = tuple(columns.split(",")) if columns else ()
    found = Format(int(record["type"]), name, int(record["length"]), letters, names)
    plausible = (
        found.length >= HEAD
        and all(part.isidentifier() for part in (name, *names))
        and (letters.isalnum() or not letters)
    )
    return found if plausible else None


def scaled(records: NDArray[Any], form: Format) -> dict[str, NDArray[Any]]:
    """Return the columns of records of one kind, with the letters' factors applied, and text as text.

    Args:
        records: Structured array of the format's dtype, shape (n,).
        form: Their format.
    """
    found = {}
    for name, letter in zip(form.columns, form.letters, strict=True):
        values = records[name]
        if letter in _DIVISORS:
            values = values / _DIVISORS[letter]
        elif values.dtype.kind == "S":
            values = np.array([_text(value) for value in values.tolist()], dtype=np.str_)
        found[name] = values
    return found


def _text(value: bytes) -> str:
    value = value.split(b"\0", 1)[0]
    try:
        return value.decode()
    except UnicodeDecodeError:
        return value.decode("latin-1")


MAGIC = b"\xa3\x95"
BLOCK = 1 << 20
_LONGEST = 255
#: Kinds declared anew with other fields, each of which divides the log: logs put end to end have some hundred, noise has one a record.
_MOST_CHANGES = 2000


@dataclass(frozen=True, slots=True, eq=False)
class Records:
    """Records that follow one another in a log, under one set of formats.

    Attributes:
        data: The bytes they lie in.
        offset: Where these begin in the file.
        start: Where each begins in them, shape (n,), increasing.
        type: Number of its kind, shape (n,).
        formats: By that number.
    """

    data: NDArray[np.uint8]
    offset: int
    start: Indices
    type: NDArray[np.uint8]
    formats: dict[int, Format]

    def kinds(self) -> Iterator[tuple[Format, Indices]]:
        """Yield each kind that occurs, with its indices among the records."""
        if not self.type.size:
            return
        order = np.argsort(self.type, kind="stable")
        found, first = np.unique(self.type[order], return_index=True)
        for number, places in zip(found.tolist(), np.split(order, first[1:]), strict=True):
            yield self.formats[number], places

    def decodable(self) -> Iterator[tuple[Format, Indices]]:
        """Yield the kinds whose declaration is understood."""
        return (kind for kind in self.kinds() if kind[0].known)

    def structured(self, form: Format, places: Indices) -> NDArray[Any]:
        """Return some records of one kind as a structured array."""
        body = form.length - HEAD
        if not body:
            return np.zeros(places.size, dtype=form.dtype)
        rows: NDArray[Any] = sliding_window_view(self.data, body)[self.start[places] + HEAD].view(
            form.dtype
        )[:, 0]
        return rows


def is_dataflash(head: bytes) -> bool:
    """Return whether the declaration of a kind of record is among these first bytes of a file."""
    view = np.frombuffer(head, dtype=np.uint8)
    return len(_pieces(view, view.size, {})[-1][2]) > 0


def read_records(file: BinaryIO, statistics: ReadStatistics) -> Iterator[Records]:
    """Yield the records block after block; bytes between them, and a cut last record, are losses."""
    formats: dict[int, Format] = {FMT_TYPE: FMT}
    changed = 0
    data, offset, sound_end, at_end = b"", 0, 0, False
    while not at_end:
        block = file.read(BLOCK)
        at_end = not block
        data += block
        searched = len(data) if at_end else max(len(data) - _LONGEST - len(MAGIC), 0)
        view = np.frombuffer(data, dtype=np.uint8)
        used = 0
        pieces = _pieces(view, searched, formats)
        changed += len(pieces) - 1
        if changed > _MOST_CHANGES:
            raise LogError(
                f"{file.name}: expected each kind of record to be declared once, {changed} are declared again and differently up to byte "
                f"{offset + len(data)}; is it a DataFlash log?"
            )
        for first, last, known in pieces:
            formats = known
            start, end = _records(
                view, max(first, used), last, formats, at_end, max(sound_end - offset, 0)
            )
            gap = "bad bytes, or records of an unknown type, skipped"
            sound_end = lose_gaps(statistics, gap, sound_end, start + offset, end + offset)
            used = max(used, sound_end - offset)
            yield Records(view, offset, start, view[start + 2], formats)
        used = max(used, searched)
        data, offset = data[used:], offset + used
    if offset > sound_end:
        statistics.lose(
            "at the end: a cut record or bad bytes, skipped", sound_end, offset - sound_end
        )


def _pieces(
    view: NDArray[np.uint8], searched: int, formats: dict[int, Format]
) -> list[tuple[int, int, dict[int, Format]]]:
    """Return (first, last byte, formats) of the parts of a block: a new part begins where a type is declared again and differently."""
    formats = dict(formats)
    pieces: list[tuple[int, int, dict[int, Format]]] = []
    first = 0
    for at in _magic(view, 0, min(searched, view.size - FMT.length + 1)).tolist():
        form = (
            read_format(view[at + HEAD : at + FMT.length].tobytes())
            if view[at + 2] == FMT_TYPE
            else None
        )
        if form is None or form.type == FMT_TYPE or formats.get(form.type) == form:
            continue
        if form.type in formats and len(pieces) <= _MOST_CHANGES:
            # records before this one are of the earlier declaration
            pieces.append((first, at, formats))
            formats, first = dict(formats), at
        formats[form.type] = form
    return [*pieces, (first, searched, formats)]


def _records(
    view: NDArray[np.uint8],
    first: int,
    last: int,
    formats: dict[int, Format],
    at_end: bool,
    sound_end: int,
) -> tuple[Indices, Indices]:
    """Return where the records that begin in part of a block begin and end.

    Args:
        view: The block.
        first: Where the part begins.
        last: Where it ends; a record may reach beyond.
        formats: Kinds of records.
        at_end: Whether the log ends with the block.
        sound_end: Where the last record found before ends.
    """
    lengths = np.zeros(256, dtype=np.int64)
    lengths[list(formats)] = [form.length for form in formats.values()]
    start = _magic(view, first, min(last, view.size - HEAD + 1))
    length = lengths[view[start + 2]]
    whole = (length > 0) & (start + length <= view.size)
    start, end = start[whole], start[whole] + length[whole]
    # the second of two magic bytes may be cut off
    followed = (end == view.size) & at_end
    inside = np.flatnonzero(end < view.size)
    after = end[inside]
    followed[inside] = (view[after] == MAGIC[0]) & (
        (after + 1 == view.size) | (view[np.minimum(after + 1, view.size - 1)] == MAGIC[1])
    )
    # a record that no other follows counts when it follows one itself and no sound record begins in it: then the next one is damaged
    alone, sound = np.flatnonzero(~followed), start[followed]
    holds = np.searchsorted(sound, end[alone]) > np.searchsorted(sound, start[alone])
    followed[alone] = (np.isin(start[alone], end) | (start[alone] == sound_end)) & ~holds
    start, end = start[followed], end[followed]
    kept = chain(start, end)
    return start[kept], end[kept]


def _magic(view: NDArray[np.uint8], first: int, last: int) -> Indices:
    """Return where the magic bytes of a record are, from the first to before the last byte."""
    if last <= first:
        return np.zeros(0, dtype=np.int64)
    start = np.flatnonzero(view[first:last] == MAGIC[0]) + first
    start = start[start + 2 < view.size]
    found: Indices = start[view[start + 1] == MAGIC[1]]
    return found
