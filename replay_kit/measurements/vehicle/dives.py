"""Pressures to depths, and depths to dives, surfacings, yos and profiles.

Where a dive begins and ends is one rule for the measurement step, surfacings, segments and mean currents. A *profile* is one leg between
two turns, a *yo* a leg down and the leg up after it, a *dive* goes from one surfacing to the next. The vehicle turns where it comes back by
a stated length, so that noise and waves smaller than that make no legs. Each sample is in one dive, one yo and one profile at most; 0
means in none, and ``sample_class`` says why.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum

import gsw
import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.frozen import replace
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


class SegmentClass(IntEnum):
    """What a sample of a track belongs to."""

    LEG = 0
    SURFACE = 1
    NO_DEPTH = 2
    TIME_BACK = 3
    UNDETERMINED = 4


Numbers = NDArray[np.int32]


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    """The parts of a track of n samples.

    Attributes:
        dive: shape (n,), number of the dive, from 1; 0 at the surface and where there is no depth.
        yo: shape (n,), number of the yo, from 1; 0 outside of all legs.
        profile: shape (n,), number of the leg, from 1; 0 outside of all.
        direction: shape (n,), +1 in a leg down, -1 in a leg up, 0 outside.
        sample_class: shape (n,), ``SegmentClass`` of each sample; UNDETERMINED is a part below the surface too short, or too cut by
            gaps, to have a direction.
        surfacings: Positions of the samples at which a dive was found to have ended.
        apogees: Positions of the deepest sample of each yo that has both its legs.
    """

    dive: Numbers
    yo: Numbers
    profile: Numbers
    direction: NDArray[np.int8]
    sample_class: NDArray[np.int8]
    surfacings: NDArray[np.intp]
    apogees: NDArray[np.intp]

    def count(self, sample_class: SegmentClass) -> int:
        """Return how many samples are so."""
        return int(np.count_nonzero(self.sample_class == sample_class))


def segments(
    time_ns: NDArray[np.int64], depth: Array, surface_depth: float, leg: float, gap: float
) -> Segments:
    """Return the dives, yos and profiles of a track.

    ``is_submerged`` is the rule for where a dive begins and ends. A sample without a depth, or not
    later than the one before it, is left out. Over a gap in time, or a step back, no leg goes on, while a dive does.

    Args:
        time_ns: shape (n,) [ns], in the order of the samples.
        depth: shape (n,) [m], positive down; NaN where not known.
        surface_depth: [m], shallower than this the vehicle is at the surface.
        leg: [m], least length of a leg, and by how much a vehicle comes back before it counts as turned.
        gap: [s], longest time between samples of one leg.
    """
    n = len(depth)
    sample_class = np.full(n, SegmentClass.UNDETERMINED, np.int8)
    sample_class[1:][time_ns[1:] <= time_ns[:-1]] = SegmentClass.TIME_BACK
    sample_class[~np.isfinite(depth)] = SegmentClass.NO_DEPTH
    sound = np.flatnonzero(sample_class == SegmentClass.UNDETERMINED)
    dive, surfacings = _dives(depth[sound], surface_depth)
    sample_class[sound[dive == 0]] = SegmentClass.SURFACE
    steps = np.diff(time_ns[sound])
    cuts = np.flatnonzero((steps > gap * 1e9) | (steps <= 0) | (np.diff(dive) != 0)) + 1
    yo, profile, direction = np.zeros(n, np.int32), np.zeros(n, np.int32), np.zeros(n, np.int8)
    apogees, n_yos, n_profiles = [], 0, 0
    for part in np.split(np.arange(sound.size), cuts):
        if part.size == 0 or dive[part[0]] == 0:
            continue
        came_down = False
        for first, last, way in _legs(depth[sound[part]], leg):
            # the sample at a turn is of the leg that it ends
            inside = sound[part[first : last + 1]]
            inside = inside[profile[inside] == 0]
            n_profiles += 1
            n_yos += way > 0 or not came_down
            if came_down and way < 0:
                apogees.append(sound[part[first]])
            came_down = way > 0
            yo[inside], profile[inside], direction[inside], sample_class[inside] = (
                n_yos,
                n_profiles,
                way,
                SegmentClass.LEG,
            )
    dives = np.zeros(n, np.int32)
    dives[sound] = dive
    return Segments(
        dives, yo, profile, direction, sample_class, sound[surfacings], np.array(apogees, np.intp)
    )


def _dives(depth: Array, surface_depth: float) -> tuple[Numbers, NDArray[np.intp]]:
    """Return the number of each sample's dive, 0 at the surface, and where dives ended."""
    number, submerged, count, ended = np.zeros(len(depth), np.int32), False, 0, []
    for k, below in enumerate(depth.tolist()):
        was = submerged
        submerged = is_submerged(below, surface_depth, was)
        count += submerged and not was
        number[k] = count if submerged else 0
        if was and not submerged:
            ended.append(k)
    return number, np.array(ended, np.intp)


def _legs(depth: Array, leg: float) -> Iterator[tuple[int, int, int]]:
    """Yield first and last sample and way (+1 down, -1 up) of each leg, in their order; neighbours share the sample at the turn.

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
                yield start, high, way
            way, start, low = -1, high, k
        elif way <= 0 and value - values[low] >= leg:
            if way:
                yield start, low, way
            way, start, high = 1, low, k
    if way:
        yield start, high if way > 0 else low, way
