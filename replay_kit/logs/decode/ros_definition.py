"""Message definitions of ROS 1 and ROS 2 (``ros1msg``, ``ros2msg``): the fields of each type, as the schema of a channel declares them.

Source: wiki.ros.org/msg; design.ros2.org/articles/legacy_interface_definition.html. Constants, defaults and comments are passed over: none
of them is in a message.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

#: Types that are sent as they are, with their codes in ``struct``; of ROS 1 ``char`` is unsigned and ``byte`` signed, of ROS 2 the reverse.
NUMBERS: Mapping[str, str] = {
    **{
        "bool": "?",
        "int8": "b",
        "uint8": "B",
        "int16": "h",
        "uint16": "H",
        "int32": "i",
        "uint32": "I",
        "int64": "q",
        "uint64": "Q",
    },
    **{"float32": "f", "float64": "d"},
}
ROS1_NUMBERS: Mapping[str, str] = {**NUMBERS, "byte": "b", "char": "B"}
ROS2_NUMBERS: Mapping[str, str] = {**NUMBERS, "byte": "B", "char": "b"}
TEXTS = frozenset({"string", "wstring"})

_SEPARATOR = re.compile(r"^={3,}[ \t]*$", re.MULTILINE)
_HEADING = re.compile(r"\s*MSG:[ \t]+(\S+)[ \t]*(?:\n|$)")
_NAME = r"[A-Za-z]\w*"
_FIELD = re.compile(
    rf"(?P<type>{_NAME}(?:/{_NAME}){{0,2}})(?:<=\d+)?(?P<array>\[(?:<=)?(?P<length>\d{{0,10}})\])?[ \t]+(?P<name>{_NAME})"
    r"(?:[ \t]+\S.*)?",
    re.ASCII,
)
_CONSTANT = re.compile(rf"{_NAME}(?:<=\d+)?[ \t]+\w+[ \t]*=", re.ASCII)


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a type.

    Attributes:
        name: Its name.
        kind: A primitive type, or the name of a type as ``package/Name``.
        length: Of an array whose length is fixed; -1 for one whose length is sent; None for a single value.
    """

    name: str
    kind: str
    length: int | None


def definitions(name: str, text: str) -> dict[str, tuple[Field, ...]]:
    """Return the fields of the types that a schema declares, by ``package/Name``.

    Args:
        name: The schema's own type; ``package/msg/Name`` is ``package/Name``.
        text: The definition, with those of other types after lines of ``=`` and ``MSG: package/Name``.

    Raises:
        ValueError: A line is no declaration, or a name no name of a type.
    """
    found = {}
    for part in _SEPARATOR.split(text):
        if heading := _HEADING.match(part):
            name, part = heading[1], part[heading.end() :]
        full = _full(name, "")
        found[full] = tuple(_fields(part, full.partition("/")[0]))
    return found


def _full(name: str, package: str) -> str:
    """Return a type as ``package/Name``; one without a package is of the package given, and ``Header`` of std_msgs."""
    parts = name.split("/")
    if len(parts) == 1 and package:
        return f"{'std_msgs' if name == 'Header' else package}/{name}"
    if len(parts) not in (2, 3) or not all(re.fullmatch(_NAME, part, re.ASCII) for part in parts):
        raise ValueError(f"{name[:80]!r} is no name of a ROS type")
    return f"{parts[0]}/{parts[-1]}"


def _fields(text: str, package: str) -> Iterator[Field]:
    for raw in text.splitlines():
        line = raw.split("#", 1)[0].strip()
        if not line or _CONSTANT.match(line):
            continue
        match = _FIELD.fullmatch(line)
        if match is None:
            raise ValueError(f"not a field declaration: {line[:80]!r}")
        kind, length = match["type"], None
        if match["array"]:
            length = int(match["length"]) if match["length"] and "<=" not in match["array"] else -1
        plain = kind in ROS1_NUMBERS or kind in TEXTS or kind in ("time", "duration")
        yield Field(match["name"], kind if plain else _full(kind, package), length)
