"""Exact constraint check of a path, segment by segment, and its clearance from hazards in many currents."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from planners.hazards.areas import Ring, first_crossing
from planners.hazards.domain import DEPTH_TOLERANCE
from planners.simulation.fly import Flight, Flights
from planners.task import Task
from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_geographic


@dataclass(frozen=True, slots=True)
class Violation:
    """First constraint violation of a path.

    Attributes:
        what: Name of the violated constraint.
        time: Time since the start [s].
        leg: Number of the leg, counted from 1.
        longitude: Longitude [degrees east].
        latitude: Latitude [degrees north].
    """

    what: str
    time: float
    leg: int
    longitude: float
    latitude: float


def first_violation(task: Task, flight: Flight, margin: float = 0.0) -> Violation | None:
    """Return the first constraint violation of a path, or None.

    Segments must clear every ring and stay above the bottom at all depths; at the surface also areas that forbid surfacing.
    Each segment is widened by the possible curvature of the path.

    Args:
        task: Mission with its constraints.
        flight: Path to check.
        margin: Additional distance to every ring [m].
    """
    if not np.all(np.isfinite(flight.place)):
        return Violation("a position that is not a number", 0.0, 1, float("nan"), float("nan"))
    segments = _segments(flight.place)[0]
    depths = np.column_stack([flight.depth[:-1], flight.depth[1:]])
    skin = bends(flight)
    wide = skin + margin
    below = task.bottom.is_below(segments, depths, skin)
    deep = (depths.max(axis=1) > task.region.deepest + DEPTH_TOLERANCE) | (
        depths.min(axis=1) < -DEPTH_TOLERANCE
    )
    # the start is exempt from constraints
    surfacing = flight.depth[1:] <= DEPTH_TOLERANCE
    lane = first_crossing(
        [ring for ring in task.rings if ring.surface_only],
        _surfaced(segments, depths)[surfacing],
        wide[surfacing],
    )
    found = [
        first_crossing([ring for ring in task.rings if not ring.surface_only], segments, wide),
        None if lane is None else (lane[0], int(np.flatnonzero(surfacing)[lane[1]]), lane[2]),
        (task.bottom.name_at(segments[np.argmax(below)]), int(np.argmax(below)), 0.0)
        if below.any()
        else None,
        ("the surface or the deepest level", int(np.argmax(deep)), 0.0) if deep.any() else None,
    ]
    first = min((one for one in found if one is not None), key=lambda one: one[1:], default=None)
    if first is None:
        return None
    what, i, share = first
    place, time = (
        values[i] + share * (values[i + 1] - values[i])
        for values in (flight.place[0], flight.time[0])
    )
    longitude, latitude = to_geographic(task.region.grid.projection, *place)
    return Violation(
        what, float(time), int(flight.leg[i + 1]) + 1, float(longitude), float(latitude)
    )


def bends(flight: Flight) -> Array:
    """Return the largest deviation of the path from each straight segment, shape (n - 1,) [m], in the first current.

    A path whose velocity changes by dv over a step of duration T is dv T / 8 off its chord; dv is taken from the steps before and after in
    the same part of a leg, and twice that is returned.
    """
    steps = np.diff(flight.time[0])
    # a step without a duration, as from a goal at full depth to it, goes nowhere
    velocity = np.diff(flight.place[0], axis=0) / np.where(steps > 0.0, steps, 1.0)[:, None]
    # heading and glide angle change between legs, and the velocity through water ends with the dive
    drifting = (flight.depth[:-1] <= DEPTH_TOLERANCE) & (flight.depth[1:] <= DEPTH_TOLERANCE)
    joined = (flight.leg[1:-1] == flight.leg[2:]) & (drifting[:-1] == drifting[1:])
    joined &= (steps[:-1] > 0.0) & (steps[1:] > 0.0)
    change = np.where(joined, np.linalg.norm(np.diff(velocity, axis=0), axis=1), 0.0)
    return np.asarray(np.maximum(np.append(change, 0.0), np.append(0.0, change)) * steps / 4.0)


def _segments(place: Array) -> Array:
    """Return the segments, shape (K, n - 1, 2, 2), of paths of shape (K, n, 2)."""
    return np.stack([place[:, :-1], place[:, 1:]], axis=2)


def _surfaced(segments: Array, depths: Array) -> Array:
    """Return the surface part of segments, shape (n, 2, 2): a whole drift, or the end of a climb."""
    begins = np.where((depths[:, 0] <= DEPTH_TOLERANCE)[:, None], segments[:, 0], segments[:, 1])
    return np.stack([begins, segments[:, 1]], axis=1)


def clearances(task: Task, flights: Flights) -> dict[str, Array]:
    """Return the clearance of K flights from nearby hazards by name, shape (K,) [m]: 0 or less for a violation.

    It is infinite beyond the length of a step. Shallows apply to dives that are too deep for them; a flight above the bottom throughout
    has a positive clearance from it.
    """
    count, found = len(flights.place), dict[str, Array]()
    steps = np.flatnonzero((np.diff(flights.time, axis=1) > 0.0).ravel())
    begins = np.searchsorted(flights.dive, np.arange(flights.ups.size))
    deepest = np.maximum.reduceat(flights.depth, begins, axis=1)[:, flights.dive[1:]]
    depths = np.stack([flights.depth[:, :-1], flights.depth[:, 1:]], axis=-1).reshape(-1, 2)[steps]
    segments = _segments(flights.place).reshape(-1, 2, 2)[steps]
    numbers, turns = steps // (flights.time.shape[1] - 1), deepest.ravel()[steps]
    for rings, taken, at_surface in _hazards(task, depths, turns):
        parts = segments[taken]
        if at_surface:
            parts = _surfaced(parts, depths[taken])
        for name, clear in _clearance(rings, parts, numbers[taken], count).items():
            found[name] = np.minimum(found.get(name, np.full(count, np.inf)), clear)
    below = np.zeros(count, dtype=bool)
    below[numbers[task.bottom.is_below(segments, depths, np.zeros(steps.size))]] = True
    shallows = [name for name in found if name not in {ring.name for ring in task.rings}]
    for name in shallows:
        found[name] = np.where(below, found[name], np.maximum(found[name], _ABOVE))
    if below.any() and not any(np.all(found[name][below] <= 0.0) for name in shallows):
        found["the bottom"] = np.where(below, 0.0, np.inf)
    return found


# Clearance of a path that is over shallows with no more than the depth they allow [m].
_ABOVE = 1.0


def _hazards(
    task: Task, depths: Array, turns: Array
) -> Iterator[tuple[Sequence[Ring], NDArray[np.bool_], bool]]:
    """Yield rings, a mask of the segments they apply to, shape (n,), and whether only at the surface."""
    lanes = [ring for ring in task.rings if ring.surface_only]
    yield [ring for ring in task.rings if not ring.surface_only], np.full(turns.size, True), False
    if lanes:
        yield lanes, depths[:, 1] <= DEPTH_TOLERANCE, True
    for turn in np.unique(turns):
        if rings := task.bottom.rings(float(turn)):
            yield rings, turns == turn, False


def _clearance(
    rings: Sequence[Ring], segments: Array, flights: NDArray[np.intp], count: int
) -> dict[str, Array]:
    """Return the clearance of K paths from nearby rings by name [m].

    Args:
        rings: Forbidden areas.
        segments: Ends of the segments, shape (n, 2, 2) [m].
        flights: Path number of each segment, shape (n,).
        count: Number of paths, K.
    """
    if not len(segments):
        return {}
    longest = float(np.max(np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1)))
    low, high = segments.min(axis=(0, 1)) - longest, segments.max(axis=(0, 1)) + longest
    around = shapely.box(*low, *high)
    near_rings = [
        ring
        for ring in rings
        if (
            not shapely.covers(ring.area, around)
            if ring.outside
            else shapely.intersects(ring.area, around)
        )
    ]
    if not near_rings:
        return {}
    lines = shapely.linestrings(segments)
    tree, found = shapely.STRtree(lines), dict[str, Array]()
    for ring in near_rings:
        near = tree.query(ring.line, predicate="dwithin", distance=longest)
        inside = (
            np.flatnonzero(~shapely.covers(ring.area, lines))
            if ring.outside
            else tree.query(ring.area, predicate="intersects")
        )
        clear = np.full(count, np.inf)
        np.minimum.at(clear, flights[near], shapely.distance(ring.line, lines[near]))
        overlap = ring.forbidden(lines[inside])
        middle, crosses = segments[inside, 1].copy(), ~shapely.is_empty(overlap)
        middle[crosses] = shapely.get_coordinates(shapely.centroid(overlap[crosses]))
        places = *segments[inside].swapaxes(0, 1), middle
        deepest = np.min([ring.clearance(points) for points in places], axis=0)
        np.minimum.at(clear, flights[inside], np.minimum(deepest, 0.0))
        found[ring.name] = np.minimum(found.get(ring.name, clear), clear)
    return found
