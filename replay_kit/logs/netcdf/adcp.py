"""Glider ADCPs as ``replay_kit.AdcpPing``: Seaglider, Nortek AD2CP exported by MIDAS, and SeaExplorer in real time.

Properties that Seaglider files do not state, and their evidence:

* ``ad2cp_velX, velY, velZ`` are not along the instrument's axes: the basestation takes them as east, north and up, and on real dives velZ
  equals the vertical speed from pressure at pitches of 35 degrees. East and north are magnetic: they deviate from the track by the
  declination, which is thus not applied.
* The first cell's centre is one blanking and one cell from the instrument, which looks up or down (``orientation``).
* ``ad2cp_soundspeed`` is in tenths of m/s and ``ad2cp_temperature`` in tenths of a degree, whatever their units attribute states.

The beams of Nortek's glider head: 1 fore and 3 aft at 47.5 degrees from its axis, 2 and 4 abeam at 25 degrees (bastienqueste/gliderad2cp,
``process_shear.py``). Ranges are distances along the axis; velocities are positive away from the instrument.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.errors import LogError
from replay_kit.logs.netcdf import units
from replay_kit.logs.netcdf.variables import NetcdfFile
from replay_kit.logs.reader import Entry
from replay_kit.logs.shared.payloads import PING, number, numbers, stamp

_UNKNOWN = (
    *(
        "beam_unit_vectors",
        "velocity_std",
        "amplitude",
        "correlation",
        "percent_good",
        "sound_speed",
        "temperature",
    ),
    *("heading", "pitch", "roll", "magnetic_declination", "bottom_track"),
)


#: Of a profile that was computed from others and begins at the surface, not at the glider: its levels are depths.
FROM_SURFACE = {
    "reference": "earth",
    "orientation": "down",
    "bin_mapped": True,
    "pressure": 0.0,
    "declination_applied": True,
    "derived": True,
}


def earth_ping(
    time_ns: int, ordinal: int, dive: int | None, velocity: Array, cells: tuple[float | None, float]
) -> dict[str, Any]:
    """Return a ping in earth coordinates, also as a template for others; unknown fields are null.

    Args:
        time_ns: [ns, UTC].
        ordinal: Ordinal of the ping.
        dive: Number of its dive; None when unknown.
        velocity: shape (n_cells, k) [m/s], east, north, perhaps up; NaN where missing.
        cells: Cell size, None if unknown, and distance of the first cell's centre [m].
    """
    return {
        "stamp": stamp(time_ns),
        "frame_id": "adcp",
        "ping": ordinal,
        **({} if dive is None else {"dive": dive}),
        "coordinate_system": "earth",
        "n_cells": len(velocity),
        "cell_size": cells[0],
        "bin0_distance": cells[1],
        "transducer_depth": 0.0,
        "velocity": numbers(np.round(velocity, 6)),
        **dict.fromkeys(_UNKNOWN),
    }


#: Topic of the absolute profiles.
INVERTED = "/adcp/inverted"
_METRES = {"m": 1.0, "meter": 1.0, "meters": 1.0, "cm": 0.01, "mm": 0.001}
_ENU = 0.0  # of ad2cp_coordinateSystem; 1 along the instrument's axes, 2 along its beams
_FASTEST_SOUND = 2000.0  # m/s; more than this is stated in tenths


def seaglider_pings(file: NetcdfFile, notes: list[str]) -> Iterator[Entry]:
    """Yield velocities relative to the glider, and absolute profiles of descent and ascent.

    A profile's time is the end of its half dive: the deepest point for the descent; the last sample or, if earlier, the end fix for the
    ascent. The inversion uses the dive's pings and DAC: ``also_in`` of the pings, ``inverted_in`` of the DAC and ``computed_from`` of the
    profiles refer to each other.

    Raises:
        LogError: The unit of a variable is unknown.
    """
    inverted = list(_inverted(file))
    for entry in _relative(file, notes):
        if inverted:
            entry[3]["also_in"] = INVERTED
        yield entry
    yield from inverted


def _relative(file: NetcdfFile, notes: list[str]) -> Iterator[Entry]:
    if not file.has(
        "ad2cp_time", "ad2cp_velX", "ad2cp_velY", "ad2cp_velZ", "ad2cp_cellSize", "ad2cp_blanking"
    ):
        return
    if file.has("ad2cp_coordinateSystem") and file.scalar("ad2cp_coordinateSystem") != _ENU:
        notes.append(
            "ADCP: not read, because its velocities are not east, north and up (ad2cp_coordinateSystem)"
        )
        return
    time_ns, known = units.time_ns("ad2cp_time", file.variables["ad2cp_time"], file.path, notes)
    velocity = np.stack([file.array(f"ad2cp_vel{axis}") for axis in "XYZ"], axis=-1)
    cell_size = _metres(file, "ad2cp_cellSize")
    bin0_distance = _metres(file, "ad2cp_blanking") + cell_size
    sound = file.scalar("ad2cp_soundspeed")
    tenths = 0.1 if sound > _FASTEST_SOUND else 1.0
    if tenths != 1.0:
        notes.append("ad2cp_soundspeed, ad2cp_temperature: in tenths of their units, converted")
    declination = number(file.scalar("magnetic_variation"))
    notes.append(
        f"ADCP: headings are magnetic; the declination used is {declination} degrees, by magnetic_variation"
    )
    names = ("pressure", "heading", "pitch", "roll", "temperature")
    sensors = {
        name: file.array(f"ad2cp_{name}")
        if file.has(f"ad2cp_{name}")
        else np.full(time_ns.size, np.nan)
        for name in names
    }
    sensors["temperature"] = sensors["temperature"] * tenths
    distance = bin0_distance + cell_size * np.arange(velocity.shape[1], dtype=np.float64)
    looks = orientation(velocity[..., :2], sensors["pressure"], distance, notes)
    dive = file.dive_number or 0
    for k in np.flatnonzero(known).tolist():
        payload = earth_ping(int(time_ns[k]), k, dive, velocity[k], (cell_size, bin0_distance))
        payload |= {
            "reference": "platform",
            "orientation": looks,
            "bin_mapped": False,
            "sound_speed": number(round(sound * tenths, 3)),
            "magnetic_declination": declination,
            "declination_applied": False,
            **{name: number(round(float(values[k]), 4)) for name, values in sensors.items()},
        }
        yield int(time_ns[k]), "/adcp", PING, payload


def _inverted(file: NetcdfFile) -> Iterator[Entry]:
    names = [f"ad2cp_inv_profile_{name}" for name in ("depth", "uocn", "vocn", "wocn")]
    if not file.has(*names, "ctd_time", "ctd_depth"):
        return
    levels, *components = (file.array(name) for name in names)
    steps = np.diff(levels)
    if steps.size == 0 or not np.allclose(steps, steps[0]) or steps[0] <= 0.0:
        return
    dive = file.dive_number or 0
    for leg, end_ns in enumerate(_leg_ends(file)):
        velocity = np.stack([component[:, leg] for component in components], axis=-1)
        payload = earth_ping(
            end_ns, 2 * dive + leg, dive, velocity, (float(steps[0]), float(levels[0]))
        )
        payload |= FROM_SURFACE | {"computed_from": ["/adcp", "/dac"]}
        yield end_ns, INVERTED, PING, payload


def _leg_ends(file: NetcdfFile) -> tuple[int, ...]:
    """Return the end times [ns] of descent and ascent; empty if the dive has no depths."""
    time_ns, known = units.time_ns("ctd_time", file.variables["ctd_time"], file.path, [])
    depth = np.where(known, file.array("ctd_depth"), np.nan)
    if not np.isfinite(depth).any():
        return ()
    fixes, fix_known = units.time_ns("log_gps_time", file.variables["log_gps_time"], file.path, [])
    last, deepest = int(time_ns[np.isfinite(depth)].max()), int(time_ns[np.nanargmax(depth)])
    return deepest, min([last, *(fix for fix in fixes[fix_known].tolist() if fix > deepest)])


def _metres(file: NetcdfFile, name: str) -> float:
    """Return a length [m] converted from the stated unit.

    Raises:
        LogError: The unit is no length.
    """
    unit = file.variables[name].units
    if unit not in _METRES:
        raise LogError(
            f"{file.path}: {name}: expected units of {', '.join(_METRES)}, got '{unit}'; process the dive again"
        )
    return file.scalar(name) * _METRES[unit]


# cells between two whose difference is a shear; nearer ones differ by noise alone
_APART = 5
_BIN = 5.0  # m of depth in which shears are compared
_LEAST = 3  # shears in a bin
# Parts of a dive, one at a time left out, for the standard error of the logarithm of the ratio of variances; it must be this many times as
# large. Five dives of a glider whose ADCP looks up have ratios of 1.03 to 1.31, which are .7 to 1.2 standard errors: no evidence.
_PARTS, _ERRORS = 10, 2.0


def agreement(velocity: Array, depth: Array, distance: Array) -> float:
    """Return the ratio of shear variances for a downward and an upward instrument; above 1 for upward.

    The instrument's motion is equal in all cells of a ping and cancels in the shear.

    Args:
        velocity: shape (n, k, 2), east and north [m/s]; NaN where missing.
        depth: shape (n,) [m], depth of the instrument.
        distance: shape (k,) [m], distance of the cells.

    Returns:
        The ratio; NaN if too few pings overlap.
    """
    shear = velocity[:, _APART:] - velocity[:, :-_APART]
    middle = 0.5 * (distance[_APART:] + distance[:-_APART])
    up, down = (_variance_within(shear, depth[:, None] + sign * middle) for sign in (-1.0, 1.0))
    return down / up if up > 0.0 else float("nan")


def orientation(velocity: Array, depth: Array, distance: Array, notes: list[str]) -> str:
    """Return ``up`` or ``down`` by the agreement of the shears; ``up`` if undecided.

    Args:
        velocity: As in ``agreement``, as the next two.
        depth: Depth of the instrument.
        distance: Distance of the cells.
        notes: Receives a note on the result.
    """
    ratio = agreement(velocity, depth, distance)
    part = np.arange(len(depth)) * _PARTS // max(len(depth), 1)
    without = np.log(
        [agreement(velocity[part != k], depth[part != k], distance) for k in range(_PARTS)]
    )
    error = np.sqrt((_PARTS - 1) * np.var(without))  # of the jackknife
    # False too where any of them is not known
    decided = abs(np.log(ratio)) > _ERRORS * error
    found = "down" if decided and ratio < 1.0 else "up"
    notes.append(
        f"ADCP: looks {found} by its shears: variance {max(ratio, 1.0 / ratio):.2f} times smaller than for the opposite"
        if decided
        else "ADCP: assumed to look up; neither the file nor its shears show its orientation"
    )
    return found


def _variance_within(shear: Array, depth: Array) -> float:
    """Return the variance of shears about the means of their depth bins; NaN if no bin has enough."""
    known = np.isfinite(shear).all(axis=-1) & np.isfinite(depth) & (depth > 0.0)
    values, at = shear[known], (depth[known] // _BIN).astype(np.int64)
    count = np.bincount(at)
    full = count >= _LEAST
    if not full.any():
        return float("nan")
    sums = np.array([np.bincount(at, component)[full] for component in values.T])
    squares = np.bincount(at, (values**2).sum(axis=-1))[full] - (sums**2).sum(axis=0) / count[full]
    return float(squares.sum() / (count[full] - 1).sum())


_FORE, _SIDE = np.deg2rad(47.5), np.deg2rad(25.0)
_BEAMS = np.array(
    [
        [np.sin(_FORE), 0.0, np.cos(_FORE)],
        [0.0, -np.sin(_SIDE), np.cos(_SIDE)],
        [-np.sin(_FORE), 0.0, np.cos(_FORE)],
        [0.0, np.sin(_SIDE), np.cos(_SIDE)],
    ]
)


# what MIDAS writes beside the beams: sensors, a row a ping, then others
_FLAT = ("heading", "pitch", "roll", "pressure", "speedofsound", "accelerometerz", "velocityrange")


def midas_pings(file: NetcdfFile, notes: list[str]) -> Iterator[Entry]:
    """Yield the pings of an AD2CP exported by MIDAS, in beam coordinates relative to the glider.

    Raises:
        LogError: The unit of the times is unknown, or the beams have different cells.
    """
    held = {name.lower().replace(" ", ""): name for name in file.variables}
    if "time" not in held:
        raise LogError(
            f"{file.path}: expected a variable time in the group Data/Average, it holds a dimension alone; export the file again"
        )
    time_ns, known = units.time_ns("time", file.variables[held["time"]], file.path, notes)
    beams = [k for k in range(1, 5) if f"velocitybeam{k}" in held]
    velocity = _by_ping(file, [held[f"velocitybeam{k}"] for k in beams], time_ns.size)
    quality = {
        word: _by_ping(file, [held[f"{word}beam{k}"] for k in beams], time_ns.size)
        for word in ("amplitude", "correlation")
        if all(f"{word}beam{k}" in held for k in beams)
    }
    flat = {name: file.array(own).ravel() for name, own in held.items() if name in _FLAT}
    sensors = {
        "sound_speed" if name == "speedofsound" else name: values
        for name, values in flat.items()
        if name in _FLAT[:5] and values.size == time_ns.size
    }
    up = flat.get("accelerometerz", np.empty(0))
    up = up[np.isfinite(up)]
    orientation = "down" if up.size and np.median(up) < 0.0 else "up"
    notes.append(
        f"ADCP: looks {orientation} by its accelerometer" if up.size else "ADCP: assumed to look up"
    )
    notes.append(
        "ADCP: beams assumed to be those of Nortek's glider head (47.5 degrees fore and aft, 25 degrees abeam)"
    )
    notes.append("ADCP: headings are magnetic; set measurements.magnetic_declination")
    distance = flat.get("velocityrange", np.empty(0))
    if distance.size != velocity.shape[1]:
        distance = _distances(file, velocity.shape[1])
    size = float(np.median(np.diff(distance))) if distance.size > 1 else None
    for k in np.flatnonzero(known).tolist():
        payload = earth_ping(int(time_ns[k]), k, None, velocity[k], (size, float(distance[0])))
        payload |= {
            "coordinate_system": "beam",
            "reference": "platform",
            "orientation": orientation,
            "bin_mapped": False,
            "attitude_convention": "nortek",
            "beam_unit_vectors": _BEAMS[[beam - 1 for beam in beams]].tolist(),
            **{word: numbers(values[k]) for word, values in quality.items()},
            "declination_applied": False,
            **{name: number(float(values[k])) for name, values in sensors.items()},
        }
        yield int(time_ns[k]), "/adcp", PING, payload


def _by_ping(file: NetcdfFile, names: list[str], n: int) -> Array:
    """Return values by ping, cell and beam, for either order of a beam's dimensions.

    Raises:
        LogError: A beam has other cells than the first, or not one row per time.
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
    """Return the distances of the cells [m] from the instrument's configuration."""
    size, blanking = (
        float(file.attributes.get(name, 1.0)) for name in ("avg_cellSize", "avg_blankingDistance")
    )
    return np.asarray(blanking + size * np.arange(1, n + 1), np.float64)


def seaexplorer_pings(file: NetcdfFile, notes: list[str]) -> Iterator[Entry]:
    """Yield nothing and add a note: in real time a SeaExplorer sends one cell of its AD2CP."""
    if any(name.lower().startswith("ad2cp_v") for name in file.variables):
        notes.append(
            "AD2CP in real time: one cell, relative to the glider, without information on the current; add the MIDAS export"
        )
    return iter(())
