"""Positions in IMC messages written as JSON (LSTS/imc, IMC.xml, messages 253 and 350): angles in radians, offsets north, east, down."""

import math
from collections.abc import Mapping
from typing import Any

from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection
from replay_kit.measurements.messages.fields import number, whole_number
from replay_kit.measurements.messages.position import Position, checked

_VALID_POSITION = 0x0004
_DEAD_RECKONING = (2, "DEAD_RECKONING")


def gps_fix(payload: Mapping[str, Any]) -> Position | str:
    """Return the position in a ``GpsFix``, or why it is none; one that states no validity is taken at its word."""
    validity = whole_number(payload.get("validity"))
    if validity is not None and not validity & _VALID_POSITION:
        return "no fix (validity without VALID_POS)"
    longitude, latitude = (math.degrees(number(payload.get(name))) for name in ("lon", "lat"))
    return checked(longitude, latitude, math.nan, payload.get("type") in _DEAD_RECKONING)


def estimated_state(payload: Mapping[str, Any]) -> Position | str:
    """Return the position in an ``EstimatedState``, or why it is none: a reference with offsets x north and y east."""
    longitude, latitude = (math.degrees(number(payload.get(name))) for name in ("lon", "lat"))
    reference = checked(longitude, latitude, math.nan, True)
    if isinstance(reference, str):
        return reference
    # an offset that the JSON leaves out is zero
    north, east = (number(payload.get(name, 0.0)) for name in ("x", "y"))
    if not (math.isfinite(north) and math.isfinite(east)):
        return "position is not a number"
    depth = number(payload.get("depth"))
    moved = to_geographic(Projection(reference.longitude, reference.latitude), east, north)
    # negative values denote invalid estimates
    return checked(float(moved[0]), float(moved[1]), depth if depth >= 0.0 else math.nan, True)
