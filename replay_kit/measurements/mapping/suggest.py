"""A first ``[[measurements.map]]`` entry for a topic that no known kind covers, guessed from names and values.

Each line says why it was guessed. What cannot be known from one message gets the answer that does no harm: profiles are taken to be
relative to the platform, of which only the shear is used, until a person states otherwise.
"""

import json
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from replay_kit.measurements.mapping.leaves import Leaf, leaves
from replay_kit.measurements.mapping.suggest_profile import line, profile_lines

_LATITUDE = re.compile(r"(.*_)?lat(itude)?(_?(deg|rad|e7|int|wgs84))?")
_LONGITUDE = re.compile(r"(.*_)?(lon|lng|long|longitude)(_?(deg|rad|e7|int|wgs84))?")
_DEPTH = re.compile(r"(.*_)?depth(_?m)?")
_PRESSURE = re.compile(r"(.*_)?(fluid_|water_|sea_)?press(ure)?(_?(pa|hpa|kpa|bar|mbar|dbar))?")
_HEIGHT = re.compile(r"(.*_)?(alt|altitude|height|z)(_?m)?")
# where something began, ended or should go, not where the vehicle is
_ELSEWHERE = re.compile(r"(?<![A-Za-z])(?i:start|end|goal|home|target|waypoint|destination)(?![a-z])")
# of other vectors, a field or a rate, z is no height
_PLACE = re.compile(r"|(.*_)?(pos|position|location|point|place|translation|pose|ned|enu)")
_UNIT_IN_NAME = (("dbar", "dbar"), ("mbar", "hPa"), ("hpa", "hPa"), ("kpa", "kPa"), ("bar", "bar"), ("pa", "Pa"))
# an absolute pressure near the surface is one atmosphere
_ATMOSPHERE = (("Pa", 101_325.0), ("hPa", 1013.25), ("kPa", 101.325), ("bar", 1.01325))


def suggestion(topic: str, schema: str, payload: Mapping[str, Any]) -> str | None:
    """Return the TOML of an entry for a topic, with a comment on each guess; None when nothing in the message looks usable.

    Args:
        topic: The topic.
        schema: Its schema's name, for the comment.
        payload: One of its messages.
    """
    found = leaves(payload)
    for kind, guess in (("profile", _profile), ("position", _position), ("depth", _only_depth)):
        lines = guess(found)
        if lines:
            head = [f"# {json.dumps(topic, ensure_ascii=False)}: {len(found)} numbers in a {schema or 'message without a schema'}"]
            entry = ["[[measurements.map]]", f"topic = {json.dumps(topic, ensure_ascii=False)}", f'kind = "{kind}"', *lines]
            # an entry all of whose fields are doubtful is doubtful as a whole
            doubtful = all(line.startswith("#") for line in lines)
            return "\n".join([*head, *(f"# {line}" if doubtful and not line.startswith("#") else line for line in entry)]) + "\n"
    return None


def suggestions(samples: Mapping[str, tuple[str, Mapping[str, Any]]]) -> str:
    """Return a TOML file of entries for topics that no known kind covers.

    Args:
        samples: Topic to its schema's name and one of its messages.
    """
    entries = [text for topic, (schema, payload) in sorted(samples.items()) if (text := suggestion(topic, schema, payload)) is not None]
    head = (
        "# A first mapping, guessed by names and values from one message of each topic that no known kind covers.\n"
        "# Check every line, above all reference, frame and units, before you use it: replay-kit replay --config THIS.toml\n"
    )
    return "\n".join([head, *entries]) if entries else head + "# Nothing in the log looks like a position, a depth or a profile.\n"


def _profile(found: Sequence[Leaf]) -> list[str]:
    lines = profile_lines(found)
    return [*lines, *_place([leaf for leaf in found if leaf.shape == ()])] if lines else []


def _position(found: Sequence[Leaf]) -> list[str]:
    scalars = [leaf for leaf in found if leaf.shape == ()]
    place = _place(scalars)
    # a position must have its place
    depth = [] if any(text.startswith("#") for text in place) else _depth_lines(scalars)
    return [*place, *depth] if place else []


def _place(scalars: Sequence[Leaf]) -> list[str]:
    """Return the lines of a position, commented out when there is none but of another time or purpose."""
    here = [leaf for leaf in scalars if not _ELSEWHERE.search(leaf.path)]
    return _pair(here) or [f"# {text}: by its name not where the vehicle is" for text in _pair(scalars)]


def _pair(scalars: Sequence[Leaf]) -> list[str]:
    for latitude in scalars:
        if _LATITUDE.fullmatch(latitude.name):
            beside = (leaf for leaf in scalars if leaf.parent == latitude.parent and _LONGITUDE.fullmatch(leaf.name))
            if (longitude := next(beside, None)) is not None:
                pair = [line("longitude", longitude.path, "by its name"), line("latitude", latitude.path, "by its name")]
                return [*pair, _angle_unit(longitude, latitude)]
    return []


def _angle_unit(longitude: Leaf, latitude: Leaf) -> str:
    x, y = abs(longitude.values[0]), abs(latitude.values[0])
    if y > 90.0 or x > 360.0:
        return line("angle_unit", "degE7", f"{longitude.values[0]:g} is more than a turn")
    if "rad" in latitude.name or (y <= math.pi / 2.0 and 0.0 < x <= math.pi):
        return line("angle_unit", "rad", f"the latitude is {latitude.values[0]:g}; write deg if these are degrees")
    return line("angle_unit", "deg", f"the latitude is {latitude.values[0]:g}")


def _only_depth(found: Sequence[Leaf]) -> list[str]:
    return _depth_lines([leaf for leaf in found if leaf.shape == ()])


def _depth_lines(scalars: Sequence[Leaf]) -> list[str]:
    """Return the lines of a depth: a depth if there is one, else a pressure, else a height, which only a person can place."""
    for pattern, lines in ((_DEPTH, _as_depth), (_PRESSURE, _as_pressure), (_HEIGHT, _as_height)):
        if (leaf := next((leaf for leaf in scalars if pattern.fullmatch(leaf.name) and _is_of_place(leaf)), None)) is not None:
            return lines(leaf)
    return []


def _is_of_place(leaf: Leaf) -> bool:
    return leaf.name != "z" or _PLACE.fullmatch(leaf.parent.rpartition(".")[2].lower()) is not None


def _as_depth(leaf: Leaf) -> list[str]:
    up = leaf.values[0] < 0.0
    why = f"{leaf.values[0]:g}: " + ("negative below the surface" if up else "positive below the surface")
    return [
        line("depth", leaf.path, "by its name"),
        line("depth_unit", "m", "the usual one"),
        line("depth_positive", "up" if up else "down", why),
    ]


def _as_pressure(leaf: Leaf) -> list[str]:
    value = leaf.values[0]
    lines = [line("depth", leaf.path, "a pressure by its name")]
    stated = next((unit for word, unit in _UNIT_IN_NAME if re.search(rf"_?{word}$", leaf.name)), None)
    near = next((unit for unit, one in _ATMOSPHERE if stated in (None, unit) and 0.8 * one < value < 1.2 * one), None)
    unit = stated or near or ("Pa" if value > 1e5 else "dbar")
    why = "in its name" if stated else "by its size; check it"
    absolute = near is not None or (unit == "Pa" and value > 1e5)
    lines.append(line("depth_unit", unit, f"{why}: {value:g}"))
    return [*lines, line("depth_absolute", absolute, "whether the atmosphere is in it: check a value at the surface")]


def _as_height(leaf: Leaf) -> list[str]:
    why = f"{leaf.values[0]:g}: use it if it is counted from the sea surface, not from the sea floor or the ellipsoid"
    return ["# " + line("depth", leaf.path, why), "# " + line("depth_positive", "up", "z and heights grow upwards")]
