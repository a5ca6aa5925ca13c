"""Quality flags of files as QARTOD flags, by the meanings that the files state."""

import re
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.observation import Flag
from replay_kit.logs.netcdf.dialects import Dialect, flag_names
from replay_kit.logs.netcdf.variables import NetcdfFile, Stored
from replay_kit.logs.reader import Told

# by words in a meaning; without any the flag is good
_WORDS = (
    (re.compile(r"suspect|question|interest", re.IGNORECASE), Flag.SUSPECT),
    (re.compile(r"bad|fail|miss|unsampled|reject|spike|stuck", re.IGNORECASE), Flag.FAIL),
    (re.compile(r"unknown|not_", re.IGNORECASE), Flag.NOT_EVALUATED),
)
# names of flags that sum up all tests, or are an operator's; and of those of single tests
_SUMS = r"prim|(qc_?)?primary(_?flag)?|qc|qc_?flag|quality_flag|.*aggregate.*|.*operator.*"
_TESTS = r"q(c_?)?\d{2,3}(_.*)?|.*_qc|[uv]cur_quality_control|.*qartod_.*"
#: Pattern of both, in lower case.
FLAGS = f"{_SUMS}|{_TESTS}"
# rank of a test that was passed: more than one that was not made
_PASSED = Flag.NOT_EVALUATED + 0.5


def remove_bad(
    file: NetcdfFile,
    dialect: Dialect,
    chosen: Mapping[str, str],
    values: dict[str, NDArray[Any]],
    told: Told,
) -> None:
    """Remove values with bad flags, and count fixes and mean currents among them.

    Args:
        file: The file.
        dialect: Dialect of the file.
        chosen: Variable of each quantity.
        values: Quantities, of which bad values become NaN.
        told: Receives notes and counts.
    """
    for key, name in chosen.items():
        # flags of a quantity of their own, or those beside a variable
        part = key.removesuffix("_flag") if key.endswith("_flag") else ""
        masked = [f"{part}_east", f"{part}_longitude"] if part else [key]
        for flag in (
            [name]
            if part
            else sorted({*flag_names(name)} & file.variables.keys() - {*chosen.values()})
        ):
            bad = flagged_bad(flag, file.variables[flag], dialect.flag_meanings, told.notes)
            if part and bad.any():
                of_fix = ("/vehicle/fix", "GPS fix")
                topic, what = ("/dac", "mean current") if part == "dac" else of_fix
                told.skipped[topic, f"{what} flagged bad ({flag})"] += int(bad.sum())
            for one in masked:
                found = values.get(one, np.empty(0))
                if found.size == bad.size and not one.endswith("time"):
                    values[one] = np.where(bad.reshape(found.shape), np.nan, found)


def flagged_bad(name: str, stored: Stored, meanings: str, notes: list[str]) -> NDArray[np.bool_]:
    """Return the mask of bad values by the meanings of their flags, never by number.

    Args:
        name: Name of the flags in notes.
        stored: Flags of any type.
        meanings: ``value meaning`` pairs if the file states none.
        notes: Receives notes on the result.
    """
    if stored.values.dtype.kind == "S":
        digits = stored.values.ravel().astype("S1").tolist()
        numbers = np.array([int(one) if one.isdigit() else -1 for one in digits], np.int64)
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


def without_bad(
    file: NetcdfFile, name: str, values: NDArray[Any], notes: list[str]
) -> NDArray[Any]:
    """Return the values of a variable, of any shape, with NaN where the flags that decide on it call them bad."""
    for flag in _flags_of(file, name):
        bad = flagged_bad(flag, file.variables[flag], "", notes)
        if bad.size == values.size:
            values = np.where(bad.reshape(values.shape), np.nan, values)
    return values


def _flags_of(file: NetcdfFile, name: str) -> list[str]:
    """Return the names of the flags that decide on a variable: its ancillary variables with meanings, else those beside it by name."""
    held = file.variables
    named = held[name].text("ancillary_variables").split()
    stated = [one for one in named if one in held and _meanings(held[one])]
    return deciding(stated) or stated or [one for one in flag_names(name) if one in held]


def deciding(names: Collection[str]) -> list[str]:
    """Return the names of the flags that decide: those that sum up all tests, without any those of single tests."""
    summed, tests = (
        [name for name in names if re.fullmatch(pattern, name, re.IGNORECASE)]
        for pattern in (_SUMS, _TESTS)
    )
    return summed or tests


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
