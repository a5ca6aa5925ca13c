"""The platform's velocity over the ground, for pings that do not state it: from a DVL's bottom track, or from a surface vessel's fixes."""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import replace
from operator import attrgetter

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.observation import VehicleState
from replay_kit.core.vessel import LEAST_FIXES, WINDOW_S, Track, vessel_velocity
from replay_kit.measurements.ping.adcp_ping import AdcpPing, PlatformVelocity
from replay_kit.measurements.ping.earth import earth_referenced

_WINDOW_NS = int(WINDOW_S * 1e9)
# more fixes than one a second cost time and say little more
_LEAST_STEP_NS = 900_000_000
# a vehicle may turn and stop in more
_BOTTOM_AGE_NS = 3_000_000_000
_time = attrgetter("time_ns")

#: A vessel's latest fixes at the surface, in the order of their times.
Fixes = tuple[VehicleState, ...]


def lacks_motion(ping: AdcpPing) -> bool:
    """Return whether a ping's velocities are relative to a platform of whose motion it says nothing."""
    return ping.reference == "platform" and ping.bottom_track is None and ping.platform_velocity is None


def with_bottom_track(ping: AdcpPing, bottom: tuple[int, PlatformVelocity] | None, time_ns: int) -> AdcpPing:
    """Return a ping with the velocity that a DVL measured within three seconds of it, where it does not state one itself.

    Args:
        ping: The ping.
        bottom: The DVL's last velocity over the ground, after its time [ns, UTC].
        time_ns: The ping's.
    """
    if bottom is None or abs(time_ns - bottom[0]) > _BOTTOM_AGE_NS or not lacks_motion(ping):
        return ping
    return replace(ping, platform_velocity=bottom[1])


def append_fix(track: Fixes, fix: VehicleState) -> Fixes:
    """Return a vessel's latest fixes with one more: those that may still give the velocity at a ping."""
    if track and fix.time_ns - track[-1].time_ns < _LEAST_STEP_NS:
        return track
    return (*track[bisect_right(track, fix.time_ns - 2 * _WINDOW_NS, key=_time) :], fix)


def waits_until(ping: AdcpPing, time_ns: int, track: Fixes) -> int:
    """Return when a ping has all the fixes that give its platform's velocity [ns, UTC]: its own time where none will."""
    frequent = len(track) - bisect_right(track, time_ns - _WINDOW_NS, key=_time) >= LEAST_FIXES
    return time_ns + _WINDOW_NS if frequent and lacks_motion(ping) else time_ns


def with_gps_velocity(ping: AdcpPing, time_ns: int, track: Fixes, config: MeasurementConfig) -> AdcpPing:
    """Return a ping made absolute by the fixes around it; as it is when these are too few, or all on one side of it.

    Args:
        ping: A ping relative to the vessel.
        time_ns: Its time [ns, UTC].
        track: The vessel's fixes.
        config: The fastest motion that is believed.
    """
    near = [fix for fix in track if abs(fix.time_ns - time_ns) <= _WINDOW_NS]
    if not near or not near[0].time_ns <= time_ns <= near[-1].time_ns:
        return ping
    times, longitude, latitude = (np.array(column) for column in zip(*((f.time_ns, f.longitude, f.latitude) for f in near), strict=True))
    (velocity,), (error,) = vessel_velocity(np.array([time_ns]), Track(times, longitude, latitude))
    if not np.isfinite(velocity).all():
        return ping
    east, north = velocity.tolist()
    return earth_referenced(replace(ping, platform_velocity=PlatformVelocity(east, north, float(error), "gps")), config)


def fixes_around(track: Sequence[VehicleState], time_ns: int) -> tuple[VehicleState | None, VehicleState | None]:
    """Return the last fix up to a time, and the first after it."""
    at = bisect_right(track, time_ns, key=_time)
    return (track[at - 1] if at else None), (track[at] if at < len(track) else None)
