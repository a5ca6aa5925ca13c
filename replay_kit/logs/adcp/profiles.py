"""Profiles in an MHKiT dataset as plain arrays by ping, in the names and units of ``replay_kit.AdcpPing``.

Velocities stay in the file's coordinates; attitude and geometry to rotate them are included.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array, Mask, Times

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
