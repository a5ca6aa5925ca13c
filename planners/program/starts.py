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
from replay_kit.core.arrays import Array
from replay_kit.core.progress import announce

# Points of each leg of a route, and of the route at which its depth is looked up.
_POINTS, _LOOKED_UP = 9, 60
# A multiple of the likely number of legs that is tried where one or two more do not hold either; legs at most.
_MORE, _MOST_LEGS = 1.3, 150
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

    def attempt(self, name: str, way: Passage, count: int, depth: float, across: bool) -> Solution:
        """Return what the program finds from a route cut into so many legs."""
        self.tried.add((name, count))
        announce(f"planning: {count} legs")
        start = cut(self.task, name, way, count, depth, across)
        self.found.append(self.solver.solve(start))
        return self.found[-1]

    def sweep(self, ways: Sequence[tuple[str, Passage]], depth: float, across: bool = False) -> None:
        """Try ways with the likely number of legs and more until one holds, then fewer."""
        task, settings = self.task, self.task.settings
        goals, most = len(task.goals), int(min(settings.most_legs, _MOST_LEGS))
        likely = int(np.clip(np.ceil(ways[0][1].passed[-1] / task.leg_time(depth=depth) - 1e-6), goals, max(most, goals)))
        counts = [likely, likely + 1, likely + 2, int(np.ceil(_MORE * likely))]
        if settings.legs is not None:
            counts = [settings.legs]
        held: list[Solution] = []
        for count in dict.fromkeys(min(count, most) for count in counts):
            held = [
                one
                for name, way in ways
                if is_feasible(task, one := self.attempt(name, way, count, depth, across))
            ]
            if held or task.is_late:
                break
        if not held or settings.legs is not None:
            return
        best = min(held, key=lambda one: ranking(task, one))
        count = best.count - 1
        while count >= goals and not task.is_late and best.seconds <= 1.01 * count * task.leg_time(depth=depth):
            assert best.start is not None
            name = best.start.name
            if (name, count) in self.tried:
                break
            fewer = self.attempt(name, as_passage(task, best), count, depth, across)
            if not is_feasible(task, fewer):
                break
            best = min(best, fewer, key=lambda one: ranking(task, one))
            count -= 1


def cut(
    task: Task, name: str, way: Passage, count: int, depth: float, across: bool
) -> Start:
    """Return a route cut into legs of equal time."""
    lasts = float(way.route.times[-1])
    ends = lasts * np.arange(count + 1) / count
    at = np.linspace(ends[:-1], ends[1:], _POINTS)
    lines = way.route.at(at.ravel()).reshape(_POINTS, count, 2).transpose(1, 0, 2)
    if task.is_glide:
        angles = np.array([lasts / 3600.0])
    else:
        angles = np.full(count, task.angle_of(lasts / count, depth))
    of = None if across else depth
    return Start(name, lines, angles, np.full(count, depth), goal_legs(way.passed, count), of)


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


def as_passage(task: Task, found: Solution) -> Passage:
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
    one = Search(task)
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
            points = across.route.at(np.linspace(0, across.route.times[-1], _LOOKED_UP))
            limits = np.minimum(task.bottom.limit_at(points, 60.0), task.settings.depth)
            depth = float(max(1.0 / np.mean(1.0 / np.maximum(limits, 20.0)), 20.0))
            one.sweep([("across", across)], depth, True)
    return one.found, bound
