"""The vehicle's attitude from other messages, for pings that do not state theirs."""

import math
from dataclasses import dataclass, replace

from replay_kit.measurements.ping.adcp_ping import AdcpPing

# s; an attitude this old says nothing of a ping
_MOST_AGE_NS = 1_000_000_000
_LEAST_NORM, _MOST_NORM = 0.9, 1.1


@dataclass(frozen=True, slots=True)
class Attitude:
    """How the vehicle lies.

    Attributes:
        heading: Of its nose, clockwise from north [degrees, 0..360); whether that is true or magnetic north the message does not say.
        pitch: Nose up [degrees].
        roll: Starboard down [degrees].
    """

    heading: float
    pitch: float
    roll: float


@dataclass(frozen=True, slots=True)
class Orientation:
    """An attitude as its message holds it: messages come often and pings rarely, so it is worked out when a ping needs it.

    Attributes:
        quaternion: x, y, z, w, NaN where not stated; turns vectors from the body (x forward, y left, z up) to the frame (x east,
            y north, z up), as in ROS REP-103.
        ned: Whether the body is forward, right, down and the frame north, east, down instead.
    """

    quaternion: tuple[float, float, float, float]
    ned: bool = False


def attitude_of(orientation: Orientation) -> Attitude | None:
    """Return the attitude of a quaternion, or None when it is none: unset, not a number, or not of unit length."""
    x, y, z, w = orientation.quaternion
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    if not _LEAST_NORM < norm < _MOST_NORM:
        return None
    x, y, z, w = x / norm, y / norm, z / norm, w / norm
    yaw = math.degrees(math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))
    tilt = math.degrees(math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x)))))
    roll = math.degrees(math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)))
    # about an axis to the left a positive turn lowers the nose, about one to the right it raises it
    return (
        Attitude(_compass(yaw), tilt, roll)
        if orientation.ned
        else Attitude(_compass(90.0 - yaw), -tilt, roll)
    )


def _compass(angle: float) -> float:
    """Return an angle in [0, 360); the remainder of a tiny negative one rounds to 360 itself."""
    remainder = angle % 360.0
    return 0.0 if remainder == 360.0 else remainder


def attitude_within(orientation: tuple[int, Orientation] | None, time_ns: int) -> Attitude | None:
    """Return the last attitude before a time, if it is close enough; the orientation comes after its time [ns]."""
    if orientation is None or not 0 <= time_ns - orientation[0] <= _MOST_AGE_NS:
        return None
    return attitude_of(orientation[1])


def with_attitude(
    ping: AdcpPing, orientation: tuple[int, Orientation] | None, time_ns: int
) -> AdcpPing:
    """Return a ping with the attitude that it does not state, if another message stated one close enough in time.

    Its pitch is then an Euler angle, which Teledyne's correction of a tilt sensor must leave alone.

    Args:
        ping: The ping.
        orientation: The last one before it, after its time [ns, UTC].
        time_ns: The ping's.
    """
    if (
        math.isfinite(ping.attitude.heading)
        or (attitude := attitude_within(orientation, time_ns)) is None
    ):
        return ping
    own = replace(
        ping.attitude,
        heading=attitude.heading,
        pitch=attitude.pitch,
        roll=attitude.roll,
        euler_pitch=True,
    )
    return replace(ping, attitude=own)
