"""A Nortek AD2CP on a glider: the NetCDF that MIDAS exports, and what a SeaExplorer keeps of it in real time.

The beams of the gliders' head: 1 fore and 3 aft at 47.5 degrees from its axis, 2 and 4 abeam at 25 degrees (bastienqueste/gliderad2cp,
``process_shear.py``). Ranges are distances along the axis; velocities are positive away from the instrument.
"""

from collections.abc import Iterator

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.errors import LogError
from replay_kit.logs.glider import units
from replay_kit.logs.glider.netcdf import NetcdfFile
from replay_kit.logs.reader import Entry
from replay_kit.logs.shared.payloads import PING, number, numbers, stamp

_FORE, _SIDE = np.deg2rad(47.5), np.deg2rad(25.0)
_BEAMS = np.array(
    [
        [np.sin(_FORE), 0.0, np.cos(_FORE)],
        [0.0, -np.sin(_SIDE), np.cos(_SIDE)],
        [-np.sin(_FORE), 0.0, np.cos(_FORE)],
        [0.0, np.sin(_SIDE), np.cos(_SIDE)],
    ]
)


def midas_pings(file: NetcdfFile, notes: list[str]) -> Iterator[Entry]:
    """Yield the pings of an AD2CP exported by MIDAS, along its beams, relative to the glider.

    Raises:
        LogError: The times have a unit that is not understood, or the beams have other cells than each other.
    """
    held = {name.lower().replace(" ", ""): name for name in file.variables}
    if "time" not in held:
        raise LogError(
            f"{file.path}: expected a variable time in the group Data/Average, it holds a dimension alone; export the file again"
        )
    time_ns, known = units.time_ns("time", file.variables[held["time"]], file, notes)
    beams = [k for k in range(1, 5) if f"velocitybeam{k}" in held]
    velocity = _by_ping(file, [held[f"velocitybeam{k}"] for k in beams], time_ns.size)
    quality = {
        word: _by_ping(file, [held[f"{word}beam{k}"] for k in beams], time_ns.size)
        for word in ("amplitude", "correlation")
        if all(f"{word}beam{k}" in held for k in beams)
    }
    sensors = {
        key: values
        for key, name in (
            ("heading",) * 2,
            ("pitch",) * 2,
            ("roll",) * 2,
            ("pressure",) * 2,
            ("sound_speed", "speedofsound"),
        )
        if name in held and (values := file.array(held[name]).ravel()).size == time_ns.size
    }
    up = file.array(held["accelerometerz"]).ravel() if "accelerometerz" in held else np.empty(0)
    up = up[np.isfinite(up)]
    orientation = "down" if up.size and np.median(up) < 0.0 else "up"
    notes.append(
        f"ADCP: looks {orientation}, by its accelerometer" if up.size else "ADCP: taken to look up"
    )
    notes.append(
        "ADCP: beams taken to be those of Nortek's glider head (47.5 degrees fore and aft, 25 degrees abeam)"
    )
    notes.append("ADCP: headings are magnetic; state measurements.magnetic_declination")
    distance = file.array(held["velocityrange"]).ravel() if "velocityrange" in held else np.empty(0)
    distance = (
        distance if distance.size == velocity.shape[1] else _distances(file, velocity.shape[1])
    )
    for k in np.flatnonzero(known).tolist():
        payload = {
            "stamp": stamp(int(time_ns[k])),
            "frame_id": "adcp",
            "ping": k,
            "coordinate_system": "beam",
            "reference": "platform",
            "orientation": orientation,
            "bin_mapped": False,
            "attitude_convention": "nortek",
            "beam_unit_vectors": _BEAMS[[beam - 1 for beam in beams]].tolist(),
            "n_cells": velocity.shape[1],
            "cell_size": float(np.median(np.diff(distance))) if distance.size > 1 else None,
            "bin0_distance": float(distance[0]),
            "transducer_depth": 0.0,
            "velocity": numbers(np.round(velocity[k], 6)),
            **{word: numbers(values[k]) for word, values in quality.items()},
            "declination_applied": False,
            **{name: number(float(values[k])) for name, values in sensors.items()},
        }
        yield int(time_ns[k]), "/adcp", PING, payload


def _by_ping(file: NetcdfFile, names: list[str], n: int) -> Array:
    """Return values by ping, cell and beam, whichever of the two dimensions a beam's variable has first.

    Raises:
        LogError: A beam has other cells than the first, or not one row for each of the n times.
    """
    beams = [file.array(name) for name in names]
    by_ping = [beam if beam.shape[:1] == (n,) else beam.T for beam in beams]
    shape = by_ping[0].shape
    if len(shape) != 2 or any(beam.shape != shape for beam in by_ping) or shape[0] != n:
        found = ", ".join(f"{name} {beam.shape}" for name, beam in zip(names, beams, strict=True))
        raise LogError(
            f"{file.path}: expected beams with the same cells at each of {n} times, got {found}; export the file again"
        )
    return np.asarray(np.stack(by_ping, axis=-1))


def _distances(file: NetcdfFile, n: int) -> Array:
    """Return the cells' distances [m] by the instrument's configuration."""
    size, blanking = (
        float(file.attributes.get(name, 1.0)) for name in ("avg_cellSize", "avg_blankingDistance")
    )
    return np.asarray(blanking + size * np.arange(1, n + 1), np.float64)


def seaexplorer_pings(file: NetcdfFile, notes: list[str]) -> Iterator[Entry]:
    """Yield nothing, and say why: in real time a SeaExplorer keeps one cell of its AD2CP."""
    if any(name.lower().startswith("ad2cp_v") for name in file.variables):
        notes.append(
            "AD2CP in real time: one cell, relative to the glider, which alone says nothing of the current; add the MIDAS export"
        )
    return iter(())
