"""ADCP pings carried by MAVLink: five ``DEBUG_FLOAT_ARRAY`` frames become one ``replay_kit.AdcpPing`` payload.

Frames belong together when topic, ``array_id`` and ``time_usec`` agree. The layout of ``ADCP_CFG`` is in
``replay_kit/README.md``. NaN means unknown.
"""

import math
from collections.abc import Mapping
from typing import Any

from replay_kit.core.errors import MeasurementError
from replay_kit.core.message import Message
from replay_kit.measurements.ping.payload import number, whole_number

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
    """Return what the frames of one ping share.

    Raises:
        MeasurementError: The frame does not say which ping it is of, or carries no numbers.
    """
    array_id, time_usec = (whole_number(message.payload.get(name)) for name in ("array_id", "time_usec"))
    if array_id is None or time_usec is None or not isinstance(message.payload.get("data"), list | tuple):
        raise MeasurementError("frame of a ping: expected array_id and time_usec to be integers and data to be a list")
    return message.topic, array_id, time_usec


def is_complete(frames: Mapping[str, Message]) -> bool:
    """Return whether all frames of a ping are there; the vertical component may be absent when the configuration says so."""
    if "ADCP_CFG" not in frames:
        return False
    n_components = _configuration(frames)["n_components"]
    return all(part in frames for part in _PARTS if part != "ADCP_U" or n_components != 2)


def assemble(frames: Mapping[str, Message]) -> dict[str, Any]:
    """Return the ping's payload, as if it had come as JSON; what a frame is too short for is left for the ping's own checks."""
    payload = _configuration(frames)
    n_cells = max(whole_number(payload["n_cells"]) or 0, 0)
    columns = [list(frames[part].payload["data"])[:n_cells] for part in ("ADCP_E", "ADCP_N", "ADCP_U") if part in frames]
    payload["n_cells"] = n_cells
    payload["velocity"] = [list(cell) for cell in zip(*columns, strict=False)]
    payload["velocity_std"] = list(frames["ADCP_STD"].payload["data"])[:n_cells]
    return payload


def _configuration(frames: Mapping[str, Message]) -> dict[str, Any]:
    """Return the named values of ``ADCP_CFG``; NaN where the frame is too short for one."""
    return dict(zip(_CONFIGURATION, [*frames["ADCP_CFG"].payload["data"], *[math.nan] * len(_CONFIGURATION)], strict=False))


def declination_in(message: Message) -> float:
    """Return the magnetic declination [degrees east] that a frame states; NaN when it is not the one that does."""
    if message.payload.get("name") != "ADCP_CFG":
        return math.nan
    return number(_configuration({"ADCP_CFG": message})["magnetic_declination"])
