"""Decoder of protobuf payloads to plain dicts, with converters compiled once from the descriptors."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from keyword import iskeyword
from typing import Any

from google.protobuf.descriptor import Descriptor, FieldDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap.records import Schema

from replay_kit.logs.mcap.records import (
    FREE,
    MAPPING,
    MOST_BYTES,
    MOST_VALUES,
    PER_BYTE,
    Budget,
    BudgetError,
)

_Read = Callable[[Any], Any]
_TIMES = frozenset({"google.protobuf.Timestamp", "google.protobuf.Duration"})


def protobuf_decoder(schema: Schema) -> Callable[[bytes], dict[str, Any]]:
    """Return the decoder of a protobuf schema's payloads.

    Original field names; enums as ints; times and durations as ``{"sec", "nsec"}``; repeated fields as lists, maps as dicts. Unset scalars
    have their default; unset messages, ``optional`` scalars and members of a oneof are None.

    Raises:
        google.protobuf.message.DecodeError: The schema is no descriptor set.
        BudgetError: It has too many types.
        KeyError: The descriptor set lacks the schema's type.
        TypeError: The descriptors are inconsistent.
        ValueError: Two of its files have the same name.
    """
    descriptor = _pool(schema.data).FindMessageTypeByName(schema.name)
    # of this type alone, and those that it holds: a class takes a hundred times the bytes of an empty type
    read, convert = GetMessageClass(descriptor).FromString, _converter(descriptor)
    known: dict[str, Cost] = {}
    cost = cost_of(descriptor, known)
    cheap = longest_cheap(known.values())

    def decode(data: bytes) -> dict[str, Any]:
        if len(data) > cheap:
            pay(cost, data, Budget(len(data)))
        plain: dict[str, Any] = convert(read(data))
        return plain

    return decode


def _pool(data: bytes) -> DescriptorPool:
    """Return the types of a descriptor set, whose files may be in any order."""
    try:
        pay(DESCRIPTORS, data, Budget(len(data)))
    except BudgetError as error:
        most = MOST_VALUES // PER_BYTE // BYTES_EACH
        raise BudgetError(
            f"more types than {most}, or than one in {BYTES_EACH} bytes of the descriptor set"
        ) from error
    files = FileDescriptorSet.FromString(data).file
    pool, left = DescriptorPool(), {file.name: file for file in files}
    if len(left) < len(files):
        raise ValueError("two files of the descriptor set have the same name")

    def add(name: str) -> None:
        if (file := left.pop(name, None)) is not None:
            for needed in file.dependency:
                add(needed)
            pool.Add(file)

    for name in list(left):
        add(name)
    return pool


def _converter(descriptor: Descriptor) -> _Read:
    """Return the function that converts a message of this type to a dict.

    It is compiled from one dict display per type, twice as fast as closures over field names. Names from the log enter the source only as
    quoted strings, or as attributes if they are plain identifiers.
    """
    names, lines = dict[str, str](), list[str]()

    def function(kind: Descriptor) -> str:
        """Return the name of the function of a type, whose source is added if new; types may be recursive."""
        if kind.full_name not in names:
            name = names[kind.full_name] = f"convert_{len(names)}"
            fields = ", ".join(f"{field.name!r}: {value_of(field)}" for field in kind.fields)
            if kind.full_name in _TIMES:
                fields = '"sec": m.seconds, "nsec": m.nanos'
            lines.append(f"def {name}(m): return {{{fields}}}")
        return names[kind.full_name]

    def value_of(field: FieldDescriptor) -> str:
        """Return the source of a field's value."""
        value = f"getattr(m, {field.name!r})"
        if field.name.isidentifier() and not iskeyword(field.name):
            value = f"m.{field.name}"
        kind = field.message_type
        if field.is_repeated:
            if kind is None:
                return f"{value}[:]"
            if kind.GetOptions().map_entry:
                item = kind.fields_by_name["value"].message_type
                if item is None:
                    return f"dict({value})"
                return f"{{k: {function(item)}(v) for k, v in {value}.items()}}"
            return f"[{function(kind)}(v) for v in {value}]"
        if kind is not None:
            value = f"{function(kind)}({value})"
        elif field.containing_oneof is None:
            return value
        # a field of that name would hide the method
        return f"{value} if type(m).HasField(m, {field.name!r}) else None"

    name, scope = function(descriptor), dict[str, Any]()
    exec("\n".join(lines), scope)
    converter: _Read = scope[name]
    return converter


_VARINT, _FIXED64, _BYTES, _GROUP, _END, _FIXED32 = range(6)
#: The library refuses messages nested deeper.
_DEEPEST = 100
#: Bytes that one packed number has at least.
_SIZES: Mapping[int, int] = {
    **dict.fromkeys(
        (FieldDescriptor.TYPE_DOUBLE, FieldDescriptor.TYPE_FIXED64, FieldDescriptor.TYPE_SFIXED64),
        8,
    ),
    **dict.fromkeys(
        (FieldDescriptor.TYPE_FLOAT, FieldDescriptor.TYPE_FIXED32, FieldDescriptor.TYPE_SFIXED32), 4
    ),
}
_TEXTS = (FieldDescriptor.TYPE_STRING, FieldDescriptor.TYPE_BYTES)


@dataclass(frozen=True, slots=True, eq=False)
class Cost:
    """Budget cost of the messages of a type.

    Attributes:
        own: Cost of a message without repeated or nested fields; unset fields count too.
        parts: By field number, cost of a nested message, or bytes of a number in a packed list; texts and numbers cost one.
    """

    own: int
    parts: "dict[int, Cost | int]"


#: Bytes of a descriptor set for each type, enumeration and service in it. One takes some 800 bytes of memory, and without fields as few
#: as five of the set; in use it has fields, of about twenty bytes each.
BYTES_EACH = 16
_DECLARED = BYTES_EACH * PER_BYTE
_LEAF = Cost(_DECLARED, {})
_TYPE = Cost(_DECLARED, {4: _LEAF})
_TYPE.parts[3] = _TYPE
#: The cost of a descriptor set: its files, in them types (which hold types and enumerations), enumerations and services.
DESCRIPTORS = Cost(0, {1: Cost(0, {4: _TYPE, 5: _LEAF, 6: _LEAF})})


def cost_of(descriptor: Descriptor, known: dict[str, Cost]) -> Cost:
    """Return the cost of the messages of a type.

    Args:
        descriptor: The type.
        known: Costs by full name, extended here; types may be recursive.
    """
    if descriptor.full_name not in known:
        cost = known[descriptor.full_name] = Cost(MAPPING + len(descriptor.fields), {})
        for field in descriptor.fields:
            if field.message_type is not None:
                cost.parts[field.number] = cost_of(field.message_type, known)
            elif field.is_repeated and field.type not in _TEXTS:
                cost.parts[field.number] = _SIZES.get(field.type, 1)
    return known[descriptor.full_name]


def longest_cheap(costs: Iterable[Cost]) -> int:
    """Return the payload length [bytes] below which the budget cannot be exceeded: a nested message takes two bytes.

    Args:
        costs: Costs of all types of a payload.
    """
    parts = [part for cost in costs for part in cost.parts.values()]
    dearest = max([2, *(part.own for part in parts if isinstance(part, Cost))])
    if dearest > 2 * PER_BYTE:
        return 2 * FREE // dearest
    return min(2 * MOST_VALUES // dearest, MOST_BYTES)


def pay(cost: Cost, data: bytes, budget: Budget) -> None:
    """Charge the contents of a payload to its budget.

    Raises:
        BudgetError: The budget is exceeded.
        ValueError: The payload is no protobuf, or nested too deeply.
    """
    try:
        _pay(cost, data, 0, len(data), budget, 0)
    except IndexError as error:
        raise ValueError("the payload ends inside a field") from error


def _pay(cost: Cost, data: bytes, at: int, end: int, budget: Budget, depth: int) -> None:
    """Charge the fields of a message between two offsets."""
    if depth > _DEEPEST:
        raise ValueError(f"messages are nested more than {_DEEPEST} deep")
    budget.spend(cost.own)
    while at < end:
        key, at = _varint(data, at)
        budget.spend(1)
        kind = key & 7
        if kind == _VARINT:
            _, at = _varint(data, at)
        elif kind == _BYTES:
            size, at = _varint(data, at)
            part = cost.parts.get(key >> 3)
            if isinstance(part, Cost):
                _pay(part, data, at, min(at + size, end), budget, depth + 1)
            elif part is not None:
                budget.spend(size // part)
            at += size
        elif kind in (_FIXED64, _FIXED32):
            at += 8 if kind == _FIXED64 else 4
        elif kind not in (_GROUP, _END):
            raise ValueError(f"a field of the unknown kind {kind}")


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """Return the variable-length integer at an offset and its end."""
    value = shift = 0
    while True:
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
        shift += 7
        if shift >= 70:
            raise ValueError("a number of more than ten bytes")
