"""Goals out of reach: how near one can come, and what keeps them there."""

from dataclasses import replace
from math import inf

import numpy as np

from planners.front.bound import Bound, Limit
from planners.front.current import CurrentLattice
from planners.front.front import Front, sea_of, spread
from planners.front.obstacles import obstacles_of
from planners.mission.task import LEAST_DIVE, MissionTask


def bound_beyond(front: Front, goal: int, place: complex, until: float) -> Bound:
    """Return how near one can come to a goal that a front does not reach in time.

    Args:
        front: From the place before it.
        goal: Its number, from 0.
        place: Where it is [m], east + i north.
        until: When the mission ends at the latest [s].
    """
    reached = replace(front, times=np.where(front.times <= until, front.times, inf))
    return Bound(inf, until, goal, *reached.approach(place, until))


def limit_of(task: MissionTask, current: CurrentLattice, speed: float, goal: int) -> Limit:
    """Return what keeps a goal out of reach of any number of legs, by the time that the way there takes in still water.

    Args:
        task: The mission.
        current: On its lattice.
        speed: Of the vehicle through water [m/s].
        goal: Number of the goal, from 0.
    """
    still = replace(current, times=np.zeros(1), values=np.zeros_like(current.values[:1]))
    obstacles = obstacles_of((*task.rings, *task.bottom.rings(LEAST_DIVE)), 0.0, task.places)
    sea, now = sea_of(still, speed, task.places[: goal + 2], obstacles), np.zeros(1)
    for number in current.places.size + np.arange(goal + 1):
        now = spread(sea, np.array([number]), now, inf, np.array([number + 1])).times[[number + 1]]
    if np.isinf(now[0]):
        return "ways"
    return "duration" if now[0] > task.settings.max_duration else "current"
