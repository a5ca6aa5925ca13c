"""Declarations of records in a DataFlash log: FMT, UNIT, MULT and FMTU.

The letters are those of ArduPilot's ``libraries/AP_Logger/README.md``. Some imply a factor, which is applied; the multipliers of FMTU are
not applied, they only name the unit of the values.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
_PREFIXES: Mapping[float, str] = {
    0.0: "",
    1.0: "",
    1e-1: "d",
    1e-2: "c",
    1e-3: "m",
    1e-6: "µ",
    1e-9: "n",
}
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


def unit_names(
    form: Format,
    unit_ids: str,
    multiplier_ids: str,
    labels: Mapping[str, str],
    factors: Mapping[str, float],
) -> dict[str, str]:
    """Return the unit of each column's values as read; empty where the log names none.

    Args:
        form: The kind of record.
        unit_ids: FMTU's letter of each column's unit.
        multiplier_ids: FMTU's letter of each column's multiplier.
        labels: UNIT's letter to unit.
        factors: MULT's letter to factor.
    """
    found = {}
    for place, (name, letter) in enumerate(zip(form.columns, form.letters, strict=True)):
        unit = labels.get(unit_ids[place : place + 1], "")
        factor = factors.get(multiplier_ids[place : place + 1])
        # a letter with a factor of its own gives values in the unit itself
        if unit and factor is not None and letter not in _DIVISORS:
            unit = _PREFIXES[factor] + unit if factor in _PREFIXES else f"{factor:.4g} {unit}"
        found[name] = unit
    return found


def _text(value: bytes) -> str:
    value = value.split(b"\0", 1)[0]
    try:
        return value.decode()
    except UnicodeDecodeError:
        return value.decode("latin-1")
