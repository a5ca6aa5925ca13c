"""ADCP pings carried by MAVLink: five ``DEBUG_FLOAT_ARRAY`` frames become one ``replay_kit.AdcpPing`` payload.

Frames belong together when topic, ``array_id`` and ``time_usec`` agree. The layout of ``ADCP_CFG`` is in
``ADCP_PING.md`` beside this file. NaN means unknown.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, repeat
from typing import Any

from replay_kit.core.errors import MeasurementError
from replay_kit.core.message import Message
from replay_kit.measurements.messages.fields import number, whole_number

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


@dataclass(frozen=True, slots=True)
class PingFrame:
    """One of the frames of a ping.

    Attributes:
        key: What the frames of one ping share: topic, ``array_id``, ``time_usec``.
        name: Which frame it is.
        data: Its numbers.
    """

    key: Key
    name: str
    data: Sequence[Any]


def ping_frame(message: Message) -> PingFrame | None:
    """Return a frame of a ping; None for an array that is none.

    Raises:
        MeasurementError: The frame does not say which ping it is of, or carries no numbers.
    """
    payload = message.payload
    if payload.get("name") not in _PARTS:
        return None
    array_id, time_usec = (whole_number(payload.get(name)) for name in ("array_id", "time_usec"))
    if array_id is None or time_usec is None or not isinstance(payload.get("data"), list | tuple):
        raise MeasurementError(
            "frame of a ping: expected array_id and time_usec to be integers and data to be a list"
        )
    return PingFrame((message.topic, array_id, time_usec), str(payload["name"]), payload["data"])


def is_complete(frames: Mapping[str, PingFrame]) -> bool:
    """Return whether all frames of a ping are there; the vertical component may be absent when the configuration says so."""
    if "ADCP_CFG" not in frames:
        return False
    n_components = _configuration(frames["ADCP_CFG"].data)["n_components"]
    return all(part in frames for part in _PARTS if part != "ADCP_U" or n_components != 2)


def assemble(frames: Mapping[str, PingFrame]) -> dict[str, Any]:
    """Return the ping's payload, as if it had come as JSON; what a frame is too short for is left for the ping's own checks."""
    payload = _configuration(frames["ADCP_CFG"].data)
    n_cells = max(whole_number(payload["n_cells"]) or 0, 0)
    columns = [
        frames[part].data[:n_cells] for part in ("ADCP_E", "ADCP_N", "ADCP_U") if part in frames
    ]
    payload["n_cells"] = n_cells
    payload["velocity"] = [list(cell) for cell in zip(*columns, strict=False)]
    payload["velocity_std"] = list(frames["ADCP_STD"].data)[:n_cells]
    return payload


def _configuration(data: Sequence[Any]) -> dict[str, Any]:
    """Return the named values of ``ADCP_CFG``; NaN where the frame is too short for one."""
    return dict(zip(_CONFIGURATION, chain(data, repeat(math.nan)), strict=False))


def declination_in(frame: PingFrame) -> float:
    """Return the magnetic declination [degrees east] that a frame states; NaN when it is not the one that does."""
    return (
        number(_configuration(frame.data)["magnetic_declination"])
        if frame.name == "ADCP_CFG"
        else math.nan
    )
