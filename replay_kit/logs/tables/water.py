"""Other measurements of the water: mean currents, temperature and salinity, and surface currents."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array, Times
from replay_kit.core.observation import Flag
from replay_kit.logs.tables.columns import (
    Payload,
    Rows,
    dive_number,
    field,
    number,
    read_each,
    regular,
    stated,
)
from replay_kit.logs.tables.instruments import believed

_NS = 1_000_000_000
#: Time of a fix that is not stated.
NO_TIME = -(2**63)
_CTD, _DRIFTER = (
    "depth temperature salinity conductivity pressure",
    "longitude latitude depth error",
)
_RADAR = "longitude latitude value error_std direction suspect depth averaged error_length kind"
Payloads = Sequence[Payload]


def _named(payloads: Payloads, names: str) -> dict[str, Array]:
    return dict(zip(names.split(), stated(payloads, names), strict=True))


def _mean_currents(payloads: Payloads) -> Rows:
    velocity = np.column_stack(stated(payloads, "dac_eastward dac_northward"))
    std, deepest, radius, declination = stated(payloads, "error max_depth radius declination")
    (start_time, start), (end_time, end) = (_fix(payloads, f"{at}_fix.") for at in ("start", "end"))
    columns = {
        "velocity": velocity,
        "error_std": believed(std),
        "start_time": start_time,
        "start": start,
        "end_time": end_time,
        "end": end,
        "dive": [*map(dive_number, field(payloads, "dive"))],
        "deepest": deepest,
        "radius": radius,
        "declination": declination,
        "inverted": [*map(bool, field(payloads, "inverted_in"))],
    }
    none = np.isnan(velocity).any(axis=1)
    return Rows("mean", columns, {"depth-averaged current: not a number": none})


def _fix(payloads: Payloads, part: str) -> tuple[Times, Array]:
    """Return times [ns, UTC] and positions of fixes; incomplete ones count as missing."""
    seconds, rest = stated(payloads, "sec nsec", part + "time.")
    place = np.column_stack(stated(payloads, "lon lat", part))
    known = (seconds >= 0.0) & (seconds < 2**33) & (rest >= 0.0) & (rest < 2 * _NS)
    known &= np.isfinite(place[:, 0]) & (np.abs(place[:, 1]) <= 90.0)
    whole = np.where(known, [seconds, rest], 0.0).astype(np.int64)
    time = np.where(known, whole[0] * _NS + whole[1], NO_TIME)
    return time, np.where(known[:, None], place, np.nan)


def _drifter_fixes(payloads: Payloads) -> Rows:
    columns = _named(payloads, _DRIFTER)
    placed = np.isfinite(columns["longitude"]) & (np.abs(columns["latitude"]) <= 90.0)
    own = np.array([*map(str, field(payloads, "id"))], object)
    reasons = {
        "drifter without its drogue: the wind moves it": [
            drogued is not True for drogued in field(payloads, "drogued")
        ],
        "drifter: no position, or no depth of its drogue": ~(placed & (columns["depth"] >= 0.0)),
    }
    return Rows("drifter", {"name": own, **columns}, reasons)


def _radar(payload: Payload) -> tuple[Any, ...] | str:
    """Return a row of complete vectors or radials, or the reason for exclusion.

    Arrays of v vectors: longitude, latitude, value (v, 2), or (v, 1) along direction, error, direction (None for vectors), suspect; then
    depth [m], averaging time [s], correlation length of errors [m] (0 if not stated), radar or sensors.
    """
    radials = "speed" in payload
    names = "speed direction error" if radials else "east north east_error north_error"
    said = [payload[name] for name in ("longitude", "latitude", *names.split())]
    columns = regular([*said, payload.get("flag", [Flag.GOOD] * len(said[0]))])
    if columns.ndim != 2:
        return "radar currents: columns are not numbers, or of unlike lengths"
    known = np.isfinite(columns[:-1]).all(axis=0) & (np.abs(columns[1]) <= 90.0)
    known &= ~np.isin(columns[-1], (Flag.FAIL, Flag.MISSING))
    if not known.any():
        return "radar currents: no vector that is whole"
    longitude, latitude, first, second, *errors, flags = columns[:, known]
    depth, averaged, length = (
        number(payload.get(name)) for name in ("depth", "averaged", "error_length")
    )
    if not (depth >= 0.0 and averaged > 0.0):
        return "radar currents: depth or time of averaging is not stated"
    value = np.column_stack([first] if radials else [first, second])
    # both components of a vector err alike
    std = np.sqrt(np.mean(np.square(errors), axis=0))
    direction, suspect = second if radials else None, flags == Flag.SUSPECT
    of = "sensors" if payload.get("kind") == "sensors" else "radar"
    extent = depth, averaged, length if length > 0.0 else 0.0
    return longitude, latitude, value, std, direction, suspect, *extent, of


#: What reads the messages of our own schemas.
READERS: Mapping[str, Callable[[Payloads], Rows]] = {
    "replay_kit.DepthAveragedCurrent": _mean_currents,
    "replay_kit.Ctd": lambda them: Rows("ctd", _named(them, _CTD)),
    "replay_kit.DrifterFix": _drifter_fixes,
    "replay_kit.RadarCurrents": lambda them: read_each("radar", _RADAR, them, _radar),
}
