"""Positions of the vehicle, its fixes at the surface, and the position of each ping.

A ping's position is interpolated between those before and after it, for which it waits. A vessel's ping without the vessel's velocity waits
for the fixes that give it. Messages are in order of time.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array, Indices, Mask
from replay_kit.core.geodesy import to_geographic_about, to_local_about
from replay_kit.core.observation.table import Columns, Integers, Rows, chosen_rows

#: Columns of positions: submerged and dive are the vehicle's, by its depths; own says whether
#: the use of its message is told with it.
ROW: Mapping[str, type] = {
    **dict.fromkeys(("time", "order", "input", "topic", "ordinal"), np.int64),
    **dict.fromkeys(("longitude", "latitude", "depth"), np.float64),
    **dict.fromkeys(("dead_reckoned", "own", "submerged"), np.bool_),
    "dive": np.int64,
}
# m/s; by which a glider's velocity on one leg departs from its mean over the dive: the place at a share s of a dive of T seconds, taken on
# the straight way between its ends, is off by this times T s (1 - s)
_SPEED_STD = 0.1
# ns; fixes this far from a time, before and after, give the velocity; fewer than three give none
WINDOW = 20_000_000_000
_LEAST_FIXES = 3
# m; noise of a fix against its neighbours, and the rounding of 32-bit degrees, at the least
_FIX_ERROR = 0.5
NEVER = np.iinfo(np.int64).max
LONG_AGO = np.iinfo(np.int64).min // 2


def no_rows() -> Rows:
    """Return no positions."""
    return {name: np.empty(0, kind) for name, kind in ROW.items()}


def appended(*parts: Columns) -> Rows:
    """Return the concatenated rows of positions."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def in_order(*parts: Columns) -> Rows:
    """Return the rows of all parts in the order of the stream."""
    rows = appended(*parts)
    return chosen_rows(rows, np.argsort(rows["order"], kind="stable"))


def as_of(at: Integers, order: Integers) -> Indices:
    """Return the index of the last row up to positions in the stream; -1 before the first.

    Args:
        at: Positions in the stream.
        order: Positions of the rows, ascending.
    """
    return np.searchsorted(order, at, side="right") - 1


def fixes_of(positions: Columns) -> Rows:
    """Return the fixes at the surface among positions, each later than those before it."""
    rows = chosen_rows(positions, ~(positions["dead_reckoned"] | positions["submerged"]))
    latest = np.maximum.accumulate(np.append(LONG_AGO, rows["time"]))
    return chosen_rows(rows, rows["time"] > latest[:-1])


def recent(positions: Columns) -> Rows:
    """Return the positions that may still be needed for pings: those of two windows before the last."""
    time = positions["time"]
    return chosen_rows(positions, time > time[-1:].max(initial=LONG_AGO) - 2 * WINDOW)


_BESIDE = {"time": LONG_AGO, "longitude": np.nan, "latitude": np.nan}
#: Time [ns, UTC], longitude and latitude [degrees] of a position beside each ping, shapes (n,); long ago and NaN for none.
Beside = list[NDArray[Any]]


def positions_at(rows: Columns, at: Indices) -> Beside:
    """Return positions by index, NaN for -1."""
    return [np.append(rows[name], end)[at] for name, end in _BESIDE.items()]


def placed_pings(
    time: Integers, in_dive: Mask, positions: Columns, upto: Indices, config: MeasurementConfig
) -> tuple[Array, Array, Array]:
    """Return longitude and latitude of pings [degrees], NaN without one, and their standard error [m], shapes (n,).

    The error is 0 near the time of a known position.

    Args:
        time: Times of the pings [ns, UTC].
        in_dive: Whether the vehicle was in a dive with a known earlier position.
        positions: Positions of the vehicle.
        upto: Number of known positions.
        config: Limits of distance in time.
    """
    later = np.searchsorted(positions["time"], time, side="right")
    before = positions_at(positions, np.minimum(later, upto) - 1)
    after = positions_at(positions, np.where(later < upto, later, -1))
    since, until = time - before[0], np.abs(after[0] - time)
    span, both = after[0] - before[0], np.isfinite(before[1] + after[1])
    is_near = np.minimum(since, until) <= config.position_max_age * 1e9
    in_gap = ~is_near & in_dive & both & (span <= config.position_max_gap * 1e9)
    known, earlier = is_near | in_gap, since <= until
    longitude, latitude = (
        np.where(known, np.where(earlier, before[k], after[k]), np.nan) for k in (1, 2)
    )
    share, std = np.zeros(time.size), np.zeros(time.size)
    at = np.flatnonzero(both & (since > 0) & known)
    if at.size:
        share[at] = since[at] / span[at]
        start = before[1][at], before[2][at]
        east, north = to_local_about(*start, after[1][at], after[2][at])
        found = to_geographic_about(*start, share[at] * east, share[at] * north)
        longitude[at] = start[0] + np.mod(found[0] - start[0] + 180.0, 360.0) - 180.0
        latitude[at] = found[1]
    std[in_gap] = _SPEED_STD * (since * 1e-9 * (1.0 - share))[in_gap]
    return longitude, latitude, std


def vessel_velocity(time: Integers, fixes: Columns, upto: Indices) -> Array:
    """Return a vessel's velocity over ground, true east and north, and its error, shape (n, 3) [m/s].

    The least-squares slope of the fixes within 20 s, with its error from their residuals, larger for a turning vessel. NaN for fewer than
    three fixes, or all on one side.

    Args:
        time: shape (n,) [ns, UTC].
        fixes: Fixes of the vessel.
        upto: shape (n,), number of known fixes.
    """
    when, found = fixes["time"], np.full((time.size, 3), np.nan)
    begin = np.searchsorted(when, time - WINDOW, side="left")
    end = np.minimum(np.searchsorted(when, time + WINDOW, side="right"), upto)
    at = np.flatnonzero(end - begin >= _LEAST_FIXES)
    at = at[(when[begin[at]] <= time[at]) & (time[at] <= when[end[at] - 1])]
    # pings with as many fixes around them are one array
    count = end[at] - begin[at]
    for number in np.unique(count):
        alike = at[count == number]
        rows = begin[alike, None] + np.arange(number)
        since = (when[rows] - time[alike, None]) * 1e-9
        centre = np.take_along_axis(rows, np.abs(since).argmin(axis=1)[:, None], axis=1)
        centre = np.repeat(centre, number, axis=1)
        # about the nearest fix the local axes are true east and north
        each = (fixes[name][k.ravel()] for k in (centre, rows) for name in list(_BESIDE)[1:])
        place = np.stack(to_local_about(*each), axis=-1).reshape(alike.size, number, 2)
        since = since - _sum(since)[:, None] / number
        spread = _sum(since**2)
        slope = _sum(since[..., None] * place) / spread[:, None]
        residual = place - (_sum(place) / number)[:, None] - since[..., None] * slope[:, None]
        scatter = np.sqrt(_sum(residual**2).sum(axis=1) / (2 * (number - 2)))
        error = np.maximum(scatter, _FIX_ERROR) / np.sqrt(spread)
        found[alike] = np.column_stack([slope, error])
    return found


def _sum(values: NDArray[Any]) -> Array:
    """Return sums over the second axis in order, independent of other rows."""
    return np.asarray(np.cumsum(values, axis=1)[:, -1])
