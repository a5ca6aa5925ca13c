"""Suggested ``[[measurements.map]]`` entry for an unknown topic, from names and values.

Each line states its evidence. The reference of velocities cannot be derived from one message: they are not used until the user states it.
"""

import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.logs.tables.columns import number, numbers, rows

_DEEPEST, _PATH_PART = 12, re.compile(r"[^.\s]([^.]*[^.\s])?")
#: Key to schema and payload, as of ``suggestions``.
Samples = Mapping[str, tuple[str, Mapping[str, Any]]]
#: MAVLink messages that carry numbers under names of the sender's own.
NAMED = ("NAMED_VALUE_FLOAT", "NAMED_VALUE_INT", "DEBUG_VECT", "DEBUG_FLOAT_ARRAY")
# of topics and names of arrays and vectors: these may be currents
_CURRENT = re.compile(r"adcp|vel|cur|profil|water|flow|speed", re.IGNORECASE)
# where something began, ended or should go, not where the vehicle is
_ELSEWHERE = re.compile(
    r"(?<![A-Za-z])(?i:start|end|goal|home|target|waypoint|destination)(?![a-z])"
)
# what may stand before a name, and ends of names of what each setting may be
_ANGLE = r"(_?(deg|rad|e7|int|wgs84))?"
_ENDS = {
    "latitude": rf"lat(itude)?{_ANGLE}",
    "longitude": rf"(lon|lng|long|longitude){_ANGLE}",
    "depth": r"depth",
    "pressure": r"(fluid_|water_|sea_)?press(ure)?(_?(pa|hpa|kpa|bar|mbar|dbar))?",
    "height": r"(alt|altitude|height|z)",
    "east": r"(east(ward)?(_vel(ocity)?)?|u|ve|vel_e)",
    "north": r"(north(ward)?(_vel(ocity)?)?|v|vn|vel_n)",
    "velocity": r"(vel|velocity|velocities|current|currents|vel_data|velocity_data)",
    "depths": r"(cell_|bin_)?depths?",
    "distances": r"(distances?|ranges?|cell_positions?)",
    "cell_size": r"(cell|bin)_?(size|length|height|depth)",
    "first_cell": r"(bin0_?distance|bin1_?distance|first_?(cell|bin)(_?distance)?|blanking(_?distance)?)",
    "count": r"(n|num|number_of|no_of)?_?(cells|bins)",
}
_NAMES = {key: re.compile(rf"(.*_)?{end}") for key, end in _ENDS.items()}
_LONLAT = ("longitude", "latitude")
# of other vectors, a field or a rate, z is no height
_PLACE = re.compile(r"|(.*_)?(pos|position|location|point|place|translation|pose|ned|enu)")
# ends of names of pressures, longer ones first, the unit, and in it an atmosphere, which an absolute one near the surface is
_PRESSURES = {
    "dbar": ("dbar", math.inf),
    "mbar": ("hPa", 1013.25),
    "hpa": ("hPa", 1013.25),
    "kpa": ("kPa", 101.325),
    "bar": ("bar", 1.01325),
    "pa": ("Pa", 101_325.0),
}
# a unit of length, or of speed, at the end of a name
_UNIT = re.compile(r"(.+)_(mm|cm|dm|m)(_?p?s|_per_s)?")
# a flat list this short is one velocity, not a profile
_SHORTEST_FLAT = 6
_MISSING = (-32768.0, -9999.0, 9999.0, -999.0)
# no current in m/s is as fast
_NO_MPS = 20.0
_IN_NAME = "in its name"
_UNKNOWN = "NOT KNOWN from the message"
_REFERENCE = f'reference = "unknown"  # {_UNKNOWN}, so it is not used yet: earth if the vehicle\'s motion is removed, else platform'
_AT_DEPTH = "at_depth = 0.0  # NOT FOUND in the message: state it, in m"
_AT_VEHICLE = (
    "distance = 0.0  # NOT KNOWN: of the cell from the vehicle, in m; 0 measures at the vehicle"
)


class Leaf(NamedTuple):
    """A number, a list of numbers or a list of lists of numbers.

    Attributes:
        path: Path in the payload.
        name: Its last field name, in lower case.
        values: shape () for a number, (n,) for a list, (n, m) for n lists; NaN if missing.
        unit: Unit of length, in a speed too, that its name stated; else empty.
    """

    path: str
    name: str
    values: Array
    unit: str = ""

    @property
    def parent(self) -> str:
        """Path of the parent."""
        return self.path.rpartition(".")[0]


def leaves(value: Any, path: str = "") -> Iterator[Leaf]:
    """Yield the numbers of a payload in order; texts, flags and fields that no path can name are skipped."""
    name = path.removesuffix(".*").rpartition(".")[2].lower()
    if isinstance(value, Mapping) and path.count(".") < _DEEPEST - 1:
        for key, item in value.items():
            if isinstance(key, str) and _PATH_PART.fullmatch(key):
                yield from leaves(item, f"{path}.{key}" if path else key)
    elif type(value) in (int, float):
        yield Leaf(path, name, np.array(number(value)))
    elif not isinstance(value, list | tuple) or not value:
        return
    elif all(isinstance(item, Mapping) for item in value):
        # every item is taken to be like the first
        within = [{leaf.path: leaf for leaf in leaves(item)} for item in value]
        for key, inner in within[0].items():
            if inner.values.ndim < 2 and all(key in found for found in within):
                values = rows([found[key].values.tolist() for found in within])
                yield Leaf(
                    f"{path}.*.{key}", inner.name, values if inner.values.ndim else values[:, 0]
                )
    else:
        nested = any(isinstance(row, list | tuple) for row in value)
        single = [one for row in value for one in (row if isinstance(row, list | tuple) else [row])]
        if all(type(one) in (int, float, type(None)) for one in single):
            yield Leaf(path, name, rows(value) if nested else numbers(value))


def suggestion(topic: str, schema: str, payload: Mapping[str, Any]) -> str | None:
    """Return the TOML of an entry for a topic, with a comment on each guess; None if nothing seems usable.

    Args:
        topic: Topic.
        schema: Name of its schema, for the comment.
        payload: One of its messages.
    """
    found, own_name = [*leaves(payload)], sample_key(topic, payload)[len(topic) + 1 :]
    names = {"value": own_name.lower()} if own_name else {}
    # an array of floats that is no ping of ours has no other use than a profile, whatever its name
    if _CURRENT.search(f"{topic} {own_name}") or topic.endswith("/DEBUG_FLOAT_ARRAY"):
        names |= {"data": "velocity"} | ({"x": "east", "y": "north"} if own_name else {})
    found = [_with_unit(leaf._replace(name=names.get(leaf.path, leaf.name))) for leaf in found]
    scalars = [leaf for leaf in found if not leaf.values.ndim]
    profile, velocity = _profile(found, scalars), _velocity(scalars)
    place, depth = _place(scalars), _depth(scalars)
    placed, deep = (bool(lines) and not lines[0].startswith("#") for lines in (place, depth))
    where = depth if deep else [_AT_DEPTH if placed else _AT_VEHICLE]
    guesses = {
        "profile": profile and profile + place,
        "velocity": velocity and velocity + place + where,
        # a position must have its place
        "position": place + depth if placed else place,
        "depth": depth,
    }
    kind, lines = next(((kind, lines) for kind, lines in guesses.items() if lines), ("", []))
    quoted = _quoted(topic)
    select = [f"name = {_quoted(own_name)}"] if own_name else []
    entry = ["[[measurements.map]]", f"topic = {quoted}", *select, f'kind = "{kind}"']
    # an entry all of whose fields are doubtful is doubtful as a whole
    mark = "# " if all(text.startswith("#") for text in lines) else ""
    head = f"# {quoted}: {len(found)} numbers in a {schema or 'message without a schema'}"
    return "\n".join([head, *(mark + text for text in entry), *lines, ""]) if lines else None


def _with_unit(leaf: Leaf) -> Leaf:
    stated = _UNIT.fullmatch(leaf.name)
    return leaf._replace(name=stated[1], unit=stated[2]) if stated else leaf


def sample_key(topic: str, payload: Mapping[str, Any]) -> str:
    """Return the key of a message: its topic, with its name on topics that carry several named quantities."""
    name = payload.get("name")
    named_by_sender = topic.rpartition("/")[2] in NAMED and isinstance(name, str)
    return f"{topic}\n{name}" if named_by_sender else topic


def suggested_entries(samples: Samples) -> dict[str, str]:
    """Return the TOML of each suggested entry by message key.

    Args:
        samples: See ``suggestions``.
    """
    found = {}
    for key, (schema, payload) in sorted(samples.items()):
        if entry := suggestion(key.partition("\n")[0], schema, payload):
            found[key] = entry
    return found


def suggestions(samples: Samples) -> str:
    """Return a TOML file of entries for unknown topics.

    Args:
        samples: Key, from ``sample_key``, to the schema name and a message.
    """
    head = (
        "# A first mapping, guessed from one message of each topic of unknown type.\n"
        "# Check every line, above all reference, frame and units; then: replay-kit replay --config THIS.toml\n"
    )
    entries = "".join(f"\n{entry}" for entry in suggested_entries(samples).values())
    return head + (
        entries or "# Nothing in the log looks like a position, a depth, a velocity or a profile.\n"
    )


def _quoted(value: object) -> str:
    return json.dumps(value, ensure_ascii=False)


def _line(key: str, value: object, why: str = "by its name") -> str:
    """Return one line of an entry with its comment."""
    return f"{key} = {_quoted(value)}  # {why}"


def _pick(found: Sequence[Leaf], *keys: str) -> dict[str, Leaf]:
    """Return the first leaves of one shape and parent for the given settings, by name; empty if one is missing."""
    for one in found:
        beside = [leaf for leaf in found if leaf.parent == one.parent]
        alike = [leaf for leaf in beside if leaf.values.shape == one.values.shape]
        picked = {
            key: leaf
            for key in keys
            for leaf in reversed(alike)
            if _NAMES[key].fullmatch(leaf.name)
        }
        if len(picked) == len(keys) and one is picked[keys[0]]:
            return picked
    return {}


def _lines(picked: Mapping[str, Leaf], why: str = "by its name") -> list[str]:
    return [_line(key, leaf.path, why) for key, leaf in picked.items()]


def _place(scalars: Sequence[Leaf]) -> list[str]:
    """Return the lines of a position, commented out if only one of another time or purpose exists."""
    here = _pick([leaf for leaf in scalars if not _ELSEWHERE.search(leaf.path)], *_LONLAT)
    found = here or _pick(scalars, *_LONLAT)
    if not found:
        return []
    x, y = (float(leaf.values) for leaf in found.values())
    unit, why = "deg", f"the latitude is {y:g}"
    if abs(y) > 90.0 or abs(x) > 360.0:
        unit, why = "degE7", f"{x:g} is more than a turn"
    elif "rad" in found["latitude"].name or (abs(y) <= math.pi / 2.0 and 0.0 < abs(x) <= math.pi):
        unit, why = "rad", f"{why}; write deg if these are degrees"
    lines = [*_lines(found), _line("angle_unit", unit, why)]
    return (
        lines if here else [f"# {text}: by its name not the vehicle's position" for text in lines]
    )


def _velocity(scalars: Sequence[Leaf]) -> list[str]:
    """Return the lines of a velocity at one depth; empty if no two numbers seem to be its components."""
    names = {"linear.x": "east", "linear.y": "north"}
    twist = [leaf._replace(name=names.get(leaf.path[-8:], "")) for leaf in scalars]
    found, why = _pick(scalars, "east", "north"), "by its name"
    if not found:
        found, why = (
            _pick(twist, "east", "north"),
            "a twist's: only if its frame is east, north, up",
        )
    return [_REFERENCE, *_lines(found, why), *_speed(found)] if found else []


def _depth(scalars: Sequence[Leaf]) -> list[str]:
    """Return the lines of a depth: from a depth, else a pressure, else a height, which the user must resolve."""
    of_place = [
        leaf
        for leaf in scalars
        if leaf.name != "z" or _PLACE.fullmatch(leaf.parent.rpartition(".")[2].lower())
    ]
    picked = [key for key in ("depth", "pressure", "height") if _pick(of_place, key)]
    if not picked:
        return []
    leaf = _pick(of_place, picked[0])[picked[0]]
    value, path = float(leaf.values), _line("depth", leaf.path)
    if picked[0] == "height":
        surface = (
            "only if it is counted from the sea surface, not from the sea floor or the ellipsoid"
        )
        return [f"# {path}, {value:g}: {surface}", f"# {_line('depth_positive', 'up')}"]
    if picked[0] == "depth":
        up, sign = ("up", "negative") if value < 0.0 else ("down", "positive")
        why = f"{value:g}: {sign} below the surface"
        unit = _line("depth_unit", leaf.unit or "m", _IN_NAME if leaf.unit else "the usual one")
        return [path, unit, _line("depth_positive", up, why)]
    stated = [unit for end, (unit, _) in _PRESSURES.items() if leaf.name.endswith(end)][:1]
    near = [unit for unit, air in _PRESSURES.values() if 0.8 * air < value < 1.2 * air]
    unit = [*stated, *near, "Pa" if value > 1e5 else "dbar"][0]
    absolute = unit in near or (unit == "Pa" and value > 1e5)
    air = "whether the atmosphere is in it: check a value at the surface"
    why = f"{_IN_NAME if stated else 'by its size; check it'}: {value:g}"
    return [path, _line("depth_unit", unit, why), _line("depth_absolute", absolute, air)]


def _profile(found: Sequence[Leaf], scalars: Sequence[Leaf]) -> list[str]:
    """Return the lines of a profile entry; empty if no list seems to be velocities."""
    nested = [leaf for leaf in found if leaf.values.ndim == 2 and leaf.values.shape[1] > 1]
    lists = [leaf for leaf in found if leaf.values.ndim == 1]
    # a flat list that is shorter is one velocity, not a profile
    flat = _pick([leaf for leaf in lists if leaf.values.size >= _SHORTEST_FLAT], "velocity")
    columns = _pick(lists, "east", "north") or _pick(nested, "velocity")
    picked = columns or flat
    if not picked:
        return []
    lines, n = _lines(picked), len(next(iter(picked.values())).values)
    if not columns:
        counts = [leaf.values for leaf in scalars if _NAMES["count"].fullmatch(leaf.name)]
        fitting = [n // int(count) for count in counts if 1.0 <= count < n and n % count == 0]
        why = "from the number of cells" if fitting else _UNKNOWN
        components = [*fitting, 2 if n % 3 else 3][0]
        n, lines = n // components, [*lines, _line("components", components, why)]
    frame = _line("frame", "enu", f"{_UNKNOWN}: enu, ned, ship, instrument or beam")
    return [_REFERENCE, frame, *lines, *_speed(picked), *_geometry(found, scalars, n)]


def _speed(picked: Mapping[str, Leaf]) -> list[str]:
    """Return the lines of the unit of velocities and of their missing values."""
    values = np.concatenate([leaf.values.ravel() for leaf in picked.values()])
    stand_in = np.isin(values, _MISSING)
    known = np.abs(values[np.isfinite(values) & ~stand_in])
    whole, fast = known.any() and not (known % 1.0).any(), known.max(initial=0.0)
    unit = "mm/s" if whole or fast > _NO_MPS else "m/s"
    why = f"up to {fast:g}{', whole numbers' if whole else ''}; check it"
    for stated in (leaf.unit for leaf in picked.values() if leaf.unit):
        unit, why = f"{stated}/s", _IN_NAME
    missing = np.unique(values[stand_in]).tolist()
    marks = [_line("missing", missing, "these stand for no velocity")] if missing else []
    return [_line("speed_unit", unit, why), *marks]


def _geometry(found: Sequence[Leaf], scalars: Sequence[Leaf], n_cells: int) -> list[str]:
    """Return the lines of the cell geometry of a profile, from the other numbers."""
    listed = [leaf for leaf in found if leaf.values.shape == (n_cells,)]
    picked = _pick(listed, "depths") or _pick(listed, "distances")
    lines = _lines(picked)
    if "depths" in picked and (least := picked["depths"].values.min()) < 0.0:
        lines.append(_line("depth_positive", "up", f"{least:g}: negative below the surface"))
    for key in ("cell_size", "first_cell")[: 2 * (not lines)]:
        blanking = "; blanking ends half a cell before: add it"
        near = _pick(scalars, key)
        picked |= near
        lines += [
            _line(key, one.path, f"{one.values:g}" + blanking * ("blanking" in one.name))
            for one in near.values()
        ] or [_line(key, 1.0, "NOT FOUND: state the instrument's, in m")]
    units = [one.unit for one in picked.values() if one.unit]
    return [*lines, *(_line("distance_unit", unit, _IN_NAME) for unit in units[:1])]
