"""Columns of a glider file in SI units: samples along the track, fixes, mean currents, absolute profiles."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import gsw
import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.errors import LogError
from replay_kit.logs.netcdf import units
from replay_kit.logs.netcdf.dialects import QUANTITIES, SIZES, Dialect, Names, Told
from replay_kit.logs.netcdf.variables import NetcdfFile

#: Columns of one length by name; ``time`` and names that end in it hold ns UTC, 0 where unknown.
Table = Mapping[str, NDArray[Any]]
_KEYS = ("time", "gps_time", "start_time", "end_time", "dac_time", *QUANTITIES)
_DAC, _GPS = ([key for key in _KEYS if key.startswith(part)] for part in ("dac_", "gps_"))
_SAMPLES = [key for key in _KEYS if not key.startswith(("gps_", "profile_"))]
# degrees north, where no position tells it
_LATITUDE = 45.0


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """Contents of a file, or of the files of one log.

    Attributes:
        samples: Samples along the track in order of time, with their dive's mean current if the file repeats it.
        gps: Fixes with their own variables.
        dac: Mean currents with their own dimension.
        profile: Absolute currents ``east`` and ``north``, shape (n, k) [m/s], at the samples of a file with one per profile, and ``depth``,
            shape (k,) [m]; else empty.
    """

    samples: Table
    gps: Table
    dac: Table
    profile: Mapping[str, Array]


def read_values(
    file: NetcdfFile, dialect: Dialect, chosen: Mapping[str, str], notes: list[str]
) -> dict[str, NDArray[Any]]:
    """Return the quantities of a file in SI units, in their stored shapes; times in ns UTC, 0 if unknown.

    Args:
        file: The file.
        dialect: Dialect of the file.
        chosen: Variable of each quantity.
        notes: Receives notes on assumptions.

    Raises:
        LogError: The unit of a time is unknown.
    """
    forced = _units_by_values(file, dialect, chosen)
    notes.append("read as " + ", ".join(f"{_words(key)}: {name}" for key, name in chosen.items()))
    values: dict[str, NDArray[Any]] = {}
    for key, name in chosen.items():
        stored = file.variables[name]
        if key.endswith("time"):
            try:
                values[key], known = units.time_ns(name, stored, file.path, notes)
            except LogError:
                # of a basestation's file each time counts; others fill what they do not use with any number
                if key == "time" or dialect.name == "seaglider":
                    raise
                notes.append(f"{name}: holds no plausible times, not used")
                continue
            # a drogue without a date was not lost
            if not known.all() and key != "lost_time":
                notes.append(f"{name}: {int((~known).sum())} values without a time, excluded")
        elif key in dialect.quantities:
            unit = forced.get(key, "") if dialect.raw or not stored.units else ""
            values[key] = units.in_si(name, stored, dialect.quantities[key], notes, unit)
    _spread_by_profile(file, chosen, values, notes)
    _with_sign(file, chosen, values, notes)
    return values


def read_columns(file: NetcdfFile, dialect: Dialect, told: Told) -> Columns:
    """Return the columns of a glider file.

    Args:
        file: The file.
        dialect: Dialect of the file.
        told: Receives assumptions and counts of unusable values.

    Raises:
        LogError: The file has no times, or the unit of a time is unknown.
    """
    notes = told.notes
    chosen = dialect.by_standard_names(file.variables, notes)
    if not {"time", "gps_time"} & set(chosen):
        names = " or ".join(dialect.names["time"].split())
        raise LogError(
            f"{file.path}: {dialect.title}: expected a variable {names} with the times of the samples, got variables "
            f"{', '.join(file.names)}; write the file again with its times"
        )
    values = read_values(file, dialect, chosen, notes)
    # the cycles of a Slocum each write some of the sensors
    notes += [] if file.sources else _missing(chosen, values)
    if "declination" in values and np.isfinite(values["declination"]).any():
        notes.append(
            f"{chosen['declination']}: declination {np.nanmedian(values['declination']):g} degrees"
        )
    heights = [name for name in file.names if name.lower() == "depth_z"]
    notes += [
        f"{name}: has the standard name depth but is positive up; not used" for name in heights
    ]
    if (dive := file.dive_number) is not None:
        values["dive"] = np.array([float(dive)])
    _without_bad(file, dialect, chosen, values, told)
    if not np.isfinite(values.get("depth", np.nan)).any():
        _with_depth(chosen, values, notes)
    for key in ("heading", "pitch", "roll"):
        if key in values and not dialect.raw:
            values[key] = units.attitude_degrees(chosen[key], values[key], key == "heading", notes)
    return _grouped(values)


def _units_by_values(file: NetcdfFile, dialect: Dialect, chosen: Mapping[str, str]) -> Names:
    """Return the dialect's units, with degrees for positions that are not in degrees and minutes."""
    places = {
        key: file.array(chosen[key])
        for key, unit in dialect.units.items()
        if unit == "nmea" and key in chosen
    }
    decimal = bool(places) and not units.in_minutes(places)
    return {
        key: "degrees" if decimal and key in places else unit for key, unit in dialect.units.items()
    }


def _spread_by_profile(
    file: NetcdfFile, chosen: Mapping[str, str], values: dict[str, NDArray[Any]], notes: list[str]
) -> None:
    """Repeat values of each profile or drifter of a ragged array at its samples."""
    sizes, dims = profile_sizes(file)
    if not dims:
        return
    each = [
        key
        for key, found in values.items()
        if found.size == sizes.size and file.variables[chosen[key]].dims == dims
    ]
    values |= {key: np.repeat(values[key].ravel(), sizes) for key in each}
    notes.append(
        f"{sizes.size} profiles of {int(sizes.sum())} samples: values stated once for each are repeated at its samples"
    )


def profile_sizes(file: NetcdfFile) -> tuple[NDArray[np.int64], tuple[str, ...]]:
    """Return the number of samples of each profile of a ragged array and its dimension; no dimension for other files."""
    for name, stored in file.variables.items():
        if stored.text("sample_dimension") or name.lower() in SIZES:
            sizes = np.maximum(np.nan_to_num(stored.unpacked()).astype(np.int64).ravel(), 0)
            # a table states them again at each sample
            if sizes.sum() in {other.values.size for other in file.variables.values()}:
                return sizes, stored.dims
    return np.empty(0, np.int64), ()


def _words(key: str) -> str:
    return key.replace("_", " ").replace("dac ", "mean current ").replace("gps ", "GPS ")


def _missing(chosen: Mapping[str, str], values: Mapping[str, NDArray[Any]]) -> list[str]:
    """Return the numbers of missing values by variable as one sentence; empty if none."""
    counts = {
        chosen[key]: int((~np.isfinite(found)).sum())
        for key, found in values.items()
        if not key.endswith("time")
    }
    lacking = ", ".join(f"{count} of {name}" for name, count in counts.items() if count)
    return [f"missing (fill values or out of range): {lacking}"] if lacking else []


def _without_bad(
    file: NetcdfFile,
    dialect: Dialect,
    chosen: Mapping[str, str],
    values: dict[str, NDArray[Any]],
    told: Told,
) -> None:
    """Remove values with bad flags, and count fixes and mean currents among them."""
    for key, name in chosen.items():
        part = key.partition("_")[0] if key.endswith("_flag") else ""
        own = [
            name + suffix
            for suffix in ("_QC", "_qc")
            if name + suffix in file.variables and name + suffix not in chosen.values()
        ]
        for flag in [name] if part else own:
            bad = units.flagged_bad(flag, file.variables[flag], dialect.flag_meanings, told.notes)
            topic, what = ("/dac", "mean current") if part == "dac" else ("/vehicle/fix", "GPS fix")
            if part and bad.any():
                told.skipped[topic, f"{what} flagged bad ({flag})"] += int(bad.sum())
            for masked in [f"{part}_east", f"{part}_longitude"] if part else [key]:
                if (
                    masked in values
                    and not masked.endswith("time")
                    and bad.size == values[masked].size
                ):
                    values[masked] = np.where(
                        bad.reshape(values[masked].shape), np.nan, values[masked]
                    )


def _with_sign(
    file: NetcdfFile, chosen: Mapping[str, str], values: dict[str, NDArray[Any]], notes: list[str]
) -> None:
    """Change the sign of depths that are positive up."""
    depth = values.get("depth")
    if depth is None or not np.isfinite(depth).any():
        return
    stated = file.variables[chosen["depth"]].text("positive").lower()
    if stated == "up" or (stated != "down" and np.nanmedian(depth) < 0.0):
        how = "as stated" if stated else "by its negative values"
        notes.append(f"{chosen['depth']}: positive up ({how}), sign reversed")
        values["depth"] = -depth


def _with_depth(
    chosen: Mapping[str, str], values: dict[str, NDArray[Any]], notes: list[str]
) -> None:
    """Add depths computed from pressure."""
    if not np.isfinite(values.get("pressure", np.nan)).any():
        return
    latitude = values.get("latitude", np.empty(0))
    mean = np.nanmean(latitude) if np.isfinite(latitude).any() else _LATITUDE
    values["depth"] = -np.asarray(gsw.z_from_p(values["pressure"], mean))
    notes.append(f"depth: computed from {chosen['pressure']}")


def _grouped(values: Mapping[str, NDArray[Any]]) -> Columns:
    """Return quantities as tables; columns as long as the samples' times, and scalars, belong to the samples."""
    n = values["time"].size if "time" in values else 0
    samples = _sorted(
        {
            key: np.broadcast_to(values[key].ravel(), (n,))
            for key in _SAMPLES
            if n and key in values and values[key].size in (1, n)
        }
    )
    dac = {} if "dac_east" in samples else _same_length(values, [*_DAC, "dive"], "dac_east")
    gps = dict(values)
    own_time = values.get("gps_time", np.zeros(n, np.int64)).ravel()
    if "gps_longitude" in gps and gps["gps_longitude"].size == n == own_time.size:
        # some writers state the position of a fix and leave its time to the row
        gps["gps_time"] = np.where(own_time > 0, own_time, values["time"].ravel())
    gps = _same_length(gps, _GPS, "gps_longitude")
    if not {"gps_time", "gps_latitude"} <= set(gps):
        gps = {}
    profile = _profile(values, n)
    if profile:
        has = np.isfinite(profile["east"] + profile["north"])
        deepest = np.where(has, profile["depth"], -np.inf).max(axis=1)
        samples["deepest"] = np.where(has.any(axis=1), deepest, np.nan)
        samples["dive"] = np.arange(1.0, has.shape[0] + 1.0)
    return Columns(samples, gps, dac, profile)


def _same_length(
    values: Mapping[str, NDArray[Any]], keys: Sequence[str], first: str
) -> dict[str, NDArray[Any]]:
    """Return the columns with the length of column ``first``; empty without it."""
    held = {key: values[key].ravel() for key in keys if key in values}
    return {key: held[key] for key in held if first in held and held[key].size == held[first].size}


def _sorted(samples: Table) -> dict[str, NDArray[Any]]:
    if not samples:
        return {}
    order = np.argsort(samples["time"], kind="stable")
    order = order[samples["time"][order] > 0]
    return {key: values[order] for key, values in samples.items()}


def _profile(values: Mapping[str, NDArray[Any]], n: int) -> Mapping[str, Array]:
    """Return absolute currents with the profile as first dimension."""
    if not {"profile_east", "profile_north", "profile_depth"} <= set(values):
        return {}
    depth = values["profile_depth"].ravel()
    east, north = values["profile_east"], values["profile_north"]
    if east.shape == north.shape == (depth.size, n):
        # a square is depth first, as the files of this dialect are
        east, north = east.T, north.T
    time_ns = values["time"].ravel() if "time" in values else np.empty(0, np.int64)
    order = np.argsort(time_ns, kind="stable")
    order = order[time_ns[order] > 0]
    return (
        {"depth": depth, "east": east[order], "north": north[order]}
        if east.shape == north.shape == (n, depth.size)
        else {}
    )


def joined(parts: Sequence[Columns]) -> Columns:
    """Return the joined columns of several files of one mission, in order of time.

    Raises:
        LogError: The files have profiles at different depths.
    """
    if len(parts) == 1:
        return parts[0]
    profiles = [part.profile for part in parts if part.profile]
    if len(profiles) > 1:
        raise LogError(
            "expected one file with absolute profiles in a log, got several; give them one by one"
        )
    samples = _sorted(_stacked([part.samples for part in parts]))
    gps, dac = _stacked([part.gps for part in parts]), _stacked([part.dac for part in parts])
    return Columns(samples, gps, dac, profiles[0] if profiles else MappingProxyType({}))


def _stacked(tables: Sequence[Table]) -> Table:
    """Return concatenated tables; missing columns are unknown."""
    held = [table for table in tables if table]
    keys = dict.fromkeys(key for table in held for key in table)
    return {
        key: np.concatenate([table.get(key, _unknown(key, table)) for table in held])
        for key in keys
    }


def _unknown(key: str, table: Table) -> NDArray[Any]:
    n = len(next(iter(table.values())))
    return np.zeros(n, np.int64) if key.endswith("time") else np.full(n, np.nan)
