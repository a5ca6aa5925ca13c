"""Where the vehicle was: its positions, poses in local frames, fixes at the surface, and the place of each ping.

A ping has the place interpolated between the positions before and after it, and waits for the latter. A vessel's ping that does not state
its motion waits for the fixes after it, which give that. Messages come in the order of their times.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array, Indices, Mask
from replay_kit.core.geodesy import moved, offset
from replay_kit.core.table import Columns, Integers

Rows = dict[str, NDArray[Any]]
#: Columns of positions: submerged and dive are the vehicle's, by its depths; own says whether
#: the use of its message is told with it.
ROW: Mapping[str, type] = {
    **dict.fromkeys(("time", "order", "dive", "input", "topic", "ordinal"), np.int64),
    **dict.fromkeys(("longitude", "latitude", "depth"), np.float64),
    **dict.fromkeys(("dead_reckoned", "submerged", "own"), np.bool_),
}
# m/s; by which a glider's velocity on one leg departs from its mean over the dive: the place at a share s of a dive of T seconds, taken on
# the straight way between its ends, is off by this times T s (1 - s)
_SPEED_STD = 0.1
# ns; fixes this far from a time, before and after, give the velocity; fewer than three give none
WINDOW = 20_000_000_000
_LEAST_FIXES = 3
# m; noise of a fix against its neighbours, and the rounding of 32-bit degrees, at the least
_FIX_ERROR = 0.5
_NEVER = np.iinfo(np.int64).max
LONG_AGO = np.iinfo(np.int64).min // 2


def no_rows() -> Rows:
    """Return no positions."""
    return {name: np.empty(0, kind) for name, kind in ROW.items()}


def joined(*parts: Columns) -> Rows:
    """Return the rows of some positions after those of others."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def in_order(*parts: Columns) -> Rows:
    """Return the rows of all parts in the order of the stream."""
    rows = joined(*parts)
    return chosen(rows, np.argsort(rows["order"], kind="stable"))


def chosen(rows: Columns, at: NDArray[Any] | slice | int) -> Rows:
    """Return some rows."""
    return {name: column[at] for name, column in rows.items()}


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """What is remembered of positions at the end of a block.

    Attributes:
        last: The last position, of at most one row.
        fixes: Latest ones at the surface, those of the last 40 s before the last but one.
        gps: By MAVLink system, time of the last three-dimensional fix of its GPS [ns, UTC]; long ago where it had none.
        navigated: The MAVLink systems that have stated a position on the Earth.
        local: By MAVLink system, longitude and latitude of its local frame's origin [degrees].
        origins: By topic of poses, longitude, latitude [degrees] of a place and its east and north [m] in the topic's local frame.
    """

    last: Columns = field(default_factory=no_rows)
    fixes: Columns = field(default_factory=no_rows)
    gps: Mapping[str, int] = field(default_factory=dict)
    navigated: frozenset[str] = frozenset()
    local: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    origins: Mapping[str, tuple[float, float, float, float]] = field(default_factory=dict)


def as_of(at: Integers, order: Integers) -> Indices:
    """Return the number of the last row up to places in the stream; -1 before the first.

    Args:
        at: Places in the stream.
        order: Those of the rows, ascending.
    """
    return np.searchsorted(order, at, side="right") - 1


def fixes_after(known: Columns, positions: Columns) -> Rows:
    """Return the fixes at the surface, each later than those before it: ``known`` ones and those among new positions."""
    at_surface = chosen(positions, ~(positions["dead_reckoned"] | positions["submerged"]))
    time, last = at_surface["time"], known["time"][-1:]
    begun = last if last.size else np.array([LONG_AGO])
    later = time > np.maximum.accumulate(np.concatenate([begun, time]))[:-1]
    return joined(known, chosen(at_surface, later))


def kept_fixes(fixes: Columns) -> Rows:
    """Return the fixes that may still give the velocity at a ping: those of two windows before the last but one, and the last."""
    time = fixes["time"]
    first = 0 if time.size < 2 else np.searchsorted(time, time[-2] - 2 * WINDOW, side="right")
    return chosen(fixes, slice(first, None))


_BESIDE = {"time": 0, "longitude": np.nan, "latitude": np.nan}
#: Time [ns, UTC], longitude and latitude [degrees] of a position beside each ping, shapes (n,); NaN for none.
Beside = list[NDArray[Any]]


def beside(rows: Columns, at: Indices) -> Beside:
    """Return some of the positions, NaN for the number -1."""
    return [np.append(rows[name], end)[at] for name, end in _BESIDE.items()]


def placed(
    time: Integers,
    in_dive: Mask,
    before: Beside,
    after: Beside,
    config: MeasurementConfig,
) -> tuple[Array, Array, Array]:
    """Return longitude and latitude of pings [degrees], NaN where they have no place, and the standard error of a place [m], shapes (n,).

    The error is 0 near a known position, in time.

    Args:
        time: Of the pings [ns, UTC].
        in_dive: Whether the vehicle was in a dive, and a position before it is known.
        before: Last positions before the pings, or at their times.
        after: First ones after them.
        config: How near they must be.
    """
    has_before, has_after = np.isfinite(before[1]), np.isfinite(after[1])
    both, begin, end = has_before & has_after, before[0], after[0]
    since = np.where(has_before, np.abs(time - begin), _NEVER)
    until = np.where(has_after, np.abs(end - time), _NEVER)
    is_near = np.minimum(since, until) <= config.position_max_age * 1e9
    gap_s = np.where(both, end - begin, 0) * 1e-9
    in_gap = ~is_near & in_dive & both & (gap_s <= config.position_max_gap)
    earlier = since <= until
    longitude, latitude = (np.where(earlier, before[k], after[k]) for k in (1, 2))
    at = np.flatnonzero(both & (begin < time) & (time < end) & (is_near | in_gap))
    if at.size:
        share = (time - begin)[at] / (end - begin)[at]
        start = before[1][at], before[2][at]
        east, north = offset(*start, after[1][at], after[2][at])
        found = moved(*start, share * east, share * north)
        longitude[at] = start[0] + np.mod(found[0] - start[0] + 180.0, 360.0) - 180.0
        latitude[at] = found[1]
    since_s = np.where(in_gap, time - begin, 0) * 1e-9
    with np.errstate(invalid="ignore", divide="ignore"):
        std = np.where(in_gap, _SPEED_STD * since_s * (1.0 - since_s / gap_s), 0.0)
    known = is_near | in_gap
    return np.where(known, longitude, np.nan), np.where(known, latitude, np.nan), std


def vessel_velocity(time: Integers, fixes: Columns, first: Indices, last: Indices) -> Array:
    """Return a vessel's velocity over the ground at times, true east and north, and its error, shape (n, 3) [m/s].

    NaN where fewer than three fixes are within 20 s, or all on one side. The slope of a straight line through these fixes, by least
    squares; its error comes from how far the fixes lie from the line, so that a turning vessel's is larger.

    Args:
        time: shape (n,) [ns, UTC].
        fixes: The vessel's.
        first: shape (n,), number of the first fix that counts for each time.
        last: shape (n,), number after that of the last.
    """
    when, found = fixes["time"], np.full((time.size, 3), np.nan)
    begin = np.maximum(np.searchsorted(when, time - WINDOW, side="left"), first)
    end = np.minimum(np.searchsorted(when, time + WINDOW, side="right"), last)
    at = np.flatnonzero(end - begin >= _LEAST_FIXES)
    at = at[(when[begin[at]] <= time[at]) & (time[at] <= when[end[at] - 1])]
    if not at.size:
        return found
    # pings with as many fixes around them are one array
    count = end[at] - begin[at]
    for number in np.unique(count):
        own = at[count == number]
        rows = begin[own, None] + np.arange(number)
        since = (when[rows] - time[own, None]) * 1e-9
        centre = np.take_along_axis(rows, np.abs(since).argmin(axis=1)[:, None], axis=1)
        centre = np.repeat(centre, number, axis=1).ravel()
        # about the nearest fix the local axes are true east and north
        places = fixes["longitude"], fixes["latitude"]
        local = offset(*(each[centre] for each in places), *(each[rows.ravel()] for each in places))
        found[own] = _slopes(since, np.stack(local, axis=-1).reshape(own.size, number, 2))
    return found


def _slopes(since: Array, place: Array) -> Array:
    """Return slopes of places, shape (n, f, 2) [m], over times, shape (n, f) [s], and their errors, shape (n, 3) [m/s]."""
    number = since.shape[1]
    since = since - _sum(since)[:, None] / number
    spread = _sum(since**2)
    slope = _sum(since[..., None] * place) / spread[:, None]
    residual = place - (_sum(place) / number)[:, None] - since[..., None] * slope[:, None]
    squares = _sum(residual**2)
    scatter = np.sqrt((squares[:, 0] + squares[:, 1]) / (2 * (number - 2)))
    return np.column_stack([slope, np.maximum(scatter, _FIX_ERROR) / np.sqrt(spread)])


def _sum(values: Array) -> Array:
    """Return sums over the second axis, in order, so that they do not depend on the other rows."""
    return np.asarray(np.cumsum(values, axis=1)[:, -1])
