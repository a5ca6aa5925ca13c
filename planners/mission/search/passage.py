"""The route past a mission's goals in the mean current of its dives and drifts, and legs along it."""

from dataclasses import dataclass
from math import inf

import numpy as np
import shapely

from planners.front.current import (
    CurrentLattice,
    Route,
    current_lattice,
    shares_of_levels,
    spacing_over,
)
from planners.front.front import sea_of, spread
from planners.front.obstacles import as_complex, obstacles_of
from planners.front.relax import relax
from planners.mission.task import MissionTask
from planners.route.hazards import Ring
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
