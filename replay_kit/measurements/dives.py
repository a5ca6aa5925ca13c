"""Pressures to depths, and depths to dives, surfacings and legs.

Where a dive begins and ends is one rule for profiles, mean currents, surfacings and legs. A leg lies between two turns: the vehicle turns
where it comes back by a stated length, so that noise and waves smaller than that make none.
"""

from collections.abc import Iterator

import gsw
import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array, Mask
from replay_kit.core.table import Columns, Integers, Rows, chosen
from replay_kit.measurements.positions import in_order

# degrees; gravity there is the mean of the equator's and the pole's, so that a depth is off by 0.27 % at most
_LATITUDE_ASSUMED = 45.0
# surface depths; below that many a dive begins, so that waves at the surface make no dives
_DIVE_BEGINS = 2.0
Numbers = NDArray[np.int32]


def depth_of(pressure: Array, latitude: Array) -> Array:
    """Return the depths at sea pressures, shape (n,) [m]; NaN for a pressure that has none.

    Args:
        pressure: shape (n,) [dbar], 0 at the surface.
        latitude: shape (n,) [degrees north]; NaN where none is known, for which 45 degrees are taken.

    References:
        TEOS-10, through gsw, for standard salinity and 0 degrees Celsius.
    """
    with np.errstate(all="ignore"):
        at = np.where(np.isfinite(latitude), latitude, _LATITUDE_ASSUMED)
        depth = -gsw.z_from_p(np.asarray(pressure, np.float64), at)
    return np.where(np.isfinite(depth), depth, np.nan)


def dive_begins(depth: Array | float, surface_depth: float) -> Mask:
    """Return whether depths [m] are deep enough to begin a dive: below twice the surface depth [m]; NaN never is."""
    return np.asarray(depth > _DIVE_BEGINS * surface_depth)


def submerged(depth: Array, surface_depth: float, before: bool) -> Mask:
    """Return whether the vehicle is in a dive at each of its depths, shape (n,).

    A dive begins below twice the surface depth and ends at the surface depth; with NaN none begins or goes on.

    Args:
        depth: shape (n,) [m], in order.
        surface_depth: Shallower than this the vehicle is at the surface [m].
        before: Whether it was in a dive before the first.
    """
    begins = dive_begins(depth, surface_depth)
    changes = begins | ~(depth > surface_depth)
    last = np.maximum.accumulate(np.where(changes, np.arange(depth.size), -1))
    return np.where(last < 0, before, begins[last])


def _dives(under: Mask, before: bool) -> Integers:
    """Return the number of dives begun, shape (n,)."""
    return np.cumsum(under & np.diff(under, prepend=before))


def no_depths() -> Rows:
    """Return the depths before the first is stated: one row, as ``depths_of`` returns them."""
    none, nothing = np.array([-1]), np.array([np.nan])
    return {
        "order": none,
        "measured": nothing,
        "depth": nothing,
        "submerged": none > 0,
        "dive": np.array([0]),
    }


def depths_of(
    before: Columns, sources: list[tuple[Integers, Array, bool]], surface_depth: float
) -> Rows:
    """Return the vehicle's depths of a block of messages, in order, with the dives that they make, after the last one before.

    The columns are ``order``, place in the stream of the message; ``measured`` [m]; ``depth``, the same where the vehicle states it, and
    NaN for the pressure of a ping, of a log that states no other depth so far; ``submerged``; and ``dive``, number of dives begun.

    Args:
        before: The last row before.
        sources: Orders, depths [m], and whether the vehicle states them, of each source; else they count before it states the first.
        surface_depth: [m].
    """
    parts = [
        {
            **{name: np.zeros(order.size, column.dtype) for name, column in before.items()},
            **{"order": order, "measured": depth, "depth": np.where(is_stated, depth, np.nan)},
        }
        for order, depth, is_stated in sources
    ]
    rows = in_order(before, *parts)
    known = np.isfinite(rows["depth"])
    counts = known | (np.isfinite(rows["measured"]) & ~np.logical_or.accumulate(known))
    counts[0] = True
    rows = chosen(rows, counts)
    was, begun = before["submerged"][0], before["dive"][0]
    under = submerged(rows["measured"][1:], surface_depth, was)
    rows["submerged"][1:], rows["dive"][1:] = under, begun + _dives(under, was)
    return rows


def legs_of(
    time_ns: Integers, depth: Array, surface_depth: float, leg: float, gap: float
) -> Numbers:
    """Return the number of the leg of each sample of a track, shape (n,), from 1; 0 in none.

    ``submerged`` is the rule for where a dive begins and ends; no leg goes on over its ends, over a gap in time or a step back. A sample
    without a depth, or not later than the one before it, is left out.

    Args:
        time_ns: shape (n,) [ns], in the order of the samples.
        depth: shape (n,) [m], positive down; NaN where not known.
        surface_depth: [m], shallower than this the vehicle is at the surface.
        leg: [m], least length of a leg, and by how much a vehicle comes back before it counts as turned.
        gap: [s], longest time between samples of one leg.
    """
    later = np.diff(time_ns, prepend=time_ns[:1] - 1) > 0
    sound = np.flatnonzero(np.isfinite(depth) & later)
    under, steps = submerged(depth[sound], surface_depth, False), np.diff(time_ns[sound])
    dive = np.where(under, _dives(under, False), 0)
    cuts = np.flatnonzero((steps > gap * 1e9) | (steps <= 0) | (np.diff(dive) != 0)) + 1
    numbers, count = np.zeros(len(depth), np.int32), 0
    for part in np.split(np.arange(sound.size), cuts):
        for first, last in _legs(depth[sound[part[dive[part] > 0]]], leg):
            # the sample at a turn is of the leg that it ends
            inside = sound[part[first : last + 1]]
            count += 1
            numbers[inside[numbers[inside] == 0]] = count
    return numbers


def _legs(depth: Array, leg: float) -> Iterator[tuple[int, int]]:
    """Yield first and last sample of each leg, in their order; neighbours share the sample at the turn.

    The last of equal extremes is the turn. What comes before the first leg or after the last turn and is shorter than a leg is in none.
    """
    values = depth.tolist()
    start, way, far = 0, 0, {1: 0, -1: 0}
    for k, value in enumerate(values):
        for down in (1, -1):
            # a first leg begins at the first of equal extremes, as nothing before it claims them
            further = down * (value - values[far[down]])
            if way != -down and (further > 0.0 or (way and further == 0.0)):
                far[down] = k
        for down in (1, -1):
            if way != -down and down * (values[far[down]] - value) >= leg:
                if way:
                    yield start, far[down]
                way, start, far[-down] = -down, far[down], k
                break
    if way:
        yield start, far[way]
