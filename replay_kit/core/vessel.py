"""A vessel's velocity over the ground from its fixes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import rotate_to_geographic, to_local
from replay_kit.core.grid import Projection

#: Fixes this far from a time, before and after, give the velocity [s].
WINDOW_S = 20.0
#: Fewer fixes give none.
LEAST_FIXES = 3

_NS = 1_000_000_000
_FIX_ERROR = 0.5  # m; noise of a fix against its neighbours, and the rounding of 32-bit degrees, at the least


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """A vessel's fixes.

    Attributes:
        time_ns: shape (n,) [ns, UTC], increasing.
        longitude: shape (n,) [degrees east].
        latitude: shape (n,) [degrees north].
    """

    time_ns: NDArray[np.int64]
    longitude: Array
    latitude: Array


def vessel_velocity(time_ns: NDArray[np.int64], track: Track) -> tuple[Array, Array]:
    """Return the vessel's velocity over the ground at each time, shape (n, 2) [m/s], and its standard error, shape (n,).

    The slope of a straight line through the fixes within 20 s, by least squares; its error comes from how far the fixes lie from
    the line, so that a turning vessel's is larger. NaN where fewer than three fixes are so near.

    Args:
        time_ns: shape (n,) [ns, UTC].
        track: The fixes.
    """
    velocity, error = np.full((time_ns.size, 2), np.nan), np.full(time_ns.size, np.nan)
    if track.time_ns.size < LEAST_FIXES:
        return velocity, error
    projection = Projection(float(track.longitude[0]), float(track.latitude[0]))
    place = np.column_stack(to_local(projection, track.longitude, track.latitude))
    window_ns = int(WINDOW_S * _NS)
    first = np.searchsorted(track.time_ns, time_ns - window_ns)
    last = np.searchsorted(track.time_ns, time_ns + window_ns, side="right")
    for k in np.flatnonzero(last - first >= LEAST_FIXES):
        near = slice(first[k], last[k])
        since = (track.time_ns[near] - time_ns[k]) / _NS
        velocity[k], error[k] = _slope(since, place[near])
    # the local axes are not quite true east and north away from the first fix
    nearest = np.clip(np.searchsorted(track.time_ns, time_ns), 0, track.time_ns.size - 1)
    longitude, latitude = track.longitude[nearest], track.latitude[nearest]
    return np.column_stack(rotate_to_geographic(projection, longitude, latitude, velocity[:, 0], velocity[:, 1])), error


def _slope(since: Array, place: Array) -> tuple[Array, float]:
    """Return the slope of positions, shape (n, 2), in time, and its standard error."""
    t = since - since.mean()
    spread = float(t @ t)
    slope = t @ place / spread
    residual = place - place.mean(axis=0) - t[:, None] * slope
    scatter = np.sqrt(np.sum(residual**2) / (2 * (since.size - 2)))
    return slope, float(max(scatter, _FIX_ERROR) / np.sqrt(spread))
