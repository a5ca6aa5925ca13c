"""Writer of messages as a MAVLink 2 telemetry log: stamps in microseconds and frames.

MAVLink has no message for a depth-averaged current and no fields for a ping's amplitude, correlation and so on: these are dropped and
counted. A ping is written as five ``DEBUG_FLOAT_ARRAY`` frames; unknown values are NaN.
"""

import math
import struct
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from replay_kit.core.atomic import atomic_file
from replay_kit.core.errors import LogError
from replay_kit.core.message import Message
from replay_kit.logs.tables.frames import CONFIGURATION, PARTS
from replay_kit.logs.tables.instruments import WORDS

MAX_CELLS = 58
_STAMP = struct.Struct(">Q")
_SYSTEM, _COMPONENT = 1, 1
_BOOT_WRAPS = 2**32
_UNKNOWN_U16 = 65535
_FIX_3D = 3
# the words that measurements take as true
_TRUE = ("true", "1")
_COMPONENTS = 3
#: Fields of a ping that the frames or the log around them hold, and those that it must state as numbers.
_HELD = {*CONFIGURATION, "stamp", "frame_id", "ping", "velocity", "velocity_std"}
_STATED = ("n_cells", "cell_size", "bin0_distance")


class _UnfitError(Exception):
    """Message without a frame, with the reason."""


_UNFIT = (
    _UnfitError,
    ArithmeticError,
    AttributeError,
    LookupError,
    TypeError,
    ValueError,
    struct.error,
)


class TlogFrames:
    """Converter of messages to entries of a telemetry log, with counts of dropped parts.

    Attributes:
        left_out: Number of messages by topic and dropped part with its reason.
    """

    def __init__(self, beside_vehicle: bool = False) -> None:
        """Create a converter.

        Args:
            beside_vehicle: Whether the log also holds the vehicle's own frames: the new ones then come from the onboard computer, a
                component with its own clock.
        """
        self.left_out: Counter[tuple[str, str]] = Counter()
        component = dialect.MAV_COMP_ID_ONBOARD_COMPUTER if beside_vehicle else _COMPONENT
        self._mav = dialect.MAVLink(None, srcSystem=_SYSTEM, srcComponent=component)
        self._boot_ns: int | None = None

    def entries(self, message: Message) -> Iterator[tuple[str, bytes]]:
        """Yield MAVLink name and entry (stamp and frame) for each frame of a message, if any.

        Args:
            message: ``foxglove.LocationFix`` or ``replay_kit.AdcpPing``; others are dropped.

        Raises:
            LogError: A ping has more than 58 cells.
        """
        make = _FRAMES.get(message.schema)
        if make is None:
            self.left_out[
                message.topic,
                f"there is no frame for {message.schema or 'a message without a schema'}",
            ] += 1
            return
        self._boot_ns = message.time_ns if self._boot_ns is None else self._boot_ns
        stamp = _STAMP.pack(message.time_ns // 1000)
        try:
            # all of a message's frames or none
            made = list(
                make(message, max(message.time_ns - self._boot_ns, 0) // 1_000_000 % _BOOT_WRAPS)
            )
            packed = [(frame.get_type(), stamp + self._packed(frame)) for frame in made]
        except _UNFIT as error:
            why = (
                error
                if isinstance(error, _UnfitError)
                else "a field is not of the expected type, or out of a frame's range"
            )
            self.left_out[message.topic, f"no frame can be made: {why}"] += 1
            return
        lost = _dropped_fields(message.payload) if message.schema == "replay_kit.AdcpPing" else ()
        if lost:
            self.left_out[message.topic, f"{', '.join(lost)}: a frame has no field for each"] += 1
        yield from packed

    def _packed(self, frame: Any) -> bytes:
        data = bytes(frame.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256
        return data


def write_tlog(path: Path, messages: Iterable[Message]) -> Mapping[str, int]:
    """Write fixes, dead-reckoned positions and pings as a telemetry log and return the number of frames by MAVLink name.

    Args:
        path: Log; an existing file is replaced.
        messages: ``foxglove.LocationFix`` and ``replay_kit.AdcpPing`` in order of time; others are dropped.

    Raises:
        ConfigError: The file cannot be written.
        LogError: A ping has more than 58 cells.
    """
    frames = TlogFrames()
    written: Counter[str] = Counter()
    with atomic_file(path) as file:
        for message in messages:
            for name, entry in frames.entries(message):
                file.write(entry)
                written[name] += 1
    return dict(written)


def _position_frames(message: Message, boot_ms: int) -> Iterator[Any]:
    payload = message.payload
    extra = {pair["key"]: pair["value"] for pair in payload.get("metadata") or ()}
    degrees = _stated(payload, "latitude")
    if abs(degrees) > 90.0:
        raise _UnfitError("expected latitude from -90 to 90 degrees")
    # a frame holds at most 214 degrees: east above 180 becomes west
    latitude, longitude = (
        round(degrees * 1e7),
        round(math.remainder(_stated(payload, "longitude"), 360.0) * 1e7),
    )
    depth = _number(extra.get("depth"))
    altitude = 0 if math.isnan(depth) else -round(depth * 1000.0)
    if str(extra.get("dead_reckoned", "")).strip().lower() not in _TRUE:
        unknown = _UNKNOWN_U16
        yield dialect.MAVLink_gps_raw_int_message(
            message.time_ns // 1000,
            _FIX_3D,
            latitude,
            longitude,
            altitude,
            unknown,
            unknown,
            unknown,
            unknown,
            255,
        )
    # the vehicle's motion is not part of a LocationFix: velocity zero, heading unknown
    yield dialect.MAVLink_global_position_int_message(
        boot_ms, latitude, longitude, altitude, altitude, 0, 0, 0, _UNKNOWN_U16
    )


def _ping_frames(message: Message, boot_ms: int) -> Iterator[Any]:
    payload = message.payload
    time_us = message.time_ns // 1000
    n_cells = payload["n_cells"]
    if n_cells > MAX_CELLS:
        raise LogError(
            f"{message.topic} at {message.time_ns} ns: a MAVLink ping holds at most {MAX_CELLS} cells, got {n_cells}; write MCAP instead"
        )
    columns = _columns(payload)
    yield dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_SUBMARINE,
        dialect.MAV_AUTOPILOT_GENERIC,
        0,
        0,
        dialect.MAV_STATE_ACTIVE,
        mavlink_version=3,
    )
    yield dialect.MAVLink_system_time_message(time_us, boot_ms)
    roll, pitch, heading = (
        math.radians(_number(payload.get(key))) for key in ("roll", "pitch", "heading")
    )
    yield dialect.MAVLink_attitude_message(
        boot_ms, roll, pitch, math.remainder(heading, math.tau), 0.0, 0.0, 0.0
    )
    std = payload.get("velocity_std")
    # a ping without the vertical component has no frame for it
    arrays = {PARTS[0]: [*_configuration(payload, len(columns))]}
    arrays |= dict(zip(PARTS[1:-1], columns, strict=False))
    arrays[PARTS[-1]] = (
        [_number(value) for value in std] if isinstance(std, list) else [_number(std)] * n_cells
    )
    array_id = int(payload.get("ping") or 0) % 65536
    for name, data in arrays.items():
        padded = data + [math.nan] * (MAX_CELLS - len(data))
        yield dialect.MAVLink_debug_float_array_message(time_us, name.encode(), array_id, padded)


def _cells(payload: Mapping[str, Any]) -> list[list[Any]]:
    """Return a ping's velocities by cell; an unknown cell is empty."""
    velocity, n_cells = list(payload["velocity"]), payload["n_cells"]
    if any(isinstance(cell, list | tuple) for cell in velocity):
        return [list(cell or ()) for cell in velocity]
    # protobuf has the cells one after another; a list of nulls has no components at all
    n = max(len(velocity) // n_cells, 1)
    return [velocity[k : k + n] if n > 1 else [] for k in range(0, len(velocity), n)]


def _columns(payload: Mapping[str, Any]) -> list[list[float]]:
    """Return a ping's velocities by component, two or three; NaN for missing values."""
    cells = _cells(payload)
    if len(cells) != payload["n_cells"]:
        raise _UnfitError("expected as many cells of velocity as n_cells says")
    n = max(max(map(len, cells), default=0), 2)
    if n > _COMPONENTS and payload["coordinate_system"] == "beam":
        raise _UnfitError(f"it has {n} beams, of which the frames hold {_COMPONENTS}")
    return [
        [_number(cell[k]) if k < len(cell) else math.nan for cell in cells]
        for k in range(min(n, _COMPONENTS))
    ]


def _dropped_fields(payload: Mapping[str, Any]) -> list[str]:
    """Return the fields of a ping that its frames cannot hold."""
    lost = sorted(
        key
        for key, value in payload.items()
        if key not in _HELD and value not in (None, [], {}, "")
    )
    return (
        [*lost, f"components of velocity after {_COMPONENTS}"]
        if max(map(len, _cells(payload)), default=0) > _COMPONENTS
        else lost
    )


def _configuration(payload: Mapping[str, Any], n_components: int) -> Iterator[float]:
    for name in CONFIGURATION:
        if name in WORDS:
            yield _choice(payload, name, WORDS[name])
        elif name == "n_components":
            yield float(n_components)
        else:
            yield _stated(payload, name) if name in _STATED else _number(payload.get(name))


def _stated(payload: Mapping[str, Any], key: str) -> float:
    value = payload.get(key)
    if not isinstance(value, int | float) or not math.isfinite(value):
        raise _UnfitError(f"expected {key} to be a number")
    return float(value)


def _choice(payload: Mapping[str, Any], key: str, words: tuple[str, ...]) -> float:
    if payload.get(key) not in words:
        raise _UnfitError(f"expected {key} to be one of {', '.join(words)}")
    return float(words.index(payload[key]))


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)


_FRAMES: dict[str, Callable[[Message, int], Iterator[Any]]] = {
    "foxglove.LocationFix": _position_frames,
    "replay_kit.AdcpPing": _ping_frames,
}
