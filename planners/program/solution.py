"""Simulated flight of a solution: what it misses and violates, and which of two solutions is the better."""

from dataclasses import dataclass
from math import inf

import numpy as np
from numpy.typing import NDArray

from planners.clearance import Violation, first_violation
from planners.program.graph import HOUR, KM
from planners.request import Found, Line, Mooring
from planners.simulation.fly import COARSE, Flight, Legs, Path, fly_leg
from planners.task import Task, apogee_depths, yo_depths
from replay_kit.core.arrays import Array

# Passes in which legs are flown one after the other at most, and how far no end may move in the last [m].
_PASSES, _STILL = 20, 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Initial guess of a mission.

    Attributes:
        name: Name in the statistics.
        lines: Route divided into legs, shape (L, n, 2) [m].
        angles: Glide angles, shape (L,) [rad]; the duration [h] for a glide.
        depths: Dive depth of each leg, shape (L,) [m]; the leg stays in water deep enough for it.
        goal_legs: Leg in which each goal is met, from 1.
        defect: Defects of an earlier solution, shape (2, N) [km]; None without.
    """

    name: str
    lines: Array
    angles: Array
    depths: Array
    goal_legs: tuple[int, ...]
    defect: Array | None = None


@dataclass(frozen=True, slots=True)
class Solved:
    """How a mission was solved.

    Attributes:
        clearance: Clearance from nearby constraints [m].
        iterations: Number of IPOPT iterations.
        status: Last status of IPOPT.
        steps: Number of integration steps per dive or climb.
    """

    clearance: float = inf
    iterations: int = 0
    status: str = ""
    steps: int = COARSE


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Solution of a mission: legs and their simulated flight.

    Attributes:
        task: Mission, at the optimised speed.
        start: Initial guess; None if nothing was solved.
        legs: Commands.
        flight: Simulated flight.
        goal_legs: Leg in which each goal is met, from 1; 0 for the start.
        points: Point of the flight at which each goal is met, shape (G,).
        miss: Miss distance of each goal, shape (G,) [m].
        violation: First constraint violation, or None.
        solved: How it was solved.
    """

    task: Task
    start: Start | None
    legs: Legs
    flight: Flight
    goal_legs: tuple[int, ...]
    points: NDArray[np.intp]
    miss: Array
    violation: Violation | None
    solved: Solved = Solved()

    @property
    def seconds(self) -> float:
        """Duration [s]."""
        return float(self.flight.time[0, -1])

    @property
    def count(self) -> int:
        """Number of legs."""
        return len(self.legs.headings)

    @property
    def energy(self) -> float:
        """Energy [J]."""
        apogees = apogee_depths(yo_depths(self.legs.turns)) if self.count else 0.0
        return float(self.task.vehicle.energy(self.seconds, apogees, self.legs.drifts.sum()))


def flown_again(found: Solution) -> Solution:
    """Return a solution with its legs simulated in sequence.

    A fixed-point iteration over all legs at once, each from the previous one's last end. It contracts by the change of the current over a
    leg's error.
    """
    task, legs, ends = found.task, found.legs, found.flight.place[0, found.flight.ends]
    down = np.broadcast_to(task.vehicle.speeds(np, legs.angles)[1], ends.shape[:1])
    lasts = np.sum(np.abs(np.diff(legs.turns, axis=0)), axis=0) / down + legs.drifts
    times = task.start_time + np.append(0.0, np.cumsum(lasts)[:-1])
    parts, stops = found.solved.steps, task.goals[:, 2]
    for _ in range(_PASSES):
        begins = np.vstack([task.start[None, :2], ends[:-1]])
        path = fly_leg(task.currents, task.vehicle, (begins, times), legs, parts, stops)
        before, ends = ends, task.start[:2] + np.cumsum(path.places[-1] - begins, axis=0)
        if np.max(np.abs(ends - before)) < _STILL:
            break
    flight = joined_flight(path, task.start_time)
    return judged_solution(task, found.start, legs, flight, found.goal_legs, found.solved)


def judged_solution(
    task: Task,
    start: Start | None,
    legs: Legs,
    flight: Flight,
    goal_legs: tuple[int, ...],
    solved: Solved,
) -> Solution:
    """Return the solution of a simulated flight: miss distances, at a leg's end or at the goal's depth, and violations."""
    ends = np.concatenate([[0], flight.ends])
    points = ends[np.array(goal_legs)]
    for j, leg in enumerate(goal_legs[:-1]):
        if task.goals[j, 2] > 0.0 and leg > 0:
            inside = np.arange(ends[leg - 1], ends[leg] + 1)
            close = inside[np.abs(flight.depth[inside] - task.goals[j, 2]) < 1e-6]
            away = np.linalg.norm(flight.place[0, close] - task.goals[j, :2], axis=1)
            points[j] = close[np.argmin(away)]
    miss = np.linalg.norm(flight.place[0, points] - task.goals[:, :2], axis=1)
    return Solution(
        task, start, legs, flight, goal_legs, points, miss, first_violation(task, flight), solved
    )


def joined_flight(path: Path, start_time: float) -> Flight:
    """Return simultaneously simulated legs as one flight, with small gaps between them."""
    count, legs = path.times.shape
    keep = np.ones((count, legs), dtype=bool)
    keep[1:] = np.diff(path.times, axis=0) > 0.0
    keep[0, 1:] = False
    numbers = np.broadcast_to(np.arange(legs), (count, legs)).T[keep.T]
    flat = [values.T[keep.T] for values in (path.times - start_time, path.depths)]
    places = path.places.transpose(1, 0, 2)[keep.T]
    ends = np.cumsum(np.bincount(numbers, minlength=legs)) - 1
    return Flight(flat[0][None], flat[1], np.asarray(places)[None], np.asarray(numbers), ends)


def staying_mission(task: Task) -> Solution:
    """Return the mission without legs that stays at its start."""
    none, nothing = np.zeros(0), np.zeros(0, dtype=int)
    at = task.start[None, None, :2]
    flight = Flight(np.zeros((1, 1)), task.start[2:], at, np.zeros(1, dtype=int), nothing)
    legs = Legs(none, none, np.zeros((2, 0)), none)
    goals = np.zeros(len(task.goals), dtype=int)
    return Solution(task, None, legs, flight, tuple(goals.tolist()), goals, task.from_start, None)


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
    feasible = is_feasible(task, found)
    aim = task.settings.aim
    lacking = lacking_energy(task, found)
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
