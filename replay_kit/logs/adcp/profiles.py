"""Profiles in an MHKiT dataset as plain arrays by ping, in the names and units of ``replay_kit.AdcpPing``; and a vessel's fixes in it.

Velocities stay in the file's coordinates; attitude and geometry to rotate them are included. From the fixes follow the instrument's clock
and the magnetic declination.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from replay_kit.core.arrays import Array, Mask, Times
from replay_kit.core.observation.table import Columns

_ORIENTATIONS = {"down": "down", "up": "up", "AHRS": "up"}
_SYSTEMS = {"beam": "beam", "inst": "instrument", "ship": "ship", "earth": "earth"}
_MISSING = (-32.768, -3.2768)  # m/s; -32768 in mm/s and in tenths of them
_SENSORS = ("heading", "pitch", "roll", "temp", "c_sound")
_NAMES = {"temp": "temperature", "c_sound": "sound_speed"}
# Teledyne's nominal echo intensity scale [dB] and correlation [%] of a count
_ECHOES = {
    "amp": ("amplitude", 0.45),
    "corr": ("correlation", 100.0 / 255.0),
    "prcnt_gd": ("percent_good", 1.0),
}
_DEEPEST_DBAR = 12_000.0
_CLOCK_TICK_NS = 100_000  # the finest clock of the formats; MHKiT carries seconds as floats


@dataclass(frozen=True, slots=True, eq=False)
class RawProfiles:
    """Pings of one profiling mode.

    Attributes:
        time_ns: shape (n,) [ns], by the instrument's clock.
        known: shape (n,), False without a time or a ping.
        common: Fields common to all pings, in the form of a ping.
        per_ping: Name to shape (n, ...) of the other fields, NaN where missing.
        ordinals: shape (n,), ordinal of each ping in the file.
        bottom: Bottom-track velocity, shape (n, components) [m/s], and vertical distance, shape (n, beams) [m]; None without.
    """

    time_ns: Times
    known: Mask
    common: Mapping[str, Any]
    per_ping: Mapping[str, Array]
    ordinals: Times
    bottom: tuple[Array, Array] | None


def raw_profiles(dataset: Any, tag: str, ordinals: Sequence[int] | None = None) -> RawProfiles:
    """Return the pings of a dataset.

    Args:
        dataset: Dataset of MHKiT (xarray).
        tag: ``""`` for the burst or only mode, ``"_avg"`` for the averaging one.
        ordinals: Ordinals of its pings in the file; None for all.

    Raises:
        LookupError: A setting is missing or not supported, such as a horizontal instrument, whose cells have no depths.
    """
    teledyne = dataset.attrs["inst_make"] == "TRDI"
    if f"vel{tag}" not in dataset:
        # bottom track alone
        dataset = _without_cells(dataset)
    velocity = _known(_by_ping(dataset, f"vel{tag}"), _MISSING[: 1 if teledyne else 2])
    times = dataset[f"time{tag}"].values
    known = ~np.isnat(times)
    since = np.where(known, times, np.datetime64(0, "ns")).astype("datetime64[ns]").astype(np.int64)
    time_ns = np.round(since / _CLOCK_TICK_NS).astype(np.int64) * _CLOCK_TICK_NS
    if f"status{tag}" in dataset and not teledyne:
        # where a ping was skipped MHKiT fills in a time
        known &= dataset[f"status{tag}"].values != 0
    common = _geometry(dataset, tag) | (_teledyne(dataset) if teledyne else _nortek(dataset))
    per_ping = {
        _NAMES.get(name, name): _by_ping(dataset, name + tag)
        for name in _SENSORS
        if name + tag in dataset
    }
    if "heading" in per_ping:
        per_ping["heading"] = np.mod(per_ping["heading"], 360.0)
    system = common["coordinate_system"]
    per_ping["velocity"] = velocity if teledyne else one_vertical(velocity, system)
    for name, (ours, scale) in _ECHOES.items():
        if name + tag in dataset:
            counts = _by_ping(dataset, name + tag)
            per_ping[ours] = np.round(counts * (scale if teledyne else 1.0), 1)
    per_ping |= _depths(dataset, tag, teledyne)
    numbers = np.arange(time_ns.size) if ordinals is None else np.array(ordinals[: time_ns.size])
    bottom = _bottom(dataset) if teledyne and "vel_bt" in dataset else None
    return RawProfiles(time_ns, known, common, per_ping, numbers, bottom)


def _known(velocity: Array, missing: Sequence[float]) -> Array:
    """Return velocities, NaN where they are numbers that stand for none."""
    none = np.isclose(velocity[..., None], missing, rtol=0.0, atol=1e-5).any(axis=-1)
    return np.where(none, np.nan, velocity)


def _without_cells(dataset: Any) -> Any:
    """Return a dataset without profiles as one of zero cells."""
    shape = dataset.sizes[dataset["vel_bt"].dims[0]], 0, dataset["time"].size
    bare = dataset.drop_vars([name for name in dataset.variables if "range" in dataset[name].dims])
    velocity = (dataset["vel_bt"].dims[0], "range", "time"), np.zeros(shape)
    return bare.assign(vel=velocity, range=("range", np.zeros(0)))


def _by_ping(dataset: Any, name: str) -> Array:
    """Return a variable with dimensions ping, cell, component; MHKiT has the ping last."""
    return np.array(np.asarray(dataset[name].values, dtype=np.float64).T)


def _geometry(dataset: Any, tag: str) -> dict[str, Any]:
    cells, attributes = np.asarray(dataset[f"range{tag}"].values, dtype=np.float64), dataset.attrs
    return {
        "coordinate_system": _SYSTEMS[attributes["coord_sys"]],
        "reference": "platform",
        "orientation": _ORIENTATIONS[attributes["orientation"]],
        "n_cells": int(cells.size),
        "cell_size": round(float(attributes[f"cell_size{tag}"]), 4),
        "bin0_distance": round(float(cells[0]), 4) if cells.size else None,
    }


def _teledyne(dataset: Any) -> dict[str, Any]:
    """Return the settings in Teledyne's fixed leader: EX (transformations), EB (declination), head geometry."""
    attributes = dataset.attrs
    turned = attributes["coord_sys"] in ("ship", "earth")
    # VMDAS makes earth coordinates with the ship's heading and the corrections that its user gave
    true = attributes["magnetic_var_deg"] != 0.0 or (
        attributes.get("source_program") == "VMDAS" and attributes["coord_sys"] == "earth"
    )
    return {
        "attitude_convention": "teledyne",
        "tilt_applied": turned and attributes["use_pitchroll"] == "yes",
        "bin_mapped": turned and attributes["bin_mapping"] == "yes",
        "beam_unit_vectors": _vectors(dataset["beam2inst_orientmat"].values, False),
        "magnetic_declination": attributes["magnetic_var_deg"] or None,
        "declination_applied": bool(true),
    }


def _nortek(dataset: Any) -> dict[str, Any]:
    """Return the settings in Nortek's configuration; the instrument adds DECL to the heading."""
    configuration = json.loads(dataset.attrs["filehead_config"])
    declination = float(configuration.get("USER", {}).get("DECL", 0.0))
    earth = dataset.attrs["coord_sys"] == "earth"
    return {
        "attitude_convention": "nortek",
        "tilt_applied": earth,
        "bin_mapped": False,
        "beam_unit_vectors": _vectors(dataset["beam2inst_orientmat"].values, True),
        "magnetic_declination": declination or None,
        "declination_applied": declination != 0.0,
    }


def _vectors(matrix: Array, nortek: bool) -> list[list[float]] | None:
    """Return the beams' unit vectors from the beam-to-instrument matrix; None if it is singular.

    Teledyne's fourth row is the error velocity; Nortek's third and fourth are two estimates of z, each from two beams.
    """
    matrix = np.asarray(matrix, dtype=np.float64)
    if matrix.shape[0] != matrix.shape[1] or np.linalg.matrix_rank(matrix) < len(matrix):
        return None
    inverse = np.linalg.inv(matrix)
    vectors = (
        np.column_stack([inverse[:, :2], inverse[:, 2:].sum(axis=1)]) if nortek else inverse[:, :3]
    )
    # the files round the matrix to four digits
    unit = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return [[*map(float, row)] for row in unit]


def one_vertical(velocity: Array, system: str) -> Array:
    """Return Nortek velocities with one vertical component, the mean of the two; beam velocities are unchanged."""
    if system == "beam" or velocity.shape[-1] < 4:
        return velocity
    return np.concatenate(
        [velocity[..., :2], velocity[..., 2:4].mean(axis=-1, keepdims=True)], axis=-1
    )


def _depths(dataset: Any, tag: str, teledyne: bool) -> dict[str, Array]:
    """Return the pressure, if measured, and the transducer depth, if entered by the operator."""
    n = dataset[f"time{tag}"].size
    stated = f"pressure{tag}" in dataset
    sensor = not teledyne or dataset.attrs["sensors_avail"][2] == "1"
    pressure = _by_ping(dataset, f"pressure{tag}") if sensor and stated else np.full(n, np.nan)
    # unsigned in the file: a little below zero reads as the largest number
    pressure = np.where(np.abs(pressure) < _DEEPEST_DBAR, pressure, np.nan)
    typed = _by_ping(dataset, "depth") if teledyne and not sensor else np.zeros(n)
    return {"pressure": pressure, "transducer_depth": typed}


def _bottom(dataset: Any) -> tuple[Array, Array]:
    distance = _by_ping(dataset, "dist_bt")
    velocity = _known(_by_ping(dataset, "vel_bt"), _MISSING[:1])
    return velocity, np.where(distance > 0.0, distance, np.nan)


SECOND_NS, _MS_NS = 1_000_000_000, 1_000_000
_DAY_MS = 86_400_000.0


class Fixes(NamedTuple):
    """Fixes of a vessel.

    Attributes:
        columns: ``time`` [ns, UTC], increasing, ``longitude``, ``latitude`` [degrees] and ``error`` [m], NaN; shape (n,).
        offset_ns: UTC minus the instrument's clock [ns]; None without fixes.
        n_bad: Number of GPS records without a fix.
    """

    columns: Columns
    offset_ns: int | None
    n_bad: int

    def declination(self, time_ns: int) -> float | None:
        """Return the magnetic declination [degrees] at the first fix from a time on, or at the last; None without fixes or before 2010."""
        times, longitude, latitude, _ = self.columns.values()
        if not times.size:
            return None
        near = min(int(np.searchsorted(times, time_ns)), times.size - 1)
        return declination_at(time_ns, float(longitude[near]), float(latitude[near]))


def fixes_of(datasets: Sequence[Any]) -> Fixes:
    """Return the fixes in the MHKiT datasets (xarray) of one file, in any order."""
    table = np.concatenate([np.empty((5, 0)), *map(_raw_fixes, datasets)], axis=1)
    good = table[4] > 0.0
    gps, clock, longitude, latitude = table[:4, good]
    dated = any(dataset.attrs.get("source_program") == "VMDAS" for dataset in datasets)
    offset = clock_offset(gps, clock, dated) if gps.size else None
    if offset is not None and not dated:
        # of several whole days the one that the offset means
        gps = gps - np.round((gps - clock - offset) / _DAY_MS) * _DAY_MS
    time, first = np.unique(gps.astype(np.int64) * _MS_NS, return_index=True)
    places = {"longitude": longitude[first], "latitude": latitude[first]}
    columns = {"time": time, **places, "error": np.full(time.size, np.nan)}
    return Fixes(
        columns, None if offset is None else int(offset * _MS_NS), int(good.size - good.sum())
    )


def _raw_fixes(dataset: Any) -> Array:
    """Return GPS time and instrument's clock [ms], longitude, latitude, and whether it is valid, of each fix, shape (5, n)."""
    if not {"time_gps", "latitude_gps"} <= {*dataset.variables}:
        return np.empty((5, 0))
    # to the millisecond: MHKiT carries seconds as floats
    times = [
        np.round(dataset[name].values.astype("datetime64[us]").astype(np.int64) / 1000)
        for name in ("time_gps", "hdwtime_gps")
    ]
    longitude, latitude = (dataset[f"{name}_gps"].values for name in ("longitude", "latitude"))
    good = np.isfinite(longitude + latitude) & ((longitude != 0.0) | (latitude != 0.0))
    if "fix_gps" in dataset:
        good &= dataset["fix_gps"].values > 0
    return np.array([*times, longitude, latitude, good], np.float64)


def clock_offset(gps: Array, clock: Array, dated: bool) -> float:
    """Return UTC minus the instrument's clock [ms], the median over the fixes.

    Args:
        gps: GPS time of each fix, shape (n,) [ms].
        clock: The instrument's clock at each fix, shape (n,) [ms].
        dated: Whether the GPS time has its own date; otherwise the offset is known modulo a day, and that within half a day is returned.
    """
    ahead = gps - clock
    return float(np.median(ahead if dated else (ahead + _DAY_MS / 2) % _DAY_MS - _DAY_MS / 2))


def declination_at(time_ns: int, longitude: float, latitude: float) -> float | None:
    """Return the magnetic declination [degrees, positive east] by the World Magnetic Model of the time; None before 2010.

    Positions are rounded to 0.1 degree and times to 0.1 year, below the resolution of a compass.
    """
    when = datetime.fromtimestamp(time_ns // SECOND_NS, UTC)
    year = round(when.year + (when.timetuple().tm_yday - 1) / 366.0, 1)
    return _declination(year, round(longitude, 1), round(latitude, 1))


@lru_cache(maxsize=1024)
def _declination(year: float, longitude: float, latitude: float) -> float | None:
    from pygeomag import GeoMag

    # models of five years each: the first that covers the year; none does before 2010
    for file in ("WMM_2010", "WMM_2015v2", "WMM_2020", "WMM_2025"):
        model = GeoMag(coefficients_file=f"wmm/{file}.COF")
        low, high = model.life_span
        if low <= year <= high:
            found = model.calculate(glat=latitude, glon=longitude, alt=0.0, time=year)
            return round(float(found.d), 2)
    return None
