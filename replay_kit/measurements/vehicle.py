"""Positions and depths of the vehicle from the messages that vehicles write."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from replay_kit.measurements.adcp import depth_of_pressure, number

_ATMOSPHERE_PA = 101_325.0
_PA_PER_DBAR = 10_000.0
_TRUE = ("true", "1")


@dataclass(frozen=True, slots=True)
class Position:
    """A position that a message states; NaN where it does not say.

    Attributes:
        longitude: [degrees east].
        latitude: [degrees north].
        depth: [m], positive down.
        dead_reckoned: True when computed, not measured.
    """

    longitude: float
    latitude: float
    depth: float
    dead_reckoned: bool


def location_fix(payload: Mapping[str, Any]) -> Position | str:
    """Return the position in a ``foxglove.LocationFix``, or why it is none.

    ``metadata`` may carry ``depth`` [m] and ``dead_reckoned``; the altitude is above the ellipsoid and is not a depth.
    """
    extra = _metadata(payload.get("metadata"))
    dead_reckoned = str(extra.get("dead_reckoned", "")).strip().lower() in _TRUE
    return checked(payload.get("longitude"), payload.get("latitude"), number(extra.get("depth")), dead_reckoned)


def nav_sat_fix(payload: Mapping[str, Any]) -> Position | str:
    """Return the position in a ``sensor_msgs/NavSatFix``, or why it is none; one that states no status is taken at its word."""
    status = payload.get("status")
    if number(status.get("status") if isinstance(status, Mapping) else status) < 0:
        return "no fix (status < 0)"
    return checked(payload.get("longitude"), payload.get("latitude"), math.nan, False)


def global_position_int(payload: Mapping[str, Any]) -> Position | str:
    """Return the position in a MAVLink ``GLOBAL_POSITION_INT``, or why it is none."""
    longitude, latitude = number(payload.get("lon")) * 1e-7, number(payload.get("lat")) * 1e-7
    return checked(longitude, latitude, -number(payload.get("relative_alt")) * 1e-3, False)


def fluid_pressure(payload: Mapping[str, Any], latitude: float) -> float:
    """Return the depth [m] of a ``sensor_msgs/FluidPressure`` (absolute, Pa); NaN when it has none."""
    return depth_of_pressure((number(payload.get("fluid_pressure")) - _ATMOSPHERE_PA) / _PA_PER_DBAR, latitude)


def odometry(payload: Mapping[str, Any]) -> tuple[float, float, float] | str:
    """Return east, north and depth [m] in the odometry's own frame (ROS REP-103: x east, y north, z up), or why there are none."""
    try:
        position = payload["pose"]["pose"]["position"]
        values = number(position["x"]), number(position["y"]), -number(position["z"])
    except (KeyError, TypeError):
        return "no pose.pose.position in it"
    return values if all(map(math.isfinite, values)) else "position is not a number"


def checked(longitude: Any, latitude: Any, depth: float, dead_reckoned: bool) -> Position | str:
    """Return a position, or why its numbers are none."""
    x, y = number(longitude), number(latitude)
    if not (math.isfinite(x) and math.isfinite(y)):
        return "position is not a number"
    if x == 0.0 and y == 0.0:
        return "position is 0, 0 (no fix)"
    if abs(y) > 90.0 or not -180.0 <= x <= 360.0:
        return "position is no longitude and latitude"
    return Position(x, y, depth, dead_reckoned)


def _metadata(pairs: Any) -> dict[str, Any]:
    """Return key-value pairs as a dict; a plain mapping is read too, and what is no pair says nothing."""
    if isinstance(pairs, Mapping):
        return {str(key): value for key, value in pairs.items()}
    if not isinstance(pairs, list | tuple):
        return {}
    return {str(pair.get("key")): pair.get("value") for pair in pairs if isinstance(pair, Mapping)}
