"""What is measured of the water besides profiles: mean currents, temperature and salinity, and currents at the surface."""

from typing import Any

import numpy as np

from replay_kit.core.arrays import Array, Times
from replay_kit.core.observation import Flag
from replay_kit.core.table import Raw
from replay_kit.logs.tables.columns import (
    Payload,
    Tables,
    dive_number,
    each,
    field,
    kept,
    number,
    read_each,
    stated,
    why,
)
from replay_kit.logs.tables.instruments import believed

_NO_MEAN = "depth-averaged current: not a number"
_NS = 1_000_000_000
#: Time of a fix that is not stated.
NO_TIME = -(2**63)
_CTD = "depth temperature salinity conductivity pressure"
_RADAR = "longitude latitude value error_std direction suspect depth averaged error_length kind"


def ctds(raw: Raw) -> Tables:
    """Return the samples of ``replay_kit.Ctd`` messages."""
    columns = dict(zip(_CTD.split(), stated(raw.payloads, _CTD), strict=True))
    return kept(raw, "ctd", "", columns)


def mean_currents(raw: Raw) -> Tables:
    """Return the mean currents of ``replay_kit.DepthAveragedCurrent`` messages."""
    payloads = raw.payloads
    velocity = np.column_stack(stated(payloads, "dac_eastward dac_northward"))
    std, deepest = stated(payloads, "error max_depth")
    (start_time, start), (end_time, end) = (_fix(payloads, f"{at}_fix.") for at in ("start", "end"))
    columns = {
        "velocity": velocity,
        "error_std": believed(std),
        "start_time": start_time,
        "start": start,
        "end_time": end_time,
        "end": end,
        "dive": each(dive_number, field(payloads, "dive")),
        "deepest": deepest,
        "inverted": [*map(bool, field(payloads, "inverted_in"))],
    }
    return kept(raw, "mean", why({_NO_MEAN: np.isnan(velocity).any(axis=1)}), columns)


def _fix(payloads: Any, part: str) -> tuple[Times, Array]:
    """Return times [ns, UTC] and places of fixes; one that is not stated whole is not stated."""
    seconds, rest = stated(payloads, "sec nsec", part + "time.")
    longitude, latitude = stated(payloads, "lon lat", part)
    known = (seconds >= 0.0) & (seconds < 2**33) & (rest >= 0.0) & (rest < 2 * _NS)
    known &= np.isfinite(longitude) & (np.abs(latitude) <= 90.0)
    whole = [np.where(known, part, 0.0).astype(np.int64) for part in (seconds, rest)]
    place = np.where(known, [longitude, latitude], np.nan).T
    return np.where(known, whole[0] * _NS + whole[1], NO_TIME), place


def drifter_fixes(raw: Raw) -> Tables:
    """Return the fixes of ``replay_kit.DrifterFix`` messages."""
    names, payloads = "longitude latitude depth error", raw.payloads
    longitude, latitude, depth, _ = found = stated(payloads, names)
    loose = [drogued is not True for drogued in field(payloads, "drogued")]
    placed = np.isfinite(longitude) & (np.abs(latitude) <= 90.0) & (depth >= 0.0)
    reasons = {
        "drifter without its drogue: the wind moves it": loose,
        "drifter: no position, or no depth of its drogue": ~placed,
    }
    own = np.array([*map(str, field(payloads, "id"))], object)
    columns = {"name": own, **dict(zip(names.split(), found, strict=True))}
    return kept(raw, "drifter", why(reasons), columns)


def radar_currents(raw: Raw) -> Tables:
    """Return the vectors or radials of ``replay_kit.RadarCurrents`` messages that are whole."""
    return read_each(raw, "radar", _RADAR, _radar)


def _radar(payload: Payload) -> tuple[Any, ...] | str:
    """Return a row of ``radar_currents``, or why there is none.

    Arrays of v vectors: longitude, latitude, value (v, 2), or (v, 1) along direction, error, direction (None for vectors), suspect; then
    depth [m], time of averaging [s], length over which errors are correlated [m] (0 where not stated), radar or sensors.
    """
    radials = "speed" in payload
    names = "speed direction error" if radials else "east north east_error north_error"
    columns = [
        np.array(payload[name], np.float64) for name in ("longitude", "latitude", *names.split())
    ]
    flags = np.array(payload.get("flag", np.ones_like(columns[0])), np.float64)
    if len({each.shape for each in (*columns, flags)}) != 1 or columns[0].ndim != 1:
        return "radar currents: columns of unlike lengths"
    known = np.isfinite(columns).all(axis=0) & (np.abs(columns[1]) <= 90.0)
    known &= (flags != Flag.FAIL) & (flags != Flag.MISSING)
    if not known.any():
        return "radar currents: no vector that is whole"
    longitude, latitude, first, second, *errors = (each[known] for each in columns)
    depth, averaged, length = (
        number(payload.get(name)) for name in ("depth", "averaged", "error_length")
    )
    if not (depth >= 0.0 and averaged > 0.0):
        return "radar currents: depth or time of averaging is not stated"
    value = first[:, None] if radials else np.column_stack([first, second])
    # both components of a vector err alike
    std = errors[0] if radials else np.sqrt(0.5 * (errors[0] ** 2 + errors[1] ** 2))
    direction, suspect = second if radials else None, flags[known] == Flag.SUSPECT
    of = "sensors" if payload.get("kind") == "sensors" else "radar"
    extent = depth, averaged, length if length > 0.0 else 0.0
    return longitude, latitude, value, std, direction, suspect, *extent, of
