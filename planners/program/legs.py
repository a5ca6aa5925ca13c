"""Routes divided into legs, each an initial guess of the program."""

import numpy as np

from planners.program.graph import HOUR
from planners.program.solution import Solution, Start
from planners.route.current import Route
from planners.route.passage import Passage
from planners.task import LEAST_DIVE, Task
from replay_kit.core.arrays import Array

# Points of each leg of a route.
_POINTS = 9
# Distance between places of a route whose depth is looked up, and between depths of dives [m]; turn of a route at a corner [rad].
_SPACING, _STEP, _CORNER = 50.0, 5.0, 0.15
#: Legs at most, and the end of the name of a route that is divided anew.
MOST_LEGS, AGAIN = 150, " again"


def cut_route(task: Task, name: str, way: Passage, count: int, depth: float) -> Start:
    """Return a route divided into legs of equal duration."""
    lasts = float(way.route.times[-1])
    angles = np.full(count, task.angle_of(lasts / count, depth))
    if task.is_glide:
        angles = np.array([lasts / HOUR])
    ends = lasts * np.arange(count + 1) / count
    lines = lines_of(way.route, ends if name.endswith(AGAIN) else snapped(way.route, ends))
    return Start(name, lines, angles, np.full(count, depth), goal_legs(way.passed, count))


def snapped(route: Route, ends: Array) -> Array:
    """Return the ends of legs [s] with the nearest one moved to each corner of the route."""
    way = np.diff(route.points[:, 0] + 1j * route.points[:, 1])
    turn = np.abs(np.angle(way[1:] * way[:-1].conj()))
    ends = ends.copy()
    free = np.ones(ends.size, dtype=bool)
    free[[0, -1]] = False
    for k in np.argsort(-turn):
        if turn[k] < _CORNER or not free.any():
            break
        at = route.times[k + 1]
        near = int(np.argmin(np.where(free, np.abs(ends - at), np.inf)))
        if ends[near - 1] < at < ends[near + 1]:
            ends[near] = at
            free[near] = False
    return ends


def lines_of(route: Route, ends: Array) -> Array:
    """Return the lines of the legs, shape (L, n, 2) [m], between times of a route, shape (L + 1,) [s]."""
    at = np.linspace(ends[:-1], ends[1:], _POINTS)
    return route.at(at.ravel()).reshape(_POINTS, -1, 2).transpose(1, 0, 2)


def straight_lines(start: Array, ends: Array) -> Array:
    """Return the lines of straight legs from a start to their ends, shape (L, 2) [m]."""
    points = np.vstack([start[None, :2], ends])
    share = np.linspace(0.0, 1.0, _POINTS)[None, :, None]
    return np.asarray(points[:-1, None] + share * np.diff(points, axis=0)[:, None])


def cut_by_depth(task: Task, name: str, way: Passage, pace: float) -> Start | None:
    """Return a route divided into legs as deep as the water allows; None if they exceed the allowed number.

    Args:
        task: Mission.
        name: Name of the initial guess.
        way: Passage along all goals.
        pace: Length of legs relative to the longest.
    """
    route, settings = way.route, task.settings
    length = float(np.sum(np.linalg.norm(np.diff(route.points, axis=0), axis=1)))
    times = np.linspace(0.0, route.times[-1], int(length / _SPACING) + 2)
    limits = task.bottom.limit_beside(route.at(times), LEAST_DIVE)
    tried = np.append(np.arange(settings.deepest, LEAST_DIVE, -_STEP), LEAST_DIVE)
    drift, most = settings.surface_time, int(min(settings.most_legs, MOST_LEGS))
    # the route's speed allows for drifts after full dives
    spans = np.array([task.leg_time(depth=depth) - drift for depth in tried])
    spans *= pace / (1.0 - drift / task.leg_time())
    ends, depths, legs = [0.0], list[float](), list[int]()
    for goal in way.passed:
        while ends[-1] < goal - 1e-6:
            until = np.minimum(ends[-1] + spans, goal)
            first = int(np.searchsorted(times, ends[-1], side="right")) - 1
            lows = np.minimum.accumulate(limits[first:])
            least = lows[np.searchsorted(times[first:], until)]
            fits = np.flatnonzero(least >= tried)
            chosen = int(fits[0]) if fits.size else tried.size - 1
            ends.append(float(until[chosen]))
            depths.append(float(tried[chosen]))
            if len(depths) > most:
                return None
        legs.append(max(len(depths), len(legs) + 1))
    deep = np.array(depths)
    at = np.array(legs) - 1
    deep[at] = np.maximum(deep[at], task.goals[:, 2])
    lasts = np.diff(ends)
    angles = np.array([task.angle_of(float(t), float(d)) for t, d in zip(lasts, deep, strict=True)])
    return Start(name, lines_of(route, np.array(ends)), angles, deep, tuple(legs))


def goal_legs(passed: Array, count: int) -> tuple[int, ...]:
    """Return the leg in which each goal is met, from 1: the nearest in time, distinct for each goal.

    Args:
        passed: Passing times, shape (G,) [s], increasing; the last is the end of the route.
        count: Number of legs, at least G.
    """
    numbers: list[int] = []
    for k, share in enumerate(passed / passed[-1]):
        least, most = (numbers[-1] if numbers else 0) + 1, count - (len(passed) - 1 - k)
        numbers.append(int(np.clip(np.round(count * share), least, most)))
    return tuple(numbers)


def as_passage(found: Solution) -> Passage:
    """Return the track of a solution as a passage."""
    flight = found.flight
    passed = flight.time[0, found.points]
    return Passage(Route(flight.place[0], flight.time[0], True), np.array(passed))
