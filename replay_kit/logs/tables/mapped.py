"""Messages that the configuration says how to read, ``[[measurements.map]]``."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from replay_kit.config.mapping import DepthMap, PositionMap, ProfileMap, TopicMap, VelocityMap
from replay_kit.config.run import MeasurementConfig
from replay_kit.core.errors import MeasurementError
from replay_kit.core.table import Raw, Table
from replay_kit.logs.tables.columns import Payload, guarded, number, read_each, some
from replay_kit.logs.tables.instruments import pings
from replay_kit.logs.tables.vehicle import Place, checked

_NAMES_SHOWN = 12
# how many of a unit make the unit used inside; dividing by a power of ten rounds once
_PER_METRE = {"m": 1.0, "dm": 10.0, "cm": 100.0, "mm": 1000.0}
_PER_DBAR = {"dbar": 1.0, "bar": 0.1, "Pa": 1e4, "hPa": 100.0, "kPa": 10.0}
_ATMOSPHERE_DBAR = 10.1325
_EARTH = {"enu": "earth", "ned": "earth"}
_PLACE = ("longitude", "latitude", "depth", "dead_reckoned")


def mapped(raw: Raw, entry: TopicMap, config: MeasurementConfig) -> list[Table]:
    """Return the tables of messages by their topic's mapping.

    Args:
        raw: The messages.
        entry: The mapping.
        config: As of ``pings``.
    """
    if isinstance(entry, DepthMap):
        by = "pressure" if entry.depth_unit in _PER_DBAR else "depth"
        return read_each(raw, "depth", [by], lambda payload: (_depth(payload, entry),), {"by": by})
    if isinstance(entry, PositionMap):
        return _positions(raw, entry, {})
    found = [guarded(lambda one: _stated(one, entry), payload) for payload in raw.payloads]
    places = [None if isinstance(one, str) else one[1] for one in found]
    tables = pings(
        raw, [one if isinstance(one, str) else one[0] for one in found], config, places=places
    )
    located = [k for k, one in enumerate(found) if not isinstance(one, str) and one[2]]
    if not located:
        return tables
    assert isinstance(entry, ProfileMap | VelocityMap)
    beside = _positions(some(raw, located), entry, {"beside": True})
    # a message without a fix still has its profile, which other positions may place
    return tables + [one for one in beside if one.kind == "position"]


def _positions(
    raw: Raw, entry: PositionMap | ProfileMap | VelocityMap, fixed: Mapping[str, Any]
) -> list[Table]:
    by_pressure = entry.depth is not None and entry.depth_unit in _PER_DBAR
    names = [*_PLACE[:2], "pressure" if by_pressure else "depth", _PLACE[3]]
    return read_each(raw, "position", names, lambda payload: _position(payload, entry), fixed)


def look_up(payload: Any, path: str) -> Any:
    """Return what stands at a path of field names, list indices and ``*``.

    Raises:
        MeasurementError: The path leads nowhere.
    """
    return _follow(payload, path.split("."), 0)


def _follow(value: Any, parts: Sequence[str], at: int) -> Any:
    if at == len(parts):
        return value
    part = parts[at]
    if isinstance(value, Mapping) and part in value:
        return _follow(value[part], parts, at + 1)
    if isinstance(value, list | tuple | bytes):
        if part == "*":
            return [_follow(item, parts, at + 1) for item in value]
        index = int(part) if part.removeprefix("-").isdecimal() else None
        if index is not None and -len(value) <= index < len(value):
            return _follow(value[index], parts, at + 1)
    where = f"at '{'.'.join(parts[:at])}'" if at else "the message"
    raise MeasurementError(
        f"measurements.map: '{'.'.join(parts)}' leads nowhere: {where} holds {_contents(value)}"
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


def _position(payload: Payload, entry: PositionMap | ProfileMap | VelocityMap) -> Place | str:
    """Return a position with depth [m], or pressure [dbar] by its unit."""
    assert entry.longitude is not None, "asked only of mappings that have them"
    assert entry.latitude is not None, "asked only of mappings that have them"
    x, y = (
        _degrees(number(look_up(payload, path)), entry.angle_unit)
        for path in (entry.longitude, entry.latitude)
    )
    depth = math.nan if entry.depth is None else _depth(payload, entry)
    return checked(x, y, depth, entry.dead_reckoned)


def _degrees(value: float, unit: str) -> float:
    return math.degrees(value) if unit == "rad" else value / 1e7 if unit == "degE7" else value


def _depth(payload: Payload, entry: TopicMap) -> float:
    """Return a depth [m], or by its unit a sea pressure [dbar]."""
    assert entry.depth is not None, "asked only of mappings that have one"
    value = number(look_up(payload, entry.depth))
    if entry.depth_unit in _PER_DBAR:
        air = _ATMOSPHERE_DBAR if entry.depth_absolute else 0.0
        return value / _PER_DBAR[entry.depth_unit] - air
    return _sign(entry) * value / _PER_METRE[entry.depth_unit]


def _sign(entry: TopicMap) -> float:
    return 1.0 if entry.depth_positive == "down" else -1.0


#: The fields of a ping, the place of a mooring, and whether the message states the vehicle's position.
_Stated = tuple[dict[str, Any], tuple[float, float, float] | None, bool]


def _stated(payload: Payload, entry: TopicMap) -> _Stated | str:
    if isinstance(entry, ProfileMap):
        return _profile(payload, entry)
    assert isinstance(entry, VelocityMap), "the others are no pings"
    return _velocity(payload, entry)


def _profile(payload: Payload, entry: ProfileMap) -> _Stated | str:
    cells = _cells(payload, entry)
    if isinstance(cells, str):
        return cells
    if entry.longitude is not None:
        _position(payload, entry)
    fields = {
        "coordinate_system": _EARTH.get(entry.frame, entry.frame),
        "reference": None if entry.reference == "unknown" else entry.reference,
        "orientation": entry.orientation,
        "n_cells": len(cells),
        "velocity": cells,
        "velocity_std": entry.velocity_std,
        **_geometry(payload, entry),
    }
    return fields, None, entry.longitude is not None


def _velocity(payload: Payload, entry: VelocityMap) -> _Stated | str:
    """Return one velocity as a profile of one cell, at the distance 0 from an instrument where it was measured."""
    place: Place | str | None = None
    if entry.place is not None:
        place = checked(*entry.place, math.nan, False)
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
        "coordinate_system": "earth",
        "reference": None if entry.reference == "unknown" else entry.reference,
        "orientation": entry.orientation,
        "n_cells": 1,
        "velocity": [velocity],
        "velocity_std": entry.velocity_std,
        "cell_distances": [entry.distance or 0.0],
        **depth,
    }
    if place is None:
        return fields, None, False
    # in no dive where a mooring measured
    return {**fields, "dive": 0}, (place[0], place[1], math.nan), False


def _instrument_depth(payload: Payload, entry: TopicMap) -> dict[str, Any]:
    """Return a depth as the fields of a ping; an unknown one is the vehicle's, but not the surface."""
    value = _depth(payload, entry)
    if not math.isfinite(value):
        return {"vehicle_depth_needed": True}
    by_pressure = entry.depth_unit in _PER_DBAR
    pressure, offset = (value, 0.0) if by_pressure else (0.0, value)
    return {"pressure": pressure, "transducer_depth": offset}


def _cells(payload: Payload, entry: ProfileMap) -> list[list[float]] | str:
    """Return the cells' components [m/s], east and north first where they are of the earth."""
    if entry.velocity is None:
        assert entry.east is not None, "the configuration checks it"
        assert entry.north is not None, "the configuration checks it"
        columns = [look_up(payload, path) for path in (entry.east, entry.north)]
        lists = all(isinstance(column, list | tuple) for column in columns)
        if not lists or len({len(column) for column in columns}) > 1:
            return "measurements.map: east and north are not lists of one length"
        return [[_speed(value, entry) for value in cell] for cell in zip(*columns, strict=True)]
    rows = look_up(payload, entry.velocity)
    if not isinstance(rows, list | tuple):
        return "measurements.map: velocity is not a list"
    if rows and not any(isinstance(row, list | tuple) for row in rows):
        if entry.components is None or len(rows) % entry.components:
            return "measurements.map: velocity is flat; state the number of components per cell"
        rows = [rows[i : i + entry.components] for i in range(0, len(rows), entry.components)]
    cells = [
        [_speed(value, entry) for value in row] if isinstance(row, list | tuple) else [math.nan] * 2
        for row in rows
    ]
    if entry.frame != "ned":
        return cells
    return [
        [cell[1], cell[0], *(-value for value in cell[2:3])] if len(cell) > 1 else cell
        for cell in cells
    ]


def _speed(value: Any, entry: ProfileMap | VelocityMap) -> float:
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
    sign = _sign(entry) if entry.depths is not None else 1.0
    values = look_up(payload, listed)
    if not isinstance(values, list | tuple):
        raise MeasurementError(f"measurements.map: '{listed}' is not a list")
    fields["cell_distances"] = [sign * number(value) / scale for value in values]
    if entry.depths is not None:
        fields |= {"pressure": 0.0, "transducer_depth": 0.0, "orientation": "down"}
    return fields
