"""Search for the best mission over routes and numbers of legs, each an initial guess of the program."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from planners.hazards.bottom import DEPTH_TOLERANCE
from planners.program.solve import Solution, Solver, Start, again
from planners.program.water import HOUR, KM
from planners.request import Found, Line, MissionPlan, Mooring
from planners.route.bound import Bound, Limit, bound_of
from planners.route.current import Route
from planners.route.passage import (
    MeanCurrent,
    Passage,
    by_rays,
    is_beside,
    mean_current,
    passage,
    wider,
)
from planners.simulation.fly import Flight, Legs
from planners.task import LEAST_DIVE, Task, yo_depths
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import to_local
from replay_kit.core.progress import announce

# Points of each leg of a route.
_POINTS = 9
# Distance between places of a route whose depth is looked up, and between depths of dives [m].
_SPACING, _STEP = 50.0, 5.0
# Numbers of legs that are tried until one holds; share of them that is added at once at most; legs at most.
_TRIES, _AT_ONCE, _MOST_LEGS, _CRAWLING, _MOORED = 5, 0.3, 150, 24, 60
# The rest of an earlier plan that takes so many times as long as the route is reconsidered; durations of glides, in those of the route.
_RECONSIDERED, _GLIDES = 1.02, (1.0, 1.1, 0.9, 1.3, 1.7)
# Shares of a route to a goal out of reach that are cut, one after the other until the legs are enough.
_PARTS = 1.0, 0.5, 0.25, 0.1
# Depths over which a mooring's mean current is taken, glide angles tried for it; turn of a route at a corner [rad].
_DEPTHS, _ANGLES, _CORNER = 51, 64, 0.15
# Share of the best mission's cost below which the route of a lesser depth is tried.
_AT_LEAST = 0.995
# Clearance that may be lacking of the margin [m].
_KEPT = 3.0
# A mission this near to walls [m] that takes so many times as long as its route is tried with a leg more.
_BESIDE, _DETOUR, AGAIN = 500.0, 1.005, " again"
# By how much a mission may be quicker with a leg less.
_SPARE = 1.01
# Share of its time that a way across shallows takes at most to be tried beside the way round them.
_ACROSS = 0.97
# Of missions that miss: one that violates a constraint ranks behind all that do not [m].
_UNSAFE = 1e9


@dataclass(eq=False)
class Search:
    """State of the search for a mission (mutable).

    Attributes:
        task: Mission.
        found: Solutions in order.
    """

    task: Task
    bound: Bound | None
    found: list[Solution] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Create the solver."""
        self.solver, self.short = Solver(self.task), False
        self.tried: set[tuple[str, int]] = set()

    @property
    def best(self) -> Solution | None:
        """Best feasible solution, or None."""
        good = [one for one in self.found if is_feasible(self.task, one)]
        return min(good, key=lambda one: ranking(self.task, one), default=None)

    def attempt(self, start: Start) -> Solution:
        """Return the solution from an initial guess, and record it."""
        count = len(start.angles)
        self.tried.add((start.name, count))
        announce(f"planning: {count} legs")
        self.found.append(self.solver.solve(start))
        return self.found[-1]

    def sweep(self, ways: Sequence[tuple[str, Passage]], depth: float) -> None:
        """Try routes with an estimated number of legs and more until one is feasible, then fewer."""
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
        while not task.is_late:
            fewer = self.recut(best, best.count - 1, self.fewest(best, depth))
            if fewer is None:
                break
            best = fewer
        if best.clearance < _BESIDE and best.seconds > _DETOUR * float(ways[0][1].passed[-1]):
            # legs that bend more often may be quicker beside walls
            self.recut(best, best.count + 1, least)

    def approach(self, way: Passage, deep: bool, limit: Limit = "") -> None:
        """Try the route with the closest approach to a goal out of reach, with a limited number of legs."""
        task, settings = self.task, self.task.settings
        likely = max(int(np.ceil(way.passed[-1] / task.leg_time() - 1e-6)), 1)
        crawling = _MOST_LEGS if limit in ("duration", "legs") else _CRAWLING
        count = min(likely, int(min(settings.most_legs, crawling)))
        if limit == "legs" and settings.max_legs is not None:
            count = settings.max_legs
        count = settings.legs or max(count, len(task.goals))
        if deep:
            self.attempt(cut(task, "nearest", way, count, settings.depth))
            return
        for part in _PARTS:
            lasts = part * float(way.passed[-1])
            times = np.append(way.route.times[way.route.times < lasts], lasts)
            route = Route(way.route.at(times), times, False)
            nearer = Passage(route, np.minimum(way.passed, lasts))
            if (start := cut_by_depth(task, "nearest", nearer, 1.0)) is not None:
                self.attempt(start)
                return
        self.attempt(cut(task, "nearest", way, count, LEAST_DIVE))

    def recut(self, best: Solution, count: int, least: int) -> Solution | None:
        """Return the solution with another number of legs along the same route; None if too few or not better."""
        task = self.task
        assert best.start is not None
        name = f"{best.start.name.removesuffix(AGAIN)}{AGAIN}"
        if count < least or (name, count) in self.tried:
            return None
        found = self.attempt(cut(task, name, as_passage(best), count, float(best.start.depths[0])))
        return (
            found
            if is_feasible(task, found) and ranking(task, found) < ranking(task, best)
            else None
        )

    def fewest(self, best: Solution, depth: float) -> int:
        """Return a lower bound of the number of legs along the same route, from the drift saved and the goal's disc."""
        longest, task = self.task.leg_time(depth=depth), self.task
        needed = best.seconds * (1.0 - task.settings.tolerance / length_of(best))
        if self.bound is not None and self.bound.is_tight:
            needed = max(needed - 2.0 * task.settings.surface_time, self.bound.time)
        return int(np.ceil(needed / longest / _SPARE))

    def turn(self, way: Passage) -> None:
        """Try a route over shallows with legs as deep as the water allows, shortened until feasible."""
        pace, task = 1.0, self.task
        for _ in range(_TRIES):
            start = cut_by_depth(task, "across", way, pace)
            if start is None:
                self.short = True
                return
            one = self.attempt(start)
            if is_feasible(task, one) or task.is_late or task.settings.legs is not None:
                return
            pace *= 1.0 - min(max(1.2 * float(np.max(one.miss)) / length_of(one), 0.04), 0.3)


def length_of(found: Solution) -> float:
    """Return the length of a solution's track over ground [m]."""
    return max(float(np.sum(np.linalg.norm(np.diff(found.flight.place[0], axis=0), axis=1))), 1.0)


def lacking(found: Solution) -> int:
    """Return the number of additional legs needed to cover the miss distance, at least one."""
    missed = float(np.max(found.miss)) / (length_of(found) / found.count)
    return max(int(np.ceil(min(missed, _AT_ONCE * found.count))), 1)


def cut(task: Task, name: str, way: Passage, count: int, depth: float) -> Start:
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


def is_feasible(task: Task, found: Solution) -> bool:
    """Return whether a solution is feasible: no violation, in time, and goals met unless the miss distance has a weight."""
    met = task.settings.weighs_distance or arrives(task, found)
    return found.violation is None and met and overtime(task, found) == 0.0


def arrives(task: Task, found: Solution) -> bool:
    """Return whether all goals are met within the tolerance and the track within the width of its line or mooring."""
    if isinstance(task.shape, Mooring):
        return deviation(task, found)[0] <= task.shape.radius
    near = task.shape is None or deviation(task, found)[0] <= task.shape.width
    return near and bool(np.all(found.miss <= task.settings.tolerance))


def deviation(task: Task, found: Solution) -> tuple[float, float]:
    """Return the largest and the RMS distance from the line or mooring [m]; zeros without one."""
    flight, goal = found.flight, task.goals[-1, :2]
    off = flight.place[0] - goal
    if isinstance(task.shape, Line):
        way = goal - task.line_begin
        away = np.abs(off @ np.array([-way[1], way[0]])) / float(np.linalg.norm(way))
    elif isinstance(task.shape, Mooring):
        away = np.linalg.norm(off, axis=1)
    else:
        return 0.0, 0.0
    lasts = np.diff(flight.time[0])
    mean = float(np.sum(0.5 * (away[1:] ** 2 + away[:-1] ** 2) * lasts)) / max(found.seconds, 1.0)
    if isinstance(task.shape, Mooring) and task.shape.surfacings_only:
        away = away[flight.ends]
        mean = float(np.mean(away**2))
    return float(np.max(away)), float(np.sqrt(mean))


def overtime(task: Task, found: Solution) -> float:
    """Return the excess over the largest duration [s]; 0 for a mooring."""
    late = found.seconds - task.settings.max_duration
    return 0.0 if isinstance(task.shape, Mooring) else max(late, 0.0)


def lacking_energy(task: Task, found: Solution) -> float:
    """Return the energy in excess of the battery [J]."""
    return max(found.energy - task.settings.battery, 0.0)


def ranking(task: Task, found: Solution) -> tuple[bool, float, float]:
    """Return the sort key of solutions: feasible ones within the battery by cost, then others by their deficit."""
    feasible, aim, lacking = (
        is_feasible(task, found),
        task.settings.aim,
        lacking_energy(task, found),
    )
    missing = overtime(task, found) + lacking / 1e3
    if not feasible or aim.distance_first:
        missing += float(np.max(found.miss)) + _UNSAFE * (found.violation is not None)
    # the margin is kept first
    missing += float(found.clearance < task.settings.margin - _KEPT)
    depths, miss = yo_depths(found.legs.turns), float(np.sum(found.miss))
    one = Found(task.vehicle, found.legs.angles, depths, found.seconds, found.energy, miss)
    cost = aim.cost(one)
    if isinstance(task.shape, Line):
        cost += task.shape.weight * found.seconds / HOUR * (deviation(task, found)[1] / KM) ** 2
    elif isinstance(task.shape, Mooring):
        cost = deviation(task, found)[1]
    return not feasible or lacking > 0.0, missing, cost


def search(task: Task, warm: MissionPlan | None = None) -> "Answer":
    """Return the best mission found, with bounds for goals out of reach.

    Args:
        task: Mission.
        warm: Earlier plan for a warm start.
    """
    if met := _met_at_start(task):
        if met == len(task.goals):
            return Answer(staying(task), [], None)
        kept = tuple(range(met, len(task.goals)))
        rest = search(_to_some(task, kept), warm)
        return replace(_to_all(task, kept, rest), bound=rest.bound)
    if isinstance(task.shape, Mooring):
        return _moored(task)
    if task.is_glide:
        return _glide(task)
    before = [] if warm is None else _rest(task, warm)
    bounded = not (task.settings.weighs_distance or task.shape is not None or before)
    mean, bound = bound_of(task) if bounded else (mean_current(task), None)
    one = Search(task, bound, before)
    if before and is_feasible(task, before[0]):
        route = passage(task, mean)
        if before[0].seconds > _RECONSIDERED * float(route.passed[-1]) and route.route.arrives:
            one.sweep([("front", route)], task.settings.depth)
        return Answer(_taken(task, one.found), one.found, None)
    tight = bound is None or bound.is_tight
    rays = None if tight and bound is not None else by_rays(task, mean)
    if bound is not None and bound.goal >= 0 and rays is None:
        return _without(task, mean, bound)
    _anew(one, mean, rays)
    best = _taken(task, one.found)
    if not is_feasible(task, best) and len(task.goals) > 1 and not task.is_late:
        # the goal missed by most takes the time that others need
        kept = tuple(k for k in range(len(best.miss)) if k != int(np.argmax(best.miss)))
        fewer = _to_all(task, kept, search(_to_some(task, kept)))
        reached = [
            int(np.sum(found.miss <= task.settings.tolerance)) for found in (fewer.best, best)
        ]
        if reached[0] > reached[1] and fewer.best.violation is None:
            return fewer
    if one.short and not is_feasible(task, best):
        bounds = (Bound(np.inf, task.longest, 0, limit="legs"),)
        return Answer(best, one.found, None, bounds)
    return Answer(best, one.found, bound)


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """Result of the search.

    Attributes:
        best: Best solution.
        tried: All solutions in order.
        bound: Lower bound of the mission's time; None if unknown.
        beyond: Bound of each goal out of reach.
    """

    best: Solution
    tried: list[Solution]
    bound: Bound | None
    beyond: tuple[Bound, ...] = ()


def _taken(task: Task, found: Sequence[Solution]) -> Solution:
    """Return the best solution, with its legs simulated in sequence."""
    for one in sorted(found, key=lambda one: ranking(task, one)):
        flown = again(one)
        if is_feasible(task, flown) or not is_feasible(task, one):
            return flown
    return again(min(found, key=lambda one: ranking(task, one)))


def _anew(one: Search, mean: MeanCurrent, rays: Passage | None) -> None:
    """Try the routes of a mission around and across shallows."""
    task, depth = one.task, one.task.settings.depth
    places = np.vstack([task.start, task.goals])[:, :2]
    ways = [] if rays is None else [("rays", rays)]
    deep = bool(task.bottom.limit_at(places).min() >= depth)
    if deep and rays is not None and not is_beside(task, rays):
        one.sweep(ways, depth)
        ways = []
    if deep and one.best is None:
        route = passage(task, mean)
        if route.route.arrives:
            ways.append(("front", route))
            if (wide := wider(task, mean, route)) is not None:
                ways.append(("wide", wide))
        if ways:
            one.sweep(ways, depth)
    if deep and one.found:
        _in_range(one)
    lanes = any(ring.surface_only for ring in task.rings)
    if deep and lanes and one.best is None and not task.is_late:
        # an area too wide to be passed under water between two surfacings must be rounded
        rings = tuple(replace(ring, surface_only=False) for ring in task.rings)
        around = Search(replace(task, rings=rings), one.bound, one.found)
        route = passage(around.task, mean)
        if route.route.arrives:
            around.sweep([("round", route)], depth)
    best = one.best
    if task.bottom.shallowest < depth and not task.is_late:
        across = passage(task, mean, LEAST_DIVE)
        quicker = best is None or across.passed[-1] < _ACROSS * best.seconds
        if across.route.arrives and quicker:
            one.turn(across)
    if not one.found:
        # as near as the quickest way comes
        nearest = passage(task, mean, None if deep else LEAST_DIVE)
        one.approach(nearest, deep)


def _in_range(one: Search) -> None:
    """Try shallower depths of the range that may allow a better route."""
    task, settings = one.task, one.task.settings
    if settings.depths is None:
        return
    least = max(settings.depths[0], LEAST_DIVE, float(np.max(task.goals[:, 2])))
    for depth in (least, float(np.sqrt(least * settings.depth))):
        of = replace(settings, depth=depth)
        shallow = replace(task, request=replace(task.request, settings=of))
        way, best = passage(shallow, mean_current(shallow)), one.best
        lasts = float(way.passed[-1])
        count = int(np.ceil(lasts / task.leg_time(depth=depth)))
        energy = float(task.vehicle.energy(lasts, count * settings.yos * depth))
        legs = ((0.0, *(depth, 0.0) * settings.yos),) * count
        angles = np.full(count, task.shallowest_angle)
        cost = settings.aim.cost(Found(task.vehicle, angles, legs, lasts, energy, 0.0))
        worth = best is None or cost < _AT_LEAST * ranking(task, best)[2]
        if way.route.arrives and count <= _MOST_LEGS and worth and not task.is_late:
            one.sweep([("shallower", way)], depth)


def _without(task: Task, mean: MeanCurrent, bound: Bound) -> Answer:
    """Return the best mission without a goal out of reach; if it is the only one, the closest approach."""
    others = tuple(k for k in range(len(task.goals)) if k != bound.goal)
    if others:
        found = _to_all(task, others, search(_to_some(task, others)))
        beyond = tuple(sorted((bound, *found.beyond), key=lambda one: one.goal))
        if len(beyond) < len(task.goals):
            return replace(found, bound=None, beyond=beyond)
    this = (bound.goal,)
    alone = _to_some(task, this)
    one = Search(alone, None)
    places = np.vstack([alone.start, alone.goals])[:1, :2]
    deep = bool(task.bottom.limit_at(places).min() >= task.settings.depth)
    one.approach(passage(alone, mean, None if deep else LEAST_DIVE), deep, bound.limit)
    found = _to_all(task, this, Answer(_taken(alone, one.found), one.found, None))
    beyond = (bound,) if not others else beyond
    return replace(found, beyond=beyond)


def _rest(task: Task, warm: MissionPlan) -> list[Solution]:
    """Return the solution warm-started from the remaining legs of a plan; empty if none remain or their number does not match."""
    flown = warm.legs_flown(task.request.start_time_ns)
    left = len(warm.headings_deg) - flown
    goals = len(warm.goals) == len(task.goals) and all(leg > flown for leg in warm.goal_legs)
    if left < max(len(task.goals), 1) or not goals or task.settings.legs not in (None, left):
        return []
    projection = task.region.grid.projection
    ends = np.column_stack(to_local(projection, *warm.surfacings[flown:].T))
    points = np.vstack([task.start[None, :2], ends])
    share = np.linspace(0.0, 1.0, _POINTS)[None, :, None]
    lines = points[:-1, None] + share * np.diff(points, axis=0)[:, None]
    depths = np.array([max(leg[1:]) for leg in warm.yo_depths[flown:]])
    if np.any(depths < task.settings.depth) and len(depths) > 1 and task.settings.depths is None:
        depths = np.minimum(depths, task.settings.depth)
    angles = np.clip(np.deg2rad(warm.glide_angles_deg[flown:]), *task.vehicle.angles)
    legs = tuple(leg - flown for leg in warm.goal_legs)
    return [Solver(task).solve(Start("rest", lines, angles, depths, legs))]


def _moored(task: Task) -> Answer:
    """Return the mooring mission: legs at the glide angle of station keeping, from two initial guesses."""
    shape, settings, place = task.shape, task.settings, task.goals[0, :2]
    assert isinstance(shape, Mooring)
    weights = task.currents.weights(np.linspace(0.0, settings.depth, _DEPTHS)).mean(axis=0)
    at, now = place[None], task.start_time + 0.5 * shape.duration
    current = task.currents.velocity(at, weights, now)[0]
    angles = np.linspace(*task.vehicle.angles, _ANGLES)
    # a drift at the surface has to be made up for under water
    lasts = np.array([task.leg_time(float(angle)) for angle in angles])
    along = (1.0 - settings.surface_time / lasts) * np.asarray(task.vehicle.speeds(np, angles)[0])
    speed = float(np.linalg.norm(current))
    best = int(np.argmin(np.abs(along - speed)))
    needed = int(np.ceil((shape.duration + settings.surface_time) / lasts[best] - 1e-6))
    count, most = settings.legs or needed, settings.max_legs or _MOORED
    if count > most:
        raise PlanError(
            f"a mooring of {shape.duration / 3600.0:g} h takes {count} legs, but max_legs = {most}; allow more, or more dives a leg"
        )
    one = Search(task, None)
    for hop in (0.0, 0.5 * max(along[best] - speed, 0.0) * lasts[best]):
        side = hop * (-1.0) ** np.arange(count)
        ends = place + np.column_stack([side, np.zeros(count)])
        points = np.vstack([task.start[None, :2], ends])
        lines = (
            points[:-1, None]
            + np.linspace(0.0, 1.0, _POINTS)[None, :, None] * np.diff(points, axis=0)[:, None]
        )
        flat = np.full(count, angles[best]), np.full(count, settings.depth)
        one.attempt(Start("held" if hop == 0.0 else "hops", lines, *flat, (count,)))
    return Answer(_taken(task, one.found), one.found, None)


def _glide(task: Task) -> Answer:
    """Return the glide to its goal, from multiples of the fastest route's duration."""
    mean = mean_current(task)
    deepest = float(max(task.start[2], task.goals[-1, 2]))
    one, way = Search(task, None), passage(task, mean, deepest)
    for share in _GLIDES:
        times = way.route.times * share
        longer = Passage(Route(way.route.points, times, True), way.passed * share)
        one.attempt(cut(task, f"glide {share:g}", longer, 1, deepest))
        if is_feasible(task, one.found[-1]):
            break
    return Answer(_taken(task, one.found), one.found, None)


def staying(task: Task) -> Solution:
    """Return the mission without legs that stays at its start."""
    none, nothing = np.zeros(0), np.zeros(0, dtype=int)
    at = task.start[None, None, :2]
    flight = Flight(np.zeros((1, 1)), task.start[2:], at, np.zeros(1, dtype=int), nothing)
    legs = Legs(none, none, np.zeros((2, 0)), none)
    goals = np.zeros(len(task.goals), dtype=int)
    return Solution(task, None, legs, flight, tuple(goals.tolist()), goals, task.from_start, None)


def _met_at_start(task: Task) -> int:
    """Return the number of leading goals within the tolerance of the start.

    If others follow, a goal at another depth is not counted: a dive passes it later.
    """
    if task.shape is not None or task.is_glide:
        return 0
    near = task.from_start <= task.settings.tolerance
    if near.all():
        return near.size
    return int(np.argmin(near & (np.abs(task.goals[:, 2] - task.start[2]) <= DEPTH_TOLERANCE)))


def _to_some(task: Task, kept: tuple[int, ...]) -> Task:
    """Return the mission to a subset of its goals, by number."""
    goals = tuple(task.request.goals[k] for k in kept)
    return replace(task, request=replace(task.request, goals=goals), goals=task.goals[list(kept)])


def _to_all(task: Task, kept: tuple[int, ...], answer: Answer) -> Answer:
    """Return a result for some goals as one for all: other goals are scored at the closest leg's end, in order."""
    found = answer.best
    ends = np.concatenate([[0], found.flight.ends])
    places, met, legs, points = (
        found.flight.place[0, ends],
        dict(zip(kept, range(len(kept)), strict=True)),
        list[int](),
        list[int](),
    )
    for k, goal in enumerate(task.goals):
        if k in met:
            legs.append(found.goal_legs[met[k]])
            points.append(int(found.points[met[k]]))
            continue
        before = legs[-1] if legs else 0
        after = next((found.goal_legs[met[j]] for j in kept if j > k), ends.size - 1)
        away = np.linalg.norm(places[before : after + 1] - goal[:2], axis=1)
        legs.append(before + int(np.argmin(away)))
        points.append(int(ends[legs[-1]]))
    miss = np.linalg.norm(found.flight.place[0, points] - task.goals[:, :2], axis=1)
    whole = replace(found, goal_legs=tuple(legs), points=np.array(points), miss=miss)
    beyond = tuple(replace(bound, goal=kept[bound.goal]) for bound in answer.beyond)
    return replace(answer, best=whole, bound=None, beyond=beyond)
