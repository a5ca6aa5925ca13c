"""Legs whose dives turn above the bottom: a route through shallow water cut into legs, each as deep as the water along it allows."""

from dataclasses import replace
from itertools import pairwise
from math import inf

import numpy as np

from planners.hazards.areas import Ring
from planners.mission.search.passage import (
    Water,
    along_route,
    initial_guess,
    longest_time,
    passage_past_goals,
)
from planners.mission.solve.attempt import ENOUGH, Attempt, Bound, GoalSteps, effort_of, is_feasible
from planners.mission.solve.legs import solve_legs
from planners.mission.task import LEAST_DIVE, MissionTask
from planners.route.current import Route
from replay_kit.core.arrays import Array

# Distance between the places of a route whose depth is looked up [m], and the water beside it that counts, in margins.
_SPACING, _BESIDE = 50.0, 2.0
# Depths at which dives turn are multiples of this [m].
_STEP = 5.0
# Shares of the longest legs with which the route is cut, one after the other until the goals are met.
_PACES = 1.0, 0.9, 0.8, 0.65
# Shares of a route to a goal out of reach that are cut, one after the other until the legs are enough.
_PARTS = 1.0, 0.5, 0.25, 0.1
#: The times at which legs begin and end [s], shape (L + 1,); the depths at which they turn [m]; after which leg each goal is met.
Cut = tuple[Array, tuple[float, ...], tuple[int, ...]]


def solve_turning(task: MissionTask, water: Water, rings: tuple[Ring, ...]) -> list[Attempt]:
    """Return the attempts along the quickest route through all water deep enough for the least dive, its dives turning above the bottom.

    Args:
        task: The problem.
        water: What the vehicle meets.
        rings: What the route keeps clear of at any depth.
    """
    attempts, passage = list[Attempt](), passage_past_goals(task, water, rings, depth=LEAST_DIVE)
    route, passed = passage.route, passage.passed
    for pace in _PACES:
        cut = _cut(task, route, passed, pace)
        if (
            cut is None
            or (attempts and (task.is_late or effort_of(attempts) > 2 * ENOUGH))
            or any(is_feasible(task, attempt) for attempt in attempts)
        ):
            break
        attempts.append(solve_cut(task, water, route, cut))
        if task.settings.legs is not None:
            break
    return attempts


def approach_turning(task: MissionTask, water: Water, rings: tuple[Ring, ...]) -> list[Attempt]:
    """Return the course towards a goal out of reach whose dives turn above the bottom, as far as it is clear; none where no legs make it.

    Args:
        task: The problem.
        water: What the vehicle meets.
        rings: What the route keeps clear of at any depth.
    """
    passage = passage_past_goals(task, water, rings, depth=LEAST_DIVE)
    for part in _PARTS:
        lasts = part * passage.route.times[-1]
        times = np.append(passage.route.times[passage.route.times < lasts], lasts)
        route = Route(passage.route.at(times), times, arrives=False)
        if (cut := _cut(task, route, np.minimum(passage.passed, lasts), 1.0)) is not None:
            flown = _flown_clear(task, water, route, cut)
            # where all of the way takes more legs than are allowed, these are what binds
            unmet = int(np.argmax(flown.miss > task.settings.tolerance))
            needs_legs = passage.route.arrives and part < _PARTS[0]
            return [
                replace(
                    flown,
                    beyond=(Bound(inf, longest_time(task), unmet, limit="legs"),)
                    if needs_legs
                    else (),
                )
            ]
    return []


def _flown_clear(task: MissionTask, water: Water, route: Route, cut: Cut) -> Attempt:
    """Return the course along a route that is cut, without the legs from the first that is not clear."""
    ends, turns, _ = cut

    def at_end(_at: Array, now: float, _goal: int) -> Array:
        return np.asarray(
            route.at(ends[min(int(np.searchsorted(ends, now, side="right")), ends.size - 1)][None])[
                0
            ]
        )

    def flown(count: int) -> Attempt:
        return along_route(replace(task, turns=turns[:count]), water, count, at_end)

    course = flown(len(turns))
    while (
        course.violation is not None
        and task.settings.legs is None
        and course.violation.leg > len(task.goals)
    ):
        course = flown(course.violation.leg - 1)
    return course


def solve_cut(task: MissionTask, water: Water, route: Route, cut: Cut) -> Attempt:
    """Return the attempt with the legs of a route that is cut."""
    ends, turns, goal_legs = cut
    limited = replace(task, turns=turns)
    guess = initial_guess(limited, route, water, ends)
    goals = GoalSteps(goal_legs, limited.goal_steps(goal_legs, len(turns), np.ones(len(goal_legs))))
    # half-planes are placed along a route whose legs take equal times
    times = np.union1d(route.times, ends)
    even = Route(
        route.at(times),
        np.interp(times, ends, np.arange(ends.size, dtype=np.float64)),
        route.arrives,
    )
    return solve_legs(limited, guess, goals, even)


def _cut(task: MissionTask, route: Route, passed: Array, pace: float) -> Cut | None:
    """Return a route cut into legs that are as deep as the water along them allows.

    Args:
        task: The problem.
        route: Past all goals.
        passed: shape (G,), when it passes each [s].
        pace: Share of the longest legs.

    Returns:
        None when that takes more legs than are allowed.
    """
    length = float(np.sum(np.linalg.norm(np.diff(route.points, axis=0), axis=1)))
    times = np.union1d(np.linspace(0.0, route.times[-1], int(length / _SPACING) + 2), route.times)
    places = route.at(times)
    beside = task.bottom.limit_at(places, _BESIDE * task.settings.margin)
    own = task.bottom.limit_at(places)
    # the route keeps its margin from what is too shallow for any dive
    limits = np.where(beside < LEAST_DIVE, own, beside)
    most = min(task.settings.legs or task.settings.most_legs, task.settings.most_legs)
    if task.settings.legs is not None:
        ends = np.unique(
            np.concatenate(
                [
                    np.linspace(0.0, route.times[-1], task.settings.legs + 1)[1:-1],
                    [0.0, route.times[-1]],
                ]
            )
        )
        turns = tuple(_turn(task, times, limits, begin, end) for begin, end in pairwise(ends))
        shares = np.round(passed / route.times[-1] * task.settings.legs).astype(int)
        goal_legs = tuple(
            int(np.clip(n, k + 1, most - len(passed) + k + 1)) for k, n in enumerate(shares)
        )
        return ends, _deep_enough(task, turns, goal_legs), goal_legs
    at, depths, counts = [0.0], list[float](), list[int]()
    for goal in passed:
        while True:
            turn = task.settings.depth
            while True:
                end = min(at[-1] + pace * _span(task, turn), float(goal))
                least = _turn(task, times, limits, at[-1], end)
                if least >= turn:
                    break
                turn = least
            at.append(end)
            depths.append(turn)
            if len(depths) > most:
                return None
            if end >= goal - 1e-6:
                break
        counts.append(len(depths))
    return np.array(at), _deep_enough(task, tuple(depths), tuple(counts)), tuple(counts)


def _deep_enough(
    task: MissionTask, turns: tuple[float, ...], goal_legs: tuple[int, ...]
) -> tuple[float, ...]:
    """Return the depths at which legs turn [m], no less than those of the goals that they meet."""
    deep = np.array(turns)
    deep[np.array(goal_legs) - 1] = np.maximum(deep[np.array(goal_legs) - 1], task.goals[:, 2])
    return tuple(float(turn) for turn in deep)


def _span(task: MissionTask, turn: float) -> float:
    """Return the time of a route [s] that the longest leg to a depth [m] takes; the route's speed allows for drifts after full dives."""
    shallow, drift = task.vehicle.angles[0], task.settings.surface_time
    return (task.leg_time(shallow, turn) - drift) / (1.0 - drift / task.leg_time(shallow))


def _turn(task: MissionTask, times: Array, limits: Array, begin: float, end: float) -> float:
    """Return how deep dives may be between two times of a route [s], by the limits [m] at some times."""
    first = np.searchsorted(times, begin, side="right") - 1
    last = np.searchsorted(times, end, side="left") + 1
    least = min(float(np.min(limits[first:last])), task.settings.depth)
    return (
        least if least == task.settings.depth else max(np.floor(least / _STEP) * _STEP, LEAST_DIVE)
    )
