"""A track's depths to dives, yos and profiles: a pure function that marks what it cannot tell and never stops at it.

A *profile* is one leg between two turns, a *yo* a leg down and the leg up after it, a *dive* goes from one surfacing to the next. The
vehicle turns where it comes back by a stated length, so that noise and waves smaller than that make no legs. Each sample is in
one dive, one yo and one profile at most; 0 means in none, and ``sample_class`` says why.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.measurements.vehicle.dives import is_submerged


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
