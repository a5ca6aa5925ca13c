"""Decoded messages to JSON, with the channels that declare them."""

import base64
from collections import Counter
from collections.abc import Mapping
from typing import Any

import orjson

from replay_kit.core.errors import LogError
from replay_kit.core.message import Message, RawChannel, RawMessage
from replay_kit.logs.decode.json_schemas import ANY_OBJECT, JSON_SCHEMAS


class JsonChannels:
    """Turns messages to JSON, a channel for each topic and schema, sequence numbers for each topic."""

    def __init__(self) -> None:
        self._channels: dict[tuple[str, str], RawChannel] = {}
        self._sent: Counter[str] = Counter()

    def raw(self, message: Message) -> RawMessage:
        """Return a message with a JSON payload; NaN and infinities become null, bytes become base64.

        Raises:
            LogError: The payload has no JSON form.
        """
        try:
            data = orjson.dumps(
                message.payload,
                default=_plain,
                option=orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_NON_STR_KEYS,
            )
        except (orjson.JSONEncodeError, TypeError) as error:
            raise LogError(
                f"{message.topic} at {message.time_ns} ns: expected a payload that JSON can hold: {error}"
            ) from error
        time_ns, sequence = message.time_ns, self._sent[message.topic]
        self._sent[message.topic] += 1
        return RawMessage(
            time_ns,
            message.input,
            message.position,
            self._channel(message.topic, message.schema),
            sequence,
            time_ns,
            time_ns,
            data,
        )

    def _channel(self, topic: str, schema: str) -> RawChannel:
        """Return the channel of a topic and schema; one topic of two schemas has two channels."""
        channel = self._channels.get((topic, schema))
        if channel is None:
            text = orjson.dumps(JSON_SCHEMAS.get(schema, ANY_OBJECT))
            # a message without a schema's name keeps it that way
            definition = (schema, "jsonschema", text) if schema else None
            channel = self._channels[topic, schema] = RawChannel(0, topic, "json", (), definition)
        return channel


def _plain(value: Any) -> Any:
    if isinstance(value, bytes | bytearray | memoryview):
        return base64.b64encode(value).decode()
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, int):
        # beyond 64 bits
        return str(value)
    if hasattr(value, "__iter__"):
        return list(value)
    raise TypeError(f"{type(value).__name__} has no JSON form")
