"""What ArduPilot's logs say: where the vehicle is, and ADCP pings carried by MAVLink.

In its telemetry and in the DataFlash log that it writes itself a filter's position goes on when GPS is lost: it is then computed, and
marked so. Five ``DEBUG_FLOAT_ARRAY`` frames become one ``replay_kit.AdcpPing`` payload: they belong together when topic, ``array_id`` and
``time_usec`` agree. The layout of ``ADCP_CFG`` is in ``ADCP_PING.md`` beside this file. NaN means unknown.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, repeat
from typing import Any

from replay_kit.core.errors import MeasurementError
from replay_kit.core.message import Message
from replay_kit.measurements.messages.fields import number, whole_number
from replay_kit.measurements.messages.vehicle import Depth, Pose, Position, checked

#: What a reader needs to decode for this module.
NAMES = frozenset(
    {
        "GPS_RAW_INT",
        "GLOBAL_POSITION_INT",
        "LOCAL_POSITION_NED",
        "GPS_GLOBAL_ORIGIN",
        "dataflash.GPS",
        "dataflash.POS",
        "dataflash.CTUN",
    }
)
_FIX_3D = 3
#: A position is measured while the last three-dimensional fix is no older than this [ns].
_FIX_AGE_NS = 5_000_000_000


@dataclass(frozen=True, slots=True)
class GpsStatus:
    """What a system's GPS says of its fix.

    Attributes:
        system: ``mavlink/{system}``.
        no_fix: Why it has no three-dimensional fix; empty when it has one.
    """

    system: str
    no_fix: str


@dataclass(frozen=True, slots=True)
class NavigationPosition:
    """A position by a system's filter, which does not say whether GPS is still in it.

    Attributes:
        system: ``mavlink/{system}``.
        position: As stated, as if it were measured.
    """

    system: str
    position: Position


@dataclass(frozen=True, slots=True)
class LocalOrigin:
    """Where a system's local frame has its origin.

    Attributes:
        system: ``mavlink/{system}``.
        longitude: [degrees east].
        latitude: [degrees north].
    """

    system: str
    longitude: float
    latitude: float


def local_position_ned(message: Message) -> Pose | str:
    """Return the position in a ``LOCAL_POSITION_NED``, or why it is none."""
    north, east, down = (number(message.payload.get(axis)) for axis in "xyz")
    if not math.isfinite(north + east + down):
        return "position is not a number"
    return Pose(east, north, down, None, _system(message.topic))


def gps_global_origin(message: Message) -> LocalOrigin | str:
    """Return the origin in a ``GPS_GLOBAL_ORIGIN``, or why it is none."""
    longitude, latitude = (number(message.payload.get(f"{name}itude")) for name in ("long", "lat"))
    found = checked(1e-7 * longitude, 1e-7 * latitude, math.nan, False)
    if isinstance(found, str):
        return found
    return LocalOrigin(_system(message.topic), found.longitude, found.latitude)


def gps_raw_int(message: Message) -> GpsStatus:
    """Return what a ``GPS_RAW_INT`` says of its system's fix."""
    return GpsStatus(_system(message.topic), _no_fix(message.payload, "fix_type"))


def global_position_int(message: Message) -> NavigationPosition | str:
    """Return the position in a ``GLOBAL_POSITION_INT``, or why it is none."""
    payload = message.payload
    longitude, latitude = number(payload.get("lon")) * 1e-7, number(payload.get("lat")) * 1e-7
    position = checked(longitude, latitude, -number(payload.get("relative_alt")) * 1e-3, False)
    return (
        position
        if isinstance(position, str)
        else NavigationPosition(_system(message.topic), position)
    )


def dataflash_gps(payload: Mapping[str, Any]) -> Position | str:
    """Return the first receiver's fix, or why there is none."""
    if number(payload.get("I", 0)) > 0:
        return "not the first GPS receiver"
    return _no_fix(payload, "Status") or checked(
        payload.get("Lng"), payload.get("Lat"), math.nan, False
    )


def dataflash_position(payload: Mapping[str, Any]) -> Position | str:
    """Return the filter's position, or why it is none."""
    return checked(payload.get("Lng"), payload.get("Lat"), math.nan, True)


def dataflash_depth(payload: Mapping[str, Any]) -> Depth:
    """Return the depth that the vehicle's controller uses.

    BARO is left alone: which of its sensors is in the water, and which in the hull or in the air, it does not say.
    """
    return Depth(-number(payload.get("Alt")))


def is_dead_reckoned(gps_fix_ns: Mapping[str, int | None], system: str, time_ns: int) -> bool:
    """Return whether a filter's position is computed: its system has a GPS whose last fix is more than five seconds old, or had none.

    Args:
        gps_fix_ns: Time of the last three-dimensional fix of each system's GPS [ns, UTC]; None where it had none.
        system: ``mavlink/{system}``; one without a GPS in the log is taken at its word.
        time_ns: Of the position.
    """
    if system not in gps_fix_ns:
        return False
    last = gps_fix_ns[system]
    return last is None or time_ns - last > _FIX_AGE_NS


def _no_fix(payload: Mapping[str, Any], name: str) -> str:
    return "" if number(payload.get(name)) >= _FIX_3D else f"no fix ({name} < {_FIX_3D})"


def sender_of(message: Message) -> tuple[str, str] | None:
    """Return the numbers of the MAVLink system and component whose position or depth a message states; None for any other message."""
    parts = message.topic.split("/")
    known = message.schema in NAMES and parts[0] == "mavlink" and len(parts) > 3
    return (parts[1], parts[2]) if known else None


def _system(topic: str) -> str:
    return "/".join(topic.split("/")[:2])


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
