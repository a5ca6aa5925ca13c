"""The messages of our own logs as a MAVLink 2 telemetry log: a stamp of microseconds, then a frame, and so on.

The carrier has no message for a depth-averaged current, and no field for a ping's amplitude, correlation and the like: these
are left out. A ping goes as five ``DEBUG_FLOAT_ARRAY`` frames, NaN for what is not known.
"""

import math
import struct
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from replay_kit.errors import LogError
from replay_kit.logs.atomic import atomic_file
from replay_kit.types import Message

MAX_CELLS = 58
_STAMP = struct.Struct(">Q")
_SYSTEM, _COMPONENT = 1, 1
_UNKNOWN_U16 = 65535
_FIX_3D = 3
_COORDINATE_SYSTEMS = ("beam", "instrument", "ship", "earth")
_REFERENCES = ("earth", "platform")
_ORIENTATIONS = ("down", "up")


def write_tlog(path: Path, messages: Iterable[Message]) -> Mapping[str, int]:
    """Write fixes, dead-reckoned positions and pings as a telemetry log and return the number of frames by MAVLink name.

    Args:
        path: The log; a file of that name is replaced.
        messages: ``foxglove.LocationFix`` and ``replay_kit.AdcpPing`` in order of time; others have no frame and are left out.

    Raises:
        ConfigError: The file cannot be written.
        LogError: A ping has more than 58 cells.
    """
    mav = dialect.MAVLink(None, srcSystem=_SYSTEM, srcComponent=_COMPONENT)
    written: dict[str, int] = {}
    boot_ns: int | None = None
    with atomic_file(path) as file:
        for message in messages:
            boot_ns = message.time_ns if boot_ns is None else boot_ns
            frames = _FRAMES.get(message.schema)
            for frame in frames(message, (message.time_ns - boot_ns) // 1_000_000) if frames else ():
                file.write(_STAMP.pack(message.time_ns // 1000) + frame.pack(mav))
                mav.seq = (mav.seq + 1) % 256
                written[frame.get_type()] = written.get(frame.get_type(), 0) + 1
    return written


def _position_frames(message: Message, boot_ms: int) -> Iterator[Any]:
    payload = message.payload
    extra = {pair["key"]: pair["value"] for pair in payload.get("metadata") or ()}
    latitude, longitude = round(payload["latitude"] * 1e7), round(payload["longitude"] * 1e7)
    altitude = -round(float(extra.get("depth", 0.0)) * 1000.0)
    if extra.get("dead_reckoned") != "true":
        unknown = _UNKNOWN_U16
        yield dialect.MAVLink_gps_raw_int_message(
            message.time_ns // 1000, _FIX_3D, latitude, longitude, altitude, unknown, unknown, unknown, unknown, 255
        )
    # the vehicle's motion is not part of a LocationFix: velocity zero, heading unknown
    yield dialect.MAVLink_global_position_int_message(boot_ms, latitude, longitude, altitude, altitude, 0, 0, 0, _UNKNOWN_U16)


def _ping_frames(message: Message, boot_ms: int) -> Iterator[Any]:
    payload = message.payload
    time_us = message.time_ns // 1000
    yield dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_SUBMARINE, dialect.MAV_AUTOPILOT_GENERIC, 0, 0, dialect.MAV_STATE_ACTIVE, mavlink_version=3
    )
    yield dialect.MAVLink_system_time_message(time_us, boot_ms)
    roll, pitch, heading = (math.radians(_number(payload.get(key))) for key in ("roll", "pitch", "heading"))
    yield dialect.MAVLink_attitude_message(boot_ms, roll, pitch, math.remainder(heading, math.tau), 0.0, 0.0, 0.0)
    n_cells = payload["n_cells"]
    if n_cells > MAX_CELLS:
        raise LogError(
            f"{message.topic} at {message.time_ns} ns: a MAVLink ping holds at most {MAX_CELLS} cells, got {n_cells}; write MCAP instead"
        )
    std = payload.get("velocity_std")
    arrays = {"ADCP_CFG": _configuration(payload)}
    # a ping without the vertical component has no frame for it
    for component, name in enumerate(("ADCP_E", "ADCP_N", "ADCP_U")[: len(payload["velocity"][0])]):
        arrays[name] = [_number(cell[component]) for cell in payload["velocity"]]
    arrays["ADCP_STD"] = [_number(value) for value in std] if isinstance(std, list) else [_number(std)] * n_cells
    array_id = int(payload.get("ping", 0)) % 65536
    for name, data in arrays.items():
        padded = data + [math.nan] * (MAX_CELLS - len(data))
        yield dialect.MAVLink_debug_float_array_message(time_us, name.encode(), array_id, padded)


def _configuration(payload: Mapping[str, Any]) -> list[float]:
    return [
        float(payload["n_cells"]),
        float(payload["cell_size"]),
        float(payload["bin0_distance"]),
        float(_COORDINATE_SYSTEMS.index(payload["coordinate_system"])),
        float(_REFERENCES.index(payload["reference"])),
        float(_ORIENTATIONS.index(payload["orientation"])),
        _number(payload.get("bin_mapped")),
        _number(payload.get("heading")),
        _number(payload.get("pitch")),
        _number(payload.get("roll")),
        _number(payload.get("pressure")),
        _number(payload.get("sound_speed")),
        _number(payload.get("temperature")),
        _number(payload.get("magnetic_declination")),
        _number(payload.get("declination_applied")),
        float(len(payload["velocity"][0])),
        _number(payload.get("transducer_depth")),
    ]


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)


_FRAMES: dict[str, Callable[[Message, int], Iterator[Any]]] = {
    "foxglove.LocationFix": _position_frames,
    "replay_kit.AdcpPing": _ping_frames,
}
