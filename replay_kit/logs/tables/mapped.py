"""Messages that the configuration says how to read, ``[[measurements.map]]``."""

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from replay_kit.config.mapping import DepthMap, PositionMap, ProfileMap, TopicMap, VelocityMap
from replay_kit.config.run import MeasurementConfig
from replay_kit.core.errors import MeasurementError
from replay_kit.core.table import Raw, Table
from replay_kit.logs.tables.columns import Payload, guarded, number, read_each, some
from replay_kit.logs.tables.instruments import pings
from replay_kit.logs.tables.vehicle import no_place

_NAMES_SHOWN = 12
# how many of a unit make the unit used inside; dividing by a power of ten rounds once
_PER_METRE = {"m": 1.0, "dm": 10.0, "cm": 100.0, "mm": 1000.0}
_PER_DBAR = {"dbar": 1.0, "bar": 0.1, "Pa": 1e4, "hPa": 100.0, "kPa": 10.0}
_ATMOSPHERE_DBAR = 10.1325
_EARTH = {"enu": "earth", "ned": "earth"}
_SIGNS = {"down": 1.0, "up": -1.0}
_NOWHERE = (math.nan,) * 3
#: Longitude, latitude, depth (NaN where not stated), whether it is dead-reckoned.
Place = tuple[float, float, float, bool]


def mapped(entry: TopicMap, raw: Raw, config: MeasurementConfig) -> list[Table]:
    """Return the tables of messages by their topic's mapping.

    Args:
        entry: The mapping.
        raw: The messages.
        config: As of ``pings``.
    """
    by = "pressure" if entry.depth_unit in _PER_DBAR else "depth"
    if isinstance(entry, DepthMap):
        return read_each(raw, "depth", by, lambda payload: (_depth(payload, entry),), by=by)
    if isinstance(entry, PositionMap):
        return _positions(raw, entry)
    read = _profile if isinstance(entry, ProfileMap) else _velocity
    found = [guarded(partial(read, entry=entry), payload) for payload in raw.payloads]
    fields, places = zip(
        *((one, _NOWHERE) if isinstance(one, str) else one for one in found), strict=True
    )
    tables = pings(raw, fields, config, places=places)
    located = [not isinstance(one, str) for one in fields]
    if isinstance(entry, VelocityMap) or entry.longitude is None or not any(located):
        return tables
    beside = _positions(some(raw, located), entry, beside=True)
    # a message without a fix still has its profile, which other positions may place
    return tables + [one for one in beside if one.kind == "position"]


def _positions(raw: Raw, entry: Any, **fixed: Any) -> list[Table]:
    depth = "pressure" if entry.depth and entry.depth_unit in _PER_DBAR else "depth"
    names = f"longitude latitude {depth} dead_reckoned"
    return read_each(raw, "position", names, lambda payload: _position(payload, entry), **fixed)


def look_up(value: Any, path: str, at: int = 0) -> Any:
    """Return what stands at a path of field names, list indices and ``*``.

    Args:
        value: What the first parts of the path led to.
        path: The whole path.
        at: Number of these parts.

    Raises:
        MeasurementError: The path leads nowhere.
    """
    parts = path.split(".")
    if at == len(parts):
        return value
    part = parts[at]
    if isinstance(value, Mapping) and part in value:
        return look_up(value[part], path, at + 1)
    if isinstance(value, list | tuple | bytes):
        if part == "*":
            return [look_up(item, path, at + 1) for item in value]
        if part.removeprefix("-").isdecimal() and -len(value) <= int(part) < len(value):
            return look_up(value[int(part)], path, at + 1)
    where = f"at '{'.'.join(parts[:at])}'" if at else "the message"
    raise MeasurementError(
        f"measurements.map: '{path}' leads nowhere: {where} holds {_contents(value)}"
    )


def _contents(value: Any) -> str:
    """Return what a value holds, in words that are the same for all messages of one make."""
    if isinstance(value, Mapping):
        names = sorted(str(name) for name in value)
        more = ", ..." if len(names) > _NAMES_SHOWN else ""
        return (", ".join(names[:_NAMES_SHOWN]) + more) if names else "no fields"
    if isinstance(value, list | tuple | bytes):
        return "a list that has no such item; write an index that it has, or * for all"
    return "nothing" if value is None else f"one {type(value).__name__}, no fields"


def _position(payload: Payload, entry: Any) -> Place | str:
    """Return a position with depth [m], or pressure [dbar] by its unit."""
    x, y = (
        _degrees(number(look_up(payload, path)), entry.angle_unit)
        for path in (entry.longitude, entry.latitude)
    )
    depth = _depth(payload, entry) if entry.depth else math.nan
    return str(no_place(x, y)) or (x, y, depth, entry.dead_reckoned)


def _degrees(value: float, unit: str) -> float:
    return math.degrees(value) if unit == "rad" else value / 1e7 if unit == "degE7" else value


def _depth(payload: Payload, entry: Any) -> float:
    """Return a depth [m], or by its unit a sea pressure [dbar]."""
    value, unit = number(look_up(payload, entry.depth)), entry.depth_unit
    if unit in _PER_DBAR:
        return value / _PER_DBAR[unit] - _ATMOSPHERE_DBAR * bool(entry.depth_absolute)
    return _SIGNS[entry.depth_positive] * (value / _PER_METRE[unit])


#: The fields of a ping, and the place of a mooring.
_Stated = tuple[dict[str, Any], tuple[float, float, float]]


def _ping(entry: Any, frame: str, cells: Sequence[Any]) -> dict[str, Any]:
    """Return the fields of a ping that its mapping and its cells say."""
    return {
        "coordinate_system": frame,
        "reference": None if entry.reference == "unknown" else entry.reference,
        "orientation": entry.orientation,
        "n_cells": len(cells),
        "velocity": cells,
        "velocity_std": entry.velocity_std,
    }


def _profile(payload: Payload, entry: Any) -> _Stated | str:
    cells = _cells(payload, entry)
    if isinstance(cells, str):
        return cells
    if entry.longitude is not None:
        _position(payload, entry)
    return {
        **_ping(entry, _EARTH.get(entry.frame, entry.frame), cells),
        **_geometry(payload, entry),
    }, _NOWHERE


def _velocity(payload: Payload, entry: Any) -> _Stated | str:
    """Return one velocity as a profile of one cell, at the distance 0 from an instrument where it was measured."""
    place: Any = None
    if entry.place is not None:
        place = str(no_place(*entry.place)) or entry.place
    elif entry.longitude is not None:
        place = _position(payload, entry)
    if isinstance(place, str):
        return place
    # a cell of an instrument is where it is on a vessel that states no depth, too; a velocity at the vehicle needs the vehicle's
    depth: dict[str, Any] = {"vehicle_depth_needed": True} if entry.distance is None else {}
    if entry.at_depth is not None:
        depth = {"pressure": 0.0, "transducer_depth": entry.at_depth}
    elif entry.depth is not None:
        depth = _instrument_depth(payload, entry)
    velocity = [_speed(look_up(payload, path), entry) for path in (entry.east, entry.north)]
    fields = {
        **_ping(entry, "earth", [velocity]),
        "cell_distances": [entry.distance or 0.0],
        **depth,
    }
    if place is None:
        return fields, _NOWHERE
    # in no dive where a mooring measured
    return {**fields, "dive": 0}, (place[0], place[1], math.nan)


def _instrument_depth(payload: Payload, entry: Any) -> dict[str, Any]:
    """Return a depth as the fields of a ping; an unknown one is the vehicle's, but not the surface."""
    value = _depth(payload, entry)
    if not math.isfinite(value):
        return {"vehicle_depth_needed": True}
    fields = {"pressure": 0.0, "transducer_depth": 0.0}
    by = "pressure" if entry.depth_unit in _PER_DBAR else "transducer_depth"
    return {**fields, by: value}


def _cells(payload: Payload, entry: Any) -> list[list[float]] | str:
    """Return the cells' components [m/s], east and north first where they are of the earth."""
    if entry.velocity is None:
        columns = [look_up(payload, path) for path in (entry.east, entry.north)]
        lists = all(isinstance(column, list | tuple) for column in columns)
        if not lists or len(columns[0]) != len(columns[1]):
            return "measurements.map: east and north are not lists of one length"
        rows: Any = zip(*columns, strict=True)
    else:
        rows = look_up(payload, entry.velocity)
        if not isinstance(rows, list | tuple):
            return "measurements.map: velocity is not a list"
        if rows and not any(isinstance(row, list | tuple) for row in rows):
            n = entry.components
            if n is None or len(rows) % n:
                return "measurements.map: velocity is flat; state the number of components per cell"
            rows = [rows[i : i + n] for i in range(0, len(rows), n)]
    cells = [
        [_speed(value, entry) for value in row] if isinstance(row, list | tuple) else [math.nan] * 2
        for row in rows
    ]
    if entry.frame == "ned":
        for cell in cells:
            cell[:3] = [*cell[1::-1], *(-down for down in cell[2:3])]
    return cells


def _speed(value: Any, entry: Any) -> float:
    speed = number(value)
    missing = speed in entry.missing
    return math.nan if missing else speed / _PER_METRE[entry.speed_unit.removesuffix("/s")]


def _geometry(payload: Payload, entry: ProfileMap) -> dict[str, Any]:
    """Return where the cells are, as the fields of a ping: depths below the surface are distances from an instrument in it."""
    scale = _PER_METRE[entry.distance_unit]
    fields = {} if entry.depth is None else _instrument_depth(payload, entry)
    listed = entry.depths or entry.distances
    if listed is None:
        for name, given in (("cell_size", entry.cell_size), ("bin0_distance", entry.first_cell)):
            value = look_up(payload, given) if isinstance(given, str) else given
            fields[name] = number(value) / scale
        return fields
    values = look_up(payload, listed)
    if not isinstance(values, list | tuple):
        raise MeasurementError(f"measurements.map: '{listed}' is not a list")
    if entry.depths is not None:
        scale *= _SIGNS[entry.depth_positive]
        fields |= {"pressure": 0.0, "transducer_depth": 0.0, "orientation": "down"}
    return {**fields, "cell_distances": [number(value) / scale for value in values]}
