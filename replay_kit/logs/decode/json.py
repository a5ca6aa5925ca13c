"""JSON payloads to plain dicts, with the numbers that JSON does not have."""

import json
import re
from typing import Any

import orjson

from replay_kit.logs.decode.budget import MAPPING, MOST_VALUES, Budget

# possessive, and with a text that does not end matched too: each byte is looked at once
_BARE_NUMBER = re.compile(
    r'"(?:[^"\\]|\\.)*+"?|(-?)\b(inf|infinity|nan)\b', re.IGNORECASE | re.DOTALL
)


def decode_json(data: bytes) -> dict[str, Any]:
    """Return a JSON object as a dict; bare NaN, Infinity, inf and their negatives are numbers.

    Raises:
        ValueError: The bytes are no JSON, or the value is no object.
    """
    value = loads(data)
    if not isinstance(value, dict):
        raise ValueError(f"expected a JSON object, got {type(value).__name__}")
    return value


def loads(data: bytes) -> Any:
    """Return any JSON value, bare numbers as in ``decode_json``.

    Raises:
        ValueError: The bytes are no JSON, or claim more than the budget of a message.
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
