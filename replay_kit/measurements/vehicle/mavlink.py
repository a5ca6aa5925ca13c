"""What ArduPilot's logs say of where the vehicle is: its telemetry, and the DataFlash log it writes itself.

In both, a filter's position goes on when GPS is lost: it is then computed, and marked so.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from replay_kit.core.message import Message
from replay_kit.measurements.ping.payload import number
from replay_kit.measurements.vehicle.position import Position, checked, global_position_int

GPS_SCHEMA = "GPS_RAW_INT"
POSITION_SCHEMA = "GLOBAL_POSITION_INT"
DATAFLASH_GPS, DATAFLASH_POSITION, DATAFLASH_DEPTH = "dataflash.GPS", "dataflash.POS", "dataflash.CTUN"
#: What a reader needs to decode for this module.
NAMES = frozenset({GPS_SCHEMA, POSITION_SCHEMA, DATAFLASH_GPS, DATAFLASH_POSITION, DATAFLASH_DEPTH})
_FIX_3D = 3
#: A position is measured while the last three-dimensional fix is no older than this [ns].
_FIX_AGE_NS = 5_000_000_000


@dataclass(frozen=True, slots=True)
class LastFix:
    """What a system's GPS last said.

    Attributes:
        system: ``mavlink/{system}``.
        time_ns: Of its last three-dimensional fix [ns, UTC]; None when it has had none.
    """

    system: str
    time_ns: int | None


Fixes = tuple[LastFix, ...]


def read(fixes: Fixes, message: Message) -> tuple[Position | float | str | None, Fixes]:
    """Return what a message says, and what is known of the systems' GPS after it.

    It says a position, a depth [m], nothing that is used by itself, or, as text, why it cannot be used.

    Args:
        fixes: What is known of the systems' GPS before it.
        message: Its schema is one of ``NAMES``.
    """
    payload = message.payload
    if message.schema == GPS_SCHEMA:
        return _after_gps(fixes, message)
    if message.schema == POSITION_SCHEMA:
        return _telemetry_position(fixes, message), fixes
    if message.schema == DATAFLASH_GPS:
        if number(payload.get("I", 0)) > 0:
            return "not the first GPS receiver", fixes
        return _no_fix(payload, "Status") or checked(payload.get("Lng"), payload.get("Lat"), math.nan, False), fixes
    if message.schema == DATAFLASH_POSITION:
        return checked(payload.get("Lng"), payload.get("Lat"), math.nan, True), fixes
    # BARO is left alone: which of its sensors is in the water, and which in the hull or in the air, it does not say
    depth = -number(payload.get("Alt"))
    return depth if math.isfinite(depth) else "depth is not a number", fixes


def _after_gps(fixes: Fixes, message: Message) -> tuple[str | None, Fixes]:
    """Return why a ``GPS_RAW_INT`` is no fix, None when it is one, and the systems' last fixes after it."""
    system = _system(message.topic)
    last = next((fix for fix in fixes if fix.system == system), LastFix(system, None))
    refused = _no_fix(message.payload, "fix_type")
    last = last if refused else replace(last, time_ns=message.time_ns)
    return refused, (*(fix for fix in fixes if fix.system != system), last)


def _telemetry_position(fixes: Fixes, message: Message) -> Position | str:
    """Return the position in a ``GLOBAL_POSITION_INT``, or why it is none.

    It is dead-reckoned when the system has a GPS whose last three-dimensional fix is more than five seconds old, or that had none.
    """
    position = global_position_int(message.payload)
    last = next((fix for fix in fixes if fix.system == _system(message.topic)), None)
    if last is None or isinstance(position, str):
        return position
    return replace(position, dead_reckoned=last.time_ns is None or message.time_ns - last.time_ns > _FIX_AGE_NS)


def _no_fix(payload: Mapping[str, Any], name: str) -> str | None:
    return None if number(payload.get(name)) >= _FIX_3D else f"no fix ({name} < {_FIX_3D})"


def system_of(topic: str) -> str | None:
    """Return the number of the MAVLink system that a topic is of; None for a topic of none."""
    parts = topic.split("/")
    return parts[1] if parts[0] == "mavlink" and len(parts) > 2 else None


def _system(topic: str) -> str:
    return "/".join(topic.split("/")[:2])
