"""Ways before the optimiser: the route past a mission's goals in its mean current, legs along it, and one flown by the pilot alone."""

from collections.abc import Callable
from dataclasses import dataclass
from math import inf

import numpy as np
import shapely

from planners.hazards.areas import Ring
from planners.mission.flight.legs import Legs, fly_legs, fly_midpoints
from planners.mission.flight.pilot import aim
from planners.mission.solve.attempt import Attempt, GoalSteps, LegsProblem
from planners.mission.solve.legs import fly_guess
from planners.mission.task import MissionTask
from planners.route.current import (
    CurrentLattice,
    Route,
    current_lattice,
    shares_of_levels,
    spacing_over,
)
from planners.route.front import sea_of, spread
from planners.route.obstacles import as_complex, obstacles_of
from planners.route.relax import relax
from planners.shooting.program import MissionGuess
from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import true_north_halfway

# Margins of wider routes [m], the widest first, and the share of time that they may cost.
_WIDER, _MAY_COST = (600.0, 300.0, 150.0), 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Passage:
    """A route past all goals.

    Attributes:
        route: Past all of them, or as far as can be reached.
        passed: shape (G,), when it passes each [s].
    """

    route: Route
    passed: Array


@dataclass(frozen=True, slots=True, eq=False)
class Water:
    """What a mission's vehicle meets in the mean over a leg.

    Attributes:
        current: Since the start of the mission.
        speed: Horizontal, through water, in the mean of dives and drifts [m/s].
    """

    current: CurrentLattice
    speed: float


def water_of(task: MissionTask, finer: float = 1.0) -> Water:
    """Return the mean current of a mission's dives and drifts, over the times that it may last, and its speed in it.

    Args:
        task: The problem.
        finer: How many times more lines than usual the lattice has.
    """
    flow, angle = task.flow, task.vehicle.angles[0]
    drift_share = task.settings.surface_time / task.leg_time(angle)
    times, latent = currents_through(task)
    shares = shares_of_levels(flow, task.settings.depth, drift_share)
    along = float(task.vehicle.speeds(np, angle)[0])
    return Water(
        current_lattice(flow, latent, times, spacing_over(flow, finer), shares),
        (1.0 - drift_share) * along,
    )


def currents_through(task: MissionTask) -> tuple[Array, Array]:
    """Return the times that a mission may meet, shape (T,) [s] since its start, and the latent values then, shape (M, Z T)."""
    if task.currents.times is None:
        return np.zeros(1), task.currents.latent[0]
    times, levels = task.currents.times - task.start_time, np.arange(task.flow.levels.size)
    # what lies before the start or after the end counts through the nearest time alone
    keep = np.flatnonzero(
        (np.append(times[1:], inf) > 0.0)
        & (np.append(-inf, times[:-1]) < task.settings.max_duration)
    )
    return times[keep], task.currents.latent[0][:, (keep[:, None] * levels.size + levels).ravel()]


def longest_time(task: MissionTask) -> float:
    """Return the time of the longest mission considered [s]."""
    settings = task.settings
    return min(
        (settings.legs or settings.most_legs) * task.leg_time(task.vehicle.angles[0]),
        settings.max_duration,
    )


def passage_past_goals(
    task: MissionTask,
    water: Water,
    rings: tuple[Ring, ...],
    *,
    margin: float | None = None,
    depth: float | None = None,
    quick: bool = False,
) -> Passage:
    """Return the quickest route past all goals, or as near as it comes to the first that is out of reach.

    Args:
        task: The problem.
        water: What the vehicle meets.
        rings: What the route keeps clear of at any depth.
        margin: Distance kept from it [m]; None for that of the settings.
        depth: Of the water that it needs [m]; None for that of the settings.
        quick: Whether to stay on the lattice: a route that is somewhat longer.
    """
    shallows = task.bottom.rings(task.settings.depth if depth is None else depth)
    places = task.places
    obstacles = obstacles_of(
        (*rings, *shallows), task.settings.margin if margin is None else margin, places
    )
    sea = sea_of(water.current, water.speed, places, obstacles)
    first, now, last = water.current.places.size, 0.0, longest_time(task)
    points, times, passed = [task.start[None, :2]], [np.zeros(1)], list[float]()
    for k in range(1, places.size):
        front = spread(sea, np.array([first + k - 1]), np.array([now]), last, np.array([first + k]))
        arrives = bool(np.isfinite(front.times[first + k]))
        number = first + k if arrives else front.nearest_to(complex(places[k]))
        on_lattice = front.route_to(number, now, arrives)
        route = on_lattice if quick else relax(sea, on_lattice, now)
        points.append(route.points[1:])
        times.append(now + route.times[1:])
        now += float(route.times[-1])
        passed.append(now)
        if not arrives:
            passed += [now] * (places.size - 1 - k)
            break
    return Passage(Route(np.concatenate(points), np.concatenate(times), arrives), np.array(passed))


def is_beside(task: MissionTask, rings: tuple[Ring, ...], passage: Passage) -> bool:
    """Return whether a passage leads beside an area or land, so that a wider way may differ from it."""
    line = shapely.linestrings(passage.route.points)
    solid = [
        ring
        for ring in (*rings, *task.bottom.rings(task.settings.depth))
        if not ring.outside and not ring.surface_only
    ]
    return any(bool(shapely.dwithin(ring.area, line, _WIDER[0])) for ring in solid)


def widest_passage(
    task: MissionTask, water: Water, rings: tuple[Ring, ...], passage: Passage
) -> Passage:
    """Return the passage farthest from what it must keep clear of that takes little longer than the quickest."""
    for margin in _WIDER:
        if margin > task.settings.margin:
            wider = passage_past_goals(task, water, rings, margin=margin)
            if wider.route.arrives and wider.passed[-1] <= (1.0 + _MAY_COST) * passage.passed[-1]:
                return wider
    return passage


def initial_guess(task: MissionTask, route: Route, water: Water, ends: Array) -> MissionGuess:
    """Return a route cut into legs at some times, shape (L + 1,) [s], with the headings that follow it in the mean current."""
    places, durations = route.at(ends), np.diff(ends)
    current = water.current.at(
        as_complex(0.5 * (places[1:] + places[:-1])), 0.5 * (ends[1:] + ends[:-1])
    )
    through = np.diff(places, axis=0) / np.maximum(durations, 1.0)[:, None] - np.column_stack(
        [current.real, current.imag]
    )
    turns = (None,) * durations.size if task.turns is None else task.turns
    angles = [
        task.angle_of(float(duration), turn)
        for duration, turn in zip(durations, turns, strict=True)
    ]
    turn = true_north_halfway(task.region.grid.projection, places[:-1], places[1:])
    return MissionGuess(
        places[1:], np.arctan2(through[:, 0], through[:, 1]) - turn, np.array(angles)
    )


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
