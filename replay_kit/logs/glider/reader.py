"""A Seaglider's dive (basestation NetCDF) as messages of the kinds that other logs hold."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from replay_kit.config.run import LogConfig
from replay_kit.core.arrays import Array
from replay_kit.core.message import Message
from replay_kit.logs.glider.dive_file import DiveFile, open_dive
from replay_kit.logs.reader import Entry, LogFile
from replay_kit.logs.shared.payloads import FIX, PING, location_fix, number, stamp
from replay_kit.logs.shared.statistics import ReadStatistics

_NS = 1_000_000_000
_DECIMATED_NS = 60 * _NS
_BAD_QUALITY = (3, 4, 6, 9)  # probably bad, bad, unsampled, missing
_DAC = "replay_kit.DepthAveragedCurrent"
_INVERTED = "/adcp/inverted"


class SeagliderReader(LogFile):
    """A dive, read whole: a file is one dive of a few hours, by one clock."""

    format = "seaglider"

    def __init__(self, path: Path, input: int = 0, config: LogConfig | None = None, wanted: frozenset[str] | None = None) -> None:
        """Read the file; arguments as of ``LogFile``.

        Raises:
            LogError: The file cannot be read as NetCDF, or is no Seaglider's.
        """
        super().__init__(path, input, config, wanted)
        self._dive = open_dive(path)

    def messages(self) -> Iterator[Message]:
        """Yield the dive's messages in order of time.

        ``/vehicle/fix``: GPS. ``/vehicle/position``: dead-reckoned with the depth, once a minute. ``/adcp``: velocity relative
        to the glider. ``/adcp/inverted``: absolute profiles of the two legs. ``/dac``: the mean current, at the end fix.

        A profile's time is the end of its leg, where the position is known: the deepest point for the descent, the last
        sample or the end fix, whichever is earlier, for the ascent. The inversion itself needs the fix after the dive.
        Because it takes the dive's pings and mean current, ``also_in`` of these and ``computed_from`` of the profiles name each other.

        Raises:
            LogError: A variable has a unit that is not understood.
        """
        self.statistics = ReadStatistics()
        file = self._dive
        inverted = list(_inverted(file))
        sources = [*self._mean_current(file), *_pings(file)]
        for _, _, _, payload in sources if inverted else ():
            payload["also_in"] = _INVERTED
        # at one time a position comes before the velocities measured there
        yield from self._by_time([*self._fixes(file), *_positions(file), *sources, *inverted])

    def _fixes(self, file: DiveFile) -> Iterator[Entry]:
        time_ns, known = file.time_ns("log_gps_time")
        longitude, latitude = file.array("log_gps_lon"), file.array("log_gps_lat")
        error = file.array("log_gps_hpe") if file.has("log_gps_hpe") else np.full(time_ns.size, np.nan)
        for k, quality in enumerate(file.quality("log_gps_qc", time_ns.size)[: time_ns.size]):
            if not known[k] or not np.isfinite(longitude[k] + latitude[k]) or quality in _BAD_QUALITY:
                self._skip("/vehicle/fix", f"GPS fix without time or position, or flagged bad (quality {quality})")
                continue
            fix = location_fix(int(time_ns[k]), longitude[k], latitude[k], 0.0, False, error[k])
            yield int(time_ns[k]), "/vehicle/fix", FIX, fix

    def _mean_current(self, file: DiveFile) -> Iterator[Entry]:
        if not file.has("depth_avg_curr_east", "depth_avg_curr_north"):
            return
        time_ns, known = file.time_ns("log_gps_time")
        (quality,) = file.quality("depth_avg_curr_qc", 1)[:1]
        if time_ns.size < 3 or not known[1:3].all() or quality in _BAD_QUALITY:
            self._skip("/dac", f"mean current without its fixes, or flagged bad (quality {quality})")
            return
        longitude, latitude = file.array("log_gps_lon"), file.array("log_gps_lat")
        start, end = ({"time": stamp(int(time_ns[k])), "lon": float(longitude[k]), "lat": float(latitude[k])} for k in (1, 2))
        payload = {
            "stamp": stamp(int(time_ns[2])),
            "dive": file.dive,
            "dac_eastward": number(file.scalar("depth_avg_curr_east")),
            "dac_northward": number(file.scalar("depth_avg_curr_north")),
            "error": number(file.scalar("depth_avg_curr_error")),
            "start_fix": start,
            "end_fix": end,
            "duration": int(time_ns[2] - time_ns[1]) / _NS,
            "dac_kind": "hydrodynamic_model",
        }
        yield int(time_ns[2]), "/dac", _DAC, payload


def _positions(file: DiveFile) -> Iterator[Entry]:
    """Yield the dead-reckoned track, one position a minute; the first and the deepest sample are treated like the others."""
    if not file.has("ctd_time", "ctd_depth", "latitude", "longitude"):
        return
    time_ns, known = file.time_ns("ctd_time")
    longitude, latitude, depth = file.array("longitude"), file.array("latitude"), file.array("ctd_depth")
    usable = known & np.isfinite(longitude + latitude + depth)
    due = -_DECIMATED_NS
    for k in np.flatnonzero(usable).tolist():
        time = int(time_ns[k])
        if time >= due:
            due = time + _DECIMATED_NS
            yield time, "/vehicle/position", FIX, location_fix(time, longitude[k], latitude[k], depth[k], True, math.nan)


def _pings(file: DiveFile) -> Iterator[Entry]:
    """Yield the velocities relative to the glider."""
    if not file.has("ad2cp_time", "ad2cp_velX", "ad2cp_velY", "ad2cp_velZ", "ad2cp_cellSize", "ad2cp_blanking"):
        return
    time_ns, known = file.time_ns("ad2cp_time")
    velocity = np.stack([file.array(f"ad2cp_vel{axis}") for axis in "XYZ"], axis=-1)
    cell_size = file.metres("ad2cp_cellSize")
    bin0_distance = file.metres("ad2cp_blanking") + cell_size
    names = ("pressure", "heading", "pitch", "roll", "temperature")
    sensors = {name: file.array(f"ad2cp_{name}") if file.has(f"ad2cp_{name}") else np.full(time_ns.size, np.nan) for name in names}
    sensors["temperature"] = sensors["temperature"] * file.tenths()
    for k in np.flatnonzero(known).tolist():
        payload = _ping(file, int(time_ns[k]), k, velocity[k], cell_size, bin0_distance)
        payload |= {
            "reference": "platform",
            "orientation": "up",
            "bin_mapped": False,
            "sound_speed": number(round(file.scalar("ad2cp_soundspeed") * file.tenths(), 3)),
            "magnetic_declination": number(file.scalar("magnetic_variation")),
            "declination_applied": False,
            **{name: number(round(float(values[k]), 4)) for name, values in sensors.items()},
        }
        yield int(time_ns[k]), "/adcp", PING, payload


def _inverted(file: DiveFile) -> Iterator[Entry]:
    """Yield the absolute profiles of the descent and the ascent."""
    names = [f"ad2cp_inv_profile_{name}" for name in ("depth", "uocn", "vocn", "wocn")]
    if not file.has(*names, "ctd_time", "ctd_depth"):
        return
    levels, *components = (file.array(name) for name in names)
    steps = np.diff(levels)
    if steps.size == 0 or not np.allclose(steps, steps[0]) or steps[0] <= 0.0:
        return
    for leg, end_ns in enumerate(_leg_ends(file)):
        velocity = np.stack([component[:, leg] for component in components], axis=-1)
        payload = _ping(file, end_ns, 2 * file.dive + leg, velocity, float(steps[0]), float(levels[0]))
        # the levels are depths: the profile begins at the surface, not at the glider
        payload |= {
            "reference": "earth",
            "orientation": "down",
            "bin_mapped": True,
            "pressure": 0.0,
            "declination_applied": True,
            "derived": True,
            "computed_from": ["/adcp", "/dac"],
        }
        yield end_ns, _INVERTED, PING, payload


def _leg_ends(file: DiveFile) -> tuple[int, ...]:
    """Return the times [ns] at which the descent and the ascent end; nothing when the dive has no depths."""
    time_ns, known = file.time_ns("ctd_time")
    depth = np.where(known, file.array("ctd_depth"), np.nan)
    if not np.isfinite(depth).any():
        return ()
    fixes, fix_known = file.time_ns("log_gps_time")
    last = int(time_ns[np.isfinite(depth)].max())
    after = [int(fix) for fix in fixes[fix_known] if fix > time_ns[np.nanargmax(depth)]]
    return int(time_ns[np.nanargmax(depth)]), min([last, *after])


def _ping(file: DiveFile, time_ns: int, ordinal: int, velocity: Array, cell_size: float, bin0_distance: float) -> dict[str, Any]:
    """Return a ping in earth coordinates; unknown fields are null.

    Args:
        file: The dive.
        time_ns: [ns, UTC].
        ordinal: Of the ping.
        velocity: shape (n_cells, 3) [m/s], east, north, up; NaN where missing.
        cell_size: [m].
        bin0_distance: [m].
    """
    unknown = ("beam_unit_vectors", "velocity_std", "amplitude", "correlation", "percent_good", "sound_speed", "temperature")
    attitude = ("heading", "pitch", "roll", "magnetic_declination", "bottom_track")
    return {
        "stamp": stamp(time_ns),
        "frame_id": "adcp",
        "ping": ordinal,
        "dive": file.dive,
        "coordinate_system": "earth",
        "n_cells": len(velocity),
        "cell_size": cell_size,
        "bin0_distance": bin0_distance,
        "transducer_depth": 0.0,
        "velocity": [[number(component) for component in cell] for cell in np.round(velocity, 6).tolist()],
        **dict.fromkeys((*unknown, *attitude)),
    }
