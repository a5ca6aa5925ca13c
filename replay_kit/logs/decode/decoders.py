"""Decoders of MCAP payloads to plain dicts, one per channel.

A payload becomes a dict of numbers, strings, bytes, lists and dicts under the schema's names. Protobuf and ROS 1 times become ``{"sec",
"nsec"}``; ROS 2 times keep their own ``{"sec", "nanosec"}``.
"""

import json
import re
import struct
from collections.abc import Callable
from typing import Any

import orjson
from google.protobuf.message import DecodeError
from mcap.exceptions import McapError
from mcap.records import Schema
from mcap.well_known import MessageEncoding, SchemaEncoding

from replay_kit.logs.decode.budget import MAPPING, MOST_SCHEMA, MOST_VALUES, Budget, check_size
from replay_kit.logs.decode.protobuf import protobuf_decoder
from replay_kit.logs.decode.ros import ros_decoder

Decoder = Callable[[bytes], dict[str, Any]]

#: What a decoder raises on a payload that does not fit its schema: the codecs' own errors, and the built-in ones that the
#: ROS decoders let through when they read past the end or meet a type they do not know.
PAYLOAD_ERRORS: tuple[type[Exception], ...] = (
    *(struct.error, DecodeError, McapError),
    *(ValueError, TypeError, LookupError, AttributeError),
    *(NotImplementedError, OverflowError, RecursionError),
)

_ROS_ENCODINGS = frozenset(
    {
        (MessageEncoding.CDR, SchemaEncoding.ROS2),
        (MessageEncoding.ROS1, SchemaEncoding.ROS1),
    }
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
            return f"{pair} is not known: record with definitions in ros2msg, as rosbag2 does by default"
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
