"""A mission flown without an optimiser: at each surfacing the glider heads at a place, in the estimate's own current."""

from collections.abc import Callable

import numpy as np

from planners.front.obstacles import as_complex
from planners.mission.flight.legs import Legs, fly_legs, fly_midpoints
from planners.mission.flight.pilot import aim
from planners.mission.search.passage import Water
from planners.mission.solve.attempt import Attempt, GoalSteps, LegsProblem
from planners.mission.solve.legs import fly_guess
from planners.mission.task import MissionTask
from planners.shooting.program import MissionGuess
from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import true_north_halfway

# Where a leg begins [m], shape (2,), when [s], and the next goal's number -> where to head [m], shape (2,).
Target = Callable[[Array, float, int], Array]


def habit(task: MissionTask, water: Water, most: int, latest: float) -> Attempt | None:
    """Return the mission of a pilot who heads at the next goal at each surfacing; None when it arrives after the most legs or too late.

    Goals below the surface are not met at the end of a leg: a mission with one has no such pilot.
    """
    if np.any(task.goals[:, 2] > 0.0) or task.turns is not None:
        return None
    return _course(task, water, most, lambda at, now, goal: task.goals[goal, :2], latest)


def along_route(task: MissionTask, water: Water, n_legs: int, target: Target) -> Attempt:
    """Return the mission of some legs that head at places of a route, whether or not they meet the goals."""
    found = _course(task, water, n_legs, target)
    assert found is not None
    return found


def _course(
    task: MissionTask, water: Water, most: int, target: Target, latest: float | None = None
) -> Attempt | None:
    """Return the legs flown one after the other; with a latest time [s] only those until the goals are met, None when not by then."""
    whole = latest is None
    at, now, goal, met = task.start[:2], 0.0, 0, list[int]()
    headings, angles, places = list[float](), list[float](), list[Array]()
    all_depths = task.depths(task.yo_depths(most))
    for k in range(most):
        to, depths = target(at, now, goal), all_depths[k]
        height = float(np.sum(np.abs(np.diff(depths))))
        drift = task.settings.surface_time if not whole or k + 1 < most else 0.0
        # the leg that arrives ends there, without a drift
        heading, angle = _aimed(
            task,
            water,
            (at, now),
            to,
            height,
            0.0 if _is_last(task, water, to - at, goal, height) else drift,
        )
        legs = Legs(np.array([heading]), np.array([angle]), (depths,), np.array([drift]))
        flight = fly_legs(
            task.currents, task.vehicle, at, legs, task.start_time + now, fly_midpoints
        )
        # the last goal is met before a drift, the others after theirs
        met_at = flight.place[0, depths.size - 1 if goal == len(task.goals) - 1 else -1]
        headings.append(heading)
        angles.append(angle)
        if not whole and np.linalg.norm(met_at - task.goals[goal, :2]) <= task.settings.tolerance:
            goal += 1
            met.append(k + 1)
        places.append(flight.place[0, -1])
        at, now = flight.place[0, -1], now + float(flight.time[-1])
        if goal == len(task.goals):
            break
        if latest is not None and now >= latest:
            return None
    n_legs = len(headings)
    if latest is not None and (goal < len(task.goals) or now >= latest):
        return None
    goal_legs = (
        tuple(met)
        if not whole
        else tuple(max(n_legs - len(task.goals) + 1 + k, 1) for k in range(len(task.goals)))
    )
    guess = MissionGuess(np.array(places), np.array(headings), np.array(angles))
    return fly_guess(LegsProblem(task, n_legs, GoalSteps(goal_legs, (0,) * len(goal_legs))), guess)


def _is_last(task: MissionTask, water: Water, way: Array, goal: int, height: float) -> bool:
    """Return whether a leg may end at the last goal."""
    longest = height / float(task.vehicle.speeds(np, task.vehicle.angles[0])[1])
    return goal == len(task.goals) - 1 and bool(
        np.linalg.norm(way) <= (water.speed + water.current.fastest) * longest
    )


def _aimed(
    task: MissionTask,
    water: Water,
    begin: tuple[Array, float],
    to: Array,
    height: float,
    drift: float,
) -> tuple[float, float]:
    """Return heading and glide angle [rad] that lead from a place [m] and time [s] towards another in the mean current."""
    at, now = begin
    lasts = task.leg_time(task.vehicle.angles[0])
    away = to - at
    reach = min(1.0, water.speed * lasts / max(float(np.linalg.norm(away)), 1.0))
    current = water.current.at(
        as_complex((at + 0.5 * reach * away)[None]), np.array([now + 0.5 * lasts])
    )
    heading, angle = aim(
        task.vehicle, away[None], np.column_stack([current.real, current.imag]), height, drift
    )
    turn = true_north_halfway(task.region.grid.projection, at[None], (at + reach * away)[None])
    return float(heading[0] - turn[0]), float(angle[0])
