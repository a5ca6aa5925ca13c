"""The platform's velocity over the ground, for pings that do not state it: from a DVL's bottom track, or from a surface vessel's fixes."""

from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.message import Message
from replay_kit.core.observation import VehicleState
from replay_kit.core.vessel import LEAST_FIXES, WINDOW_S, Track, vessel_velocity
from replay_kit.measurements.ping.earth import earth_referenced

_WINDOW_NS = int(WINDOW_S * 1e9)
# more fixes than one a second cost time and say little more
_LEAST_STEP_NS = 900_000_000
# a vehicle may turn and stop in more
_BOTTOM_AGE_NS = 3_000_000_000


@dataclass(frozen=True, slots=True)
class GroundVelocity:
    """The vehicle's velocity over the ground at one time.

    Attributes:
        time_ns: [ns, UTC].
        east: True east [m/s].
        north: True north [m/s].
        error_std: Of each component [m/s].
    """

    time_ns: int
    east: float
    north: float
    error_std: float


def lacks_motion(payload: Mapping[str, Any]) -> bool:
    """Return whether a ping's velocities are relative to a platform of whose motion it says nothing."""
    relative = payload.get("reference") in ("platform", 1)
    return relative and payload.get("bottom_track") is None and payload.get("platform_velocity") is None


def with_bottom_track(payload: Mapping[str, Any], bottom: GroundVelocity | None, time_ns: int) -> Mapping[str, Any]:
    """Return a ping with the velocity that a DVL measured within three seconds of it, where it does not state one itself."""
    if bottom is None or abs(time_ns - bottom.time_ns) > _BOTTOM_AGE_NS or not lacks_motion(payload):
        return payload
    return {**payload, "platform_velocity": _stated(bottom.east, bottom.north, bottom.error_std, "dvl")}


def sailed(track: tuple[VehicleState, ...], fix: VehicleState) -> tuple[VehicleState, ...]:
    """Return a vessel's latest fixes with one more: those that may still give the velocity at a ping."""
    if track and fix.time_ns - track[-1].time_ns < _LEAST_STEP_NS:
        return track
    return (*track[bisect_right(track, fix.time_ns - 2 * _WINDOW_NS, key=_time) :], fix)


def waits_until(payload: Mapping[str, Any], time_ns: int, track: tuple[VehicleState, ...]) -> int:
    """Return when a ping has all the fixes that give its platform's velocity [ns, UTC]: its own time where none will."""
    frequent = len(track) - bisect_right(track, time_ns - _WINDOW_NS, key=_time) >= LEAST_FIXES
    return time_ns + _WINDOW_NS if frequent and lacks_motion(payload) else time_ns


def under_way(message: Message, track: tuple[VehicleState, ...], config: MeasurementConfig) -> Message:
    """Return a ping made absolute by the fixes around it; as it is when these are too few, or all on one side of it.

    Args:
        message: A ping in earth coordinates, relative to the vessel.
        track: The vessel's fixes.
        config: The fastest motion that is believed.
    """
    near = [fix for fix in track if abs(fix.time_ns - message.time_ns) <= _WINDOW_NS]
    if not near or not near[0].time_ns <= message.time_ns <= near[-1].time_ns:
        return message
    times, longitude, latitude = (np.array(column) for column in zip(*((f.time_ns, f.longitude, f.latitude) for f in near), strict=True))
    (velocity,), (error,) = vessel_velocity(np.array([message.time_ns]), Track(times, longitude, latitude))
    if not np.isfinite(velocity).all():
        return message
    stated = {**message.payload, "platform_velocity": _stated(float(velocity[0]), float(velocity[1]), float(error), "gps")}
    return message._replace(payload=earth_referenced(stated, config))


def around(track: tuple[VehicleState, ...], time_ns: int) -> tuple[VehicleState | None, VehicleState | None]:
    """Return the last fix up to a time, and the first after it."""
    at = bisect_right(track, time_ns, key=_time)
    return (track[at - 1] if at else None), (track[at] if at < len(track) else None)


def _stated(east: float, north: float, std: float, source: str) -> dict[str, Any]:
    return {"east": east, "north": north, "velocity_std": std, "source": source}


def _time(fix: VehicleState) -> int:
    return fix.time_ns
