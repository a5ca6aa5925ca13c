"""JSON schemas of the messages that replay-kit's logs hold; any other message is declared as an object."""

from typing import Any


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
        "velocity_std": {"type": ["number", "array", "null"], "items": _NULLABLE},
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
        "declination_applied": {"type": ["boolean", "null"]},
        "bottom_track": {
            "type": ["object", "null"],
            "properties": {"velocity": _array(_NULLABLE), "distance": _array(_NULLABLE)},
        },
        "platform_velocity": {
            "type": ["object", "null"],
            "properties": {"east": _NULLABLE, "north": _NULLABLE, "source": _STRING},
        },
        "attitude_convention": _words("teledyne", "nortek"),
        "tilt_applied": {"type": ["boolean", "null"]},
        "clock_offset": _NULLABLE,
        "error_velocity": {"type": ["array", "null"], "items": _NULLABLE},
        "snr": _PER_BEAM,
        "noise_floor": {"type": ["number", "array", "null"], "items": _NULLABLE},
        "derived": {"type": ["boolean", "null"]},
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
