"""Columns of a file in SI units without what its quality flags call bad, by the meanings that the file states.

Those of a glider become tables: samples along the track, fixes, mean currents, absolute profiles.
"""

import re
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

import gsw
import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Indices, Mask
from replay_kit.core.errors import LogError
from replay_kit.core.observation import Flag
from replay_kit.logs.netcdf import units
from replay_kit.logs.netcdf.dialect import SIZES, Dialect, flag_names
from replay_kit.logs.netcdf.variables import NetcdfFile, Stored

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
# a flag that is missing
_NONE = -1
# topics and names of what is counted where its own flag is bad
_COUNTED = {"dac": ("/dac", "mean current"), "gps": ("/vehicle/fix", "GPS fix")}


def remove_bad(
    file: NetcdfFile, dialect: Dialect, chosen: Mapping[str, str], values: "Table"
) -> None:
    """Remove values with bad flags, and count fixes and mean currents among them.

    Args:
        file: The file.
        dialect: Dialect of the file.
        chosen: Variable of each quantity.
        values: Quantities, of which bad values become NaN.
    """
    own = [name for key, name in chosen.items() if key.endswith("_flag")]
    for key, name in chosen.items():
        part = key.removesuffix("_flag")
        if name in own:
            bad = flagged_bad(file, name, dialect.flag_meanings)
            topic, what = _COUNTED.get(part, _COUNTED["gps"])
            file.told.skipped[topic, f"{what} flagged bad ({name})"] += int(bad.sum())
            for of_part in (f"{part}_east", f"{part}_longitude"):
                if of_part in values:
                    values[of_part] = _masked(values[of_part], bad)
        elif key in values and not key.endswith("time"):
            values[key] = without_bad(file, name, values[key], dialect.flag_meanings, own)


def without_bad(
    file: NetcdfFile,
    name: str,
    values: NDArray[Any],
    meanings: str = "",
    others: Collection[str] = (),
) -> NDArray[Any]:
    """Return the values of a variable, of any shape, with NaN where the flags that decide on it call them bad.

    Args:
        file: The file.
        name: Name of the variable.
        values: Its values.
        meanings: As in ``flagged_bad``.
        others: Flags of others, whatever their names.
    """
    for flag in _flags_of(file, name):
        if flag not in others:
            values = _masked(values, flagged_bad(file, flag, meanings))
    return values


def _masked(values: NDArray[Any], bad: Mask) -> NDArray[Any]:
    return (
        np.where(bad.reshape(values.shape), np.nan, values) if bad.size == values.size else values
    )


def flagged_bad(file: NetcdfFile, name: str, meanings: str = "") -> Mask:
    """Return the mask of bad values by the meanings of their flags, never by number.

    Args:
        file: The file.
        name: Name of the flags, of any type.
        meanings: ``value meaning`` pairs if the file states none.
    """
    stored, words = file.variables[name], meanings.split()
    numbers = _numbers(stored)
    known = _meanings(stored) or dict(zip(map(int, words[::2]), words[1::2], strict=True))
    bad = {value: said for value, said in known.items() if _flag(said) in (Flag.SUSPECT, Flag.FAIL)}
    for value in sorted(bad.keys() & set(numbers.ravel().tolist())):
        file.note(f"{name}: {int((numbers == value).sum())} x {value} ({bad[value]}), not used")
    return np.isin(numbers, list(bad))


def as_qartod(stored: Stored) -> NDArray[np.int8]:
    """Return flags as QARTOD flags, by their stated meanings or else by number; missing ones are not evaluated."""
    numbers = _numbers(stored)
    flags = np.where(numbers == _NONE, Flag.NOT_EVALUATED, numbers).astype(np.int8)
    for value, words in _meanings(stored).items():
        flags[numbers == value] = _flag(words)
    return flags


def _numbers(stored: Stored) -> Indices:
    """Return flags of any type as numbers."""
    if stored.values.dtype.kind == "S":
        digits = stored.values.ravel().astype("S1").tolist()
        return np.array([int(one) if one.isdigit() else _NONE for one in digits], np.int64)
    return np.nan_to_num(stored.unpacked(), nan=_NONE).astype(np.int64)


def _flags_of(file: NetcdfFile, name: str) -> list[str]:
    """Return the names of the flags that decide on a variable: its ancillary variables with meanings, else those beside it by name."""
    held = file.variables
    named = held[name].text("ancillary_variables").split()
    stated = [one for one in named if one in held and _meanings(held[one])]
    return deciding_flags(stated) or stated or [one for one in flag_names(name) if one in held]


def deciding_flags(names: Collection[str]) -> list[str]:
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


def is_failed(flags: NDArray[np.int8]) -> Mask:
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


#: Columns by name; ``time`` and names that end in it hold ns UTC, 0 where unknown.
Table = dict[str, NDArray[Any]]
# Columns that samples have, known or not.
_OF_SAMPLES = ("longitude", "latitude", "depth", "declination")
# degrees north, where no position tells it
_LATITUDE = 45.0


class Columns(NamedTuple):
    """Contents of a file, or of the files of one log; the columns of a table have one length.

    Attributes:
        samples: Samples along the track in order of time: at least ``time``, ``dac_time`` and those of ``_OF_SAMPLES``; with their dive's
            mean current if the file repeats it.
        gps: Fixes with their own variables.
        dac: Mean currents with their own dimension.
        profile: Absolute currents ``east`` and ``north``, shape (n, k) [m/s], at the samples of a file with one per profile, and ``depth``,
            shape (k,) [m]; else empty.
    """

    samples: Table
    gps: Table
    dac: Table
    profile: Table


def read_values(file: NetcdfFile, dialect: Dialect, chosen: Mapping[str, str]) -> Table:
    """Return the quantities of a file in SI units, in their stored shapes; times in ns UTC, 0 if unknown.

    Args:
        file: The file.
        dialect: Dialect of the file.
        chosen: Variable of each quantity.

    Raises:
        LogError: The unit of a time is unknown.
    """
    file.note("read as " + ", ".join(f"{key}: {name}" for key, name in chosen.items()))
    forced = dict(dialect.units)
    places = {
        key: file.array(chosen[key])
        for key, unit in forced.items()
        if unit == "nmea" and key in chosen
    }
    if not units.in_minutes(places):
        forced |= dict.fromkeys(places, "degrees")
    values: Table = {}
    for key, name in chosen.items():
        stored = file.variables[name]
        if key.endswith("time"):
            try:
                values[key] = units.times_of(file, name)
            except LogError:
                # of a basestation's file each time counts; others fill what they do not use with any number
                if key == "time" or dialect.name == "seaglider":
                    raise
                file.note(f"{name}: holds no plausible times, not used")
                continue
            # a drogue without a date was not lost
            if key != "lost_time" and not values[key].all():
                unknown = int((values[key] == 0).sum())
                file.note(f"{name}: {unknown} values without a time, excluded")
        elif key == "id":
            texts = stored.texts() or [f"{value:.0f}" for value in stored.unpacked().ravel()]
            values[key] = np.array(texts)
        elif quantity := dialect.quantity_of(key):
            unit = forced.get(key, "") if dialect.raw or not stored.units else ""
            values[key] = units.in_si(file, name, quantity, unit)
    sizes, dims = _profile_sizes(file)
    if dims:
        for key, found in values.items():
            if found.size == sizes.size and file.variables[chosen[key]].dims == dims:
                values[key] = np.repeat(found.ravel(), sizes)
        file.note(
            f"{sizes.size} profiles of {int(sizes.sum())} samples: values stated once for each are repeated at its samples"
        )
    depth = values.get("depth", np.empty(0))
    if np.isfinite(depth).any():
        stated = file.variables[chosen["depth"]].text("positive").lower()
        if stated == "up" or (stated != "down" and np.nanmedian(depth) < 0.0):
            how = "as stated" if stated else "by its negative values"
            file.note(f"{chosen['depth']}: positive up ({how}), sign reversed")
            values["depth"] = -depth
    return values


def _profile_sizes(file: NetcdfFile) -> tuple[NDArray[np.int64], tuple[str, ...]]:
    """Return the number of samples of each profile of a ragged array and its dimension; no dimension for other files."""
    for name, stored in file.variables.items():
        if stored.text("sample_dimension") or name.lower() in SIZES:
            sizes = np.maximum(np.nan_to_num(stored.unpacked()).astype(np.int64).ravel(), 0)
            # a table states them again at each sample
            if sizes.sum() in {other.values.size for other in file.variables.values()}:
                return sizes, stored.dims
    return np.empty(0, np.int64), ()


def read_columns(file: NetcdfFile, dialect: Dialect) -> Columns:
    """Return the columns of a glider file.

    Raises:
        LogError: The file has no times, or the unit of a time is unknown.
    """
    chosen = dialect.by_standard_names(file)
    if not {"time", "gps_time"} & chosen.keys():
        raise LogError(
            f"{file.path}: {dialect.title}: expected a variable {dialect.names['time'].replace(' ', ' or ')}, got "
            f"{', '.join(file.names)}; write the file with its times"
        )
    values = read_values(file, dialect, chosen)
    if (dive := file.dive_number) is not None:
        values["dive"] = np.array([float(dive)])
    remove_bad(file, dialect, chosen, values)
    pressure = values.get("pressure", np.empty(0))
    if not np.isfinite(values.get("depth", np.nan)).any() and np.isfinite(pressure).any():
        latitude = values.get("latitude", np.empty(0))
        mean = np.nanmean(latitude) if np.isfinite(latitude).any() else _LATITUDE
        values["depth"] = -np.asarray(gsw.z_from_p(pressure, mean))
        file.note(f"depth: computed from {chosen['pressure']}")
    for key in ("heading", "pitch", "roll"):
        if key in values and not dialect.raw:
            values[key] = units.attitude_degrees(file, chosen[key], values[key], key == "heading")
    return _tables(values)


def _tables(values: Table) -> Columns:
    """Return quantities as tables; columns as long as the samples' times, and scalars, belong to the samples."""
    time = values.get("time", np.empty(0, np.int64)).ravel()
    n = time.size
    order = np.argsort(time, kind="stable")
    order = order[time[order] > 0]
    samples = {name: np.full(order.size, np.nan) for name in _OF_SAMPLES}
    samples |= {"time": time[order], "dac_time": np.zeros(order.size, np.int64)}
    samples |= {
        key: np.broadcast_to(found.ravel(), n)[order]
        for key, found in values.items()
        if n and found.size in (1, n) and not key.startswith(("gps_", "profile_"))
    }
    dac = {} if "dac_east" in samples else _alike(values, ("dac_", "dive"), "dac_east")
    gps = _alike(values, ("gps_",), "gps_longitude")
    gps_time = values.get("gps_time", np.zeros(n, np.int64)).ravel()
    if gps and gps_time.size == gps["gps_longitude"].size == n:
        # some writers state the position of a fix and leave its time to the row
        gps["gps_time"] = np.where(gps_time > 0, gps_time, time)
    profile = _profile(values, n, order)
    if profile:
        has = np.isfinite(profile["east"] + profile["north"])
        deepest = np.where(has, profile["depth"], -np.inf).max(axis=1)
        samples["deepest"] = np.where(has.any(axis=1), deepest, np.nan)
        samples["dive"] = np.arange(1.0, len(has) + 1.0)
    return Columns(samples, gps if {"gps_time", "gps_latitude"} <= gps.keys() else {}, dac, profile)


def _alike(values: Table, begins: tuple[str, ...], first: str) -> Table:
    """Return the columns of some names with the length of column ``first``; empty without it."""
    size = values[first].size if first in values else -1
    return {
        key: found.ravel()
        for key, found in values.items()
        if key.startswith(begins) and found.size == size
    }


def _profile(values: Table, n: int, order: Indices) -> Table:
    """Return absolute currents with the profile as first dimension, in order of time."""
    if not {"profile_east", "profile_north", "profile_depth"} <= values.keys():
        return {}
    depth = values["profile_depth"].ravel()
    east, north = values["profile_east"], values["profile_north"]
    if east.shape == north.shape == (depth.size, n):
        # a square is depth first, as the files of this dialect are
        east, north = east.T, north.T
    if not east.shape == north.shape == (n, depth.size):
        return {}
    return {"depth": depth, "east": east[order], "north": north[order]}


def joined_columns(parts: Sequence[Columns]) -> Columns:
    """Return the joined columns of several files of one mission, in order of time.

    Raises:
        LogError: The files have profiles at different depths.
    """
    if len(parts) == 1:
        return parts[0]
    if sum(bool(part.profile) for part in parts) > 1:
        raise LogError(
            "expected one file with absolute profiles in a log, got several; give them one by one"
        )
    columns = Columns(
        *(stacked_tables([t for t in tables if t]) for tables in zip(*parts, strict=True))
    )
    order = np.argsort(columns.samples["time"], kind="stable")
    return columns._replace(samples=rows_of(columns.samples, order))


def rows_of(table: Table, rows: NDArray[Any]) -> Table:
    """Return some rows of a table, by a mask or indices."""
    return {key: column[rows] for key, column in table.items()}


def stacked_tables(tables: Sequence[Table], unknown: float = np.nan) -> Table:
    """Return concatenated tables; missing columns are ``unknown``, times 0."""
    sizes = [len(next(iter(table.values()))) for table in tables]
    keys = dict.fromkeys(key for table in tables for key in table)

    def column(key: str) -> NDArray[Any]:
        empty = 0 if key.endswith("time") else unknown
        parts = zip(tables, sizes, strict=True)
        return np.concatenate([table.get(key, np.full(n, empty)) for table, n in parts])

    return {key: column(key) for key in keys}


def are_known(places: Table) -> Mask:
    """Return whether both time and position are known, shape (n,)."""
    return np.asarray((places["time"] > 0) & np.isfinite(places["longitude"] + places["latitude"]))
