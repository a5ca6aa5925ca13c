"""Pressures to depths, and depths to dives, surfacings and legs.

Where a dive begins and ends is one rule for the measurement step, surfacings, legs and mean currents. A leg lies between two turns: the
vehicle turns where it comes back by a stated length, so that noise and waves smaller than that make none.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import gsw
import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array, replace
from replay_kit.core.observation import Measurement, Observation, VehicleState

# degrees; gravity there is the mean of the equator's and the pole's, so that a depth is off by 0.27 % at most
_LATITUDE_ASSUMED = 45.0


def depths_of_pressures(pressure_dbar: Array, latitude: Array) -> Array:
    """Return the depths at sea pressures, shape (n,) [m], as ``depth_of_pressure`` gives each.

    Args:
        pressure_dbar: shape (n,) [dbar].
        latitude: shape (n,) [degrees north].
    """
    with np.errstate(all="ignore"):
        depth = -gsw.z_from_p(pressure_dbar, latitude)
    return np.where(np.isfinite(depth), depth, np.nan)


def depth_of_pressure(pressure_dbar: float, latitude: float | None) -> float:
    """Return the depth at a sea pressure [m]; NaN for a pressure that has none.

    Args:
        pressure_dbar: Sea pressure [dbar], 0 at the surface.
        latitude: [degrees north]; None when none is known yet, for which 45 degrees are taken.

    References:
        TEOS-10, through gsw, for standard salinity and 0 degrees Celsius.
    """
    with np.errstate(all="ignore"):
        depth = float(
            -gsw.z_from_p(pressure_dbar, _LATITUDE_ASSUMED if latitude is None else latitude)
        )
    return depth if np.isfinite(depth) else float("nan")


# surface depths; below that many a dive begins, so that waves at the surface make no dives
_DIVE_BEGINS = 2.0


def dive_begins(depth: float, surface_depth: float) -> bool:
    """Return whether a depth [m] is deep enough to begin a dive: below twice the surface depth [m]; NaN never is."""
    return depth > _DIVE_BEGINS * surface_depth


def is_submerged(depth: float, surface_depth: float, before: bool) -> bool:
    """Return whether the vehicle is in a dive, which begins below twice the surface depth and ends at the surface depth.

    Args:
        depth: Of the vehicle now [m]; with NaN no dive begins or goes on.
        surface_depth: Shallower than this the vehicle is at the surface [m].
        before: Whether it was in a dive until now.
    """
    return dive_begins(depth, surface_depth) or (before and depth > surface_depth)


@dataclass(frozen=True, slots=True)
class SurfacingState:
    """What is remembered between events.

    Attributes:
        submerged: Whether the vehicle is in a dive, by its positions' depths.
        dive: Number of the last dive that a profile belonged to.
        reported: Whether the surfacing after that dive was seen.
        fix: Last measured position since the last surfacing; None without.
    """

    submerged: bool = False
    dive: int = 0
    reported: bool = True
    fix: VehicleState | None = None


def detect_surfacing(
    state: SurfacingState, event: VehicleState | Measurement, surface_depth: float
) -> tuple[SurfacingState, VehicleState | None]:
    """Return the state after an event, and the fix at which the vehicle is now seen to have surfaced; None when it is not.

    That is the first measured position after a dive that is not below the surface depth. Where positions have no depths, it is the last
    measured one before the first profile of the next dive. ``is_submerged`` is the rule for where a dive begins and ends.

    Args:
        state: Before it.
        event: A position or a measurement, in the order of the log.
        surface_depth: [m], shallower than this the vehicle is at the surface.
    """
    if isinstance(event, VehicleState):
        below = event.depth > surface_depth
        # a position without a depth says nothing of the dive
        unknown = math.isnan(event.depth)
        submerged = (
            state.submerged
            if unknown
            else is_submerged(event.depth, surface_depth, state.submerged)
        )
        if event.dead_reckoned or below:
            # a dive ends with a fix; a position that was computed may come up before it
            return replace(state, submerged=submerged or state.submerged), None
        if state.submerged:
            return SurfacingState(False, state.dive, True, None), event
        return replace(state, fix=event), None
    if not isinstance(event, Observation) or event.dive <= state.dive:
        return state, None
    unseen = None if state.reported else state.fix
    return SurfacingState(state.submerged, event.dive, False, None), unseen


Numbers = NDArray[np.int32]


def legs_of(
    time_ns: NDArray[np.int64], depth: Array, surface_depth: float, leg: float, gap: float
) -> Numbers:
    """Return the number of the leg of each sample of a track, shape (n,), from 1; 0 in none.

    ``is_submerged`` is the rule for where a dive begins and ends; no leg goes on over its ends, over a gap in time or a step back. A sample
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
    dive, steps = _dives(depth[sound], surface_depth), np.diff(time_ns[sound])
    cuts = np.flatnonzero((steps > gap * 1e9) | (steps <= 0) | (np.diff(dive) != 0)) + 1
    numbers, count = np.zeros(len(depth), np.int32), 0
    for part in np.split(np.arange(sound.size), cuts):
        if part.size == 0 or dive[part[0]] == 0:
            continue
        for first, last in _legs(depth[sound[part]], leg):
            # the sample at a turn is of the leg that it ends
            inside = sound[part[first : last + 1]]
            count += 1
            numbers[inside[numbers[inside] == 0]] = count
    return numbers


def _dives(depth: Array, surface_depth: float) -> Numbers:
    """Return the number of each sample's dive, 0 at the surface."""
    number, submerged, count = np.zeros(len(depth), np.int32), False, 0
    for k, below in enumerate(depth.tolist()):
        was = submerged
        submerged = is_submerged(below, surface_depth, was)
        count += submerged and not was
        number[k] = count if submerged else 0
    return number


def _legs(depth: Array, leg: float) -> Iterator[tuple[int, int]]:
    """Yield first and last sample of each leg, in their order; neighbours share the sample at the turn.

    The last of equal extremes is the turn. What comes before the first leg or after the last turn and is shorter than a leg is in none.
    """
    values = depth.tolist()
    low = high = start = way = 0
    for k, value in enumerate(values):
        # a first leg begins at the first of equal extremes, as nothing before it claims them
        if way >= 0 and (value > values[high] or (way and value == values[high])):
            high = k
        if way <= 0 and (value < values[low] or (way and value == values[low])):
            low = k
        if way >= 0 and values[high] - value >= leg:
            if way:
                yield start, high
            way, start, low = -1, high, k
        elif way <= 0 and value - values[low] >= leg:
            if way:
                yield start, low
            way, start, high = 1, low, k
    if way:
        yield start, high if way > 0 else low
