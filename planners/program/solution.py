"""Simulated flight of a solution: what it misses and violates."""

from dataclasses import dataclass
from math import inf

import numpy as np
from numpy.typing import NDArray

from planners.clearance import Violation, check
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


def again(found: Solution) -> Solution:
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
    flight = joined(path, task.start_time)
    return judged(task, found.start, legs, flight, found.goal_legs, found.solved)


def judged(
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
    return Solution(task, start, legs, flight, goal_legs, points, miss, check(task, flight), solved)


def joined(path: Path, start_time: float) -> Flight:
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


def staying(task: Task) -> Solution:
    """Return the mission without legs that stays at its start."""
    none, nothing = np.zeros(0), np.zeros(0, dtype=int)
    at = task.start[None, None, :2]
    flight = Flight(np.zeros((1, 1)), task.start[2:], at, np.zeros(1, dtype=int), nothing)
    legs = Legs(none, none, np.zeros((2, 0)), none)
    goals = np.zeros(len(task.goals), dtype=int)
    return Solution(task, None, legs, flight, tuple(goals.tolist()), goals, task.from_start, None)
