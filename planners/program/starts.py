"""The search: routes cut into some number of legs, the program from each in turn, until no fewer legs do and nothing else is quicker."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from planners.program.solve import Solution, Solver, Start
from planners.request import Found
from planners.route.bound import Bound, bound_of
from planners.route.current import Route
from planners.route.passage import Passage, by_rays, passage, wider
from planners.task import LEAST_DIVE, Task, yo_depths
from planners.water import HOUR
from replay_kit.core.arrays import Array
from replay_kit.core.progress import announce

# Points of each leg of a route.
_POINTS = 9
# Distance between places of a route whose depth is looked up, and between depths of dives [m].
_SPACING, _STEP = 50.0, 5.0
# Numbers of legs that are tried until one holds; share of them that is added at once at most; legs at most.
_TRIES, _AT_ONCE, _MOST_LEGS = 5, 0.3, 150
# A mission this near to walls [m] that takes so many times as long as its route is tried with a leg more.
_BESIDE, _DETOUR, _AGAIN = 500.0, 1.005, " again"
# By how much a mission may be quicker with a leg less.
_SPARE = 1.01
# Share of its time that a way across shallows takes at most to be tried beside the way round them.
_ACROSS = 0.97
# Of missions that miss: one that violates a constraint ranks behind all that do not [m].
_UNSAFE = 1e9


@dataclass(eq=False)
class Search:
    """The search for a mission: mutable, what was tried grows.

    Attributes:
        task: The mission.
        found: Solutions, in turn.
    """

    task: Task
    bound: Bound | None
    found: list[Solution] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Make what solves."""
        self.solver = Solver(self.task)
        self.tried: set[tuple[str, int]] = set()

    @property
    def best(self) -> Solution | None:
        """The best feasible solution; None when there is none."""
        good = [one for one in self.found if is_feasible(self.task, one)]
        return min(good, key=lambda one: ranking(self.task, one), default=None)

    def attempt(self, start: Start) -> Solution:
        """Return what the program finds from a start."""
        count = len(start.angles)
        self.tried.add((start.name, count))
        announce(f"planning: {count} legs")
        self.found.append(self.solver.solve(start))
        return self.found[-1]

    def sweep(self, ways: Sequence[tuple[str, Passage]], depth: float) -> None:
        """Try ways with the likely number of legs and more until one holds, then fewer."""
        task, settings = self.task, self.task.settings
        least = len(task.goals)
        most = max(int(min(settings.most_legs, _MOST_LEGS)), least)
        likely = int(np.ceil(ways[0][1].passed[-1] / task.leg_time(depth=depth) - 1e-6))
        count, held = settings.legs or max(min(likely, most), least), list[Solution]()
        for _ in range(_TRIES):
            made = [self.attempt(cut(task, name, way, count, depth)) for name, way in ways]
            held = [one for one in made if is_feasible(task, one)]
            if held or settings.legs is not None or task.is_late or count == most:
                break
            count = min(count + lacking(min(made, key=lambda one: ranking(task, one))), most)
        best = min(held, key=lambda one: ranking(task, one), default=None)
        if best is None or settings.legs is not None:
            return
        better = best
        while better is not None and not task.is_late:
            best, better = better, self.recut(better, better.count - 1, self.fewest(better, depth))
        if best.clearance < _BESIDE and best.seconds > _DETOUR * float(ways[0][1].passed[-1]):
            # legs that bend more often may be quicker beside walls
            self.recut(best, best.count + 1, least)

    def recut(self, best: Solution, count: int, least: int) -> Solution | None:
        """Return the solution with so many legs along the way of another; None where there are too few or it is not better."""
        task = self.task
        assert best.start is not None
        name = f"{best.start.name.removesuffix(_AGAIN)}{_AGAIN}"
        if count < least or (name, count) in self.tried:
            return None
        found = self.attempt(cut(task, name, as_passage(best), count, float(best.start.depths[0])))
        return found if is_feasible(task, found) and ranking(task, found) < ranking(task, best) else None

    def fewest(self, best: Solution, depth: float) -> int:
        """Return the fewest legs that may do where some do: a leg less takes no drift, and the goal's disc is enough."""
        longest, task = self.task.leg_time(depth=depth), self.task
        needed = best.seconds * (1.0 - task.settings.tolerance / length_of(best))
        if self.bound is not None and self.bound.is_tight:
            needed = max(needed - 2.0 * task.settings.surface_time, self.bound.time)
        return int(np.ceil(needed / longest / _SPARE))

    def turn(self, way: Passage) -> None:
        """Try a way through all water with legs each of a depth that it allows, shorter ones until they hold."""
        pace, task = 1.0, self.task
        for _ in range(_TRIES):
            start = cut_by_depth(task, "across", way, pace)
            if start is None:
                return
            one = self.attempt(start)
            if is_feasible(task, one) or task.is_late or task.settings.legs is not None:
                return
            pace *= 1.0 - min(max(1.2 * float(np.max(one.miss)) / length_of(one), 0.04), 0.3)


def length_of(found: Solution) -> float:
    """Return how far a solution leads over ground [m]."""
    return max(float(np.sum(np.linalg.norm(np.diff(found.flight.place[0], axis=0), axis=1))), 1.0)


def lacking(found: Solution) -> int:
    """Return how many legs more a solution needs to lead over what it misses, one at least."""
    missed = float(np.max(found.miss)) / (length_of(found) / found.count)
    return max(int(np.ceil(min(missed, _AT_ONCE * found.count))), 1)


def cut(task: Task, name: str, way: Passage, count: int, depth: float) -> Start:
    """Return a route cut into legs of equal time."""
    lasts = float(way.route.times[-1])
    angles = np.full(count, task.angle_of(lasts / count, depth))
    if task.is_glide:
        angles = np.array([lasts / HOUR])
    ends = lasts * np.arange(count + 1) / count
    lines = lines_of(way.route, ends if name.endswith(_AGAIN) else snapped(way.route, ends))
    return Start(name, lines, angles, np.full(count, depth), goal_legs(way.passed, count))


def snapped(route: Route, ends: Array) -> Array:
    """Return times at which legs begin and end, the nearest moved to each corner of a route."""
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


_CORNER = 0.15


def lines_of(route: Route, ends: Array) -> Array:
    """Return a route between some times, shape (L + 1,) [s], as lines of the legs, shape (L, n, 2) [m]."""
    at = np.linspace(ends[:-1], ends[1:], _POINTS)
    return route.at(at.ravel()).reshape(_POINTS, -1, 2).transpose(1, 0, 2)


def cut_by_depth(task: Task, name: str, way: Passage, pace: float) -> Start | None:
    """Return a route cut into legs that are as deep as the water along them allows; None where they are more than are allowed.

    Args:
        task: The mission.
        name: Of the start.
        way: Past all goals.
        pace: Share of the longest legs.
    """
    route, settings = way.route, task.settings
    length = float(np.sum(np.linalg.norm(np.diff(route.points, axis=0), axis=1)))
    times = np.linspace(0.0, route.times[-1], int(length / _SPACING) + 2)
    limits = task.bottom.limit_beside(route.at(times), LEAST_DIVE)
    deepest = settings.depth if settings.depths is None else settings.depths[1]
    tried = np.append(np.arange(deepest, LEAST_DIVE, -_STEP), LEAST_DIVE)
    drift, most = settings.surface_time, int(min(settings.most_legs, _MOST_LEGS))
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
    """Return after which leg each goal is met, counted from 1: the nearest in time to the route, each goal after a leg of its own.

    Args:
        passed: shape (G,) [s], increasing; the last is the route's end.
        count: Number of legs, at least G.
    """
    numbers: list[int] = []
    for k, share in enumerate(passed / passed[-1]):
        least, most = (numbers[-1] if numbers else 0) + 1, count - (len(passed) - 1 - k)
        numbers.append(int(np.clip(np.round(count * share), least, most)))
    return tuple(numbers)


def as_passage(found: Solution) -> Passage:
    """Return where a solution leads as a route."""
    flight = found.flight
    passed = flight.time[0, found.points]
    return Passage(Route(flight.place[0], flight.time[0], True), np.array(passed))


def is_feasible(task: Task, found: Solution) -> bool:
    """Return whether a solution violates no constraint, is in time and meets its goals, unless their miss is weighed against a cost."""
    met = task.settings.weighs_distance or goals_met(task, found)
    return found.violation is None and met and overtime(task, found) == 0.0


def goals_met(task: Task, found: Solution) -> bool:
    """Return whether every miss distance is within the tolerance."""
    return bool(np.all(found.miss <= task.settings.tolerance))


def overtime(task: Task, found: Solution) -> float:
    """Return how much longer than the longest mission a solution lasts [s]."""
    return max(found.seconds - task.settings.max_duration, 0.0)


def ranking(task: Task, found: Solution) -> tuple[bool, float, float]:
    """Return the key that solutions are sorted by."""
    feasible = is_feasible(task, found)
    lacks = feasible and found.clearance < task.settings.margin - 3.0
    missing = 0.0 if feasible else float(np.max(found.miss)) + _UNSAFE * (found.violation is not None)
    depths = yo_depths(found.legs.turns)
    cost = task.settings.aim.cost(Found(task.vehicle, found.legs.angles, depths, found.seconds, found.energy, float(np.sum(found.miss))))
    return not feasible, missing + lacks * 1.0, cost


def search(task: Task) -> tuple[list[Solution], Bound | None]:
    """Return solutions, in turn, and the bound."""
    mean, bound = bound_of(task)
    rays = None if bound.is_tight else by_rays(task, mean)
    if bound.goal >= 0 and rays is None:
        return [], bound
    one = Search(task, bound)
    route = passage(task, mean)
    places = np.vstack([task.start, task.goals])[:, :2]
    full = task.bottom.limit_at(places).min() >= task.settings.depth
    ways = [] if rays is None else [("rays", rays)]
    if route.route.arrives:
        ways.append(("front", route))
        if (wide := wider(task, mean, route)) is not None:
            ways.append(("wide", wide))
    if full and ways:
        one.sweep(ways, task.settings.depth)
        if task.settings.depths is not None:
            one.sweep(ways, max(task.settings.depths[0], 20.0))
    if task.bottom.shallowest < task.settings.depth:
        across = passage(task, mean, LEAST_DIVE)
        if across.route.arrives and (
            one.best is None or across.passed[-1] < _ACROSS * one.best.seconds
        ):
            one.turn(across)
    return one.found, bound
