"""Assignment of goals to vehicles that minimises the total travel time."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planners.request import MissionRequest
from planners.route.front import sea_of, spread
from planners.route.obstacles import obstacles_of
from planners.route.passage import mean_current
from planners.simulation.currents import Flow
from planners.task import task_of
from replay_kit.core.arrays import Array
from replay_kit.core.plan import Place


def times_to_goals(
    flow: Flow, requests: Sequence[MissionRequest], goals: tuple[Place, ...]
) -> Array:
    """Return the earliest arrival of each vehicle at each goal, shape (K, G) [s since its start]; infinite if unreachable.

    A front propagates around obstacles in the mean current of the vehicle's dives and drifts.

    Args:
        flow: Current estimate, or estimates at increasing times.
        requests: Requests of the vehicles; their goals are ignored.
        goals: Goals, at least one.

    Raises:
        PlanError: A start or goal is outside the region, on land or in a forbidden area.
    """
    times = np.empty((len(requests), len(goals)))
    for k, request in enumerate(requests):
        settings = replace(request.settings, legs=None)
        task = task_of(flow, replace(request, goals=goals, settings=settings))
        mean, dives = mean_current(task), task.solid(task.settings.depth)
        sea = sea_of(
            mean.current,
            mean.speed,
            task.places,
            obstacles_of(dives, task.settings.margin, task.places),
        )
        start, nowhere = np.array([mean.current.places.size]), np.zeros(0, dtype=np.intp)
        front = spread(sea, start, np.zeros(1), task.longest, nowhere)
        times[k] = front.times[start[0] + 1 : start[0] + 1 + len(goals)]
    return times


def assign(times: Array) -> tuple[int | None, ...]:
    """Return the goal of each vehicle, or None: the most assignments, then the least total time.

    Args:
        times: Travel times, shape (K, G) [s]; infinite for goals out of reach.

    References:
        Crouse (2016), On implementing 2D rectangular assignment algorithms.
    """
    # loads slowly, and one vehicle needs none
    from scipy.optimize import linear_sum_assignment

    finite = np.isfinite(times)
    # dearer than all that can be reached together
    beyond = 1.0 + 2.0 * min(times.shape) * float(np.max(times, initial=0.0, where=finite))
    rows, columns = linear_sum_assignment(np.where(finite, times, beyond))
    found = {int(k): int(goal) for k, goal in zip(rows, columns, strict=True) if finite[k, goal]}
    return tuple(found.get(k) for k in range(len(times)))
