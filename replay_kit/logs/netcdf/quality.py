"""Quality flags of files as QARTOD flags, by the meanings that the files state."""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.observation import Flag
from replay_kit.logs.netcdf.variables import Stored

# by words in a meaning; without any the flag is good
_WORDS = (
    (re.compile(r"suspect|question|interest", re.IGNORECASE), Flag.SUSPECT),
    (re.compile(r"bad|fail|miss|unsampled|reject|spike|stuck", re.IGNORECASE), Flag.FAIL),
    (re.compile(r"unknown|not_", re.IGNORECASE), Flag.NOT_EVALUATED),
)
# rank of a test that was passed: more than one that was not made
_PASSED = Flag.NOT_EVALUATED + 0.5


def flagged_bad(name: str, stored: Stored, meanings: str, notes: list[str]) -> NDArray[np.bool_]:
    """Return the mask of bad values by the meanings of their flags, never by number.

    Args:
        name: Name of the flags in notes.
        stored: Flags of any type.
        meanings: ``value meaning`` pairs if the file states none.
        notes: Receives notes on the result.
    """
    if stored.values.dtype.kind == "S":
        digits = stored.values.ravel().astype("S1").astype(str)
        numbers = np.where(np.char.isdigit(digits), digits, "-1").astype(np.int64)
    else:
        numbers = np.nan_to_num(stored.unpacked(), nan=-1.0).astype(np.int64)
    words = meanings.split()
    known = _meanings(stored) or dict(zip(map(int, words[::2]), words[1::2], strict=True))
    bad = {value: said for value, said in known.items() if _flag(said) in (Flag.SUSPECT, Flag.FAIL)}
    for value in sorted(bad.keys() & set(numbers.ravel().tolist())):
        notes.append(f"{name}: {int((numbers == value).sum())} x {value} ({bad[value]}), not used")
    return np.isin(numbers, list(bad))


def as_qartod(stored: Stored) -> NDArray[np.int8]:
    """Return flags as QARTOD flags, by their stated meanings or else by number; missing ones are not evaluated."""
    found = np.nan_to_num(stored.unpacked(), nan=Flag.NOT_EVALUATED).astype(np.int8)
    flags = found.copy()
    for value, words in _meanings(stored).items():
        flags[found == value] = _flag(words)
    return flags


def worst_flag(flags: Sequence[NDArray[np.int8]], shape: tuple[int, ...]) -> NDArray[np.int8]:
    """Return the worst QARTOD flag of each value; not evaluated without flags."""
    held = np.stack([np.full(shape, Flag.NOT_EVALUATED, np.int8), *flags])
    worst = np.where(held == Flag.GOOD, _PASSED, held).max(axis=0)
    return np.where(worst == _PASSED, Flag.GOOD, worst).astype(np.int8)


def is_failed(flags: NDArray[np.int8]) -> NDArray[np.bool_]:
    """Return whether QARTOD flags are fail or missing."""
    return np.isin(flags, (Flag.FAIL, Flag.MISSING))


def _flag(words: str) -> Flag:
    return next((flag for pattern, flag in _WORDS if pattern.search(words)), Flag.GOOD)


def _meanings(stored: Stored) -> dict[int, str]:
    """Return the meanings of flags by value; some writers state the values as one text."""
    values: Any = stored.attributes.get("flag_values")
    if values is None or not stored.text("flag_meanings"):
        return {}
    if isinstance(values, str | bytes):
        values = re.findall(r"-?\d+", stored.text("flag_values"))
    return dict(zip(map(int, np.ravel(values)), stored.text("flag_meanings").split(), strict=False))
