"""The path between two fixes, as places with the time spent about each, and a surface vessel's velocity from its fixes.

The path is what a mean current along it is a mean over.
The dead-reckoned positions are joined by straight lines at constant speed. Each stretch counts at its middle with the time that it
took, which is exact for whatever is linear along it, and neighbours are merged at their common middle when they become many: the
weights always sum to the whole time, and the mean depth stays that of the lines.
"""

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from operator import attrgetter
from typing import Literal

import numpy as np

from replay_kit.core.geodesy import to_geographic, to_local, unwrap_longitude
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Fix, PathMean, VehicleState
from replay_kit.measurements.ping.adcp_ping import PlatformVelocity

# m and s; a longer stretch counts as several, because a current is not linear in depth or along the way
_LONGEST_DEPTH, _LONGEST_S = 10.0, 300.0
_MOST_PIECES = 64
# stretches kept of a path; when they are more, two become one
_MOST = 256
# of a descent and an ascent at constant speed: an even number, so that none reaches over the deepest point
_V_PIECES = 128

# of a stretch: its time [s], and its middle: time since the start [s], longitude, latitude [degrees], depth [m]
Stretch = tuple[float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class Path:
    """Where the vehicle was since a fix.

    Attributes:
        start: The fix.
        last: Last position on the path.
        stretches: Of the path up to ``last``.
        deepest: Greatest depth since the start [m]; NaN when none is known.
        reckoned: Number of dead-reckoned positions on it.
    """

    start: VehicleState
    last: VehicleState
    stretches: tuple[Stretch, ...] = ()
    deepest: float = math.nan
    reckoned: int = 0


def begin(fix: VehicleState) -> Path:
    """Return the path that begins at a fix."""
    return Path(fix, fix)


def extend(path: Path, position: VehicleState) -> Path:
    """Return a path with one more position; one without a depth, or not later than the last, changes nothing."""
    if not (position.time_ns > path.last.time_ns and math.isfinite(position.depth)):
        return path
    # a fix does not always say how deep it is: at the surface
    first = path.last if math.isfinite(path.last.depth) else replace(path.last, depth=0.0)
    stretches = (*path.stretches, *_stretches(path.start, first, position))
    while len(stretches) > _MOST:
        stretches = _halved(stretches)
    return Path(
        path.start,
        position,
        stretches,
        float(np.fmax(path.deepest, position.depth)),
        path.reckoned + 1,
    )


def at_depth(path: Path, depth: float) -> Path:
    """Return a path on which a depth was met; positions come less often than depths."""
    return (
        path
        if depth <= path.deepest
        else Path(path.start, path.last, path.stretches, depth, path.reckoned)
    )


def path_mean(
    path: Path,
    end: VehicleState,
    velocity: tuple[float, float],
    error_std: float,
    kind: Literal["dac", "drift"],
    dive: int,
) -> PathMean:
    """Return a mean current with the path that it belongs to, moved so that it ends at a fix.

    The way from the dead-reckoned end to the fix is spread over the path linearly in time, as is usual practice: it is what a
    constant current would have done. Without positions between the fixes the path is a straight way, down to the greatest depth
    and up again at constant speed.

    Args:
        path: From the fix before.
        end: The fix after; its source is the message that completed the mean current.
        velocity: Mean current, true east and north [m/s].
        error_std: Of each component [m/s].
        kind: What it is the mean of.
        dive: Number of the dive.
    """
    closed = _closed(path, end)
    seconds, since, longitude, latitude, depth = np.array(closed).T
    projection = Projection(path.start.longitude, path.start.latitude)
    east, north = to_local(projection, longitude, latitude)
    # the last stretch ends where the dead reckoning does: at the surface nothing drives the vehicle
    (reckoned_east, end_east), (reckoned_north, end_north) = to_local(
        projection, [_end_of(path).longitude, end.longitude], [_end_of(path).latitude, end.latitude]
    )
    share = since / ((end.time_ns - path.start.time_ns) * 1e-9)
    longitude, latitude = to_geographic(
        projection,
        east + share * (end_east - reckoned_east),
        north + share * (end_north - reckoned_north),
    )
    return PathMean(
        time_ns=max(end.time_ns, end.source.time_ns),
        path_time_ns=path.start.time_ns + np.round(since * 1e9).astype(np.int64),
        longitude=unwrap_longitude(longitude, path.start.longitude),
        latitude=latitude,
        depth=np.maximum(depth, 0.0),
        weight=seconds / seconds.sum(),
        velocity=velocity,
        error_std=error_std,
        kind=kind,
        dive=dive,
        source=end.source,
        fixes=(_fix(path.start), _fix(end)),
        deepest=path.deepest,
        reckoned=drift_velocity(path, end) if kind == "dac" and path.reckoned else None,
    )


def _fix(position: VehicleState) -> Fix:
    return Fix(position.time_ns, position.longitude, position.latitude)


def drift_velocity(path: Path, end: VehicleState) -> tuple[float, float]:
    """Return how far a fix lies from the dead-reckoned end of the path to it, over the time between the fixes, east and north [m/s]."""
    here, seconds = _end_of(path), (end.time_ns - path.start.time_ns) * 1e-9
    east, north = to_local(Projection(here.longitude, here.latitude), end.longitude, end.latitude)
    return float(east) / seconds, float(north) / seconds


def _end_of(path: Path) -> VehicleState:
    return path.last if path.reckoned else path.start


def _closed(path: Path, end: VehicleState) -> tuple[Stretch, ...]:
    """Return the stretches of a path up to a fix, before the path is moved to end there."""
    start, last = path.start, path.last
    if path.reckoned:
        return (
            *path.stretches,
            *_stretches(start, last, replace(last, time_ns=end.time_ns, depth=max(end.depth, 0.0))),
        )
    total = (end.time_ns - start.time_ns) * 1e-9
    deepest = path.deepest if math.isfinite(path.deepest) else 0.0
    middles = (np.arange(_V_PIECES) + 0.5) / _V_PIECES
    depths = deepest * (1.0 - np.abs(2.0 * middles - 1.0))
    return tuple(
        (total / _V_PIECES, share * total, start.longitude, start.latitude, depth)
        for share, depth in zip(middles.tolist(), depths.tolist(), strict=True)
    )


def _stretches(start: VehicleState, before: VehicleState, after: VehicleState) -> list[Stretch]:
    """Return the stretches of the straight way between two positions, their times counted from a path's start."""
    seconds = (after.time_ns - before.time_ns) * 1e-9
    if seconds <= 0.0:
        return []
    wanted = max(abs(after.depth - before.depth) / _LONGEST_DEPTH, seconds / _LONGEST_S)
    pieces = max(math.ceil(min(wanted, _MOST_PIECES)), 1)
    since = (before.time_ns - start.time_ns) * 1e-9
    west, east = (
        float(unwrap_longitude(place.longitude, start.longitude)) for place in (before, after)
    )
    middles = [(k + 0.5) / pieces for k in range(pieces)]
    return [
        (
            seconds / pieces,
            since + share * seconds,
            west + share * (east - west),
            before.latitude + share * (after.latitude - before.latitude),
            before.depth + share * (after.depth - before.depth),
        )
        for share in middles
    ]


def _halved(stretches: Sequence[Stretch]) -> tuple[Stretch, ...]:
    """Return stretches merged in twos at their middles, weighted by their times; an odd last one stays."""
    merged = [
        (
            a[0] + b[0],
            *((a[0] * x + b[0] * y) / (a[0] + b[0]) for x, y in zip(a[1:], b[1:], strict=True)),
        )
        for a, b in list(pairwise(stretches))[::2]
    ]
    return tuple(merged) if len(stretches) % 2 == 0 else (*merged, stretches[-1])  # type: ignore[arg-type]


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
