"""Payload bytes of an MCAP channel to plain dicts, one decoder a channel.

A payload of any encoding becomes a dict of numbers, strings, bytes, lists and dicts under the schema's names. Protobuf and ROS 1
times become ``{"sec", "nsec"}``; ROS 2 times keep their own ``{"sec", "nanosec"}``.
"""

import contextlib
import io
import re
import struct
from collections.abc import Callable
from typing import Any

from google.protobuf.message import DecodeError
from mcap.exceptions import McapError
from mcap.records import Schema
from mcap.well_known import MessageEncoding, SchemaEncoding

from replay_kit.logs.decode.json import decode_json
from replay_kit.logs.decode.protobuf import protobuf_decoder
from replay_kit.logs.decode.ros2idl import ros2msg_from_idl

Decoder = Callable[[bytes], dict[str, Any]]

#: What a decoder raises on a payload that does not fit its schema: the codecs' own errors, and the built-in ones that the
#: ROS decoders let through when they read past the end or meet a type they do not know.
PAYLOAD_ERRORS: tuple[type[Exception], ...] = (
    *(struct.error, DecodeError, McapError),
    *(ValueError, TypeError, LookupError, AttributeError, NotImplementedError, OverflowError, RecursionError),
)

_ROS_ENCODINGS = {
    (MessageEncoding.CDR, SchemaEncoding.ROS2): "ros2",
    (MessageEncoding.CDR, SchemaEncoding.ROS2IDL): "ros2",
    (MessageEncoding.ROS1, SchemaEncoding.ROS1): "ros1",
}
_KNOWN = "json, protobuf, cdr with ros2msg or ros2idl, ros1 with ros1msg"
_ROS1_NAME = re.compile(r"[A-Za-z]\w*/[A-Za-z]\w*", re.ASCII)
_ROS1_LINE = re.compile(r"(?:={80}|MSG: [A-Za-z]\w*/[A-Za-z]\w*|[A-Za-z][\w/]*(?:\[\d*\])? +[A-Za-z]\w*)", re.ASCII)
_ROS1_CONSTANT = re.compile(r"\w+\s+\w+\s*=", re.ASCII)


def channel_decoder(message_encoding: str, schema: Schema | None) -> Decoder | str:
    """Return the decoder of a channel's payloads, or the reason why there is none.

    Args:
        message_encoding: As the channel record states it.
        schema: The channel's schema; None when it has none.
    """
    if message_encoding == MessageEncoding.JSON:
        return decode_json
    if schema is None:
        return f"encoding {message_encoding!r} needs a schema and the channel has none"
    pair = f"encoding {message_encoding!r} with schema {schema.name!r} in {schema.encoding!r}"
    try:
        if (message_encoding, schema.encoding) == (MessageEncoding.Protobuf, SchemaEncoding.Protobuf):
            return protobuf_decoder(schema)
        dialect = _ROS_ENCODINGS.get((message_encoding, schema.encoding))
        if dialect == "ros2":
            return _ros2_decoder(schema)
        if dialect == "ros1":
            return _ros1_decoder(schema)
    # The schema is a program for third-party parsers: those of ROS raise private classes that derive from Exception itself,
    # and compile generated code. Nothing they raise may stop the other channels.
    except Exception as error:
        return f"{pair}: the schema cannot be parsed: {_words(error)}"
    return f"{pair} is not known; known: {_KNOWN}"


def explain(error: BaseException) -> str:
    """Return one line that says why a payload could not be decoded."""
    return f"payload does not fit the schema: {_words(error)}"


def _words(error: BaseException) -> str:
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text[:200]}" if text else type(error).__name__


def _ros2_decoder(schema: Schema) -> Decoder:
    from mcap_ros2.decoder import DecoderFactory

    if schema.encoding == SchemaEncoding.ROS2IDL:
        definition = ros2msg_from_idl(schema.name, schema.data.decode("utf-8"))
        schema = Schema(id=schema.id, name=schema.name, encoding=SchemaEncoding.ROS2, data=definition.encode())
    # The parser prints what it cannot parse; the reason goes into the report instead.
    with contextlib.redirect_stderr(io.StringIO()):
        decode = DecoderFactory().decoder_for(MessageEncoding.CDR, schema)
    assert decode is not None, "asked only for encodings that it decodes"
    return lambda data: _plain_object(decode(data))


def _ros1_decoder(schema: Schema) -> Decoder:
    from mcap_ros1.decoder import DecoderFactory

    if not _ROS1_NAME.fullmatch(schema.name):
        raise ValueError(f"{schema.name!r} is no ROS 1 type name")
    declarations = _ros1_declarations(schema.data.decode("utf-8"))
    bare = Schema(id=schema.id, name=schema.name, encoding=schema.encoding, data=declarations.encode())
    parse = DecoderFactory().decoder_for(MessageEncoding.ROS1, bare)
    assert parse is not None, "asked only for encodings that it decodes"

    def decode(data: bytes) -> dict[str, Any]:
        try:
            message = parse(data)
        # genpy's DeserializationError derives from Exception itself and lives in a vendored, private module.
        except Exception as error:
            raise ValueError(_words(error)) from error
        return _plain_object(message)

    return decode


def _ros1_declarations(text: str) -> str:
    """Return only the field declarations of a ROS 1 definition.

    The ROS 1 package turns the definition into Python source and imports it, comments and constants included. A log is not
    to be trusted with that: what is not a plain declaration is left out or refused. Neither comments nor constants are in
    the payload.
    """
    lines = []
    for raw in text.splitlines():
        if _ROS1_CONSTANT.match(raw.strip()):
            continue
        line = raw.split("#", 1)[0].strip()
        if not line:
            continue
        line = " ".join(line.split())
        if not _ROS1_LINE.fullmatch(line):
            raise ValueError(f"not a field declaration: {line[:80]!r}")
        lines.append(line)
    return "\n".join(lines) + "\n"


def _plain_object(value: Any) -> dict[str, Any]:
    """Return a decoded ROS message as a dict of its slots."""
    names = value.__slots__
    if len(names) == 2 and names[0] == "secs" and names[1] == "nsecs":
        return {"sec": value.secs, "nsec": value.nsecs}
    return {name: _plain(getattr(value, name)) for name in names}


def _plain(value: Any) -> Any:
    if isinstance(value, int | float | str | bytes):
        return value
    if isinstance(value, list | tuple):
        if value and hasattr(value[0], "__slots__") and not isinstance(value[0], int | float | str | bytes):
            return [_plain_object(item) for item in value]
        return list(value)
    return _plain_object(value)
