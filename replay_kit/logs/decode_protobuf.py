"""Protobuf payloads to plain dicts, by converters built once from the descriptors."""

from collections.abc import Callable
from typing import Any

from google.protobuf.descriptor import Descriptor, FieldDescriptor
from mcap.records import Schema
from mcap.well_known import MessageEncoding
from mcap_protobuf.decoder import DecoderFactory

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
    convert: _Read | None = None

    def decode(data: bytes) -> dict[str, Any]:
        nonlocal convert
        message = parse(data)
        if convert is None:
            convert = _converter(message.DESCRIPTOR, {})
        plain: dict[str, Any] = convert(message)
        return plain

    return decode


def _converter(descriptor: Descriptor, known: dict[str, _Read]) -> _Read:
    """Return the function that turns a message of this type into a dict; types may contain themselves."""
    if descriptor.full_name in _TIMES:
        return lambda message: {"sec": message.seconds, "nsec": message.nanos}
    if descriptor.full_name in known:
        return known[descriptor.full_name]
    fields: list[tuple[str, _Read]] = []

    def convert(message: Any) -> dict[str, Any]:
        return {name: read(message) for name, read in fields}

    known[descriptor.full_name] = convert
    fields.extend((field.name, _field_reader(field, known)) for field in descriptor.fields)
    return convert


def _field_reader(field: FieldDescriptor, known: dict[str, _Read]) -> _Read:
    name = field.name
    if field.is_repeated:
        if field.message_type is None:
            return lambda message: list(getattr(message, name))
        if field.message_type.GetOptions().map_entry:
            return _map_reader(field, known)
        convert = _converter(field.message_type, known)
        return lambda message: [convert(item) for item in getattr(message, name)]
    if field.message_type is not None:
        convert = _converter(field.message_type, known)
        return lambda message: convert(getattr(message, name)) if message.HasField(name) else None
    if field.containing_oneof is not None:
        return lambda message: getattr(message, name) if message.HasField(name) else None
    return lambda message: getattr(message, name)


def _map_reader(field: FieldDescriptor, known: dict[str, _Read]) -> _Read:
    name = field.name
    value_type = field.message_type.fields_by_name["value"].message_type
    if value_type is None:
        return lambda message: dict(getattr(message, name))
    convert = _converter(value_type, known)
    return lambda message: {key: convert(value) for key, value in getattr(message, name).items()}
