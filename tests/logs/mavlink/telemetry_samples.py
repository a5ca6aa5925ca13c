"""A MAVLink telemetry log of fixes and pings, as a vehicle with an ADCP records it: the ping in five ``DEBUG_FLOAT_ARRAY`` frames."""

import math
import struct
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from replay_kit.core.message import Message
from replay_kit.logs.tables.instruments import CONFIGURATION, PARTS, WORDS

#: Values of a frame.
MAX_CELLS = 58
_UNKNOWN = 65535


def write_tlog(path: Path, messages: Iterable[Message]) -> None:
    """Write ``foxglove.LocationFix`` and ``replay_kit.AdcpPing`` messages as a telemetry log; others are left out."""
    sender, boot_ns = dialect.MAVLink(None, srcSystem=1, srcComponent=1), None
    with path.open("wb") as file:
        for message in messages:
            if (make := _FRAMES.get(message.schema)) is None:
                continue
            boot_ns = message.time_ns if boot_ns is None else boot_ns
            for frame in make(message, (message.time_ns - boot_ns) // 1_000_000):
                file.write(struct.pack(">Q", message.time_ns // 1000) + bytes(frame.pack(sender)))
                sender.seq = (sender.seq + 1) % 256


def _fix(message: Message, boot_ms: int) -> Iterator[Any]:
    payload = message.payload
    extra = {pair["key"]: pair["value"] for pair in payload.get("metadata", ())}
    place = [round(payload[name] * 1e7) for name in ("latitude", "longitude")]
    altitude = -round(1000.0 * float(extra.get("depth", 0.0)))
    if extra.get("dead_reckoned") != "true":
        time_us, none = message.time_ns // 1000, [_UNKNOWN] * 4
        yield dialect.MAVLink_gps_raw_int_message(time_us, 3, *place, altitude, *none, 255)
    yield dialect.MAVLink_global_position_int_message(
        boot_ms, *place, altitude, altitude, 0, 0, 0, _UNKNOWN
    )


def _ping(message: Message, boot_ms: int) -> Iterator[Any]:
    payload, time_us = message.payload, message.time_ns // 1000
    yield dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_SUBMARINE, dialect.MAV_AUTOPILOT_GENERIC, 0, 0, dialect.MAV_STATE_ACTIVE, 3
    )
    yield dialect.MAVLink_system_time_message(time_us, boot_ms)
    roll, pitch, heading = (math.radians(_number(payload.get(name))) for name in _ANGLES)
    yield dialect.MAVLink_attitude_message(
        boot_ms, roll, pitch, math.remainder(heading, math.tau), 0.0, 0.0, 0.0
    )
    columns = [
        [_number(value) for value in column] for column in zip(*payload["velocity"], strict=True)
    ]
    known = {**payload, "n_components": len(columns)}
    settings = [
        float(WORDS[name].index(known[name])) if name in WORDS else _number(known.get(name))
        for name in CONFIGURATION
    ]
    std = payload.get("velocity_std")
    errors = std if isinstance(std, list) else [std] * payload["n_cells"]
    # of two components there is no frame of the third
    names = [PARTS[0], *PARTS[1 : 1 + len(columns)], PARTS[-1]]
    for name, values in zip(names, (settings, *columns, map(_number, errors)), strict=True):
        data = [*values]
        yield dialect.MAVLink_debug_float_array_message(
            time_us,
            name.encode(),
            payload["ping"] % 65536,
            data + [math.nan] * (MAX_CELLS - len(data)),
        )


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)


_ANGLES = ("roll", "pitch", "heading")
_FRAMES = {"foxglove.LocationFix": _fix, "replay_kit.AdcpPing": _ping}
