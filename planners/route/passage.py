"""Mean current of a mission's dives, and routes along its goals, relaxed off the lattice: points move sideways to minimise the time."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely

from planners.route.current import (
    Complex,
    CurrentLattice,
    Route,
    current_lattice,
    shares_of_levels,
    spacing_over,
)
from planners.route.front import Sea, sea_of, spread_front
from planners.route.obstacles import as_complex, obstacles_of
from planners.task import Task
from replay_kit.core.arrays import Array

# Margins of wider routes [m], the widest first, and the share of time that they may cost.
_WIDER, _MAY_COST = (600.0, 300.0, 150.0), 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Passage:
    """Route along all goals.

    Attributes:
        route: Route along all goals, or as far as reachable.
        passed: Passing time of each goal, shape (G,) [s].
    """

    route: Route
    passed: Array


@dataclass(frozen=True, slots=True, eq=False)
class MeanCurrent:
    """Mean current and speed over a leg.

    Attributes:
        current: Current on a lattice, with times since the start of the mission.
        speed: Mean horizontal speed through water over dives and drifts [m/s].
    """

    current: CurrentLattice
    speed: float


def mean_current(task: Task) -> MeanCurrent:
    """Return the mean current and speed of a mission's dives and drifts, over its largest duration."""
    flow, angle = task.flow, task.shallowest_angle
    drift_share = task.settings.surface_time / task.leg_time()
    times, latent = task.currents_through()
    shares = shares_of_levels(task.currents, task.settings.depth, drift_share)
    along = float(task.vehicle.speeds(np, angle)[0])
    return MeanCurrent(
        current_lattice(flow, latent, times, spacing_over(flow), shares),
        (1.0 - drift_share) * along,
    )


def passage(
    task: Task, mean: MeanCurrent, depth: float | None = None, margin: float | None = None
) -> Passage:
    """Return the fastest route along all goals, or to the closest approach to the first out of reach.

    Args:
        task: Mission.
        mean: Mean current and speed.
        depth: Required water depth [m]; None for the dive depth of the settings.
        margin: Margin to forbidden areas [m]; None for that of the settings.
    """
    wanted = task.settings.depth if depth is None else depth
    apart = task.settings.margin if margin is None else margin
    obstacles = obstacles_of(task.solid(wanted), apart, task.places)
    sea = sea_of(mean.current, mean.speed, task.places, obstacles)
    first, now, last = mean.current.places.size, 0.0, task.longest
    points, times, passed = [task.start[None, :2]], [np.zeros(1)], list[float]()
    for k in range(1, task.places.size):
        front = spread_front(
            sea, np.array([first + k - 1]), np.array([now]), last, np.array([first + k])
        )
        arrives = bool(np.isfinite(front.times[first + k]))
        number = first + k if arrives else front.nearest_to(complex(task.places[k]))
        route = relax(sea, front.route_to(number, now, arrives), now)
        points.append(route.points[1:])
        times.append(now + route.times[1:])
        now += float(route.times[-1])
        passed.append(now)
        if not arrives:
            passed += [now] * (task.places.size - 1 - k)
            break
    return Passage(Route(np.concatenate(points), np.concatenate(times), arrives), np.array(passed))


def wider_passage(task: Task, mean: MeanCurrent, quickest: Passage) -> Passage | None:
    """Return the passage with the widest margin at little extra time; None if the fastest is clear of areas, land and shallows."""
    line = shapely.linestrings(quickest.route.points)
    solid = [ring for ring in task.solid(task.settings.depth) if not ring.outside]
    if not any(bool(shapely.dwithin(ring.area, line, _WIDER[0])) for ring in solid):
        return None
    for margin in _WIDER:
        if margin > task.settings.margin:
            found = passage(task, mean, margin=margin)
            if found.route.arrives and found.passed[-1] <= (1.0 + _MAY_COST) * quickest.passed[-1]:
                return found
    return None


# Pieces of a stretch, doubled until each is no longer than so many lattice lines, and sweeps over the points between them.
_FIRST, _LINES, _SWEEPS = 4, 2.5, 5
# First trial step sideways, in lattice lines, and by which it shrinks from sweep to sweep.
_STEP, _SHRINK = 0.5, 0.6


def relax(sea: Sea, route: Route, begins: float) -> Route:
    """Return a relaxed route, at least as fast, with points between corners off the lattice.

    Args:
        sea: Graph of the front.
        route: Route of the front.
        begins: Begin of the route [s].
    """
    places = as_complex(route.points)
    corners = np.zeros(0) if sea.obstacles is None else sea.obstacles.corners
    fixed = [0, *(np.flatnonzero(np.isin(places[1:-1], corners)) + 1), places.size - 1]
    found, times = [places[:1]], [np.zeros(1)]
    for first, last in pairwise(fixed):
        at = begins + times[-1][-1]
        stretch = places[first : last + 1]
        kept = stretch, _times(sea, stretch, at)
        moved = _relaxed(sea, *kept, at)
        best = moved if moved[1][-1] < kept[1][-1] else kept
        found.append(best[0][1:])
        times.append(times[-1][-1] + best[1][1:])
    # a route that leads nowhere keeps the second that it is given, as its times are divided by
    if not 0.0 < times[-1][-1] <= route.times[-1]:
        return route
    ends = np.concatenate(found)
    return Route(np.column_stack([ends.real, ends.imag]), np.concatenate(times), route.arrives)


def _times(sea: Sea, places: Complex, begins: float) -> Array:
    """Return the passing times of positions [s], the first at 0."""
    times = np.zeros(places.size)
    for k in range(places.size - 1):
        depart = np.array([begins + times[k]])
        if not np.isfinite(depart[0]):
            times[k + 1 :] = np.inf
            break
        lasts = sea.durations(places[k : k + 1], places[k + 1 : k + 2], depart)
        times[k + 1] = times[k] + lasts[0]
    return times


def _relaxed(sea: Sea, places: Complex, times: Array, begins: float) -> tuple[Complex, Array]:
    """Return a relaxed section of a route between fixed ends, and its times."""
    if times[-1] <= 0.0 or not np.isfinite(times[-1]):
        return places, times
    length, count = float(np.sum(np.abs(np.diff(places)))), _FIRST
    most = max(int(np.ceil(length / (_LINES * sea.current.spacing))), _FIRST)
    while True:
        even = np.linspace(0.0, times[-1], count + 1)
        places = np.interp(even, times, places.real) + 1j * np.interp(even, times, places.imag)
        step = _STEP * sea.current.spacing
        for _ in range(_SWEEPS):
            for parity in (1, 2):
                places = _swept(sea, places, begins + even, parity, step)
            step *= _SHRINK
        times = _times(sea, places, begins)
        if count >= most or not np.isfinite(times[-1]):
            break
        count *= 2
    crossed = sea.obstacles is not None and sea.obstacles.crossed(places[:-1], places[1:]).any()
    return places, np.full(times.size, np.inf) if crossed else times


def _swept(sea: Sea, places: Complex, times: Array, parity: int, step: float) -> Complex:
    """Return positions with every other one moved sideways to the least time."""
    inner = np.arange(parity, places.size - 1, 2)
    before, here, after = places[inner - 1], places[inner], places[inner + 1]
    side = 1j * (after - before) / np.maximum(np.abs(after - before), 1e-9)

    def duration(offset: Array) -> Array:
        at, depart = here + offset * side, times[inner - 1]
        lasts = sea.durations(before, at, depart)
        # a closed edge never ends; its second half must still have a time
        depart = np.where(np.isfinite(lasts), depart + lasts, depart)
        return lasts + sea.durations(at, after, depart)

    left, middle, right = (duration(np.full(inner.size, offset)) for offset in (-step, 0.0, step))
    with np.errstate(invalid="ignore"):
        bend = left + right - 2.0 * middle
        offset = np.where(
            bend > 0.0,
            0.5 * step * (left - right) / np.where(bend > 0.0, bend, 1.0),
            step * np.sign(left - right),
        )
    offset = np.clip(np.nan_to_num(offset), -2.0 * step, 2.0 * step)
    better = duration(offset) < middle
    if sea.obstacles is not None:
        at = here + offset * side
        better &= ~(sea.obstacles.crossed(before, at) | sea.obstacles.crossed(at, after))
    found = places.copy()
    found[inner[better]] = (here + offset * side)[better]
    return found
