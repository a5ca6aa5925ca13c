"""Depths from pressures, and dives, surfacings and casts from depths.

One rule defines the start and end of dives for profiles, mean currents, surfacings and casts. A cast (``leg``) lies between two turns; a
turn requires a return by a stated length, so that noise and waves smaller than that are ignored.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import gsw
import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array, Mask, replace
from replay_kit.core.observation import Measurement, Observation, Profiles, VehicleState
from replay_kit.core.observation.table import Columns, Integers, Rows, chosen_rows
from replay_kit.measurements.track.positions import in_order

# degrees; gravity there is the mean of the equator's and the pole's, so that a depth is off by 0.27 % at most
_LATITUDE_ASSUMED = 45.0
# surface depths; below that many a dive begins, so that waves at the surface make no dives
_DIVE_BEGINS = 2.0
Numbers = NDArray[np.int32]


def depth_of(pressure: Array, latitude: Array) -> Array:
    """Return the depths at sea pressures, shape (n,) [m]; NaN for invalid pressures.

    Args:
        pressure: shape (n,) [dbar], 0 at the surface.
        latitude: shape (n,) [degrees north]; NaN counts as 45 degrees.

    References:
        TEOS-10, through gsw, for standard salinity and 0 degrees Celsius.
    """
    with np.errstate(all="ignore"):
        at = np.where(np.isfinite(latitude), latitude, _LATITUDE_ASSUMED)
        depth = -gsw.z_from_p(np.asarray(pressure, np.float64), at)
    return np.where(np.isfinite(depth), depth, np.nan)


def dive_begins(depth: Array | float, surface_depth: float) -> Mask:
    """Return whether depths [m] begin a dive: below twice the surface depth [m]; False for NaN."""
    return np.asarray(depth > _DIVE_BEGINS * surface_depth)


def submerged(depth: Array, surface_depth: float, before: bool) -> Mask:
    """Return whether the vehicle is in a dive at each depth, shape (n,).

    A dive begins below twice the surface depth and ends at the surface depth or NaN.

    Args:
        depth: shape (n,) [m], in order.
        surface_depth: Depth above which the vehicle is at the surface [m].
        before: Whether it was in a dive before.
    """
    begins = dive_begins(depth, surface_depth)
    changes = begins | ~(depth > surface_depth)
    last = np.maximum.accumulate(np.where(changes, np.arange(depth.size), -1))
    return np.where(last < 0, before, begins[last])


def _dives(under: Mask, before: bool) -> Integers:
    """Return the number of dives begun, shape (n,)."""
    return np.cumsum(under & np.diff(under, prepend=before))


def no_depths() -> Rows:
    """Return the depths before the first is stated: one row, in the form of ``depths_of``."""
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
    """Return the vehicle's depths and dives in a block of messages, after the last earlier row.

    Columns: ``order``, position in the stream; ``measured`` [m]; ``depth``, the same if stated by the vehicle, NaN if from a ping's
    pressure in a log without other depths; ``submerged``; ``dive``, number of dives begun.

    Args:
        before: Last earlier row.
        sources: Orders, depths [m], and whether the vehicle states them; others count only before its first.
        surface_depth: Depth above which the vehicle is at the surface [m].
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
    rows = chosen_rows(rows, counts)
    was, begun = before["submerged"][0], before["dive"][0]
    under = submerged(rows["measured"][1:], surface_depth, was)
    rows["submerged"][1:], rows["dive"][1:] = under, begun + _dives(under, was)
    return rows


def legs_of(
    time_ns: Integers, depth: Array, surface_depth: float, leg: float, gap: float
) -> Numbers:
    """Return the number of the cast of each sample of a track, shape (n,), from 1; 0 for none.

    ``submerged`` defines dives; no cast crosses a dive's ends, a gap in time or a step back. Samples without a depth, or not later than the
    previous one, are excluded.

    Args:
        time_ns: shape (n,) [ns], in the order of the samples.
        depth: shape (n,) [m], positive down; NaN if unknown.
        surface_depth: Above it the vehicle is at the surface [m].
        leg: Least length of a cast, and least return for a turn [m].
        gap: Longest time between samples of one cast [s].
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
    """Yield first and last sample of each cast in order; neighbours share the sample at the turn.

    The last of equal extremes is the turn. Shorter parts before the first cast or after the last turn are excluded.
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


@dataclass(frozen=True, slots=True)
class SurfacingState:
    """State between events.

    Attributes:
        submerged: Whether the vehicle is in a dive, by the depths of its positions.
        dive: Number of the last dive with a profile.
        reported: Whether the surfacing after that dive was detected.
        fix: Last measured position since the last surfacing; None without.
    """

    submerged: bool = False
    dive: int = 0
    reported: bool = True
    fix: VehicleState | None = None


def detect_surfacing(
    state: SurfacingState, event: VehicleState | Measurement, surface_depth: float
) -> tuple[SurfacingState, VehicleState | None]:
    """Return the state after an event, and the fix of a newly detected surfacing, or None.

    It is the first measured position after a dive at or above the surface depth. Without depths it is the last measured one before the
    first profile of the next dive. Dives are defined by ``dives.submerged``.

    Args:
        state: State before the event.
        event: Position or measurement, in the order of the log.
        surface_depth: Depth above which the vehicle is at the surface [m].
    """
    if isinstance(event, VehicleState):
        if event.dead_reckoned or event.depth > surface_depth:
            # a dive ends with a fix; a position that was computed may come up before it
            under = state.submerged or bool(dive_begins(event.depth, surface_depth))
            return replace(state, submerged=under), None
        if state.submerged:
            return SurfacingState(False, state.dive), event
        return replace(state, fix=event), None
    if not isinstance(event, Observation | Profiles) or event.dive <= state.dive:
        return state, None
    unseen = None if state.reported else state.fix
    return SurfacingState(state.submerged, event.dive, False), unseen
