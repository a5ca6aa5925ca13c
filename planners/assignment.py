"""Who goes to which goal: the assignment of least total time, of the times at which a front from each vehicle reaches each goal."""

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
    """Return when each vehicle could be at each goal first, shape (K, G) [s] since its start; infinite where it cannot.

    It is the time of a front in the mean current of the vehicle's dives and drifts, round what it must keep clear of.

    Args:
        flow: The estimate, or estimates for increasing times.
        requests: Of the vehicles; their own goals do not count.
        goals: One at least.

    Raises:
        PlanError: A start or a goal is outside of the region, on land or where the mission may not go.
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
    """Return the goal of each vehicle, None for a vehicle without one: as many as can reach one, then in the least total time.

    Args:
        times: shape (K, G) [s], infinite where a vehicle cannot reach a goal.

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
