"""Messages read by a mapping of the configuration, ``[[measurements.map]]``; and drafts of entries for topics of unknown type.

A draft is by the names of the fields and the units in them, and a person checks it: each line says where it comes from. The reference of
velocities is in no name: until it is stated they are not used.
"""

import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from replay_kit.config.mapping import TopicMap
from replay_kit.config.run import MeasurementConfig
from replay_kit.core.errors import MeasurementError
from replay_kit.core.observation.table import Raw, Table
from replay_kit.logs.tables.columns import (
    Payload,
    Rows,
    field,
    first_reason,
    number,
    numbers,
    padded_rows,
    result_or_reason,
    some_messages,
    unused_table,
    used_and_unused,
)
from replay_kit.logs.tables.instruments import ping_tables
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


def mapped_tables(entry: TopicMap, raw: Raw, config: MeasurementConfig) -> list[Table]:
    """Return the tables of messages by their topic's mapping.

    Args:
        entry: Mapping.
        raw: Messages.
        config: see ``ping_tables``.
    """
    found = [result_or_reason(partial(_mapped_values, entry), payload) for payload in raw.payloads]
    words = [one if isinstance(one, str) else "" for one in found]
    tables, raw = unused_table(raw, words), some_messages(raw, np.equal(words, ""))
    said = [one for one in found if not isinstance(one, str)]
    by = "pressure" if entry.depth and entry.depth_unit in _PER_DBAR else "depth"
    depth = _depth(numbers(field(said, "depth")), entry)
    if entry.kind == "depth":
        return tables + used_and_unused(raw, Rows("depth", {by: depth}, fixed={"by": by}))
    places = [numbers(field(said, name)) for name in ("longitude", "latitude")]
    places = [place / _PER_DEGREE[entry.angle_unit] for place in places]
    wrong = no_place(*places)
    columns = {"longitude": places[0], "latitude": places[1], by: depth}
    positions = Rows("position", {**columns, "dead_reckoned": entry.dead_reckoned}, wrong)
    if entry.kind == "position":
        return tables + used_and_unused(raw, positions)
    payloads: Any = [result_or_reason(partial(_ping, entry), one) for one in said]
    there = np.full((len(said), 3), np.nan)
    if entry.kind == "velocity" and entry.place:
        there[:, :2] = entry.place
    elif entry.kind == "velocity" and entry.longitude:
        there[:, :2] = np.transpose(places)
        payloads = [
            word or one for word, one in zip(first_reason(wrong).tolist(), payloads, strict=True)
        ]
    elif entry.longitude:
        beside = used_and_unused(raw, positions._replace(fixed={"beside": True}))
        # a message without a fix still has its profile, which other positions may place
        tables += [one for one in beside if one.kind == "position"]
    return tables + ping_tables(raw, payloads, config, places=there)


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
    cells = padded_rows(values)
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


_DEEPEST, _PATH_PART = 12, re.compile(r"[^.\s]([^.]*[^.\s])?")
#: Topic to the name of its schema and one of its messages.
Samples = Mapping[str, tuple[str, Mapping[str, Any]]]
# where something began, ended or should go, not where the vehicle is
_ELSEWHERE = re.compile(
    r"(?<![A-Za-z])(?i:start|end|goal|home|target|waypoint|destination)(?![a-z])"
)
_ANGLE, _PRESSURE = r"(_?(?P<unit>deg|rad|e7))?", r"(_?(?P<unit>dbar|mbar|bar|hpa|kpa|pa))?"
_LENGTH, _SPEED = r"(_(?P<unit>mm|cm|dm|m))?", r"(_(?P<unit>mm|cm|dm|m)(_?p?s|_per_s)?)?"
# ends of paths, in lower case, by what they may hold
_ENDS = {
    "latitude": f"lat(itude)?{_ANGLE}",
    "longitude": f"(lon|lng|long|longitude){_ANGLE}",
    "depth": f"depth{_LENGTH}",
    "pressure": f"press(ure)?{_PRESSURE}",
    "east": rf"(east(ward)?(_vel(ocity)?)?|u|ve|vel_e|linear\.x){_SPEED}",
    "north": rf"(north(ward)?(_vel(ocity)?)?|v|vn|vel_n|linear\.y){_SPEED}",
    "velocity": f"(vel|velocity|velocities|currents?|(vel|velocity)_data){_SPEED}",
    "depths": f"(cell_|bin_)?depths?{_LENGTH}",
    "distances": f"(distances?|ranges?|cell_positions?){_LENGTH}",
    "cell_size": f"(cell|bin)_?(size|length|height|depth){_LENGTH}",
    "first_cell": f"(bin0_?distance|bin1_?distance|first_?(cell|bin)(_?distance)?){_LENGTH}",
}
_NAMES = {key: re.compile(rf"(.*[._])?{end}") for key, end in _ENDS.items()}
# units as the mapping spells them, where a name spells them otherwise
_UNITS = {"e7": "degE7", "mbar": "hPa", "hpa": "hPa", "kpa": "kPa", "pa": "Pa"}
# the setting of what has another name here
_SETTINGS = {"pressure": "depth"}
# a flat list this short is one velocity, not a profile
_SHORTEST_FLAT = 6
_CHECK = "NOT KNOWN from the names"
_HEAD = """\
# A first mapping, by the names of the fields of each topic of unknown type.
# Check every line, above all reference, frame and units; then: replay-kit replay --config THIS.toml
"""


class Leaf(NamedTuple):
    """Path of a number, a list of numbers or a list of lists of numbers in a payload, with its shape."""

    path: str
    shape: tuple[int, ...]

    @property
    def place(self) -> tuple[str, tuple[int, ...]]:
        """Path of the parent, and the shape: numbers that belong together have both in common."""
        return self.path.rpartition(".")[0], self.shape


def _leaves(value: Any, path: str = "") -> Iterator[Leaf]:
    """Yield the numbers of a payload; all items of a list are taken to be like the first that is there."""
    if isinstance(value, Mapping) and path.count(".") < _DEEPEST - 1:
        for key, item in value.items():
            if isinstance(key, str) and _PATH_PART.fullmatch(key):
                yield from _leaves(item, f"{path}.{key}" if path else key)
    elif type(value) in (int, float):
        yield Leaf(path, ())
    elif isinstance(value, list | tuple):
        first = next((item for item in value if item is not None), None)
        each = f"{path}.*" if isinstance(first, Mapping) else path
        yield from (Leaf(one, (len(value), *inner)) for one, inner in _leaves(first, each))


def suggestion(topic: str, schema: str, payload: Mapping[str, Any]) -> tuple[str, str] | None:
    """Return the kind of an entry for a topic, and its TOML with a comment on each guess; None if nothing seems usable.

    Args:
        topic: Topic.
        schema: Name of its schema, for the comment.
        payload: One of its messages.
    """
    found = [leaf for leaf in _leaves(payload) if not _ELSEWHERE.search(leaf.path)]
    numbers = [leaf for leaf in found if not leaf.shape]
    place = _lines(_picked(numbers, "longitude", "latitude"), "angle_unit", "deg")
    depth = _depth_line(numbers)
    profile, velocity = _profile(found), _picked(numbers, "east", "north")
    if profile:
        kind, lines = "profile", profile + place
    elif velocity:
        # without a depth its own place, or the vehicle's, needs one
        where = _line("at_depth" if place else "distance", 0.0, f"{_CHECK}: state it, in m")
        kind, lines = "velocity", _velocity(velocity) + place + (depth or [where])
    else:
        kind, lines = "position" if place else "depth", place + depth
    head = f"# {len(found)} numbers in a message of the schema {_quoted(schema)}"
    entry = [head, "[[measurements.map]]", f"topic = {_quoted(topic)}", f'kind = "{kind}"']
    return (kind, "\n".join([*entry, *lines, ""])) if lines else None


def suggested_entries(samples: Samples) -> dict[str, tuple[str, str]]:
    """Return the kind and the TOML of each suggested entry by topic."""
    entries = {topic: suggestion(topic, *sample) for topic, sample in sorted(samples.items())}
    return {topic: entry for topic, entry in entries.items() if entry}


def suggestions(samples: Samples) -> str:
    """Return a TOML file of entries for unknown topics."""
    entries = "".join(f"\n{entry}" for _, entry in suggested_entries(samples).values())
    nothing = "# Nothing in the log looks like a position, a depth, a velocity or a profile.\n"
    return _HEAD + (entries or nothing)


def _quoted(value: object) -> str:
    # the one character that TOML forbids and JSON does not
    return json.dumps(value, ensure_ascii=False).replace("\x7f", r"\u007f")


def _line(key: str, value: object, why: str = _CHECK) -> str:
    """Return one line of an entry with its comment."""
    return f"{key} = {_quoted(value)}  # {why}"


def _picked(found: Sequence[Leaf], *keys: str) -> dict[str, str]:
    """Return the first paths that belong together for the given settings; empty if one is missing."""
    for place in dict.fromkeys(leaf.place for leaf in found):
        beside = [leaf.path for leaf in found if leaf.place == place]
        fitting = [[p for p in beside if _NAMES[key].fullmatch(p.lower())] for key in keys]
        if all(fitting):
            return {key: paths[0] for key, paths in zip(keys, fitting, strict=True)}
    return {}


def _lines(picked: Mapping[str, str], unit: str, usual: str) -> list[str]:
    """Return the lines of settings and of their unit: that in a name, else the usual one."""
    named = [_line(_SETTINGS.get(key, key), path, "by its name") for key, path in picked.items()]
    for key, path in picked.items():
        match = _NAMES[key].fullmatch(path.lower())
        if match and (stated := match["unit"]):
            spelt = f"{stated}/s" if unit == "speed_unit" else _UNITS.get(stated, stated)
            return [*named, _line(unit, spelt, "in its name")]
    return [*named, _line(unit, usual)] if named else []


def _depth_line(numbers: Sequence[Leaf]) -> list[str]:
    """Return the lines of a depth, or of a pressure."""
    if depth := _picked(numbers, "depth"):
        return [*_lines(depth, "depth_unit", "m"), _line("depth_positive", "down")]
    if pressure := _picked(numbers, "pressure"):
        lines = _lines(pressure, "depth_unit", "dbar")
        return [*lines, _line("depth_absolute", False, f"{_CHECK}: check a value at the surface")]
    return []


def _velocity(picked: Mapping[str, str]) -> list[str]:
    """Return the lines of velocities."""
    why = (
        f"{_CHECK}, so it is not used yet: earth if the vehicle's motion is removed, else platform"
    )
    return [_line("reference", "unknown", why), *_lines(picked, "speed_unit", "m/s")]


def _profile(found: Sequence[Leaf]) -> list[str]:
    """Return the lines of a profile; empty if no list seems to be velocities."""
    lists = [leaf for leaf in found if len(leaf.shape) == 1]
    nested = [leaf for leaf in found if len(leaf.shape) == 2]
    flat = _picked([leaf for leaf in lists if leaf.shape[0] >= _SHORTEST_FLAT], "velocity")
    columns = _picked(lists, "east", "north") or _picked(nested, "velocity")
    if not (columns or flat):
        return []
    sizes = [leaf.shape[:1] for leaf in found if leaf.path in columns.values()]
    listed = [leaf for leaf in lists if leaf.shape in sizes]
    cells = _picked(listed, "depths") or _picked(listed, "distances")
    scalars = [leaf for leaf in found if not leaf.shape]
    near = {} if cells else _picked(scalars, "cell_size") | _picked(scalars, "first_cell")
    lines = _lines(cells or near, "distance_unit", "m")
    lacking = () if cells else {"cell_size", "first_cell"} - near.keys()
    lines += [_line(key, 1.0, f"{_CHECK}: the instrument's") for key in sorted(lacking)]
    flattened = [] if columns else [_line("components", 2)]
    frame = _line("frame", "enu", f"{_CHECK}: enu, ned, ship, instrument or beam")
    return [*_velocity(columns or flat), frame, *flattened, *lines]
