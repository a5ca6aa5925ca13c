"""A first ``[[measurements.map]]`` entry for a topic that no known kind covers, guessed from names and values.

Each line says why it was guessed. What velocities are relative to cannot be known from one message and is left open: they are not
used until a person states it.
"""

import json
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from replay_kit.logs.tables.suggest_profile import (
    Leaf,
    by_name,
    leaves,
    line,
    named,
    pair,
    profile_lines,
    velocity_lines,
)

_NO_SCHEMA = "message without a schema"
_AT_VEHICLE = line(
    "distance", 0.0, "NOT KNOWN: of the cell from the vehicle, in m; 0 measures at the vehicle"
)
#: Key to schema and payload, as of ``suggestions``.
Samples = Mapping[str, tuple[str, Mapping[str, Any]]]


def _entry(topic: str, head: str, select: list[str], kind: str, lines: list[str]) -> str:
    """Return an entry; one all of whose fields are doubtful is doubtful as a whole."""
    quoted = json.dumps(topic, ensure_ascii=False)
    entry = ["[[measurements.map]]", f"topic = {quoted}", *select, f'kind = "{kind}"']
    if all(each.startswith("#") for each in lines):
        entry = [f"# {each}" for each in entry]
    return "\n".join([f"# {quoted}: {head}", *entry, *lines, ""])


_LATITUDE = re.compile(r"(.*_)?lat(itude)?(_?(deg|rad|e7|int|wgs84))?")
_LONGITUDE = re.compile(r"(.*_)?(lon|lng|long|longitude)(_?(deg|rad|e7|int|wgs84))?")
_DEPTH = re.compile(r"(.*_)?depth(_?m)?")
_PRESSURE = re.compile(r"(.*_)?(fluid_|water_|sea_)?press(ure)?(_?(pa|hpa|kpa|bar|mbar|dbar))?")
_HEIGHT = re.compile(r"(.*_)?(alt|altitude|height|z)(_?m)?")
# where something began, ended or should go, not where the vehicle is
_ELSEWHERE = re.compile(
    r"(?<![A-Za-z])(?i:start|end|goal|home|target|waypoint|destination)(?![a-z])"
)
# of other vectors, a field or a rate, z is no height
_PLACE = re.compile(r"|(.*_)?(pos|position|location|point|place|translation|pose|ned|enu)")
#: MAVLink messages that carry numbers under names of the sender's own.
NAMED = ("NAMED_VALUE_FLOAT", "NAMED_VALUE_INT", "DEBUG_VECT", "DEBUG_FLOAT_ARRAY")
# of topics and names of arrays and vectors: these may be currents
_CURRENT = re.compile(r"adcp|vel|cur|profil|water|flow|speed", re.IGNORECASE)
# longer ones before their ends
_UNIT_IN_NAME = {
    "dbar": "dbar",
    "mbar": "hPa",
    "hpa": "hPa",
    "kpa": "kPa",
    "bar": "bar",
    "pa": "Pa",
}
# an absolute pressure near the surface is one atmosphere
_ATMOSPHERE = {"Pa": 101_325.0, "hPa": 1013.25, "kPa": 101.325, "bar": 1.01325}


def suggestion(topic: str, schema: str, payload: Mapping[str, Any]) -> str | None:
    """Return the TOML of an entry for a topic, with a comment on each guess; None when nothing in the message looks usable.

    Args:
        topic: The topic.
        schema: Its schema's name, for the comment.
        payload: One of its messages.
    """
    found, name = [*leaves(payload)], payload.get("name")
    named_by_sender = sample_key(topic, payload) != topic
    names = {"value": str(name).lower()} if named_by_sender else {}
    # an array of floats that is no ping of ours has no other use than a profile, whatever its name
    label = f"{topic} {name if named_by_sender else ''}"
    if _CURRENT.search(label) or topic.endswith("/DEBUG_FLOAT_ARRAY"):
        names |= {"data": "velocity"} | ({"x": "east", "y": "north"} if named_by_sender else {})
    found = [leaf._replace(name=names.get(leaf.path, leaf.name)) for leaf in found]
    select = [f"name = {json.dumps(name, ensure_ascii=False)}"] if named_by_sender else []
    scalars = [leaf for leaf in found if leaf.shape == ()]
    profile = profile_lines(found)
    guesses = {
        "profile": [*profile, *_place(scalars)] if profile else [],
        "velocity": _velocity(scalars),
        "position": _position(scalars),
        "depth": _depth_lines(scalars),
    }
    head = f"{len(found)} numbers in a {schema or _NO_SCHEMA}"
    return next(
        (_entry(topic, head, select, kind, lines) for kind, lines in guesses.items() if lines), None
    )


def sample_key(topic: str, payload: Mapping[str, Any]) -> str:
    """Return what a message is a sample of: its topic, and on topics that carry several things under names its name."""
    name = payload.get("name")
    named_by_sender = topic.rpartition("/")[2] in NAMED and isinstance(name, str)
    return f"{topic}\n{name}" if named_by_sender else topic


def suggested_entries(samples: Samples) -> dict[str, str]:
    """Return the TOML of each entry that can be guessed, by the key of its messages.

    Args:
        samples: As of ``suggestions``.
    """
    found = {
        key: suggestion(key.partition("\n")[0], schema, payload)
        for key, (schema, payload) in samples.items()
    }
    return {key: entry for key, entry in sorted(found.items()) if entry}


def suggestions(samples: Samples) -> str:
    """Return a TOML file of entries for topics that no known kind covers.

    Args:
        samples: Key, as of ``sample_key``, to its schema's name and one of its messages.
    """
    head = (
        "# A first mapping, guessed by names and values from one message of each topic that no known kind covers.\n"
        "# Check every line, above all reference, frame and units, before you use it: replay-kit replay --config THIS.toml\n"
    )
    entries = "".join(f"\n{entry}" for entry in suggested_entries(samples).values())
    return head + (
        entries or "# Nothing in the log looks like a position, a depth, a velocity or a profile.\n"
    )


def _velocity(scalars: Sequence[Leaf]) -> list[str]:
    """Return the lines of one velocity at one depth, with its place where the message has one."""
    lines = velocity_lines(scalars)
    if not lines:
        return []
    place, depth = _place(scalars), named(scalars, _DEPTH)
    where = [_AT_VEHICLE]
    if depth is not None:
        where = _as_depth(depth)
    elif place and not place[0].startswith("#"):
        unknown = "NOT FOUND in the message: state the depth of the measurement, in m"
        where = [line("at_depth", 0.0, unknown)]
    return [*lines, *place, *where]


def _position(scalars: Sequence[Leaf]) -> list[str]:
    place = _place(scalars)
    # a position must have its place
    depth = [] if any(text.startswith("#") for text in place) else _depth_lines(scalars)
    return [*place, *depth] if place else []


def _place(scalars: Sequence[Leaf]) -> list[str]:
    """Return the lines of a position, commented out when there is none but of another time or purpose."""
    here = [leaf for leaf in scalars if not _ELSEWHERE.search(leaf.path)]
    return _pair(here) or [
        f"# {text}: by its name not where the vehicle is" for text in _pair(scalars)
    ]


def _pair(scalars: Sequence[Leaf]) -> list[str]:
    found = pair(scalars, _LATITUDE, _LONGITUDE)
    if found is None:
        return []
    latitude, longitude = found
    x, y = longitude.values[0], latitude.values[0]
    unit, why = "deg", f"the latitude is {y:g}"
    if abs(y) > 90.0 or abs(x) > 360.0:
        unit, why = "degE7", f"{x:g} is more than a turn"
    elif "rad" in latitude.name or (abs(y) <= math.pi / 2.0 and 0.0 < abs(x) <= math.pi):
        unit, why = "rad", f"{why}; write deg if these are degrees"
    return [*by_name(longitude=longitude, latitude=latitude), line("angle_unit", unit, why)]


def _depth_lines(scalars: Sequence[Leaf]) -> list[str]:
    """Return the lines of a depth: a depth if there is one, else a pressure, else a height, which only a person can place."""
    of_place = [
        leaf
        for leaf in scalars
        if leaf.name != "z" or _PLACE.fullmatch(leaf.parent.rpartition(".")[2].lower())
    ]
    for pattern, lines in ((_DEPTH, _as_depth), (_PRESSURE, _as_pressure), (_HEIGHT, _as_height)):
        if (leaf := named(of_place, pattern)) is not None:
            return lines(leaf)
    return []


def _as_depth(leaf: Leaf) -> list[str]:
    value = leaf.values[0]
    up, sign = ("up", "negative") if value < 0.0 else ("down", "positive")
    return [
        *by_name(depth=leaf),
        line("depth_unit", "m", "the usual one"),
        line("depth_positive", up, f"{value:g}: {sign} below the surface"),
    ]


def _as_pressure(leaf: Leaf) -> list[str]:
    value = leaf.values[0]
    stated = next((unit for end, unit in _UNIT_IN_NAME.items() if leaf.name.endswith(end)), None)
    near = [
        unit
        for unit, one in _ATMOSPHERE.items()
        if stated in (None, unit) and 0.8 * one < value < 1.2 * one
    ]
    large = "Pa" if value > 1e5 else "dbar"
    unit = stated or (near[0] if near else large)
    why = "in its name" if stated else "by its size; check it"
    air = "whether the atmosphere is in it: check a value at the surface"
    return [
        line("depth", leaf.path, "a pressure by its name"),
        line("depth_unit", unit, f"{why}: {value:g}"),
        line("depth_absolute", bool(near) or unit == large == "Pa", air),
    ]


def _as_height(leaf: Leaf) -> list[str]:
    why = f"{leaf.values[0]:g}: use it if it is counted from the sea surface, not from the sea floor or the ellipsoid"
    return [
        "# " + line("depth", leaf.path, why),
        "# " + line("depth_positive", "up", "z and heights grow upwards"),
    ]
