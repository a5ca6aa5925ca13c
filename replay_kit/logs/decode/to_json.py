"""Conversion of decoded messages to JSON, with channels and schemas."""

import base64
from collections import Counter
from collections.abc import Mapping
from typing import Any

import orjson

from replay_kit.core.errors import LogError
from replay_kit.core.message import Message, RawChannel, RawMessage


def _object(
    properties: dict[str, Any], required: tuple[str, ...] | None = None, title: str | None = None
) -> dict[str, Any]:
    named = {"title": title} if title else {}
    return {
        **named,
        "type": "object",
        "properties": properties,
        "required": list(properties if required is None else required),
    }


def _array(items: Any) -> dict[str, Any]:
    return {"type": "array", "items": items}


_NUMBER = {"type": "number"}
_INTEGER = {"type": "integer"}
_STRING = {"type": "string"}
_BOOLEAN = {"type": "boolean"}
_NULLABLE = {"type": ["number", "null"]}
_MAYBE_BOOLEAN = {"type": ["boolean", "null"]}
_PER_CELL = {"type": ["number", "array", "null"], "items": _NULLABLE}
_STAMP = _object({"sec": _INTEGER, "nsec": _INTEGER})
_FIX = _object({"time": _STAMP, "lon": _NUMBER, "lat": _NUMBER})
_PER_BEAM = {"type": ["array", "null"], "items": _array(_NULLABLE)}


def _words(*words: str) -> dict[str, Any]:
    return {"type": "string", "enum": list(words)}


_ADCP_PING = _object(
    {
        "stamp": _STAMP,
        "frame_id": _STRING,
        "ping": _INTEGER,
        "dive": _INTEGER,
        "coordinate_system": _words("beam", "instrument", "ship", "earth"),
        "reference": _words("earth", "platform"),
        "orientation": _words("down", "up"),
        "bin_mapped": _BOOLEAN,
        "n_cells": _INTEGER,
        "cell_size": _NUMBER,
        "bin0_distance": _NUMBER,
        "transducer_depth": _NULLABLE,
        "beam_unit_vectors": _PER_BEAM,
        "velocity": _array(_array(_NULLABLE)),
        "velocity_std": _PER_CELL,
        **dict.fromkeys(("amplitude", "correlation", "percent_good"), _PER_BEAM),
        **dict.fromkeys(
            (
                "sound_speed",
                "temperature",
                "pressure",
                "heading",
                "pitch",
                "roll",
                "magnetic_declination",
            ),
            _NULLABLE,
        ),
        "declination_applied": _MAYBE_BOOLEAN,
        "bottom_track": {
            "type": ["object", "null"],
            "properties": {"velocity": _array(_NULLABLE), "distance": _array(_NULLABLE)},
        },
        "platform_velocity": {
            "type": ["object", "null"],
            "properties": {"east": _NULLABLE, "north": _NULLABLE, "source": _STRING},
        },
        "attitude_convention": _words("teledyne", "nortek"),
        "tilt_applied": _MAYBE_BOOLEAN,
        "clock_offset": _NULLABLE,
        "error_velocity": {"type": ["array", "null"], "items": _NULLABLE},
        "snr": _PER_BEAM,
        "noise_floor": _PER_CELL,
        "derived": _MAYBE_BOOLEAN,
    },
    (
        "stamp",
        "coordinate_system",
        "reference",
        "orientation",
        "n_cells",
        "cell_size",
        "bin0_distance",
        "velocity",
    ),
    "replay_kit.AdcpPing",
)

#: Schema of the mean current of a dive.
DIVE_MEAN = "replay_kit.DepthAveragedCurrent"
_DEPTH_AVERAGED_CURRENT = _object(
    {
        "stamp": _STAMP,
        "dive": _INTEGER,
        "dac_eastward": _NULLABLE,
        "dac_northward": _NULLABLE,
        "error": _NULLABLE,
        "start_fix": _FIX,
        "end_fix": _FIX,
        "duration": _NUMBER,
        "dac_kind": _STRING,
    },
    title=DIVE_MEAN,
)

_LOCATION_FIX = _object(
    {
        "timestamp": _STAMP,
        "frame_id": _STRING,
        "latitude": _NUMBER,
        "longitude": _NUMBER,
        "altitude": _NUMBER,
        "position_covariance": {**_array(_NUMBER), "minItems": 9, "maxItems": 9},
        "position_covariance_type": {"type": "integer", "enum": [0, 1, 2, 3]},
        "metadata": _array(_object({"key": _STRING, "value": _STRING})),
    },
    title="foxglove.LocationFix",
)

JSON_SCHEMAS: dict[str, dict[str, Any]] = {
    "replay_kit.AdcpPing": _ADCP_PING,
    DIVE_MEAN: _DEPTH_AVERAGED_CURRENT,
    "foxglove.LocationFix": _LOCATION_FIX,
}

ANY_OBJECT: dict[str, Any] = {"type": "object"}


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
            self._channel(message.topic, message.schema),
            sequence,
            time_ns,
            time_ns,
            data,
        )

    def _channel(self, topic: str, schema: str) -> RawChannel:
        """Return the channel of a topic and schema."""
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
