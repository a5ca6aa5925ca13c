"""Glider ADCPs as ``replay_kit.AdcpPing``: Seaglider, Nortek AD2CP exported by MIDAS, SeaExplorer in real time, absolute profiles."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array, Times
from replay_kit.core.errors import LogError
from replay_kit.core.words.quantities import metres
from replay_kit.logs.netcdf import units
from replay_kit.logs.netcdf.columns import Columns, Table
from replay_kit.logs.netcdf.currents import DiveMean
from replay_kit.logs.netcdf.variables import NetcdfFile
from replay_kit.logs.payloads import PING, Entry, entries, number

#: Topics of profiles that were computed from a dive's own pings, and of those of a whole mission.
INVERTED, PROFILES = "/adcp/inverted", "/adcp/absolute"
# of a profile that was computed from others and begins at the surface, not at the glider: its levels are depths
_FROM_SURFACE = {
    "reference": "earth",
    "orientation": "down",
    "bin_mapped": True,
    "pressure": 0.0,
    "declination_applied": True,
    "derived": True,
}
_RELATIVE = {"reference": "platform", "bin_mapped": False, "declination_applied": False}


def _pings(
    topic: str, columns: Table, cells: tuple[float | None, float], common: Mapping[str, Any]
) -> Iterator[Entry]:
    """Yield the pings of a topic in earth coordinates if nothing else is stated.

    Args:
        topic: Their topic.
        columns: Fields of each ping, shape (n, ...): ``time`` [ns, UTC], 0 for pings that are excluded, and ``velocity``, shape
            (n, n_cells, k) [m/s]: east, north, perhaps up.
        cells: Cell size, None if unknown, and distance of the first cell's centre [m].
        common: Fields of all pings.
    """
    time_ns, velocity = columns["time"], columns["velocity"]
    fields = {
        "frame_id": "adcp",
        "coordinate_system": "earth",
        "n_cells": velocity.shape[1],
        "cell_size": cells[0],
        "bin0_distance": cells[1],
        "transducer_depth": 0.0,
        **common,
    }
    held = {"ping": np.arange(time_ns.size), **columns, "velocity": np.round(velocity, 6)}
    return entries((topic, PING), time_ns, held, np.flatnonzero(time_ns), fields)


def _profiles(
    topic: str, depth: Array, components: Sequence[Array], columns: Table, common: dict[str, Any]
) -> Iterator[Entry]:
    """Yield absolute profiles as pings from the surface.

    Args:
        topic: Their topic.
        depth: Depths of the levels [m], even or not, shape (k,).
        components: Velocities towards east, north and perhaps up [m/s], shape (n, k).
        columns: Other fields of each profile, as of ``_pings``.
        common: Fields of all profiles.
    """
    steps = np.diff(depth)
    even = bool(steps.size and np.allclose(steps, steps[0]) and steps[0] > 0.0)
    uneven = {} if even else {"cell_distances": depth.tolist()}
    held = {"velocity": np.stack(components, axis=-1), **columns}
    cells = float(steps[0]) if even else 1.0, float(depth[0])
    return _pings(topic, held, cells, _FROM_SURFACE | common | uneven)


# What Seaglider files do not state, and the evidence: these velocities are not along the instrument's axes. The basestation takes them as
# east, north and up, and on real dives velZ equals the vertical speed from pressure at pitches of 35 degrees. East and north are magnetic:
# they deviate from the track by the declination, which is thus not applied. The first cell's centre is one blanking and one cell from the
# instrument, which looks up or down (``orientation``). Sound speed and temperature are in tenths, whatever their units attribute states.
_VELOCITY = ("ad2cp_velX", "ad2cp_velY", "ad2cp_velZ")
_ENU = 0.0  # of ad2cp_coordinateSystem; 1 along the instrument's axes, 2 along its beams
_FASTEST_SOUND = 2000.0  # m/s; more than this is stated in tenths


def seaglider_pings(file: NetcdfFile) -> Iterator[Entry]:
    """Yield velocities relative to the glider, and absolute profiles of descent and ascent.

    A profile's time is the end of its half dive: the deepest point for the descent; the last sample or, if earlier, the end fix for the
    ascent. The inversion uses the dive's pings and DAC: ``also_in`` of the pings, ``inverted_in`` of the DAC and ``computed_from`` of the
    profiles refer to each other.

    Raises:
        LogError: The unit of a variable is unknown.
    """
    inverted = list(_inverted(file))
    yield from _relative(file, {"also_in": INVERTED} if inverted else {})
    yield from inverted


def _relative(file: NetcdfFile, common: dict[str, Any]) -> Iterator[Entry]:
    if not file.has("ad2cp_time", *_VELOCITY, "ad2cp_cellSize", "ad2cp_blanking"):
        return
    if file.has("ad2cp_coordinateSystem") and file.scalar("ad2cp_coordinateSystem") != _ENU:
        file.note(
            "ADCP: not read, because its velocities are not east, north and up (ad2cp_coordinateSystem)"
        )
        return
    time_ns = units.times_of(file, "ad2cp_time")
    velocity = np.stack([file.array(name) for name in _VELOCITY], axis=-1)
    cell_size = _metres(file, "ad2cp_cellSize")
    bin0_distance = _metres(file, "ad2cp_blanking") + cell_size
    sound = file.scalar("ad2cp_soundspeed")
    tenths = 0.1 if sound > _FASTEST_SOUND else 1.0
    if tenths != 1.0:
        file.note("ad2cp_soundspeed, ad2cp_temperature: in tenths of their units, converted")
    declination = number(file.scalar("magnetic_variation"))
    file.note(
        f"ADCP: headings are magnetic; the declination used is {declination} degrees, by magnetic_variation"
    )
    sensors: Table = {"time": time_ns, "velocity": velocity}
    for name in ("pressure", "heading", "pitch", "roll", "temperature"):
        held = f"ad2cp_{name}"
        values = file.array(held) if file.has(held) else np.full(time_ns.size, np.nan)
        sensors[name] = np.round(values * (tenths if name == "temperature" else 1.0), 4)
    distance = bin0_distance + cell_size * np.arange(velocity.shape[1], dtype=np.float64)
    common |= _RELATIVE | {
        "dive": file.dive_number or 0,
        "orientation": orientation(
            velocity[..., :2], sensors["pressure"], distance, file.told.notes
        ),
        "sound_speed": number(round(sound * tenths, 3)),
        "magnetic_declination": declination,
    }
    yield from _pings("/adcp", sensors, (cell_size, bin0_distance), common)


def _inverted(file: NetcdfFile) -> Iterator[Entry]:
    names = [f"ad2cp_inv_profile_{name}" for name in ("depth", "uocn", "vocn", "wocn")]
    if not file.has(*names, "ctd_time", "ctd_depth"):
        return iter(())
    depth, *components = (file.array(name) for name in names)
    ends = _leg_ends(file)
    dive, n = file.dive_number or 0, ends.size
    columns = {"time": ends, "ping": 2 * dive + np.arange(n)}
    common = {"dive": dive, "computed_from": ["/adcp", "/dac"]}
    return _profiles(INVERTED, depth, [each.T[:n] for each in components], columns, common)


def _leg_ends(file: NetcdfFile) -> Times:
    """Return the end times [ns] of descent and ascent; empty if the dive has no depths."""
    time_ns, fixes = (units.times_of(file, name) for name in ("ctd_time", "log_gps_time"))
    depth = np.where(time_ns > 0, file.array("ctd_depth"), np.nan)
    if not np.isfinite(depth).any():
        return np.empty(0, np.int64)
    last, deepest = time_ns[np.isfinite(depth)].max(), time_ns[np.nanargmax(depth)]
    return np.array([deepest, np.append(fixes[fixes > deepest], last).min()])


def _metres(file: NetcdfFile, name: str) -> float:
    """Return a length [m] converted from the stated unit.

    Raises:
        LogError: The unit is no length.
    """
    unit = file.variables[name].units
    factor = metres(unit)
    if factor is None:
        raise LogError(
            f"{file.path}: {name}: expected units of m, cm, mm, got '{unit}'; process the dive again"
        )
    return file.scalar(name) * factor


def absolute_profiles(
    columns: Columns, means: Sequence[DiveMean], notes: list[str]
) -> Iterator[Entry]:
    """Yield the absolute profiles of a mission as pings at the stated middle of their dives.

    They are referenced to the DACs: ``computed_from`` and ``also_in`` of the DACs prevent double counting.
    """
    profile, samples = columns.profile, columns.samples
    if not profile:
        return
    notes.append(
        "absolute profiles: taken as east and north relative to the earth, each at the middle of its dive"
    )
    components, middle = (profile["east"], profile["north"]), samples["dac_time"]
    placed = np.isin(middle, [mean.middle.time_ns for mean in means if mean.middle])
    has = np.isfinite(components).all(axis=0).any(axis=-1)
    time_ns = np.where(has, np.where(placed, middle, samples["time"]), 0)
    times = {"time": time_ns, "dive": samples["dive"].astype(np.int64)}
    common = {"computed_from": ["/dac"]}
    yield from _profiles(PROFILES, profile["depth"], components, times, common)


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


# what MIDAS writes beside the beams, and the names of these fields
_SENSORS = {name: name for name in ("heading", "pitch", "roll", "pressure")} | {
    "sound_speed": "speedofsound",
    "up": "accelerometerz",
    "distance": "velocityrange",
}
_NORTEK_HEAD = (
    "beams assumed to be those of Nortek's glider head (47.5 degrees fore and aft, 25 abeam)"
)


def midas_pings(file: NetcdfFile) -> Iterator[Entry]:
    """Yield the pings of an AD2CP exported by MIDAS, in beam coordinates relative to the glider.

    Raises:
        LogError: The unit of the times is unknown, or the beams have different cells.
    """
    held = {name.lower().replace(" ", ""): name for name in file.variables}
    if "time" not in held:
        raise LogError(
            f"{file.path}: expected a variable time in the group Data/Average, it holds a dimension alone; export the file again"
        )
    time_ns = units.times_of(file, held["time"])
    beams = [k for k in range(1, 5) if f"velocitybeam{k}" in held]
    columns: Table = {
        word: _by_ping(file, [held[f"{word}beam{k}"] for k in beams], time_ns.size)
        for word in ("velocity", "amplitude", "correlation")
        if all(f"{word}beam{k}" in held for k in beams)
    }
    flat = {name: file.flat(held.get(sensor, "")) for name, sensor in _SENSORS.items()}
    up, distance = flat.pop("up"), flat.pop("distance")
    columns |= {name: values for name, values in flat.items() if values.size == time_ns.size}
    columns |= {"time": time_ns}
    up = up[np.isfinite(up)]
    looks = "down" if up.size and np.median(up) < 0.0 else "up"
    file.told.notes += [
        f"ADCP: looks {looks} by its accelerometer" if up.size else "ADCP: assumed to look up",
        f"ADCP: {_NORTEK_HEAD}",
        "ADCP: headings are magnetic; set measurements.magnetic_declination",
    ]
    n_cells = columns["velocity"].shape[1]
    if distance.size != n_cells:
        raise LogError(
            f"{file.path}: Velocity Range: expected {n_cells} distances, as velocities have cells, got {distance.size}; export it again"
        )
    cell_size = float(np.median(np.diff(distance))) if n_cells > 1 else None
    common = _RELATIVE | {
        "coordinate_system": "beam",
        "orientation": looks,
        "attitude_convention": "nortek",
        "beam_unit_vectors": _BEAMS[[beam - 1 for beam in beams]].tolist(),
    }
    yield from _pings("/adcp", columns, (cell_size, float(distance[0])), common)


def _by_ping(file: NetcdfFile, names: list[str], n: int) -> Array:
    """Return values by ping, cell and beam, for either order of a beam's dimensions.

    Raises:
        LogError: A beam has other cells than the first, or not one row per time.
    """
    beams = [file.array(name) for name in names]
    by_ping = [beam if beam.shape[:1] == (n,) else beam.T for beam in beams]
    shapes = {beam.shape for beam in by_ping}
    if len(shapes) != 1 or by_ping[0].ndim != 2 or len(by_ping[0]) != n:
        found = ", ".join(f"{name} {beam.shape}" for name, beam in zip(names, beams, strict=True))
        raise LogError(
            f"{file.path}: expected beams with the same cells at each of {n} times, got {found}; export the file again"
        )
    return np.asarray(np.stack(by_ping, axis=-1))


# Beams of Nortek's glider head: 1 fore and 3 aft at 47.5 degrees from its axis, 2 and 4 abeam at 25 degrees (bastienqueste/gliderad2cp,
# ``process_shear.py``). Ranges are distances along the axis; velocities are positive away from the instrument.
_FORE, _SIDE = np.deg2rad(47.5), np.deg2rad(25.0)
_BEAMS = np.array(
    [
        [np.sin(_FORE), 0.0, np.cos(_FORE)],
        [0.0, -np.sin(_SIDE), np.cos(_SIDE)],
        [-np.sin(_FORE), 0.0, np.cos(_FORE)],
        [0.0, np.sin(_SIDE), np.cos(_SIDE)],
    ]
)


def seaexplorer_pings(file: NetcdfFile) -> Iterator[Entry]:
    """Yield nothing and add a note: in real time a SeaExplorer sends one cell of its AD2CP."""
    if any(name.lower().startswith("ad2cp_v") for name in file.variables):
        file.note(
            "AD2CP in real time: one cell, relative to the glider, no current; add the MIDAS export"
        )
    return iter(())
