"""A first ``[[measurements.map]]`` entry for a topic that no known kind covers, guessed from names and values.

Each line says why it was guessed. What velocities are relative to cannot be known from one message and is left open: they are not
used until a person states it.
"""

import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from replay_kit.logs.tables.columns import number

_DEEPEST = 12
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
_NAMES = {
    "latitude": rf"lat(itude)?{_ANGLE}",
    "longitude": rf"(lon|lng|long|longitude){_ANGLE}",
    "depth": r"depth(_?m)?",
    "pressure": r"(fluid_|water_|sea_)?press(ure)?(_?(pa|hpa|kpa|bar|mbar|dbar))?",
    "height": r"(alt|altitude|height|z)(_?m)?",
    "east": r"(east|eastward|u|ve|vel_e|vel_east|east_vel|velocity_east|east_velocity)",
    "north": r"(north|northward|v|vn|vel_n|vel_north|north_vel|velocity_north|north_velocity)",
    "velocity": r"(vel|velocity|velocities|current|currents|vel_data|velocity_data)",
    "depths": r"(cell_|bin_)?depths?",
    "distances": r"(distances?|ranges?|cell_positions?)",
    "cell_size": r"(cell|bin)_?(size|length|height|depth)",
    "first_cell": r"(bin0_?distance|bin1_?distance|first_?(cell|bin)(_?distance)?|blanking(_?distance)?)",
    "count": r"(n|num|number_of|no_of)?_?(cells|bins)",
}
_PATTERNS = {key: re.compile(rf"(.*_)?{name}") for key, name in _NAMES.items()}
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
# a flat list this short is one velocity, not a profile
_SHORTEST_FLAT = 6
_MISSING = (-32768.0, -9999.0, 9999.0, -999.0)
# no current in m/s is as fast
_NO_MPS = 20.0
_UNKNOWN = "NOT KNOWN from the message"
_REFERENCE = f'reference = "unknown"  # {_UNKNOWN}, so it is not used yet: earth if the vehicle\'s motion is removed, else platform'


class Leaf(NamedTuple):
    """A number, a list of numbers or a list of lists of numbers.

    Attributes:
        path: Where it stands.
        name: Its last field name, in lower case.
        shape: () for a number, (n,) for a list, (n, m) for n lists of which the first has m.
        values: The numbers in one row; NaN for what is missing.
    """

    path: str
    name: str
    shape: tuple[int, ...]
    values: tuple[float, ...]

    @property
    def parent(self) -> str:
        """The path of what holds it."""
        return self.path.rpartition(".")[0]

    def is_a(self, key: str) -> bool:
        """Return whether its name is one of a setting's."""
        return _PATTERNS[key].fullmatch(self.name) is not None


def leaves(value: Any, path: str = "") -> Iterator[Leaf]:
    """Yield the numbers of a payload, in its order; texts, flags and what no path can name are left out."""
    if isinstance(value, Mapping) and path.count(".") < _DEEPEST - 1:
        for key, item in value.items():
            if isinstance(key, str) and key and "." not in key and key == key.strip():
                yield from leaves(item, f"{path}.{key}" if path else key)
    elif _is_row([value]) and value is not None:
        yield _leaf(path, (), [value])
    elif isinstance(value, list | tuple) and value:
        yield from _in_list(value, path)


def _in_list(items: Sequence[Any], path: str) -> Iterator[Leaf]:
    n, rows = len(items), [item for item in items if item is not None]
    if all(isinstance(item, Mapping) for item in items):
        # every item is taken to be like the first
        within = [{leaf.path: leaf for leaf in leaves(item)} for item in items]
        for inner in within[0].values():
            if len(inner.shape) < 2 and all(inner.path in found for found in within):
                values = [value for found in within for value in found[inner.path].values]
                yield _leaf(f"{path}.*.{inner.path}", (n, *inner.shape), values)
    elif _is_row(items):
        yield _leaf(path, (n,), items)
    elif all(isinstance(row, list | tuple) and row and _is_row(row) for row in rows):
        yield _leaf(path, (n, len(rows[0])), [value for row in rows for value in row])


def _leaf(path: str, shape: tuple[int, ...], values: Sequence[Any]) -> Leaf:
    name = path.removesuffix(".*").rpartition(".")[2].lower()
    return Leaf(path, name, shape, tuple(map(number, values)))


def _is_row(items: Sequence[Any]) -> bool:
    return all(item is None or type(item) in (int, float) for item in items)


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
    scalars = [leaf for leaf in found if leaf.shape == ()]
    profile, velocity = _profile(found), _velocity(scalars)
    place, depth = _place(scalars), _depth(scalars)
    # a position must have its place
    known = bool(place) and not place[0].startswith("#")
    guesses = {
        "profile": profile and profile + place,
        "velocity": velocity and velocity + place + _where(scalars, known),
        "position": place + depth if known else place,
        "depth": depth,
    }
    for kind, lines in guesses.items():
        if lines:
            quoted = _quoted(topic)
            select = [f"name = {_quoted(name)}"] if named_by_sender else []
            entry = ["[[measurements.map]]", f"topic = {quoted}", *select, f'kind = "{kind}"']
            # an entry all of whose fields are doubtful is doubtful as a whole
            mark = "# " if all(text.startswith("#") for text in lines) else ""
            head = f"# {quoted}: {len(found)} numbers in a {schema or 'message without a schema'}"
            return "\n".join([head, *(mark + text for text in entry), *lines, ""])
    return None


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
    found = {}
    for key, (schema, payload) in sorted(samples.items()):
        if entry := suggestion(key.partition("\n")[0], schema, payload):
            found[key] = entry
    return found


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


def _quoted(value: object) -> str:
    return json.dumps(value, ensure_ascii=False)


def _line(key: str, value: object, why: str = "by its name") -> str:
    """Return one line of an entry with its comment."""
    return f"{key} = {_quoted(value)}  # {why}"


def _named(found: Sequence[Leaf], key: str, shape: tuple[int, ...] = ()) -> Leaf | None:
    """Return the first leaf of a shape whose name fits; None without any."""
    return next((leaf for leaf in found if leaf.shape == shape and leaf.is_a(key)), None)


def _pair(found: Sequence[Leaf], first: str, second: str, dimensions: int = 0) -> list[Leaf]:
    """Return the first two leaves of one shape and one part of the message whose names fit; none without any."""
    for one in found:
        if len(one.shape) == dimensions and one.is_a(first):
            beside = [leaf for leaf in found if leaf.parent == one.parent]
            if other := _named(beside, second, one.shape):
                return [one, other]
    return []


def _place(scalars: Sequence[Leaf]) -> list[str]:
    """Return the lines of a position, commented out when there is none but of another time or purpose."""
    here = [leaf for leaf in scalars if not _ELSEWHERE.search(leaf.path)]
    found = _pair(here, "latitude", "longitude")
    latitude, longitude = found or _pair(scalars, "latitude", "longitude") or (None, None)
    if not latitude or not longitude:
        return []
    x, y = longitude.values[0], latitude.values[0]
    unit, why = "deg", f"the latitude is {y:g}"
    if abs(y) > 90.0 or abs(x) > 360.0:
        unit, why = "degE7", f"{x:g} is more than a turn"
    elif "rad" in latitude.name or (abs(y) <= math.pi / 2.0 and 0.0 < abs(x) <= math.pi):
        unit, why = "rad", f"{why}; write deg if these are degrees"
    names = [_line("longitude", longitude.path), _line("latitude", latitude.path)]
    lines = [*names, _line("angle_unit", unit, why)]
    return lines if found else [f"# {text}: by its name not where the vehicle is" for text in lines]


def _velocity(scalars: Sequence[Leaf]) -> list[str]:
    """Return the lines of a velocity at one depth; none when no two numbers look like its components."""
    found, why = _pair(scalars, "east", "north"), "by its name"
    if not found:
        names = {"linear.x": "east", "linear.y": "north"}
        twist = [leaf._replace(name=names.get(leaf.path[-8:], "")) for leaf in scalars]
        found, why = (
            _pair(twist, "east", "north"),
            "a twist's: only if its frame is east, north, up",
        )
    lines = [
        _line(key, leaf.path, why) for key, leaf in zip(("east", "north"), found, strict=False)
    ]
    return lines and [_REFERENCE, *lines, *_speed(found[0].values + found[1].values)]


def _where(scalars: Sequence[Leaf], placed: bool) -> list[str]:
    """Return the lines of where one velocity was measured."""
    if depth := _named(scalars, "depth"):
        return _as_depth(depth)
    if placed:
        unknown = "NOT FOUND in the message: state the depth of the measurement, in m"
        return [_line("at_depth", 0.0, unknown)]
    unknown = "NOT KNOWN: of the cell from the vehicle, in m; 0 measures at the vehicle"
    return [_line("distance", 0.0, unknown)]


def _depth(scalars: Sequence[Leaf]) -> list[str]:
    """Return the lines of a depth: a depth if there is one, else a pressure, else a height, which only a person can place."""
    of_place = [
        leaf
        for leaf in scalars
        if leaf.name != "z" or _PLACE.fullmatch(leaf.parent.rpartition(".")[2].lower())
    ]
    if depth := _named(of_place, "depth"):
        return _as_depth(depth)
    if pressure := _named(of_place, "pressure"):
        return _as_pressure(pressure)
    if height := _named(of_place, "height"):
        why = f"{height.values[0]:g}: use it if it is counted from the sea surface, not from the sea floor or the ellipsoid"
        up = _line("depth_positive", "up", "z and heights grow upwards")
        return ["# " + _line("depth", height.path, why), "# " + up]
    return []


def _as_depth(leaf: Leaf) -> list[str]:
    value = leaf.values[0]
    up, sign = ("up", "negative") if value < 0.0 else ("down", "positive")
    return [
        _line("depth", leaf.path),
        _line("depth_unit", "m", "the usual one"),
        _line("depth_positive", up, f"{value:g}: {sign} below the surface"),
    ]


def _as_pressure(leaf: Leaf) -> list[str]:
    value = leaf.values[0]
    stated = [unit for end, (unit, _) in _PRESSURES.items() if leaf.name.endswith(end)][:1]
    near = [unit for unit, air in _PRESSURES.values() if 0.8 * air < value < 1.2 * air]
    unit = [*stated, *near, "Pa" if value > 1e5 else "dbar"][0]
    why = "in its name" if stated else "by its size; check it"
    absolute = unit in near or (unit == "Pa" and value > 1e5)
    air = "whether the atmosphere is in it: check a value at the surface"
    return [
        _line("depth", leaf.path),
        _line("depth_unit", unit, f"{why}: {value:g}"),
        _line("depth_absolute", absolute, air),
    ]


def _profile(found: Sequence[Leaf]) -> list[str]:
    """Return the lines of a profile entry; none when no list looks like velocities."""
    lists = [leaf for leaf in found if leaf.shape and leaf.is_a("velocity")]
    nested = [leaf for leaf in lists if len(leaf.shape) > 1 and leaf.shape[1] >= 2]
    flat = [leaf for leaf in lists if len(leaf.shape) == 1 and leaf.shape[0] >= _SHORTEST_FLAT]
    likely = _pair(found, "east", "north", 1) or nested or flat
    if not likely:
        return []
    leaf, *rest = likely
    n, values, lines = leaf.shape[0], leaf.values, [_line("velocity", leaf.path)]
    if leaf.is_a("east"):
        values += rest[0].values
        lines = [_line("east", leaf.path), _line("north", rest[0].path)]
    elif leaf in flat:
        counts = [int(one.values[0]) for one in found if one.shape == () and one.is_a("count")]
        fitting = [n // count for count in counts if 0 < count < n and n % count == 0]
        why = "from the number of cells" if fitting else _UNKNOWN
        components = [*fitting, 2 if n % 3 else 3][0]
        n, lines = n // components, [*lines, _line("components", components, why)]
    frame = _line("frame", "enu", f"{_UNKNOWN}: enu, ned, ship, instrument or beam")
    return [_REFERENCE, frame, *lines, *_speed(values), *_geometry(found, n)]


def _speed(values: Sequence[float]) -> list[str]:
    """Return the lines of the unit of velocities, and of numbers that stand for none."""
    missing = sorted({value for value in values if value in _MISSING})
    known = [value for value in values if math.isfinite(value) and value not in _MISSING]
    whole = any(known) and all(value.is_integer() for value in known)
    fast = max(map(abs, known), default=0.0)
    unit = "mm/s" if whole or fast > _NO_MPS else "m/s"
    why = f"up to {fast:g}{', whole numbers' if whole else ''}; check it"
    stand_in = [_line("missing", missing, "these stand for no velocity")] if missing else []
    return [_line("speed_unit", unit, why), *stand_in]


def _geometry(found: Sequence[Leaf], n_cells: int) -> list[str]:
    """Return the lines of where the cells of a profile are, by the numbers beside it."""
    if depths := _named(found, "depths", (n_cells,)):
        least = min(depths.values)
        up = _line("depth_positive", "up", f"{least:g}: negative below the surface")
        return [_line("depths", depths.path), *([up] if least < 0.0 else [])]
    if distances := _named(found, "distances", (n_cells,)):
        return [_line("distances", distances.path)]
    lines = []
    for key in ("cell_size", "first_cell"):
        leaf, why = _named(found, key), "NOT FOUND in the message: state the instrument's, in m"
        if leaf is not None:
            why = f"by its name: {leaf.values[0]:g} m"
            if "blanking" in leaf.name:
                why += "; blanking ends where the first cell begins: state half a cell more"
        lines.append(_line(key, leaf.path if leaf else 1.0, why))
    return lines
