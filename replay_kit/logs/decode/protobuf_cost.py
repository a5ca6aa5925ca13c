"""What a protobuf payload costs of its message's budget, found before it is parsed: the library makes all values at once.

A descriptor set is a payload too.

Sources: protobuf.dev/programming-guides/encoding; google/protobuf/descriptor.proto.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from google.protobuf.descriptor import Descriptor, FieldDescriptor

from replay_kit.logs.decode.budget import FREE, MAPPING, MOST_BYTES, MOST_VALUES, PER_BYTE, Budget

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
    """What the messages of a type cost.

    Attributes:
        own: A message without what is repeated or nested in it; every field of it is in the mapping, set or not.
        parts: By number, the cost of a nested message, or the bytes of a number in a packed list; texts and numbers cost one.
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
    """Return what messages of a type cost.

    Args:
        descriptor: The type.
        known: By full name, types found already, as types may contain themselves; grows.
    """
    if descriptor.full_name not in known:
        cost = known[descriptor.full_name] = Cost(MAPPING + len(descriptor.fields), {})
        for field in descriptor.fields:
            if field.message_type is not None:
                cost.parts[field.number] = cost_of(field.message_type, known)
            elif field.is_repeated and field.type not in _TEXTS:
                cost.parts[field.number] = _SIZES.get(field.type, 1)
    return known[descriptor.full_name]


def longest_cheap(cost: Cost) -> int:
    """Return the length of a payload [bytes] up to which it keeps its budget whatever is in it: a nested message takes two."""
    dearest, found, left = 2, {id(cost)}, [cost]
    while left:
        for part in left.pop().parts.values():
            if isinstance(part, Cost) and id(part) not in found:
                found.add(id(part))
                left.append(part)
                dearest = max(dearest, part.own)
            elif part is cost:
                dearest = max(dearest, cost.own)
    return (
        min(2 * MOST_VALUES // dearest, MOST_BYTES)
        if dearest <= 2 * PER_BYTE
        else 2 * FREE // dearest
    )


def pay(cost: Cost, data: bytes, budget: Budget) -> None:
    """Spend the budget of a payload on what is in it.

    Raises:
        BudgetError: It holds more than it may.
        ValueError: It is no protobuf, or nested too deeply.
    """
    try:
        _pay(cost, data, 0, len(data), budget, 0)
    except IndexError as error:
        raise ValueError("the payload ends inside a field") from error


def _pay(cost: Cost, data: bytes, at: int, end: int, budget: Budget, depth: int) -> None:
    """Spend on the fields of a message between two bytes."""
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
    """Return the number that begins at a byte, seven bits a byte, and where it ends."""
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
