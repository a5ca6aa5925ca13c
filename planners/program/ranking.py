"""Which of two solutions of a mission is the better: feasible ones by cost, others by what they miss."""

import numpy as np

from planners.program.solution import Solution
from planners.program.water import HOUR, KM
from planners.request import Found, Line, Mooring
from planners.task import Task, yo_depths

# Clearance that may be lacking of the margin [m].
_KEPT = 3.0
# Of missions that miss: one that violates a constraint ranks behind all that do not [m].
_UNSAFE = 1e9


def length_of(found: Solution) -> float:
    """Return the length of a solution's track over ground [m]."""
    return max(float(np.sum(np.linalg.norm(np.diff(found.flight.place[0], axis=0), axis=1))), 1.0)


def is_feasible(task: Task, found: Solution) -> bool:
    """Return whether a solution is feasible: no violation, in time, and goals met unless the miss distance has a weight."""
    met = task.settings.weighs_distance or arrives(task, found)
    return found.violation is None and met and overtime(task, found) == 0.0


def arrives(task: Task, found: Solution) -> bool:
    """Return whether all goals are met within the tolerance and the track within the width of its line or mooring."""
    if isinstance(task.shape, Mooring):
        return deviation(task, found)[0] <= task.shape.radius
    near = task.shape is None or deviation(task, found)[0] <= task.shape.width
    return near and bool(np.all(found.miss <= task.settings.tolerance))


def deviation(task: Task, found: Solution) -> tuple[float, float]:
    """Return the largest and the RMS distance from the line or mooring [m]; zeros without one."""
    flight, goal = found.flight, task.goals[-1, :2]
    off = flight.place[0] - goal
    if isinstance(task.shape, Line):
        way = goal - task.line_begin
        away = np.abs(off @ np.array([-way[1], way[0]])) / float(np.linalg.norm(way))
    elif isinstance(task.shape, Mooring):
        away = np.linalg.norm(off, axis=1)
    else:
        return 0.0, 0.0
    lasts = np.diff(flight.time[0])
    mean = float(np.sum(0.5 * (away[1:] ** 2 + away[:-1] ** 2) * lasts)) / max(found.seconds, 1.0)
    if isinstance(task.shape, Mooring) and task.shape.surfacings_only:
        away = away[flight.ends]
        mean = float(np.mean(away**2))
    return float(np.max(away)), float(np.sqrt(mean))


def overtime(task: Task, found: Solution) -> float:
    """Return the excess over the largest duration [s]; 0 for a mooring."""
    late = found.seconds - task.settings.max_duration
    return 0.0 if isinstance(task.shape, Mooring) else max(late, 0.0)


def lacking_energy(task: Task, found: Solution) -> float:
    """Return the energy in excess of the battery [J]."""
    return max(found.energy - task.settings.battery, 0.0)


def ranking(task: Task, found: Solution) -> tuple[bool, float, float]:
    """Return the sort key of solutions: feasible ones within the battery by cost, then others by their deficit."""
    feasible, aim, lacking = (
        is_feasible(task, found),
        task.settings.aim,
        lacking_energy(task, found),
    )
    missing = overtime(task, found) + lacking / 1e3
    if not feasible or aim.distance_first:
        missing += float(np.max(found.miss)) + _UNSAFE * (found.violation is not None)
    # the margin is kept first
    missing += float(found.solved.clearance < task.settings.margin - _KEPT)
    depths, miss = yo_depths(found.legs.turns), float(np.sum(found.miss))
    one = Found(task.vehicle, found.legs.angles, depths, found.seconds, found.energy, miss)
    cost = aim.cost(one)
    if isinstance(task.shape, Line):
        cost += task.shape.weight * found.seconds / HOUR * (deviation(task, found)[1] / KM) ** 2
    elif isinstance(task.shape, Mooring):
        cost = deviation(task, found)[1]
    return not feasible or lacking > 0.0, missing, cost
