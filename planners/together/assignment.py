"""Who goes to which goal: the assignment of least total time, of the times at which a front from each vehicle reaches each goal."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from planners.mission.search.passage import longest_time, water_of
from planners.mission.task import mission_task
from planners.request import MissionRequest
from planners.route.front import sea_of, spread
from planners.route.obstacles import obstacles_of
from planners.simulation.currents import Flow
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
        settings = replace(request.settings, spline=0, legs=None)
        task = mission_task(flow, replace(request, goals=goals, settings=settings))
        water, dives = water_of(task), task.rings_at(task.settings.depth)
        sea = sea_of(
            water.current,
            water.speed,
            task.places,
            obstacles_of(dives, task.settings.margin, task.places),
        )
        start, nowhere = np.array([water.current.places.size]), np.zeros(0, dtype=np.intp)
        front = spread(sea, start, np.zeros(1), longest_time(task), nowhere)
        times[k] = front.times[start[0] + 1 : start[0] + 1 + len(goals)]
    return times


def assign(times: Array) -> tuple[int | None, ...]:
    """Return the goal of each vehicle, None for a vehicle without one: as many as can reach one, then in the least total time.

    Args:
        times: shape (K, G) [s], infinite where a vehicle cannot reach a goal.

    References:
        Crouse (2016), On implementing 2D rectangular assignment algorithms.
    """
    finite = np.isfinite(times)
    # dearer than all that can be reached together
    beyond = 1.0 + 2.0 * min(times.shape) * float(np.max(times, initial=0.0, where=finite))
    rows, columns = linear_sum_assignment(np.where(finite, times, beyond))
    found = {int(k): int(goal) for k, goal in zip(rows, columns, strict=True) if finite[k, goal]}
    return tuple(found.get(k) for k in range(len(times)))
