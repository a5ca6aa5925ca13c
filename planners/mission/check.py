"""The dense check of a mission's path, every ten metres, and its outcome in words."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.mission.flight import Flight
from planners.mission.task import MissionTask
from planners.route.hazards import SPACING, Ring, densified, first_violation
from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_geographic

# Depths are compared to this [m].
_DEPTH = 1e-3


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


def check(task: MissionTask, flight: Flight) -> Violation | None:
    """Return the first constraint violation of a path, at points no farther apart than ten metres; None when there is none.

    At all depths the path must keep clear of every ring and stay in the water; at the surface it must also keep clear of areas that only
    forbid surfacing.
    """
    if not np.all(np.isfinite(flight.place)):
        return Violation("the path is not a number", 0.0, 1, float("nan"), float("nan"))
    number, dense = densified(np.column_stack([flight.place[0], flight.depth]))
    wet = task.region.wet(dense)
    too_deep = (dense[:, 2] > task.region.deepest + _DEPTH) | (dense[:, 2] < -_DEPTH)
    # the start itself is given, whatever may be forbidden there
    surfaced = np.flatnonzero((dense[:, 2] <= _DEPTH) & (number > 1.0))
    lane = first_violation(task.rings, dense[surfaced, :2], surfacing=True)
    found = [
        first_violation(task.rings, dense[:, :2], surfacing=False),
        None if lane is None else (lane[0], int(surfaced[lane[1]])),
        None if wet.all() else ("land", int(np.argmin(wet))),
        ("the surface or the deepest level", int(np.argmax(too_deep))) if too_deep.any() else None,
    ]
    first = min((one for one in found if one is not None), key=lambda one: one[1], default=None)
    if first is None:
        return None
    what, i = first
    time = float(np.interp(number[i], np.arange(flight.depth.size), flight.time))
    longitude, latitude = to_geographic(task.region.grid.projection, *dense[i, :2])
    leg = int(flight.leg[int(np.ceil(number[i]))]) + 1
    return Violation(what, time, leg, float(longitude), float(latitude))


def clearances(task: MissionTask, flight: Flight) -> dict[str, Array]:
    """Return the clearance of each of K flights from each hazard, by its name, shape (K,) [m]: 0 or less where it violates it.

    A flight that is never as near as one of its steps is long has an infinite clearance: no point between its own can be nearer.
    """
    count, found = len(flight.place), dict[str, Array]()
    surfaced = (flight.depth <= _DEPTH) & (np.arange(flight.depth.size) > 0)
    for ring in task.rings:
        numbers = np.flatnonzero(surfaced) if ring.surface_only else np.arange(flight.depth.size)
        found[ring.name] = np.minimum(found.get(ring.name, np.full(count, np.inf)), _clearance(ring, flight.place[:, numbers], numbers))
    if not task.region.grid.wet.all():
        track = np.dstack([flight.place, np.broadcast_to(flight.depth, flight.place.shape[:2])])
        wet = task.region.wet(track.reshape(-1, 3)).reshape(count, -1).all(axis=1)
        land = found.get("land", np.full(count, np.inf))
        found["land"] = np.where(wet, land, np.minimum(land, 0.0))
    return found


def _clearance(ring: Ring, place: Array, numbers: NDArray[np.intp]) -> Array:
    """Return the clearance of each of K paths, shape (K, n, 2) [m], from one ring; only successive numbers are joined by a step."""
    clear, joined = np.full(place.shape[:2], np.inf), np.diff(numbers) == 1
    longest = float(np.max(np.linalg.norm(np.diff(place, axis=1), axis=2)[:, joined], initial=0.0))
    near = ring.is_near(place.reshape(-1, 2), longest).reshape(clear.shape)
    clear[near] = ring.clearance(place[near])
    # a step that begins no farther away than it is long may come nearer on its way
    flight, step = np.nonzero((np.abs(clear[:, :-1]) <= longest) & joined)
    if flight.size:
        share = np.linspace(0.0, 1.0, int(np.ceil(longest / SPACING)) + 1)[:, None]
        between = place[flight, step][:, None] + share * (place[flight, step + 1] - place[flight, step])[:, None]
        nearest = ring.clearance(between.reshape(-1, 2)).reshape(flight.size, -1).min(axis=1)
        np.minimum.at(clear, (flight, step), nearest)
    return np.asarray(clear.min(axis=1))
