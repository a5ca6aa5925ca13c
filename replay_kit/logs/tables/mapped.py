"""Messages that the configuration says how to read, ``[[measurements.map]]``."""

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from replay_kit.config.mapping import DepthMap, PositionMap, ProfileMap, TopicMap, VelocityMap
from replay_kit.config.run import MeasurementConfig
from replay_kit.core.errors import MeasurementError
from replay_kit.core.table import Raw, Table
from replay_kit.logs.tables.columns import (
    Payload,
    Rows,
    guarded,
    kept,
    number,
    read_each,
    some,
    why,
)
from replay_kit.logs.tables.instruments import pings
from replay_kit.logs.tables.vehicle import no_place

_NAMES_SHOWN = 12
# how many of a unit make the unit used inside; dividing by a power of ten rounds once
_PER_METRE = {"m": 1.0, "dm": 10.0, "cm": 100.0, "mm": 1000.0}
_PER_DEGREE = {"deg": 1.0, "rad": math.radians(1.0), "degE7": 1e7}
_PER_DBAR = {"dbar": 1.0, "bar": 0.1, "Pa": 1e4, "hPa": 100.0, "kPa": 10.0}
_ATMOSPHERE_DBAR = 10.1325
_EARTH = {"enu": "earth", "ned": "earth"}
_SIGNS = {"down": 1.0, "up": -1.0}
_SURFACE = {"pressure": 0.0, "transducer_depth": 0.0}


def mapped(entry: TopicMap, raw: Raw, config: MeasurementConfig) -> list[Table]:
    """Return the tables of messages by their topic's mapping.

    Args:
        entry: The mapping.
        raw: The messages.
        config: As of ``pings``.
    """
    if isinstance(entry, DepthMap):
        by = _depth_by(entry)
        depths = read_each("depth", by, raw.payloads, lambda one: (_depth(one, entry),), float)
        return kept(raw, depths._replace(fixed={"by": by}))
    if isinstance(entry, PositionMap):
        return kept(raw, _positions(raw, entry))
    read: Any = _profile if isinstance(entry, ProfileMap) else _velocity
    found = [guarded(partial(read, entry=entry), payload) for payload in raw.payloads]
    places = [
        (math.nan,) * 3 if isinstance(one, str) else one.pop("place", (math.nan,) * 3)
        for one in found
    ]
    tables = pings(raw, found, config, places=places)
    located = np.array([not isinstance(one, str) for one in found])
    if isinstance(entry, VelocityMap) or entry.longitude is None or not located.any():
        return tables
    raw = some(raw, located)
    beside = kept(raw, _positions(raw, entry)._replace(fixed={"beside": True}))
    # a message without a fix still has its profile, which other positions may place
    return tables + [one for one in beside if one.kind == "position"]


def _depth_by(entry: Any) -> str:
    """Return what a mapping's depth is, by its unit."""
    return "pressure" if entry.depth_unit in _PER_DBAR else "depth"


def _positions(raw: Raw, entry: Any) -> Rows:
    names = f"longitude latitude {_depth_by(entry) if entry.depth else 'depth'}"
    found = read_each("position", names, raw.payloads, lambda one: _position(one, entry), float)
    return found._replace(columns={**found.columns, "dead_reckoned": entry.dead_reckoned})


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


def _position(payload: Payload, entry: Any) -> tuple[float, float, float] | str:
    """Return longitude and latitude [degrees], and a depth as of ``_depth``, NaN where the mapping has none."""
    per = _PER_DEGREE[entry.angle_unit]
    x, y = (number(look_up(payload, path)) / per for path in (entry.longitude, entry.latitude))
    depth = _depth(payload, entry) if entry.depth else math.nan
    return str(why(no_place(x, y))) or (x, y, depth)


def _depth(payload: Payload, entry: Any) -> float:
    """Return a depth [m], or by its unit a sea pressure [dbar]."""
    value, unit = number(look_up(payload, entry.depth)), entry.depth_unit
    if unit in _PER_DBAR:
        return value / _PER_DBAR[unit] - _ATMOSPHERE_DBAR * bool(entry.depth_absolute)
    return _SIGNS[entry.depth_positive] * (value / _PER_METRE[unit])


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


def _profile(payload: Payload, entry: ProfileMap) -> dict[str, Any]:
    fields = _ping(entry, _EARTH.get(entry.frame, entry.frame), _cells(payload, entry))
    if entry.longitude is not None:
        _position(payload, entry)
    return fields | _geometry(payload, entry)


def _velocity(payload: Payload, entry: VelocityMap) -> dict[str, Any] | str:
    """Return one velocity as a profile of one cell, at the distance 0 from an instrument where it was measured."""
    place: Any = entry.place
    if place is not None:
        place = str(why(no_place(*place))) or place
    elif entry.longitude is not None:
        place = _position(payload, entry)
    if isinstance(place, str):
        return place
    velocity = [_speed(look_up(payload, path), entry) for path in (entry.east, entry.north)]
    fields = _ping(entry, "earth", [velocity]) | {"cell_distances": [entry.distance or 0.0]}
    if entry.at_depth is not None:
        fields |= _SURFACE | {"transducer_depth": entry.at_depth}
    elif entry.depth is not None:
        fields |= _instrument_depth(payload, entry)
    elif entry.distance is None:
        # a cell of an instrument is where it is on a vessel that states no depth, too; a velocity at the vehicle needs the vehicle's
        fields["vehicle_depth_needed"] = True
    # in no dive where a mooring measured
    return fields | ({"dive": 0, "place": (*place[:2], math.nan)} if place else {})


def _instrument_depth(payload: Payload, entry: Any) -> dict[str, Any]:
    """Return a depth as the fields of a ping; an unknown one is the vehicle's, but not the surface."""
    value = _depth(payload, entry)
    if not math.isfinite(value):
        return {"vehicle_depth_needed": True}
    by = "pressure" if entry.depth_unit in _PER_DBAR else "transducer_depth"
    return _SURFACE | {by: value}


def _cells(payload: Payload, entry: ProfileMap) -> list[list[float]]:
    """Return the cells' components [m/s], east and north first where they are of the earth.

    Raises:
        MeasurementError: They are not what the mapping says.
    """
    rows: Any
    if entry.velocity is None:
        columns = [look_up(payload, str(path)) for path in (entry.east, entry.north)]
        lists = all(isinstance(column, list | tuple) for column in columns)
        if not lists or len(columns[0]) != len(columns[1]):
            raise MeasurementError("measurements.map: east and north are not lists of one length")
        rows = zip(*columns, strict=True)
    else:
        rows = look_up(payload, entry.velocity)
        if not isinstance(rows, list | tuple):
            raise MeasurementError("measurements.map: velocity is not a list")
        if rows and not any(isinstance(row, list | tuple) for row in rows):
            n = entry.components
            if n is None or len(rows) % n:
                raise MeasurementError(
                    "measurements.map: velocity is flat; state the number of components per cell"
                )
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
        fields |= _SURFACE | {"orientation": "down"}
    return {**fields, "cell_distances": [number(value) / scale for value in values]}
