"""The depth of the dives as a control, and the speed of a vehicle with a propeller: for a whole mission, then depths leg by leg.

Each of several depths in the range is judged by the quickest route at it; those that may be the best are solved, the most promising first.
Along the best mission each leg then takes the depth at which it makes most way there, and these legs are solved again. A speed is chosen
after the depth, at which the highest speed was tried.
"""

from dataclasses import dataclass, replace

import numpy as np

from planners.mission.search.passage import Water, passage_past_goals, water_of
from planners.mission.search.search import likely_legs, solve_attempts
from planners.mission.search.turning import Cut, solve_cut
from planners.mission.solve.attempt import Attempt, best_of, is_feasible, ranking_key
from planners.mission.task import LEAST_DIVE, MissionTask
from planners.request import Found, MissionPlan
from planners.route.current import Route
from planners.route.obstacles import as_complex
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError

# Neighbouring depths, and speeds, are at most this factor apart.
_RATIO = 1.3
# Share of the cost on the lattice that a mission solved may have at least.
_AT_LEAST = 0.97
# Shares of the way of the longest legs with which a mission of unlike depths is cut, until it meets its goals.
_PACES = 1.0, 0.96, 0.9
# Points of a mission's way at which depths are compared.
_POINTS = 400


@dataclass(frozen=True, slots=True, eq=False)
class _Choice:
    """One depth or speed of a mission: its task, water, and the least cost to be expected."""

    task: MissionTask
    water: Water
    cost: float


def solve_in_ranges(
    task: MissionTask, warm: MissionPlan | None = None
) -> tuple[MissionTask, list[Attempt]]:
    """Return the attempts of a mission at the depth and speed within their ranges that are best, and the task with these.

    Args:
        task: The problem; its depth is the greatest allowed, its vehicle's speed the highest.
        warm: An earlier plan, whose depths are kept.

    Raises:
        PlanError: The range of depths holds none that fits the goals and the water; or as ``solve_attempts``.
    """
    settings = task.settings
    if warm is not None or not task.is_finite or not (settings.depths or settings.speeds):
        return task, solve_attempts(task, warm)
    attempts = list[Attempt]()
    if settings.depths:
        choices = [_choice(_to_depth(task, depth)) for depth in _depths(task, *settings.depths)]
        best, attempts = _solve(choices)
        # and those halfway to its neighbours
        near = [best.task.settings.depth * step for step in (_RATIO**-0.5, _RATIO**0.5)]
        low, high = (choices[k].task.settings.depth for k in (0, -1))
        between = [_choice(_to_depth(task, depth)) for depth in near if low < depth < high]
        best, attempts = _solve(between, (best, attempts))
        found = best_of(best.task, attempts)
        if is_feasible(best.task, found) and found.yo_depths and settings.legs is None:
            attempts += _leg_by_leg(best, found, choices)
        task = best.task
    if settings.speeds:
        speeds = [speed for speed in _steps(*settings.speeds) if speed < task.vehicle.speed]
        vehicles = (replace(task.vehicle, speed=speed) for speed in speeds)
        slower = [
            _choice(replace(task, request=replace(task.request, vehicle=one))) for one in vehicles
        ]
        first = attempts or solve_attempts(task)
        choice, attempts = _solve(slower, (_choice(task), first))
        task = choice.task
    # a bound holds for one depth and one speed
    return task, [replace(attempt, bound=None) for attempt in attempts]


def _to_depth(task: MissionTask, depth: float) -> MissionTask:
    return replace(
        task, request=replace(task.request, settings=replace(task.settings, depth=depth))
    )


def _steps(least: float, most: float) -> list[float]:
    count = int(np.ceil(np.log(most / least) / np.log(_RATIO) - 1e-9)) + 1
    return [float(value) for value in np.geomspace(least, most, count)] if count > 1 else [most]


def _depths(task: MissionTask, least: float, most: float) -> list[float]:
    """Return the depths that are tried [m]."""
    deepest = min(most, task.settings.depth)
    needed = max(least, LEAST_DIVE, float(np.max(task.goals[:, 2])), float(task.start[2]))
    if needed > deepest:
        raise PlanError(
            f"dives of {least:g} to {most:g} m: expected a depth from {needed:g} m, the least of the range, the start and the goals, to "
            f"{deepest:g} m, the most that range and bottom allow; choose a wider range"
        )
    return _steps(needed, deepest)


def _choice(task: MissionTask) -> _Choice:
    """Return what a mission at one depth and speed may cost at least."""
    water, settings = water_of(task), task.settings
    places = np.vstack([task.start, task.goals])[:, :2]
    limit = max(float(task.bottom.limit_at(places).min()), LEAST_DIVE)
    passage = passage_past_goals(
        task, water, task.rings, depth=min(settings.depth, limit), quick=True
    )
    if not passage.route.arrives:
        return _Choice(task, water, np.inf)
    lasts, n_legs = float(passage.passed[-1]), likely_legs(task, float(passage.passed[-1]))
    leg = (0.0, *(settings.depth, 0.0) * settings.yos)
    energy = float(task.vehicle.energy(lasts, n_legs * settings.yos * settings.depth))
    angles = np.full(n_legs, task.vehicle.angles[0])
    found = Found(task.vehicle, angles, (leg,) * n_legs, lasts, energy, 0.0)
    return _Choice(task, water, settings.aim.cost(found))


def _solve(
    choices: list[_Choice], done: tuple[_Choice, list[Attempt]] | None = None
) -> tuple[_Choice, list[Attempt]]:
    """Return the best of some choices and its attempts; those that cannot be better than what is found are not solved."""
    for choice in sorted(choices, key=lambda one: one.cost):
        if done is not None:
            best = ranking_key(done[0].task, best_of(done[0].task, done[1]))
            if not best[0] and (_AT_LEAST * choice.cost > best[2] or choice.task.is_late):
                break
        attempts = solve_attempts(choice.task)
        rank = ranking_key(choice.task, best_of(choice.task, attempts))
        if done is None or rank < best:
            done = choice, attempts
    assert done is not None, "a range holds a depth"
    return done


def _leg_by_leg(best: _Choice, found: Attempt, choices: list[_Choice]) -> list[Attempt]:
    """Return the attempts along the way of a mission whose legs each have the depth that makes most way there."""
    task, flight = best.task, found.flight
    route = Route(flight.place[0], flight.time, arrives=True)
    passed = flight.time[found.goals.points(flight)]
    times = np.linspace(0.0, float(flight.time[-1]), _POINTS)
    places = route.at(times)
    own = _made_good(best, places, times)
    # how much more way each depth makes, and whether the water is deep enough
    pays = [_made_good(choice, places, times) / np.maximum(own, 1e-3) for choice in choices]
    limits, attempts = task.bottom.limit_at(places, task.settings.margin), list[Attempt]()
    for pace in _PACES:
        cut = _cut(choices, (times, pays, limits), passed, pace)
        if cut is None or set(cut[1]) == {task.settings.depth}:
            break
        if len(cut[1]) <= task.settings.most_legs:
            attempts.append(solve_cut(task, best.water, route, cut))
            if is_feasible(task, attempts[-1]) or task.is_late:
                break
    return attempts


def _made_good(choice: _Choice, places: Array, times: Array) -> Array:
    """Return the speed made good [m/s], shape (n,), along a way through places, shape (n, 2) [m], at some times [s]."""
    way = as_complex(np.gradient(places, axis=0))
    along = way / np.maximum(np.abs(way), 1e-9)
    turned = choice.water.current.at(as_complex(places), times) * along.conj()
    room = np.maximum(choice.water.speed**2 - turned.imag**2, 0.0)
    return np.asarray(turned.real + np.sqrt(room))


def _cut(
    choices: list[_Choice], way: tuple[Array, list[Array], Array], passed: Array, pace: float
) -> Cut | None:
    """Return a route cut into legs, each of the depth that pays most; None where the water is too shallow for all.

    Args:
        choices: The depths.
        way: Times along the route [s], what each depth pays then, and how deep a dive may be [m].
        passed: shape (G,), when the route passes each goal [s].
        pace: Share of the longest legs.
    """
    (times, pays, limits), at, turns, goal_legs = way, [0.0], list[float](), list[int]()
    for goal in passed:
        while at[-1] < goal - 1e-6:
            legs = []
            for choice, pay in zip(choices, pays, strict=True):
                depth = choice.task.settings.depth
                lasts = choice.task.leg_time(choice.task.vehicle.angles[0])
                inside = slice(
                    int(np.searchsorted(times, at[-1])),
                    int(np.searchsorted(times, at[-1] + lasts)) + 1,
                )
                paid = max(float(np.mean(pay[inside])), 0.1)
                end = min(at[-1] + pace * paid * lasts, float(goal))
                if limits[inside].min() >= depth:
                    legs.append((paid, depth, end))
            if not legs:
                return None
            _, turn, end = max(legs)
            turns.append(turn)
            at.append(end)
        goal_legs.append(len(turns))
    return np.array(at), tuple(turns), tuple(goal_legs)
