"""Mean current of a mission's dives, and routes along its goals."""

from dataclasses import dataclass

import numpy as np
import shapely

from planners.route.current import (
    CurrentLattice,
    Route,
    current_lattice,
    shares_of_levels,
    spacing_over,
)
from planners.route.front import sea_of, spread
from planners.route.obstacles import obstacles_of
from planners.route.relax import relax
from planners.task import Task
from replay_kit.core.arrays import Array

# Margins of wider routes [m], the widest first, and the share of time that they may cost.
_WIDER, _MAY_COST = (600.0, 300.0, 150.0), 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Passage:
    """Route along all goals.

    Attributes:
        route: Route along all goals, or as far as reachable.
        passed: Passing time of each goal, shape (G,) [s].
    """

    route: Route
    passed: Array


@dataclass(frozen=True, slots=True, eq=False)
class MeanCurrent:
    """Mean current and speed over a leg.

    Attributes:
        current: Current on a lattice, with times since the start of the mission.
        speed: Mean horizontal speed through water over dives and drifts [m/s].
    """

    current: CurrentLattice
    speed: float


def mean_current(task: Task) -> MeanCurrent:
    """Return the mean current and speed of a mission's dives and drifts, over its largest duration."""
    flow, angle = task.flow, task.shallowest_angle
    drift_share = task.settings.surface_time / task.leg_time()
    times, latent = task.currents_through()
    shares = shares_of_levels(flow, task.settings.depth, drift_share)
    along = float(task.vehicle.speeds(np, angle)[0])
    return MeanCurrent(
        current_lattice(flow, latent, times, spacing_over(flow), shares),
        (1.0 - drift_share) * along,
    )


def passage(
    task: Task, mean: MeanCurrent, depth: float | None = None, margin: float | None = None
) -> Passage:
    """Return the fastest route along all goals, or to the closest approach to the first out of reach.

    Args:
        task: Mission.
        mean: Mean current and speed.
        depth: Required water depth [m]; None for the dive depth of the settings.
        margin: Margin to forbidden areas [m]; None for that of the settings.
    """
    wanted = task.settings.depth if depth is None else depth
    apart = task.settings.margin if margin is None else margin
    obstacles = obstacles_of(task.solid(wanted), apart, task.places)
    sea = sea_of(mean.current, mean.speed, task.places, obstacles)
    first, now, last = mean.current.places.size, 0.0, task.longest
    points, times, passed = [task.start[None, :2]], [np.zeros(1)], list[float]()
    for k in range(1, task.places.size):
        front = spread(sea, np.array([first + k - 1]), np.array([now]), last, np.array([first + k]))
        arrives = bool(np.isfinite(front.times[first + k]))
        number = first + k if arrives else front.nearest_to(complex(task.places[k]))
        route = relax(sea, front.route_to(number, now, arrives), now)
        points.append(route.points[1:])
        times.append(now + route.times[1:])
        now += float(route.times[-1])
        passed.append(now)
        if not arrives:
            passed += [now] * (task.places.size - 1 - k)
            break
    return Passage(Route(np.concatenate(points), np.concatenate(times), arrives), np.array(passed))


def wider(task: Task, mean: MeanCurrent, quickest: Passage) -> Passage | None:
    """Return the passage with the widest margin at little extra time; None if the fastest is clear of areas, land and shallows."""
    line = shapely.linestrings(quickest.route.points)
    solid = [ring for ring in task.solid(task.settings.depth) if not ring.outside]
    if not any(bool(shapely.dwithin(ring.area, line, _WIDER[0])) for ring in solid):
        return None
    for margin in _WIDER:
        if margin > task.settings.margin:
            found = passage(task, mean, margin=margin)
            if found.route.arrives and found.passed[-1] <= (1.0 + _MAY_COST) * quickest.passed[-1]:
                return found
    return None
