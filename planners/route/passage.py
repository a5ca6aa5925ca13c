"""The mean current of a mission's dives, and routes past its goals in it."""

from dataclasses import dataclass
from itertools import pairwise

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
from planners.route.rays import ray_to
from planners.route.relax import relax
from planners.task import Task
from replay_kit.core.arrays import Array

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
class MeanCurrent:
    """What a mission's vehicle meets in the mean over a leg.

    Attributes:
        current: Since the start of the mission.
        speed: Horizontal, through water, in the mean of dives and drifts [m/s].
    """

    current: CurrentLattice
    speed: float


def mean_current(task: Task, finer: float = 1.0) -> MeanCurrent:
    """Return the mean current of a mission's dives and drifts, over the times that it may last, and its speed in it.

    Args:
        task: The problem.
        finer: How many times more lines than usual the lattice has.
    """
    flow, angle = task.flow, task.shallowest_angle
    drift_share = task.settings.surface_time / task.leg_time()
    times, latent = task.currents_through()
    shares = shares_of_levels(flow, task.settings.depth, drift_share)
    along = float(task.vehicle.speeds(np, angle)[0])
    return MeanCurrent(
        current_lattice(flow, latent, times, spacing_over(flow, finer), shares),
        (1.0 - drift_share) * along,
    )


def passage(
    task: Task, mean: MeanCurrent, depth: float | None = None, margin: float | None = None
) -> Passage:
    """Return the quickest route past all goals, or as near as it comes to the first that is out of reach.

    Args:
        task: The problem.
        mean: What the vehicle meets.
        depth: Of the water that it needs [m]; None for that of the settings.
        margin: Distance kept from what is forbidden [m]; None for that of the settings.
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


def is_beside(task: Task, way: Passage) -> bool:
    """Return whether a passage leads beside an area, land or shallows, so that a wider one may differ from it."""
    line = shapely.linestrings(way.route.points)
    solid = [ring for ring in task.solid(task.settings.depth) if not ring.outside]
    return any(bool(shapely.dwithin(ring.area, line, _WIDER[0])) for ring in solid)


def wider(task: Task, mean: MeanCurrent, quickest: Passage) -> Passage | None:
    """Return the passage farthest from what it keeps clear of that takes little longer; None where the quickest is clear of all."""
    if not is_beside(task, quickest):
        return None
    for margin in _WIDER:
        if margin > task.settings.margin:
            found = passage(task, mean, margin=margin)
            if found.route.arrives and found.passed[-1] <= (1.0 + _MAY_COST) * quickest.passed[-1]:
                return found
    return None


def by_rays(task: Task, mean: MeanCurrent) -> Passage | None:
    """Return the passage of rays past all goals, for a current that may be faster than the vehicle; None where they do not arrive."""
    obstacles = obstacles_of(task.solid(task.settings.depth), task.settings.margin, task.places)
    points, times, passed = [task.start[None, :2]], [np.zeros(1)], [0.0]
    for begin, end in pairwise(task.places.tolist()):
        now, until = passed[-1], task.longest
        found = ray_to(mean.current, mean.speed, (begin, end), (now, until), obstacles)
        if found is None:
            return None
        points.append(found.points[1:])
        times.append(now + found.times[1:])
        passed.append(now + float(found.times[-1]))
    return Passage(Route(np.concatenate(points), np.concatenate(times), True), np.array(passed[1:]))
