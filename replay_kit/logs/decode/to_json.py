"""Conversion of decoded messages to JSON, with channels and schemas."""

import base64
from collections import Counter
from collections.abc import Mapping
from typing import Any

import orjson

from replay_kit.core.errors import LogError
from replay_kit.core.message import Message, RawChannel, RawMessage

_TYPES = {str: "string", bool: "boolean", int: "number", float: "number"}


class JsonChannels:
    """Converter of messages to JSON, with a channel per topic and schema and sequence numbers per topic."""

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
            self._channel(message.topic, message.schema, data),
            sequence,
            time_ns,
            time_ns,
            data,
        )

    def _channel(self, topic: str, schema: str, data: bytes) -> RawChannel:
        """Return the channel of a topic and schema, whose first message has these data."""
        channel = self._channels.get((topic, schema))
        if channel is None:
            text = orjson.dumps(_described(orjson.loads(data)))
            # a message without a schema's name keeps it that way
            definition = (schema, "jsonschema", text) if schema else None
            channel = self._channels[topic, schema] = RawChannel(0, topic, "json", (), definition)
        return channel


def _described(value: Any) -> dict[str, Any]:
    """Return the JSON schema of a value, without fields that are null and lists of lists, for which viewers have no type."""
    if isinstance(value, dict):
        fields = {name: found for name, one in value.items() if (found := _described(one))}
        return {"type": "object", "properties": fields}
    if isinstance(value, list):
        items = _described(value[0]) if value else {}
        return {"type": "array", "items": items} if items.get("type", "array") != "array" else {}
    return {"type": _TYPES[type(value)]} if type(value) in _TYPES else {}


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
