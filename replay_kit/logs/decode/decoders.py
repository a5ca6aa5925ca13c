"""Channels of an MCAP file, and the decoders of their payloads to plain dicts.

A payload becomes a dict of numbers, strings, bytes, lists and dicts under the schema's names. Protobuf and ROS 1 times become ``{"sec",
"nsec"}``; ROS 2 times keep their own ``{"sec", "nanosec"}``.
"""

import json
import re
import struct
from collections.abc import Callable, Container
from dataclasses import dataclass
from functools import cache, reduce
from operator import or_
from typing import Any

import orjson
from google.protobuf.message import DecodeError
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Schema
from mcap.well_known import MessageEncoding, SchemaEncoding

from replay_kit.core.message import MAVLINK_FRAMES, RawChannel
from replay_kit.logs.decode.protobuf import protobuf_decoder
from replay_kit.logs.decode.ros import ros_decoder
from replay_kit.logs.mcap.records import (
    MAPPING,
    MOST_DECLARED,
    MOST_SCHEMA,
    MOST_SCHEMAS,
    MOST_VALUES,
    Budget,
    Summary,
    check_size,
    parse,
)

Decoder = Callable[[bytes], dict[str, Any]]

#: What a decoder raises on a payload that does not fit its schema: the codecs' own errors, and the built-in ones that the
#: ROS decoders let through when they read past the end or meet a type they do not know.
PAYLOAD_ERRORS: tuple[type[Exception], ...] = (
    *(struct.error, DecodeError, McapError),
    *(ValueError, TypeError, LookupError, AttributeError),
    *(NotImplementedError, OverflowError, RecursionError),
)

_ROS_ENCODINGS = frozenset(
    {(MessageEncoding.CDR, SchemaEncoding.ROS2), (MessageEncoding.ROS1, SchemaEncoding.ROS1)}
)
_KNOWN = "json, protobuf, cdr with ros2msg, ros1 with ros1msg"


def channel_decoder(message_encoding: str, schema: Schema | None) -> Decoder | str:
    """Return the decoder of a channel's payloads, or the reason why none exists.

    Args:
        message_encoding: Encoding in the channel record.
        schema: Schema of the channel, if any.
    """
    if message_encoding == MessageEncoding.JSON:
        return decode_json
    if schema is None:
        return f"encoding {message_encoding!r} needs a schema and the channel has none"
    pair = f"encoding {message_encoding!r} with schema {schema.name!r} in {schema.encoding!r}"
    try:
        check_size(len(schema.data), MOST_SCHEMA, "its text")
        if (message_encoding, schema.encoding) == (
            MessageEncoding.Protobuf,
            SchemaEncoding.Protobuf,
        ):
            return protobuf_decoder(schema)
        if schema.encoding == SchemaEncoding.ROS2IDL:
            return f"{pair} is not known: record in ros2msg, as rosbag2 does"
        if (message_encoding, schema.encoding) in _ROS_ENCODINGS:
            text = schema.data.decode("utf-8")
            return ros_decoder(schema.name, text, message_encoding == MessageEncoding.CDR)
    # nothing that a parser makes of a foreign schema may stop the other channels
    except Exception as error:
        return f"{pair}: the schema cannot be parsed: {_words(error)}"
    return f"{pair} is not known; known: {_KNOWN}"


def explain(error: BaseException) -> str:
    """Return the reason of a decoding error as one line."""
    return f"payload does not fit the schema: {_words(error)}"


def _words(error: BaseException) -> str:
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text[:200]}" if text else type(error).__name__


# possessive, and with a text that does not end matched too: each byte is looked at once
_BARE_NUMBER = re.compile(
    r'"(?:[^"\\]|\\.)*+"?|(-?)\b(inf|infinity|nan)\b', re.IGNORECASE | re.DOTALL
)


def decode_json(data: bytes) -> dict[str, Any]:
    """Return a JSON object as a dict; bare NaN, Infinity, inf and their negatives are accepted.

    Raises:
        ValueError: The bytes are no JSON object.
    """
    value = loads(data)
    if not isinstance(value, dict):
        raise ValueError(f"expected a JSON object, got {type(value).__name__}")
    return value


def loads(data: bytes) -> Any:
    """Return any JSON value, bare numbers as in ``decode_json``.

    Raises:
        ValueError: The bytes are no JSON, or exceed the budget of a message.
    """
    # a shorter message cannot hold more: a value takes two bytes, a mapping three
    if len(data) > MOST_VALUES // 2:
        Budget(len(data)).spend(
            sum(data.count(mark) for mark in (b",", b"[", b":")) + MAPPING * data.count(b"{")
        )
    try:
        return orjson.loads(data)
    except orjson.JSONDecodeError:
        return json.loads(_BARE_NUMBER.sub(_standard_number, data.decode("utf-8")))


def _standard_number(match: re.Match[str]) -> str:
    if match[2] is None:
        return match[0]
    return "NaN" if match[2].lower() == "nan" else f"{match[1]}Infinity"


@dataclass(frozen=True, slots=True)
class Sink:
    """Topic, schema and decoder of one channel.

    Attributes:
        topic: Topic of the channel.
        schema: Name of its schema; empty without one.
        decode: Decoder; the reason for a missing one; or None for raw frames and copies, whose messages are on other topics.
        channel: Channel as declared in the file.
    """

    topic: str
    schema: str
    decode: Decoder | str | None
    channel: RawChannel


class Channels:
    """Channels and schemas of the summary and those declared so far; decoders are built at the first message."""

    def __init__(self, summary: Summary, rename: Callable[[str], str]) -> None:
        """Create the registry.

        Args:
            summary: Summary of the file, for channels without a declaration, as after a lost chunk.
            rename: Returns the name of a topic of the file.
        """
        self._rename = rename
        self._schemas: dict[int, Schema] = dict(summary.schemas)
        self._channels: dict[int, Channel] = dict(summary.channels)
        self._declared = 0
        #: By encoding and schema: channels of one schema share a decoder.
        self._decoders: dict[tuple[str, str, str, bytes], Decoder | str] = {}
        self._parsed = 0
        #: Those built so far, by channel.
        self._sinks: dict[int, Sink] = {}

    def declare(self, opcode: int, body: bytes) -> None:
        """Add a schema or channel record.

        Raises:
            struct.error, ValueError, OverflowError, mcap.exceptions.McapError: The body is invalid, or the log declares too much.
        """
        check_size(self._declared + len(body), MOST_DECLARED, "all schemas and channels")
        kind: Any = Schema if opcode == Opcode.SCHEMA else Channel
        known: dict[int, Any] = self._schemas if opcode == Opcode.SCHEMA else self._channels
        record = parse(kind, body)
        if known.get(record.id) != record:
            known[record.id] = record
            self._declared += len(body)
            self._sinks.clear()

    def sink(self, channel_id: int) -> Sink:
        """Return the sink of a channel, declared or not."""
        found = self._sinks.get(channel_id)
        if found is None:
            found = self._sinks[channel_id] = self._build(channel_id)
        return found

    def _build(self, channel_id: int) -> Sink:
        channel = self._channels.get(channel_id)
        if channel is None:
            unknown = RawChannel(channel_id, f"(channel {channel_id})", "", (), None)
            return Sink(unknown.topic, "", "the file does not declare this channel", unknown)
        schema = self._schemas.get(channel.schema_id) if channel.schema_id else None
        definition = (schema.name, schema.encoding, schema.data) if schema else None
        topic = self._rename(channel.topic)
        raw = RawChannel(
            channel_id, topic, channel.message_encoding, tuple(channel.metadata.items()), definition
        )
        name = schema.name if schema else ""
        if raw.encoding == MessageEncoding.JSON and (known := mavlink_channel(channel.topic)):
            return Sink(topic, known[0] or name, known[1], raw)
        framed = raw.encoding == MAVLINK_FRAMES
        return Sink(topic, name, None if framed else self._decoder(raw.encoding, schema), raw)

    def _decoder(self, encoding: str, schema: Schema | None) -> Decoder | str:
        """Return the result of ``channel_decoder``, or the reason if the log's schemas are too large in total."""
        if schema is None:
            return channel_decoder(encoding, None)
        key = encoding, schema.name, schema.encoding, schema.data
        if key not in self._decoders:
            self._parsed += min(len(schema.data), MOST_SCHEMA)
            full = self._parsed > MOST_SCHEMAS
            why = f"the schemas of this log have more than {MOST_SCHEMAS} bytes"
            self._decoders[key] = (
                why
                if full and encoding != MessageEncoding.JSON
                else channel_decoder(encoding, schema)
            )
        return self._decoders[key]


# MAVLink recorded by BlueOS as JSON, converted to the payloads of a telemetry log. On ``mavlink/{system}/{component}/{NAME}`` a message is
# ``{"header": {...}, "message": {"type": NAME, ...}}``; enums come as ``{"type": "MAV_..."}`` or as their name, flags as ``{"bits": n}`` or
# as names joined by ``|``. The recorded schemas are guesses from each topic's first message and are not used.
# Source: bluerobotics/blueos-recorder, bluerobotics/mavlink-server.
_TOPIC = re.compile(r"mavlink/\d+/\d+/([A-Z][A-Z0-9_]*)", re.ASCII)
# all messages once more, and the fields of messages one by one
_COPIES = re.compile(r"mavlink/out|mavlink/\d+/\d+/[A-Z][A-Z0-9_]*/\w+", re.ASCII)


def mavlink_channel(topic: str) -> tuple[str, Callable[[bytes], dict[str, Any]] | None] | None:
    """Return the schema name and the decoder of a JSON channel of MAVLink; no decoder of one that repeats others; None for other topics.

    Args:
        topic: The channel's topic.
    """
    if match := _TOPIC.fullmatch(topic):
        name = match[1]
        fields = _fields().get(name, (frozenset(), ()))
        return name, lambda data: _payload(decode_json(data), fields)
    return ("", None) if _COPIES.fullmatch(topic) else None


#: Text fields of a MAVLink message, and those that are enums; both empty for an unknown message.
_Fields = tuple[frozenset[str], Container[str]]


@cache
def _fields() -> dict[str, _Fields]:
    """Return the fields of each message of the dialect by name."""
    # takes longer to load than a small log to read
    from pymavlink.dialects.v20 import ardupilotmega as dialect

    found = {}
    for message in dialect.mavlink_map.values():
        kinds = zip(message.fieldnames, message.fieldtypes, strict=True)
        texts = frozenset(name for name, kind in kinds if kind == "char")
        found[message.msgname] = texts, message.fieldenums_by_name
    return found


@cache
def _enum_values() -> dict[str, int]:
    """Return the values of all enum names of the dialect."""
    from pymavlink.dialects.v20 import ardupilotmega as dialect

    return {entry.name: value for enum in dialect.enums.values() for value, entry in enum.items()}


def _payload(value: dict[str, Any], fields: _Fields) -> dict[str, Any]:
    """Return the fields of a message, with or without the envelope; ``convert`` writes none."""
    message = value.get("message")
    if not isinstance(message, dict) or not isinstance(message.get("type"), str):
        return value
    plain = {name: _value(name, item, fields) for name, item in message.items() if name != "type"}
    # the recorder's library renames the field ``type``, which is its key for the message's name
    if "mavtype" in plain:
        plain["type"] = plain.pop("mavtype")
    return plain


def _value(name: str, value: Any, fields: _Fields) -> Any:
    if isinstance(value, dict):
        if set(value) == {"bits"}:
            return value["bits"]
        if set(value) == {"type"}:
            return _number_of(value["type"])
        return value
    texts, enums = fields
    if name in texts:
        return _text(value)
    if isinstance(value, str) and name in enums:
        return _number_of(value)
    return value


def _number_of(words: Any) -> Any:
    """Return the number of an enum name, or of names joined by ``|``; unknown names are returned unchanged."""
    if not isinstance(words, str):
        return words
    values = [_enum_values().get(word.strip()) for word in words.split("|")]
    return words if None in values else reduce(or_, values)


def _text(value: Any) -> Any:
    """Return a character array, given as text, characters or codes, as text without padding."""
    if isinstance(value, list):
        value = "".join(
            chr(item) if isinstance(item, int) and 0 <= item < 256 else str(item) for item in value
        )
    return value.split("\x00", 1)[0] if isinstance(value, str) else value
