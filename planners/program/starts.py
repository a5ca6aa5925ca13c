"""Search for the best mission over routes and numbers of legs, each an initial guess of the program."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from planners.hazards.domain import DEPTH_TOLERANCE
from planners.program.legs import (
    AGAIN,
    MOST_LEGS,
    as_passage,
    cut_by_depth,
    cut_route,
    straight_lines,
)
from planners.program.solution import (
    Solution,
    Start,
    flown_again,
    is_feasible,
    length_of,
    ranking,
    staying_mission,
)
from planners.program.solve import Solver
from planners.request import Found, MissionPlan, Mooring
from planners.route.bound import Bound, Limit, bound_of
from planners.route.current import Route
from planners.route.passage import MeanCurrent, Passage, mean_current, passage, wider_passage
from planners.task import LEAST_DIVE, Task
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import to_local
from replay_kit.core.words.progress import announce

# Numbers of legs that are tried until one holds; share of them that is added at once at most; legs at most.
_TRIES, _AT_ONCE, _CRAWLING, _MOORED = 5, 0.3, 24, 60
# The rest of an earlier plan that takes so many times as long as the route is reconsidered; durations of glides, in those of the route.
_RECONSIDERED, _GLIDES = 1.02, (1.0, 1.1, 0.9, 1.3, 1.7)
# Shares of a route to a goal out of reach that are cut, one after the other until the legs are enough.
_PARTS = 1.0, 0.5, 0.25, 0.1
# Depths over which a mooring's mean current is taken, glide angles tried for it.
_DEPTHS, _ANGLES = 51, 64
# Share of the best mission's cost below which the route of a lesser depth is tried.
_AT_LEAST = 0.995
# A mission this near to walls [m] that takes so many times as long as its route is tried with a leg more.
_BESIDE, _DETOUR = 500.0, 1.005
# By how much a mission may be quicker with a leg less.
_SPARE = 1.01
# Share of its time that a way across shallows takes at most to be tried beside the way round them.
_ACROSS = 0.97


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
        most = max(int(min(settings.most_legs, MOST_LEGS)), least)
        likely = int(np.ceil(ways[0][1].passed[-1] / task.leg_time(depth=depth) - 1e-6))
        count, held = settings.legs or max(min(likely, most), least), list[Solution]()
        for _ in range(_TRIES):
            made = [self.attempt(cut_route(task, name, way, count, depth)) for name, way in ways]
            held = [one for one in made if is_feasible(task, one)]
            if held or settings.legs is not None or task.is_late or count == most:
                break
            count = min(count + lacking_legs(min(made, key=lambda one: ranking(task, one))), most)
        best = min(held, key=lambda one: ranking(task, one), default=None)
        if best is None or settings.legs is not None:
            return
        while not task.is_late:
            fewer = self.recut(best, best.count - 1, self.fewest(best, depth), depth)
            if fewer is None:
                break
            best = fewer
        if best.solved.clearance < _BESIDE and best.seconds > _DETOUR * float(
            ways[0][1].passed[-1]
        ):
            # legs that bend more often may be quicker beside walls
            self.recut(best, best.count + 1, least, depth)

    def approach(self, way: Passage, deep: bool, limit: Limit = "") -> None:
        """Try the route with the closest approach to a goal out of reach, with a limited number of legs."""
        task, settings = self.task, self.task.settings
        likely = max(int(np.ceil(way.passed[-1] / task.leg_time() - 1e-6)), 1)
        crawling = MOST_LEGS if limit in ("duration", "legs") else _CRAWLING
        count = min(likely, int(min(settings.most_legs, crawling)))
        if limit == "legs" and settings.max_legs is not None:
            count = settings.max_legs
        count = settings.legs or max(count, len(task.goals))
        if deep:
            self.attempt(cut_route(task, "nearest", way, count, settings.depth))
            return
        for part in _PARTS:
            lasts = part * float(way.passed[-1])
            times = np.append(way.route.times[way.route.times < lasts], lasts)
            route = Route(way.route.at(times), times, False)
            nearer = Passage(route, np.minimum(way.passed, lasts))
            if (start := cut_by_depth(task, "nearest", nearer, 1.0)) is not None:
                self.attempt(start)
                return
        self.attempt(cut_route(task, "nearest", way, count, LEAST_DIVE))

    def recut(self, best: Solution, count: int, least: int, depth: float) -> Solution | None:
        """Return the solution with another number of legs along the same route; None if too few or not better.

        Args:
            best: Solution along the route.
            count: Number of legs.
            least: Least number of legs.
            depth: Greatest depth of the dives [m].
        """
        task = self.task
        assert best.start is not None
        name = f"{best.start.name.removesuffix(AGAIN)}{AGAIN}"
        if count < least or (name, count) in self.tried:
            return None
        found = self.attempt(cut_route(task, name, as_passage(best), count, depth))
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


def lacking_legs(found: Solution) -> int:
    """Return the number of additional legs needed to cover the miss distance, at least one."""
    missed = float(np.max(found.miss)) / (length_of(found) / found.count)
    return max(int(np.ceil(min(missed, _AT_ONCE * found.count))), 1)


def search(task: Task, warm: MissionPlan | None = None) -> "Answer":
    """Return the best mission found, with bounds for goals out of reach.

    Args:
        task: Mission.
        warm: Earlier plan for a warm start.
    """
    if met := _met_at_start(task):
        if met == len(task.goals):
            return Answer(staying_mission(task), [], None)
        kept = tuple(range(met, len(task.goals)))
        rest = search(_to_some(task, kept), warm)
        return replace(_to_all(task, kept, rest), bound=rest.bound)
    if isinstance(task.shape, Mooring):
        return _moored(task)
    if task.is_glide:
        return _glide(task)
    before = [] if warm is None else _rest(task, warm)
    # an earliest arrival is known for one depth and one speed
    free = task.settings.weighs_distance or task.settings.has_ranges or task.shape
    mean, bound = (mean_current(task), None) if free or before else bound_of(task)
    one = Search(task, bound, before)
    if before and is_feasible(task, before[0]):
        route = passage(task, mean)
        if before[0].seconds > _RECONSIDERED * float(route.passed[-1]) and route.route.arrives:
            one.sweep([("front", route)], task.settings.depth)
        return Answer(_taken(task, one.found), one.found, None)
    if bound is not None and bound.goal >= 0:
        return _without(task, mean, bound)
    _anew(one, mean)
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
        flown = flown_again(one)
        if is_feasible(task, flown) or not is_feasible(task, one):
            return flown
    return flown_again(min(found, key=lambda one: ranking(task, one)))


def _anew(search: Search, mean: MeanCurrent) -> None:
    """Try the routes of a mission around and across shallows."""
    task, depth = search.task, search.task.settings.depth
    places = np.vstack([task.start, task.goals])[:, :2]
    deep = bool(task.bottom.limit_at(places).min() >= depth)
    if deep and (route := passage(task, mean)).route.arrives:
        wide = wider_passage(task, mean, route)
        search.sweep([("front", route), *([] if wide is None else [("wide", wide)])], depth)
    if deep and search.found:
        _in_range(search)
    lanes = any(ring.surface_only for ring in task.rings)
    if deep and lanes and search.best is None and not task.is_late:
        # an area too wide to be passed under water between two surfacings must be rounded
        rings = tuple(replace(ring, surface_only=False) for ring in task.rings)
        around = Search(replace(task, rings=rings), search.bound, search.found)
        route = passage(around.task, mean)
        if route.route.arrives:
            around.sweep([("round", route)], depth)
    best = search.best
    if task.bottom.shallowest < depth and not task.is_late:
        across = passage(task, mean, LEAST_DIVE)
        quicker = best is None or across.passed[-1] < _ACROSS * best.seconds
        if across.route.arrives and quicker:
            search.turn(across)
    if not search.found:
        # as near as the quickest way comes
        nearest = passage(task, mean, None if deep else LEAST_DIVE)
        search.approach(nearest, deep)


def _in_range(search: Search) -> None:
    """Try shallower depths of the range that may allow a better route."""
    task, settings = search.task, search.task.settings
    if settings.depths is None:
        return
    least = max(settings.depths[0], LEAST_DIVE, float(np.max(task.goals[:, 2])))
    for depth in (least, float(np.sqrt(least * settings.depth))):
        settings_at_depth = replace(settings, depth=depth)
        shallow = replace(task, request=replace(task.request, settings=settings_at_depth))
        way, best = passage(shallow, mean_current(shallow)), search.best
        lasts = float(way.passed[-1])
        count = int(np.ceil(lasts / task.leg_time(depth=depth)))
        energy = task.vehicle.energy(lasts, count * settings.yos * depth, sum(task.drifts(count)))
        legs = ((0.0, *(depth, 0.0) * settings.yos),) * count
        angles = np.full(count, task.shallowest_angle)
        cost = settings.aim.cost(Found(task.vehicle, angles, legs, lasts, energy, 0.0))
        worth = best is None or cost < _AT_LEAST * ranking(task, best)[2]
        if way.route.arrives and count <= MOST_LEGS and worth and not task.is_late:
            search.sweep([("shallower", way)], depth)


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
    lines = straight_lines(task.start, ends)
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
    search = Search(task, None)
    for hop in (0.0, 0.5 * max(along[best] - speed, 0.0) * lasts[best]):
        side = hop * (-1.0) ** np.arange(count)
        ends = place + np.column_stack([side, np.zeros(count)])
        lines = straight_lines(task.start, ends)
        flat = np.full(count, angles[best]), np.full(count, settings.depth)
        search.attempt(Start("held" if hop == 0.0 else "hops", lines, *flat, (count,)))
    return Answer(_taken(task, search.found), search.found, None)


def _glide(task: Task) -> Answer:
    """Return the glide to its goal, from multiples of the fastest route's duration."""
    mean = mean_current(task)
    deepest = float(max(task.start[2], task.goals[-1, 2]))
    search, way = Search(task, None), passage(task, mean, deepest)
    for share in _GLIDES:
        times = way.route.times * share
        longer = Passage(Route(way.route.points, times, True), way.passed * share)
        search.attempt(cut_route(task, f"glide {share:g}", longer, 1, deepest))
        if is_feasible(task, search.found[-1]):
            break
    return Answer(_taken(task, search.found), search.found, None)


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
    places = found.flight.place[0, ends]
    met = dict(zip(kept, range(len(kept)), strict=True))
    legs = list[int]()
    points = list[int]()
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
