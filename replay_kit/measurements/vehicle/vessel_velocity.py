"""A surface vessel's velocity over the ground from its fixes, for pings that do not state how their platform moves."""

import math
from bisect import bisect_right
from collections.abc import Sequence
from operator import attrgetter

import numpy as np

from replay_kit.core.geodesy import to_local
from replay_kit.core.grid import Projection
from replay_kit.core.observation import VehicleState
from replay_kit.measurements.ping.adcp_ping import PlatformVelocity

# fixes this far from a time, before and after, give the velocity
_WINDOW_NS = 20_000_000_000
# fewer give none
_LEAST_FIXES = 3
# m; noise of a fix against its neighbours, and the rounding of 32-bit degrees, at the least
_FIX_ERROR = 0.5
_time = attrgetter("time_ns")

#: A vessel's latest fixes at the surface, in the order of their times.
Fixes = tuple[VehicleState, ...]


def append_fix(track: Fixes, fix: VehicleState) -> Fixes:
    """Return a vessel's latest fixes with one more: those that may still give the velocity at a ping."""
    if not track:
        return (fix,)
    if fix.time_ns <= track[-1].time_ns:
        return track
    # the pings that this fix releases are up to a window older than the last fix, and those wanted before them up to another
    return (*track[bisect_right(track, track[-1].time_ns - 2 * _WINDOW_NS, key=_time) :], fix)


def waits_until(time_ns: int, track: Fixes) -> int:
    """Return when all the fixes are there that may give the velocity at a time [ns, UTC]: that time itself without one shortly before."""
    recent = bool(track) and time_ns - track[-1].time_ns <= _WINDOW_NS
    return time_ns + _WINDOW_NS if recent else time_ns


def vessel_velocity(time_ns: int, track: Fixes) -> PlatformVelocity | None:
    """Return the vessel's velocity over the ground at a time; None where fewer than three fixes are within 20 s, or all on one side.

    The slope of a straight line through these fixes, by least squares; its error comes from how far the fixes lie from the line, so that
    a turning vessel's is larger.

    Args:
        time_ns: [ns, UTC].
        track: The vessel's fixes.
    """
    near = [fix for fix in track if abs(fix.time_ns - time_ns) <= _WINDOW_NS]
    if len(near) < _LEAST_FIXES or not near[0].time_ns <= time_ns <= near[-1].time_ns:
        return None
    # about the nearest fix the local axes are true east and north
    centre = min(near, key=lambda fix: abs(fix.time_ns - time_ns))
    longitude, latitude = zip(*((fix.longitude, fix.latitude) for fix in near), strict=True)
    place = np.column_stack(
        to_local(Projection(centre.longitude, centre.latitude), longitude, latitude)
    )
    since = np.array([fix.time_ns - time_ns for fix in near]) * 1e-9
    since -= since.mean()
    spread = float(since @ since)
    slope = since @ place / spread
    residual = place - place.mean(axis=0) - np.outer(since, slope)
    scatter = math.sqrt(np.sum(residual**2) / (2 * (len(near) - 2)))
    return PlatformVelocity(
        float(slope[0]), float(slope[1]), max(scatter, _FIX_ERROR) / math.sqrt(spread), "gps"
    )


def fixes_around(
    track: Sequence[VehicleState], time_ns: int
) -> tuple[VehicleState | None, VehicleState | None]:
    """Return the last fix up to a time, and the first after it."""
    at = bisect_right(track, time_ns, key=_time)
    return (track[at - 1] if at else None), (track[at] if at < len(track) else None)
