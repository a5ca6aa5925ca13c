"""What is measured of the water besides profiles: mean currents, temperature and salinity, and currents at the surface."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.observation import Flag
from replay_kit.core.table import Raw, Table
from replay_kit.logs.tables.cells import STD_BELIEVED
from replay_kit.logs.tables.columns import (
    Payload,
    dive_number,
    field,
    number,
    numbers,
    table,
)

_NS = 1_000_000_000
#: Time of a fix that is not stated.
NO_TIME = -(2**63)
_CTD = ("depth", "temperature", "salinity", "conductivity", "pressure")
_NO_FIX = (NO_TIME, (math.nan, math.nan))


def ctd(raw: Raw, config: MeasurementConfig) -> list[Table]:
    """Return the samples of ``replay_kit.Ctd`` messages."""
    del config
    columns = {name: numbers(field(raw.payloads, name)) for name in _CTD}
    return [table(raw, "ctd", slice(None), columns)]


def depth_averaged_current(payload: Payload) -> tuple[Any, ...] | str:
    """Return the mean current of a ``replay_kit.DepthAveragedCurrent``, or why there is none."""
    velocity = number(payload.get("dac_eastward")), number(payload.get("dac_northward"))
    if not math.isfinite(sum(velocity)):
        return "depth-averaged current: not a number"
    std = number(payload.get("error"))
    start, end = (_fix(payload.get(name)) for name in ("start_fix", "end_fix"))
    believed = std if STD_BELIEVED[0] <= std <= STD_BELIEVED[1] else math.nan
    dive, inverted = dive_number(payload.get("dive")), bool(payload.get("inverted_in"))
    return velocity, believed, *start, *end, dive, number(payload.get("max_depth")), inverted


def _fix(stated: Any) -> tuple[int, tuple[float, float]]:
    """Return time [ns, UTC] and place of a fix of a payload; one that it does not hold whole is not stated."""
    if not isinstance(stated, Mapping) or not isinstance(stated.get("time"), Mapping):
        return _NO_FIX
    seconds, rest = (number(stated["time"].get(name)) for name in ("sec", "nsec"))
    longitude, latitude = number(stated.get("lon")), number(stated.get("lat"))
    in_time = 0.0 <= seconds < 2**33 and 0.0 <= rest < 2 * _NS
    if not (in_time and math.isfinite(longitude) and abs(latitude) <= 90.0):
        return _NO_FIX
    return int(seconds) * _NS + int(rest), (longitude, latitude)


def drifter_fix(payload: Payload) -> tuple[Any, ...] | str:
    """Return the fix in a ``replay_kit.DrifterFix``, or why there is none."""
    longitude, latitude, depth, error = (
        number(payload.get(name)) for name in ("longitude", "latitude", "depth", "error")
    )
    if payload.get("drogued") is not True:
        return "drifter without its drogue: the wind moves it"
    if not (math.isfinite(longitude) and abs(latitude) <= 90.0 and depth >= 0.0):
        return "drifter: no position, or no depth of its drogue"
    return str(payload.get("id")), longitude, latitude, depth, error


def radar_currents(payload: Payload) -> tuple[Any, ...] | str:
    """Return the vectors or radials in a ``replay_kit.RadarCurrents`` that are whole, or why there is none.

    Arrays of v vectors: longitude, latitude, value (v, 2), or (v, 1) along direction, error, direction (None for vectors), suspect; then
    depth [m], time of averaging [s], length over which errors are correlated [m] (0 where not stated), radar or sensors.
    """
    radials = "speed" in payload
    names = ("speed", "direction") if radials else ("east", "north", "east_error", "north_error")
    columns = [
        np.array(payload[name], np.float64)
        for name in ("longitude", "latitude", *names, *(("error",) if radials else ()))
    ]
    flags = np.array(payload.get("flag", np.ones_like(columns[0])), np.float64)
    if len({each.shape for each in (*columns, flags)}) != 1 or columns[0].ndim != 1:
        return "radar currents: columns of unlike lengths"
    known = np.isfinite(columns).all(axis=0) & (np.abs(columns[1]) <= 90.0)
    known &= (flags != Flag.FAIL) & (flags != Flag.MISSING)
    if not known.any():
        return "radar currents: no vector that is whole"
    longitude, latitude, first, second, *errors = (each[known] for each in columns)
    depth, averaged = number(payload.get("depth")), number(payload.get("averaged"))
    length = number(payload.get("error_length"))
    if not (depth >= 0.0 and averaged > 0.0):
        return "radar currents: depth or time of averaging is not stated"
    value = first[:, None] if radials else np.column_stack([first, second])
    # both components of a vector err alike
    std = errors[0] if radials else np.sqrt(0.5 * (errors[0] ** 2 + errors[1] ** 2))
    direction, suspect = second if radials else None, flags[known] == Flag.SUSPECT
    of = "sensors" if payload.get("kind") == "sensors" else "radar"
    extent = depth, averaged, length if length > 0.0 else 0.0
    return longitude, latitude, value, std, direction, suspect, *extent, of
