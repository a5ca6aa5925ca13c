"""Messages that the configuration says how to read, ``[[measurements.map]]``."""

import math
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from replay_kit.config.mapping import PositionMap, ProfileMap, TopicMap, VelocityMap
from replay_kit.core.errors import MeasurementError
from replay_kit.measurements.messages.fields import number
from replay_kit.measurements.messages.profiles import StatedPing
from replay_kit.measurements.messages.vehicle import Depth, Position, Pressure, checked
from replay_kit.measurements.vehicle.dives import depth_of_pressure

_NAMES_SHOWN = 12
# how many of a unit make the unit used inside; dividing by a power of ten rounds once
_PER_METRE = {"m": 1.0, "dm": 10.0, "cm": 100.0, "mm": 1000.0}
_PER_DBAR = {"dbar": 1.0, "bar": 0.1, "Pa": 1e4, "hPa": 100.0, "kPa": 10.0}
_DEGREES: dict[str, Callable[[float], float]] = {
    "deg": float,
    "rad": math.degrees,
    "degE7": lambda value: value / 1e7,
}
_ATMOSPHERE_DBAR = 10.1325
_COORDINATES = {"enu": "earth", "ned": "earth"}


def mapped(
    payload: Mapping[str, Any], entry: TopicMap
) -> StatedPing | Position | Depth | Pressure | str:
    """Return what a message states by its topic's mapping, or why it states nothing.

    Args:
        payload: The message's fields.
        entry: The mapping.

    Raises:
        MeasurementError: A path leads nowhere; the message says what stands there, alike for all messages alike.
    """
    return _READERS[entry.kind](payload, entry)


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
        return (
            ", ".join(names[:_NAMES_SHOWN]) + (", ..." if len(names) > _NAMES_SHOWN else "")
            if names
            else "no fields"
        )
    if isinstance(value, list | tuple | bytes):
        return "a list that has no such item; write an index that it has, or * for all"
    return "nothing" if value is None else f"one {type(value).__name__}, no fields"


def _position(
    payload: Mapping[str, Any], entry: PositionMap | ProfileMap | VelocityMap
) -> Position | str:
    # asked only of mappings that have them
    assert entry.longitude is not None
    assert entry.latitude is not None
    degrees = _DEGREES[entry.angle_unit]
    longitude, latitude = (
        degrees(number(look_up(payload, path))) for path in (entry.longitude, entry.latitude)
    )
    depth = math.nan
    if entry.depth is not None:
        stated = _depth(payload, entry)
        depth = (
            stated.depth
            if isinstance(stated, Depth)
            else depth_of_pressure(stated.pressure_dbar, latitude)
        )
    return checked(longitude, latitude, depth, entry.dead_reckoned)


def _depth(payload: Mapping[str, Any], entry: TopicMap) -> Depth | Pressure:
    assert entry.depth is not None, "asked only of mappings that have one"
    value = number(look_up(payload, entry.depth))
    if entry.depth_unit in _PER_DBAR:
        return Pressure(
            value / _PER_DBAR[entry.depth_unit]
            - (_ATMOSPHERE_DBAR if entry.depth_absolute else 0.0)
        )
    return Depth(_sign(entry) * value / _PER_METRE[entry.depth_unit])


def _sign(entry: TopicMap) -> float:
    return 1.0 if entry.depth_positive == "down" else -1.0


def _profile(payload: Mapping[str, Any], entry: ProfileMap) -> StatedPing | str:
    cells = _cells(payload, entry)
    if isinstance(cells, str):
        return cells
    position = None if entry.longitude is None else _position(payload, entry)
    return StatedPing(
        {
            "coordinate_system": _COORDINATES.get(entry.frame, entry.frame),
            "reference": None if entry.reference == "unknown" else entry.reference,
            "orientation": entry.orientation,
            "n_cells": len(cells),
            "velocity": cells,
            "velocity_std": entry.velocity_std,
            **_geometry(payload, entry),
        },
        # a message without a fix still has its profile, which other positions may place
        None if isinstance(position, str) else position,
    )


def _velocity(payload: Mapping[str, Any], entry: VelocityMap) -> StatedPing | str:
    """Return one velocity as a profile of one cell, at the distance 0 from an instrument where it was measured."""
    place: Position | str | None = None
    if entry.place is not None:
        place = checked(*entry.place, math.nan, False)
    elif entry.longitude is not None:
        place = _position(payload, entry)
    if isinstance(place, str):
        return place
    # a cell of an instrument is where it is on a vessel that states no depth, too; a velocity at the vehicle needs the vehicle's
    fields: dict[str, Any] = {"vehicle_depth_needed": True} if entry.distance is None else {}
    if entry.at_depth is not None:
        fields = {"pressure": 0.0, "transducer_depth": entry.at_depth}
    elif entry.depth is not None:
        fields = _instrument_depth(_depth(payload, entry))
    return StatedPing(
        {
            "coordinate_system": "earth",
            "reference": None if entry.reference == "unknown" else entry.reference,
            "orientation": entry.orientation,
            "n_cells": 1,
            "velocity": [
                [_speed(look_up(payload, path), entry) for path in (entry.east, entry.north)]
            ],
            "velocity_std": entry.velocity_std,
            "cell_distances": [entry.distance or 0.0],
            **fields,
        },
        *((None, place) if entry.elsewhere else (place, None)),
    )


def _instrument_depth(stated: Depth | Pressure) -> dict[str, Any]:
    """Return a depth as the fields of a ping; an unknown one is the vehicle's, but not the surface."""
    pressure, offset = (
        (0.0, stated.depth) if isinstance(stated, Depth) else (stated.pressure_dbar, 0.0)
    )
    known = math.isfinite(pressure + offset)
    return (
        {"pressure": pressure, "transducer_depth": offset}
        if known
        else {"vehicle_depth_needed": True}
    )


def _cells(payload: Mapping[str, Any], entry: ProfileMap) -> list[list[float]] | str:
    """Return the cells' components [m/s], east and north first where they are of the earth."""
    if entry.velocity is None:
        assert entry.east is not None and entry.north is not None, "the configuration checks it"  # noqa: PT018
        columns = [look_up(payload, path) for path in (entry.east, entry.north)]
        if (
            not all(isinstance(column, list | tuple) for column in columns)
            or len({len(column) for column in columns}) > 1
        ):
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
    return (
        math.nan
        if speed in entry.missing
        else speed / _PER_METRE[entry.speed_unit.removesuffix("/s")]
    )


def _geometry(payload: Mapping[str, Any], entry: ProfileMap) -> dict[str, Any]:
    """Return where the cells are, as the fields of a ping: depths below the surface are distances from an instrument in it."""
    scale = _PER_METRE[entry.distance_unit]
    fields: dict[str, Any] = {}
    if entry.depth is not None:
        fields |= _instrument_depth(_depth(payload, entry))
    listed = entry.depths or entry.distances
    if listed is not None:
        sign = _sign(entry) if entry.depths is not None else 1.0
        values = look_up(payload, listed)
        if not isinstance(values, list | tuple):
            raise MeasurementError(f"measurements.map: '{listed}' is not a list")
        fields["cell_distances"] = [sign * number(value) / scale for value in values]
        if entry.depths is not None:
            fields |= {"pressure": 0.0, "transducer_depth": 0.0, "orientation": "down"}
        return fields
    for name, given in (("cell_size", entry.cell_size), ("bin0_distance", entry.first_cell)):
        fields[name] = number(look_up(payload, given) if isinstance(given, str) else given) / scale
    return fields


_READERS: Mapping[
    str, Callable[[Mapping[str, Any], Any], StatedPing | Position | Depth | Pressure | str]
] = MappingProxyType(
    {"profile": _profile, "velocity": _velocity, "position": _position, "depth": _depth}
)
