"""MAVLink messages recorded by BlueOS as JSON, converted to the payloads of a telemetry log.

On ``mavlink/{system}/{component}/{NAME}`` a message is ``{"header": {...}, "message": {"type": NAME, ...}}``; enums come as ``{"type":
"MAV_..."}`` or as their name, flags as ``{"bits": n}`` or as names joined by ``|``. The recorded schemas are guesses from each topic's
first message and are not used. Source: bluerobotics/blueos-recorder, bluerobotics/mavlink-server.
"""

import re
from collections.abc import Callable, Container
from functools import cache, reduce
from operator import or_
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from replay_kit.logs.decode.decoders import decode_json

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
    found = {}
    for message in dialect.mavlink_map.values():
        kinds = zip(message.fieldnames, message.fieldtypes, strict=True)
        texts = frozenset(name for name, kind in kinds if kind == "char")
        found[message.msgname] = texts, message.fieldenums_by_name
    return found


@cache
def _enum_values() -> dict[str, int]:
    """Return the values of all enum names of the dialect."""
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
