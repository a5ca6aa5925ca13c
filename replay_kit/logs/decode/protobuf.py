"""Protobuf payloads to plain dicts, by converters built once from the descriptors."""

from collections.abc import Callable
from keyword import iskeyword
from typing import Any

from google.protobuf.descriptor import Descriptor, FieldDescriptor
from mcap.records import Schema
from mcap.well_known import MessageEncoding
from mcap_protobuf.decoder import DecoderFactory

from replay_kit.logs.decode.budget import Budget
from replay_kit.logs.decode.protobuf_cost import Cost, cost_of, longest_cheap, pay

_Read = Callable[[Any], Any]
_TIMES = frozenset({"google.protobuf.Timestamp", "google.protobuf.Duration"})


def protobuf_decoder(schema: Schema) -> Callable[[bytes], dict[str, Any]]:
    """Return the decoder of a protobuf schema's payloads.

    Original field names; enums as ints; times and durations as ``{"sec", "nsec"}``; repeated fields as lists, maps as dicts.
    Unset scalars have their default; unset messages, ``optional`` scalars and members of a oneof are None.

    Raises:
        google.protobuf.message.DecodeError: The schema is no descriptor set.
        mcap.exceptions.McapError: The descriptor set does not hold the schema's own type.
        TypeError: The descriptors contradict each other.
    """
    parse = DecoderFactory().decoder_for(MessageEncoding.Protobuf, schema)
    assert parse is not None, "asked only for encodings that it decodes"
    read: _Read | None = None
    convert: _Read | None = None
    cost, cheap = Cost(0, {}), 0

    def decode(data: bytes) -> dict[str, Any]:
        nonlocal read, convert, cost, cheap
        if read is None or convert is None:
            # the library's function makes the type from the descriptors on its first use
            message = type(parse(b""))
            read, convert = message.FromString, _converter(message.DESCRIPTOR)
            cost = cost_of(message.DESCRIPTOR, {})
            cheap = longest_cheap(cost)
        if len(data) > cheap:
            pay(cost, data, Budget(len(data)))
        plain: dict[str, Any] = convert(read(data))
        return plain

    return decode


def _converter(descriptor: Descriptor) -> _Read:
    """Return the function that turns a message of this type into a dict.

    It is written as one dict display a type and compiled, which takes half the time of closures over field names. Names come
    from the log: they enter the text only as quoted strings, or as attributes once they are plain identifiers.
    """
    functions: dict[str, str] = {}
    lines: list[str] = []
    name = _function(descriptor, functions, lines)
    scope: dict[str, Any] = {}
    exec("\n".join(lines), scope)
    function: _Read = scope[name]
    return function


def _function(descriptor: Descriptor, functions: dict[str, str], lines: list[str]) -> str:
    """Return the name of the function of a type, whose text is added when it is new; types may contain themselves.

    Args:
        descriptor: The type.
        functions: Full name of a type to the name of its function; grows.
        lines: The text of the functions; grows.
    """
    if descriptor.full_name not in functions:
        name = functions[descriptor.full_name] = f"convert_{len(functions)}"
        lines.append(f"def {name}(m): return {_display(descriptor, 'm', functions, lines)}")
    return functions[descriptor.full_name]


def _display(descriptor: Descriptor, variable: str, functions: dict[str, str], lines: list[str]) -> str:
    """Return the text of the dict that a message in a variable becomes."""
    if descriptor.full_name in _TIMES:
        return f'{{"sec": {variable}.seconds, "nsec": {variable}.nanos}}'
    return "{" + ", ".join(f"{field.name!r}: {_value(field, variable, functions, lines)}" for field in descriptor.fields) + "}"


def _value(field: FieldDescriptor, variable: str, functions: dict[str, str], lines: list[str]) -> str:
    """Return the text of a field's plain value."""
    plain = field.name.isidentifier() and not iskeyword(field.name)
    value = f"{variable}.{field.name}" if plain else f"getattr({variable}, {field.name!r})"
    kind = field.message_type
    if field.is_repeated:
        if kind is None:
            return f"{value}[:]"
        if kind.GetOptions().map_entry:
            item = kind.fields_by_name["value"].message_type
            return f"dict({value})" if item is None else f"{{k: {_function(item, functions, lines)}(v) for k, v in {value}.items()}}"
        # a display in place of a call, for types of numbers and texts alone
        each = _display(kind, "v", functions, lines) if _flat(kind) else f"{_function(kind, functions, lines)}(v)"
        return f"[{each} for v in {value}]"
    if kind is not None:
        value = f"{_function(kind, functions, lines)}({value})"
    elif field.containing_oneof is None:
        return value
    return f"{value} if {variable}.HasField({field.name!r}) else None"


def _flat(descriptor: Descriptor) -> bool:
    return all(field.message_type is None and not field.is_repeated and field.containing_oneof is None for field in descriptor.fields)
