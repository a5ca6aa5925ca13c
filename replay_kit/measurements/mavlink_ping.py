"""ADCP pings carried by MAVLink: five ``DEBUG_FLOAT_ARRAY`` frames become one ``replay_kit.AdcpPing`` payload.

Frames belong together when topic, ``array_id`` and ``time_usec`` agree. The layout of ``ADCP_CFG`` is in
``replay_kit/README.md``. NaN means unknown.
"""

import math
from collections.abc import Mapping
from typing import Any

from replay_kit.types import Message

SCHEMA = "DEBUG_FLOAT_ARRAY"
_PARTS = ("ADCP_CFG", "ADCP_E", "ADCP_N", "ADCP_U", "ADCP_STD")
_CONFIGURATION = (
    "n_cells",
    "cell_size",
    "bin0_distance",
    "coordinate_system",
    "reference",
    "orientation",
    "bin_mapped",
    "heading",
    "pitch",
    "roll",
    "pressure",
    "sound_speed",
    "temperature",
    "magnetic_declination",
    "declination_applied",
    "n_components",
    "transducer_depth",
)

Key = tuple[str, int, int]


def is_ping_frame(message: Message) -> bool:
    """Return whether a message is one of the frames of a ping."""
    return message.schema == SCHEMA and message.payload.get("name") in _PARTS


def frame_key(message: Message) -> Key:
    """Return what the frames of one ping share."""
    return message.topic, int(message.payload["array_id"]), int(message.payload["time_usec"])


def is_complete(frames: Mapping[str, Message]) -> bool:
    """Return whether all frames of a ping are there; the vertical component may be absent when the configuration says so."""
    configuration = frames.get("ADCP_CFG")
    if configuration is None:
        return False
    n_components = configuration.payload["data"][_CONFIGURATION.index("n_components")]
    return all(part in frames for part in _PARTS if part != "ADCP_U" or n_components != 2)


def assemble(frames: Mapping[str, Message]) -> dict[str, Any]:
    """Return the ping's payload, as if it had come as JSON."""
    data = {part: list(frame.payload["data"]) for part, frame in frames.items()}
    payload: dict[str, Any] = dict(zip(_CONFIGURATION, data["ADCP_CFG"], strict=False))
    n_cells = int(payload["n_cells"]) if math.isfinite(payload["n_cells"]) else 0
    columns = [data[part][:n_cells] for part in ("ADCP_E", "ADCP_N", "ADCP_U") if part in data]
    payload["n_cells"] = n_cells
    payload["velocity"] = [list(cell) for cell in zip(*columns, strict=True)]
    payload["velocity_std"] = data["ADCP_STD"][:n_cells]
    return payload
