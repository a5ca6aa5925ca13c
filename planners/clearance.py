"""The exact check of a mission's path, segment by segment, and its clearance from hazards in many currents."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from planners.hazards.areas import Ring, first_crossing
from planners.hazards.bottom import DEPTH_TOLERANCE
from planners.simulation.fly import Flight
from planners.task import Task
from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_geographic


@dataclass(frozen=True, slots=True)
class Violation:
    """Where a path first violates a constraint.

    Attributes:
        what: Name of what the path crosses.
        time: Since the start [s].
        leg: Number of the leg, counted from 1.
        longitude: [degrees east].
        latitude: [degrees north].
    """

    what: str
    time: float
    leg: int
    longitude: float
    latitude: float


def check(task: Task, flight: Flight, margin: float = 0.0) -> Violation | None:
    """Return the first constraint violation of a path; None when there is none.

    Its segments must keep clear of every ring and stay above the bottom with all of their depths; at the surface they must also keep clear
    of areas that only forbid surfacing. Each counts as wide as the path may bend between its ends.

    Args:
        task: What it must not violate.
        flight: The path.
        margin: Distance that it must keep from every ring beside [m].
    """
    if not np.all(np.isfinite(flight.place)):
        return Violation("the path is not a number", 0.0, 1, float("nan"), float("nan"))
    segments = _segments(flight.place)[0]
    depths = np.column_stack([flight.depth[:-1], flight.depth[1:]])
    skin = bends(flight)
    wide = skin + margin
    below = task.bottom.is_below(segments, depths, skin)
    deep = (depths.max(axis=1) > task.region.deepest + DEPTH_TOLERANCE) | (
        depths.min(axis=1) < -DEPTH_TOLERANCE
    )
    surfacing = _at_surface(flight)
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
    """Return how far the path may be from each straight segment between its points [m], shape (n - 1,), in the first of its currents.

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


def _at_surface(flight: Flight) -> NDArray[np.bool_]:
    """Return which segments end at the surface, shape (n - 1,): the start itself is given, whatever may be forbidden there."""
    return flight.depth[1:] <= DEPTH_TOLERANCE


def _surfaced(segments: Array, depths: Array) -> Array:
    """Return the part at the surface of segments, shape (n, 2, 2), that end there: all of a drift, the end of a climb."""
    begins = np.where((depths[:, 0] <= DEPTH_TOLERANCE)[:, None], segments[:, 0], segments[:, 1])
    return np.stack([begins, segments[:, 1]], axis=1)


def clearances(task: Task, flight: Flight) -> dict[str, Array]:
    """Return the clearance of each of K flights from each hazard, by its name, shape (K,) [m]: 0 or less where it violates it.

    A flight that is never as near as one of its steps is long has an infinite clearance. Shallows count for the legs that are too deep for
    them; a flight whose dives all stay above the bottom has at least some clearance from it.
    """
    count, found = len(flight.place), dict[str, Array]()
    segments = _segments(flight.place)
    depths = np.column_stack([flight.depth[:-1], flight.depth[1:]])
    for rings, taken, fixed in _hazards(task, flight):
        parts = segments[:, taken]
        if fixed and rings[0].surface_only:
            parts = np.stack([_surfaced(path, depths[taken]) for path in parts])
        for name, clear in _clearance(rings, parts).items():
            found[name] = np.minimum(found.get(name, np.full(count, np.inf)), clear)
    skin = np.zeros(segments.shape[0] * segments.shape[1])
    below = (
        task.bottom.is_below(segments.reshape(-1, 2, 2), np.tile(depths, (count, 1)), skin)
        .reshape(count, -1)
        .any(axis=1)
    )
    shallows = [name for name in found if name not in {ring.name for ring in task.rings}]
    for name in shallows:
        found[name] = np.where(below, found[name], np.maximum(found[name], _ABOVE))
    if below.any() and not any(np.all(found[name][below] <= 0.0) for name in shallows):
        found["the bottom"] = np.where(below, 0.0, np.inf)
    return found


# Clearance of a path that is over shallows with no more than the depth they allow [m].
_ABOVE = 1.0


def _hazards(
    task: Task, flight: Flight
) -> Iterator[tuple[Sequence[Ring], NDArray[np.bool_], bool]]:
    """Yield rings, the segments that they count for, shape (n - 1,), and whether they hold at any depth."""
    lanes = [ring for ring in task.rings if ring.surface_only]
    yield (
        [ring for ring in task.rings if not ring.surface_only],
        np.full(flight.depth.size - 1, True),
        True,
    )
    if lanes:
        yield lanes, _at_surface(flight), True
    # legs begin where the one before ended, at the surface
    turns = np.array([flight.depth[flight.leg == leg].max() for leg in range(flight.ends.size)])
    for turn in np.unique(turns):
        if rings := task.bottom.rings(float(turn)):
            yield rings, turns[flight.leg[1:]] == turn, False


def _clearance(rings: Sequence[Ring], segments: Array) -> dict[str, Array]:
    """Return the clearance of each of K paths, shape (K, n, 2, 2) [m], from rings, by their names."""
    count, n = segments.shape[:2]
    flat = segments.reshape(-1, 2, 2)
    lines, flights = shapely.linestrings(flat), np.arange(count * n) // max(n, 1)
    longest = float(np.max(np.linalg.norm(flat[:, 1] - flat[:, 0], axis=1), initial=0.0))
    tree, found = shapely.STRtree(lines), dict[str, Array]()
    for ring in rings:
        near = tree.query(ring.line, predicate="dwithin", distance=longest)
        inside = (
            np.flatnonzero(~shapely.covers(ring.area, lines))
            if ring.outside
            else tree.query(ring.area, predicate="intersects")
        )
        clear = np.full(count, np.inf)
        np.minimum.at(clear, flights[near], shapely.distance(ring.line, lines[near]))
        overlap = (
            shapely.difference(lines[inside], ring.area)
            if ring.outside
            else shapely.intersection(lines[inside], ring.area)
        )
        middle, crosses = flat[inside, 1].copy(), ~shapely.is_empty(overlap)
        middle[crosses] = shapely.get_coordinates(shapely.centroid(overlap[crosses]))
        deepest = np.min(
            [ring.clearance(points) for points in (flat[inside, 0], flat[inside, 1], middle)],
            axis=0,
        )
        np.minimum.at(clear, flights[inside], np.minimum(deepest, 0.0))
        found[ring.name] = np.minimum(found.get(ring.name, clear), clear)
    return found
