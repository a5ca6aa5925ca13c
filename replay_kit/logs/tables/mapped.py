"""Messages read by a mapping of the configuration, ``[[measurements.map]]``."""

import math
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from replay_kit.config.mapping import TopicMap
from replay_kit.config.run import MeasurementConfig
from replay_kit.core.errors import MeasurementError
from replay_kit.core.observation.table import Raw, Table
from replay_kit.logs.tables.columns import (
    Payload,
    Rows,
    field,
    guarded,
    kept,
    number,
    numbers,
    rows,
    some,
    unused,
    why,
)
from replay_kit.logs.tables.instruments import pings
from replay_kit.logs.tables.vehicle import no_place

_NAMES_SHOWN = 12
# how many of a unit make the unit used inside; dividing by a power of ten rounds once
_PER_METRE = {"m": 1.0, "dm": 10.0, "cm": 100.0, "mm": 1000.0}
_PER_DBAR = {"dbar": 1.0, "bar": 0.1, "Pa": 1e4, "hPa": 100.0, "kPa": 10.0}
_PER_DEGREE = {"deg": 1.0, "rad": math.radians(1.0), "degE7": 1e7}
_ATMOSPHERE_DBAR = 10.1325
_SIGNS = {"down": 1.0, "up": -1.0}
_SURFACE = {"pressure": 0.0, "transducer_depth": 0.0}
# settings that are paths in a message, or of a cell's size and place numbers
_PATHS = (
    *("longitude", "latitude", "depth", "velocity", "east", "north"),
    *("depths", "distances", "cell_size", "first_cell"),
)


def mapped(entry: TopicMap, raw: Raw, config: MeasurementConfig) -> list[Table]:
    """Return the tables of messages by their topic's mapping.

    Args:
        entry: Mapping.
        raw: Messages.
        config: See ``pings``.
    """
    found = [guarded(partial(_mapped_values, entry), payload) for payload in raw.payloads]
    words = [one if isinstance(one, str) else "" for one in found]
    tables, raw = unused(raw, words), some(raw, np.equal(words, ""))
    said = [one for one in found if not isinstance(one, str)]
    by = "pressure" if entry.depth and entry.depth_unit in _PER_DBAR else "depth"
    depth = _depth(numbers(field(said, "depth")), entry)
    if entry.kind == "depth":
        return tables + kept(raw, Rows("depth", {by: depth}, fixed={"by": by}))
    places = [numbers(field(said, name)) for name in ("longitude", "latitude")]
    places = [place / _PER_DEGREE[entry.angle_unit] for place in places]
    wrong = no_place(*places)
    columns = {"longitude": places[0], "latitude": places[1], by: depth}
    positions = Rows("position", {**columns, "dead_reckoned": entry.dead_reckoned}, wrong)
    if entry.kind == "position":
        return tables + kept(raw, positions)
    payloads: Any = [guarded(partial(_ping, entry), one) for one in said]
    there = np.full((len(said), 3), np.nan)
    if entry.kind == "velocity" and entry.place:
        there[:, :2] = entry.place
    elif entry.kind == "velocity" and entry.longitude:
        there[:, :2] = np.transpose(places)
        payloads = [word or one for word, one in zip(why(wrong).tolist(), payloads, strict=True)]
    elif entry.longitude:
        beside = kept(raw, positions._replace(fixed={"beside": True}))
        # a message without a fix still has its profile, which other positions may place
        tables += [one for one in beside if one.kind == "position"]
    return tables + pings(raw, payloads, config, places=there)


def _mapped_values(entry: Any, payload: Payload) -> dict[str, Any]:
    """Return the values at the mapping's paths, by setting."""
    asked = {name: getattr(entry, name, None) for name in _PATHS}
    return {k: look_up(payload, path) for k, path in asked.items() if isinstance(path, str)}


def look_up(value: Any, path: str, at: int = 0) -> Any:
    """Return the value at a path of field names, list indices and ``*``.

    Args:
        value: Value at the first parts of the path.
        path: Whole path.
        at: Number of these parts.

    Raises:
        MeasurementError: The path does not exist.
    """
    parts = path.split(".")
    if at == len(parts):
        return value
    if parts[at] == "*" and isinstance(value, list | tuple | bytes):
        return [look_up(item, path, at + 1) for item in value]
    try:
        inner = value[parts[at] if isinstance(value, Mapping) else int(parts[at])]
    except (LookupError, TypeError, ValueError) as error:
        where = f"at '{'.'.join(parts[:at])}'" if at else "the message"
        raise MeasurementError(
            f"measurements.map: '{path}' leads nowhere: {where} holds {_contents(value)}"
        ) from error
    return look_up(inner, path, at + 1)


def _contents(value: Any) -> str:
    """Return a description of a value, equal for all messages of one structure."""
    if isinstance(value, Mapping):
        names = sorted(map(str, value))
        more = ", ..." if len(names) > _NAMES_SHOWN else ""
        return ", ".join(names[:_NAMES_SHOWN]) + more or "no fields"
    if isinstance(value, list | tuple | bytes):
        return "a list that has no such item; write an index that it has, or * for all"
    return "nothing" if value is None else f"one {type(value).__name__}, no fields"


def _depth(value: Any, entry: Any) -> Any:
    """Return depths [m], or sea pressures [dbar], by unit."""
    if entry.depth_unit in _PER_DBAR:
        return value / _PER_DBAR[entry.depth_unit] - _ATMOSPHERE_DBAR * entry.depth_absolute
    return _SIGNS[entry.depth_positive] * (value / _PER_METRE[entry.depth_unit])


def _ping(entry: Any, said: Payload) -> dict[str, Any]:
    """Return the fields of a ping; a single velocity is a profile of one cell at distance 0.

    Raises:
        MeasurementError: The message does not match the mapping.
    """
    alone = entry.kind == "velocity"
    cells = _cells(said, entry)
    fields = {
        "coordinate_system": "earth" if alone or entry.frame in ("enu", "ned") else entry.frame,
        "reference": None if entry.reference == "unknown" else entry.reference,
        "orientation": entry.orientation,
        "n_cells": len(cells),
        "velocity": cells,
        "velocity_std": entry.velocity_std,
    }
    depth = _depth(number(said.get("depth")), entry)
    by = "pressure" if entry.depth_unit in _PER_DBAR else "transducer_depth"
    if alone and entry.at_depth is not None:
        fields |= _SURFACE | {"transducer_depth": entry.at_depth}
    elif math.isfinite(depth):
        fields |= _SURFACE | {by: depth}
    else:
        # an unknown depth is the vehicle's, but not the surface; a cell of an instrument is where it is on a vessel that states no depth,
        # too, but a velocity at the vehicle needs the vehicle's
        fields["vehicle_depth_needed"] = bool(entry.depth) or (alone and entry.distance is None)
    if alone:
        # in no dive where a mooring measured
        dive = 0 if entry.elsewhere else None
        return fields | {"cell_distances": [entry.distance or 0.0], "dive": dive}
    return fields | _geometry(said, entry)


def _cells(said: Payload, entry: Any) -> list[list[float]]:
    """Return the cells' components [m/s], east and north first in earth coordinates.

    Raises:
        MeasurementError: See ``_ping``.
    """
    values = said.get("velocity", [said.get("east"), said.get("north")])
    if not isinstance(values, list | tuple):
        raise MeasurementError("measurements.map: velocity is not a list")
    sizes = {len(row) if isinstance(row, list | tuple) else 0 for row in values}
    cells = rows(values)
    if "east" in said:
        cells = cells.T
        if len(sizes) > 1:
            raise MeasurementError("measurements.map: east and north are not lists of one length")
    elif sizes == {0}:
        if not entry.components or len(values) % entry.components:
            raise MeasurementError(
                "measurements.map: velocity is flat; state the number of components per cell"
            )
        cells = cells.reshape(-1, entry.components)
    cells = np.where(np.isin(cells, entry.missing), np.nan, cells)
    cells /= _PER_METRE[entry.speed_unit.removesuffix("/s")]
    if entry.kind == "profile" and entry.frame == "ned":
        cells[:, :2] = cells[:, 1::-1].copy()
        cells[:, 2:3] *= -1.0
    return [*cells.tolist()]


def _geometry(said: Payload, entry: Any) -> dict[str, Any]:
    """Return the geometry of the cells as fields of a ping; depths count as distances from an instrument at the surface."""
    scale = _PER_METRE[entry.distance_unit]
    if entry.cell_size is not None:
        size = said.get("cell_size", entry.cell_size)
        first = said.get("first_cell", entry.first_cell)
        return {"cell_size": number(size) / scale, "bin0_distance": number(first) / scale}
    values = said.get("depths", said.get("distances"))
    if not isinstance(values, list | tuple):
        path = entry.depths or entry.distances
        raise MeasurementError(f"measurements.map: '{path}' is not a list")
    fields: dict[str, Any] = {}
    if entry.depths:
        scale *= _SIGNS[entry.depth_positive]
        fields = _SURFACE | {"orientation": "down"}
    return fields | {"cell_distances": [number(value) / scale for value in values]}
