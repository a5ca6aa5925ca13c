"""Protobuf payloads to plain dicts, by converters built once from the descriptors."""

from collections.abc import Callable
from dataclasses import dataclass
from keyword import iskeyword
from typing import Any

from google.protobuf.descriptor import Descriptor, FieldDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap.records import Schema

from replay_kit.logs.decode.budget import MOST_VALUES, PER_BYTE, Budget, BudgetError
from replay_kit.logs.decode.protobuf_cost import (
    BYTES_EACH,
    DESCRIPTORS,
    cost_of,
    longest_cheap,
    pay,
)

_Read = Callable[[Any], Any]
_TIMES = frozenset({"google.protobuf.Timestamp", "google.protobuf.Duration"})
#: Fields that the converter of a schema has, those of a type again wherever it is written in place of a call: about 1 kB each.
_MOST_FIELDS = 1 << 14
#: Fields of a type that is written in place of a call.
_MOST_IN_PLACE = 16


def protobuf_decoder(schema: Schema) -> Callable[[bytes], dict[str, Any]]:
    """Return the decoder of a protobuf schema's payloads.

    Original field names; enums as ints; times and durations as ``{"sec", "nsec"}``; repeated fields as lists, maps as dicts.
    Unset scalars have their default; unset messages, ``optional`` scalars and members of a oneof are None.

    Raises:
        google.protobuf.message.DecodeError: The schema is no descriptor set.
        BudgetError: It has more types, or its own type more fields, than any in use.
        KeyError: The descriptor set does not hold the schema's own type.
        TypeError: The descriptors contradict each other.
        ValueError: Two of its files have the same name.
    """
    descriptor = _pool(schema.data).FindMessageTypeByName(schema.name)
    # of this type alone, and those that it holds: a class takes a hundred times the bytes of an empty type
    read, convert = GetMessageClass(descriptor).FromString, _converter(descriptor)
    cost = cost_of(descriptor, {})
    cheap = longest_cheap(cost)

    def decode(data: bytes) -> dict[str, Any]:
        if len(data) > cheap:
            pay(cost, data, Budget(len(data)))
        plain: dict[str, Any] = convert(read(data))
        return plain

    return decode


def _pool(data: bytes) -> DescriptorPool:
    """Return the types of a descriptor set, whose files come in any order."""
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
    """Return the function that turns a message of this type into a dict.

    It is written as one dict display a type and compiled, which takes half the time of closures over field names. Names come
    from the log: they enter the text only as quoted strings, or as attributes once they are plain identifiers.
    """
    text = _Text({}, [])
    name = text.function(descriptor)
    scope: dict[str, Any] = {}
    exec("\n".join(text.lines), scope)
    function: _Read = scope[name]
    return function


@dataclass(slots=True)
class _Text:
    """The text of a converter while it is written.

    Attributes:
        functions: Full name of a type to the name of its function.
        lines: The functions, one a line.
        fields: Number of fields in them.
    """

    functions: dict[str, str]
    lines: list[str]
    fields: int = 0

    def function(self, descriptor: Descriptor) -> str:
        """Return the name of the function of a type, whose text is added when it is new; types may contain themselves."""
        if descriptor.full_name not in self.functions:
            name = self.functions[descriptor.full_name] = f"convert_{len(self.functions)}"
            self.lines.append(f"def {name}(m): return {self._display(descriptor, 'm')}")
        return self.functions[descriptor.full_name]

    def _display(self, descriptor: Descriptor, variable: str) -> str:
        """Return the text of the dict that a message in a variable becomes."""
        if descriptor.full_name in _TIMES:
            return f'{{"sec": {variable}.seconds, "nsec": {variable}.nanos}}'
        self.fields += len(descriptor.fields)
        if self.fields > _MOST_FIELDS:
            raise BudgetError(
                f"more than the {_MOST_FIELDS} fields that are read of one type and those in it"
            )
        return (
            "{"
            + ", ".join(
                f"{field.name!r}: {self._value(field, variable)}" for field in descriptor.fields
            )
            + "}"
        )

    def _value(self, field: FieldDescriptor, variable: str) -> str:
        """Return the text of a field's plain value."""
        plain = field.name.isidentifier() and not iskeyword(field.name)
        value = f"{variable}.{field.name}" if plain else f"getattr({variable}, {field.name!r})"
        kind = field.message_type
        if field.is_repeated:
            if kind is None:
                return f"{value}[:]"
            if kind.GetOptions().map_entry:
                item = kind.fields_by_name["value"].message_type
                return (
                    f"dict({value})"
                    if item is None
                    else f"{{k: {self.function(item)}(v) for k, v in {value}.items()}}"
                )
            # a display in place of a call, for types of numbers and texts alone
            each = self._display(kind, "v") if _flat(kind) else f"{self.function(kind)}(v)"
            return f"[{each} for v in {value}]"
        if kind is not None:
            value = f"{self.function(kind)}({value})"
        elif field.containing_oneof is None:
            return value
        return f"{value} if {variable}.HasField({field.name!r}) else None"


def _flat(descriptor: Descriptor) -> bool:
    """Return whether a type has few fields, all of them numbers and texts that are always there."""
    fields = descriptor.fields
    return len(fields) <= _MOST_IN_PLACE and not any(
        field.message_type or field.is_repeated or field.containing_oneof for field in fields
    )
