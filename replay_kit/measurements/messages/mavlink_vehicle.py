"""What ArduPilot's logs say of where the vehicle is: its telemetry, and the DataFlash log it writes itself.

In both, a filter's position goes on when GPS is lost: it is then computed, and marked so.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from replay_kit.core.message import Message
from replay_kit.measurements.messages.fields import number
from replay_kit.measurements.messages.position import Depth, Position, checked

#: What a reader needs to decode for this module.
NAMES = frozenset(
    {"GPS_RAW_INT", "GLOBAL_POSITION_INT", "dataflash.GPS", "dataflash.POS", "dataflash.CTUN"}
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


def system_of(message: Message) -> str | None:
    """Return the number of the MAVLink system whose position or depth a message states; None for any other message."""
    parts = message.topic.split("/")
    return (
        parts[1] if message.schema in NAMES and parts[0] == "mavlink" and len(parts) > 2 else None
    )


def _system(topic: str) -> str:
    return "/".join(topic.split("/")[:2])
