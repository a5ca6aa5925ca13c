"""Decoder of ROS messages to plain dicts: ROS 1 serialization, and CDR of ROS 2 with alignment and byte order.

The reader of a type is built once, from its definition: neighbouring numbers form one ``struct``. Each value is charged to the message's
budget before it is created. Sources: wiki.ros.org/msg; OMG, "DDS-RTPS" 2.3, 10.2 (encapsulation), and "CORBA" 3.4, 9.3 (CDR alignment).
"""

import re
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from replay_kit.logs.mcap.records import MAPPING, Budget

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
    """Field of a type.

    Attributes:
        name: Field name.
        kind: Primitive type, or type name as ``package/Name``.
        length: Length of a fixed array; -1 for variable length; None for a single value.
    """

    name: str
    kind: str
    length: int | None


def definitions(name: str, text: str) -> dict[str, tuple[Field, ...]]:
    """Return the fields of the types that a schema declares, by ``package/Name``.

    Args:
        name: Type of the schema; ``package/msg/Name`` equals ``package/Name``.
        text: Definition, followed by other types after lines of ``=`` and ``MSG: package/Name``.

    Raises:
        ValueError: A line is no declaration, or a type name is invalid.
    """
    found = {}
    for part in _SEPARATOR.split(text):
        if heading := _HEADING.match(part):
            name, part = heading[1], part[heading.end() :]
        full = _full(name, "")
        found[full] = tuple(_fields(part, full.partition("/")[0]))
    return found


def _full(name: str, package: str) -> str:
    """Return a type as ``package/Name``; without a package the given one, or std_msgs for ``Header``."""
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


_TIMES_OF_ROS2 = (Field("sec", "int32", None), Field("nanosec", "uint32", None))
#: Sent as bytes and returned as bytes.
_OF_BYTES = {True: ("uint8", "byte"), False: ("uint8", "char")}
# Bytes before the values of CDR: its kind, odd where numbers are little-endian, and options.
_ENCAPSULATION = 4


class _Wire:
    """Bytes of one message being read; mutable, as the offset advances."""

    __slots__ = ("at", "budget", "cdr", "data", "order", "origin")

    def __init__(self, data: bytes, cdr: bool) -> None:
        self.data, self.cdr, self.budget = data, cdr, Budget(len(data))
        self.at = self.origin = _ENCAPSULATION if cdr else 0
        if len(data) < self.origin:
            raise ValueError(f"{len(data)} bytes, fewer than the {_ENCAPSULATION} that begin CDR")
        self.order = ">" if cdr and not data[1] & 1 else "<"

    def array(self, code: str, count: int) -> list[Any]:
        """Return ``count`` numbers of one type code."""
        self.budget.spend(count)
        if not count:
            return []
        size = struct.calcsize(f"<{code}")
        if self.cdr:
            self.at += -(self.at - self.origin) % size
        values = struct.unpack_from(f"{self.order}{count}{code}", self.data, self.at)
        self.at += count * size
        return list(values)

    def count(self, fixed: int | None = -1) -> int:
        """Return the number of elements: ``fixed``, or read from the message if it is -1."""
        return fixed if fixed is not None and fixed >= 0 else int(self.array("I", 1)[0])

    def places(self, fixed: int | None) -> int:
        """Return the number of elements after charging them to the budget."""
        count = self.count(fixed)
        self.budget.spend(count)
        return count

    def bytes(self, size: int) -> bytes:
        """Return the next ``size`` bytes."""
        end = self.at + size
        if end > len(self.data):
            raise ValueError(f"{size} bytes at byte {self.at}, the message has {len(self.data)}")
        value, self.at = self.data[self.at : end], end
        return value

    def text(self) -> str:
        """Return a text, without the terminating zero of CDR."""
        self.budget.spend(1)
        value = self.bytes(self.count())
        return (value[:-1] if self.cdr else value).decode("utf-8")


_Read = Callable[[_Wire], Any]
#: Names of fields, what reads them, and whether it returns one value for each of them.
_Step = tuple[tuple[str, ...], _Read, bool]


def ros_decoder(name: str, text: str, cdr: bool) -> Callable[[bytes], dict[str, Any]]:
    """Return the decoder of a type.

    ROS 1 times become ``{"sec", "nsec"}``; ROS 2 times are messages. Byte arrays are bytes, other arrays lists.

    Args:
        name: Type, ``package/Name`` or ``package/msg/Name``.
        text: Definition of the type and of nested types.
        cdr: Whether messages are CDR of ROS 2 instead of ROS 1 serialization.

    Raises:
        ValueError: The definition is invalid or lacks a type.
    """
    types = definitions(name, text)
    if cdr:
        types = {
            f"builtin_interfaces/{kind}": _TIMES_OF_ROS2 for kind in ("Time", "Duration")
        } | types
    read = _message(next(iter(definitions(name, ""))), types, {}, cdr)
    return lambda data: read(_Wire(data, cdr))


def _message(
    name: str, types: Mapping[str, Sequence[Field]], readers: dict[str, _Read], cdr: bool
) -> _Read:
    """Return the reader of a type, cached in ``readers``, as types may be recursive."""
    if name in readers:
        return readers[name]
    if name not in types:
        raise ValueError(f"definition not found: {name}")
    steps: list[_Step] = []

    def read(wire: _Wire) -> dict[str, Any]:
        wire.budget.spend(MAPPING)
        message: dict[str, Any] = {}
        for names, part, several in steps:
            if several:
                message.update(zip(names, part(wire), strict=True))
            else:
                message[names[0]] = part(wire)
        # IDL has no structure without members: ROS 2 sends a byte for it
        if cdr and not steps:
            wire.bytes(1)
        return message

    readers[name] = read
    numbers = ROS2_NUMBERS if cdr else ROS1_NUMBERS
    for single, fields in groupby(
        types[name], lambda field: field.length is None and field.kind in numbers
    ):
        if single:
            run = list(fields)
            codes = "".join(numbers[field.kind] for field in run)
            steps.append((tuple(field.name for field in run), _run(codes), True))
        else:
            steps.extend(
                ((field.name,), _field(field, types, readers, cdr), False) for field in fields
            )
    return read


def _run(codes: str) -> _Read:
    """Return the reader of consecutive numbers; CDR alignment depends on their first offset."""
    forms: dict[tuple[str, int], struct.Struct] = {}

    def read(wire: _Wire) -> tuple[Any, ...]:
        wire.budget.spend(len(codes))
        key = wire.order, (wire.at - wire.origin) % 8 if wire.cdr else -1
        if (form := forms.get(key)) is None:
            form = forms[key] = _aligned(*key, codes)
        values = form.unpack_from(wire.data, wire.at)
        wire.at += form.size
        return values

    return read


def _aligned(order: str, phase: int, codes: str) -> struct.Struct:
    """Return the struct of numbers from an offset modulo 8; -1 for no alignment."""
    parts, at = [order], phase
    for code in codes:
        size = struct.calcsize(f"<{code}")
        pad = -at % size if phase >= 0 else 0
        parts.append(f"{'x' * pad}{code}")
        at += pad + size
    return struct.Struct("".join(parts))


def _field(
    field: Field, types: Mapping[str, Sequence[Field]], readers: dict[str, _Read], cdr: bool
) -> _Read:
    """Return the reader of a field that is not a single number."""
    kind, length = field.kind, field.length
    code = (ROS2_NUMBERS if cdr else ROS1_NUMBERS).get(kind)
    if code is not None and kind in _OF_BYTES[cdr]:
        return lambda wire: wire.bytes(wire.count(length))
    if code is not None:
        return lambda wire: wire.array(code, wire.count(length))
    each = _element(kind, types, readers, cdr)
    if length is None:
        return each
    return lambda wire: [each(wire) for _ in range(wire.places(length))]


def _element(
    kind: str, types: Mapping[str, Sequence[Field]], readers: dict[str, _Read], cdr: bool
) -> _Read:
    """Return the reader of one value that is not a number."""
    if kind == "string":
        return _Wire.text
    if "/" in kind:
        return _message(kind, types, readers, cdr)
    if cdr:
        raise ValueError(f"values of the type {kind} are not read")
    pair = _run("II" if kind == "time" else "ii")
    return lambda wire: dict(zip(("sec", "nsec"), pair(wire), strict=True))
