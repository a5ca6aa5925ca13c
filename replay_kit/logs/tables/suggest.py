"""Draft of a ``[[measurements.map]]`` entry for a topic of unknown type, from the names of its fields and the units in them.

A person checks it: each line says where it comes from. The reference of velocities is in no name: until it is stated they are not used.
"""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

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
    place, depth = _place(numbers), _depth(numbers)
    profile, velocity = _profile(found), _picked(numbers, "east", "north")
    if profile:
        kind, lines = "profile", profile + place
    elif velocity:
        kind, lines = "velocity", _velocity(velocity) + place + (depth or _where(place))
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


def _place(numbers: Sequence[Leaf]) -> list[str]:
    return _lines(_picked(numbers, "longitude", "latitude"), "angle_unit", "deg")


def _where(place: Sequence[str]) -> list[str]:
    """Return the line of the place of a velocity without a depth, which its own place or the vehicle's needs."""
    return [_line("at_depth" if place else "distance", 0.0, f"{_CHECK}: state it, in m")]


def _depth(numbers: Sequence[Leaf]) -> list[str]:
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
