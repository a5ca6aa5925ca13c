"""One number of legs solved and flown, how attempts are ranked, and what no vehicle of their speed can do better."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planners.mission.flight.legs import Flight, Legs
from planners.mission.solve.check import Violation
from planners.mission.task import REFINED, MissionTask, YoDepths, apogee_depths
from planners.request import Found
from planners.shooting.layout import Layout
from planners.shooting.program import MissionGuess
from planners.solver import HOUR, KM
from replay_kit.core.arrays import Array

Limit = Literal["", "legs", "duration", "ways", "current"]


@dataclass(frozen=True, slots=True)
class Bound:
    """What no vehicle of a mission's speed can do better.

    Attributes:
        time: Earliest arrival within the tolerance of the last goal, all others passed [s]; infinite when it is out of reach.
        is_tight: Whether it is near to what such a vehicle can do. Where a current within reach is about as fast as the vehicle, nothing
            better is known than the straight way in the fastest current of all, and what is out of reach of the lattice may be reached.
        most: The longest time considered [s].
        goal: Number of the first goal out of reach, from 0; -1 when there is none.
        nearest: How near one can come to that goal [m].
        when: At which time [s].
        limit: What keeps it out of reach: fewer ``legs`` than the way takes; the longest ``duration``, which the way takes longer than in
            still water; the ``ways``, none of which is open; or the ``current``. Empty when none is out of reach.
    """

    time: float
    most: float
    goal: int = -1
    nearest: float = 0.0
    when: float = 0.0
    is_tight: bool = True
    limit: Limit = ""


# An attempt that violates a constraint ranks behind all that do not [m of miss distance].
_UNSAFE = 1e9


@dataclass(frozen=True, slots=True)
class GoalSteps:
    """When goals are met.

    Attributes:
        legs: In which leg, counted from 1; 0 for the start.
        steps: After which of its steps, counted from 1; 0 for its end.
    """

    legs: tuple[int, ...]
    steps: tuple[int, ...]

    def points(self, flight: Flight) -> NDArray[np.intp]:
        """Return the numbers of a flight's points at which the goals are met."""
        ends = np.concatenate([[0], flight.ends])
        legs = np.array(self.legs)
        steps = np.array(self.steps)
        return np.asarray(
            np.where(steps == 0, ends[legs], ends[np.maximum(legs - 1, 0)] + REFINED * steps)
        )


# Not slotted: depth profiles are made once, when they are first needed.
@dataclass(frozen=True, eq=False)
class LegsProblem:
    """A mission with a given number of legs.

    Attributes:
        task: The mission.
        n_legs: Number of legs.
        goals: When each goal is to be met.
    """

    task: MissionTask
    n_legs: int
    goals: GoalSteps

    @cached_property
    def yo_depths(self) -> tuple[YoDepths, ...]:
        """Depths [m] at which each leg begins, turns and ends."""
        return self.task.yo_depths(self.n_legs)

    @cached_property
    def depths(self) -> tuple[Array, ...]:
        """Depths [m] of each leg's steps."""
        return self.task.depths(self.yo_depths)

    @property
    def drifts(self) -> Array:
        """Drift time [s] after each leg."""
        return self.task.drifts(self.n_legs)

    def layout(self, n_planes: int = 0) -> Layout:
        """Return the layout of its program with so many half-planes for each place."""
        goals = tuple(
            (leg - 1, step) for leg, step in zip(self.goals.legs, self.goals.steps, strict=True)
        )
        n_places = self.depths[0].size - 1 + int(np.any(self.drifts))
        has_reference = self.task.reference_path is not None
        changing = self.task.currents.times is not None
        return Layout(self.n_legs, goals, n_places, n_planes, has_reference, changing)


@dataclass(frozen=True, slots=True, eq=False)
class Attempt:
    """One number of legs solved and flown.

    Attributes:
        legs: The commands of each leg.
        yo_depths: Depths [m] at which each leg begins, turns and ends.
        flight: Where they lead.
        goals: When each goal is met.
        miss: shape (G,) [m], miss distances as flown.
        deviation: Largest distance from the reference path and its root mean square [m]; zeros without one.
        violation: The first constraint violation; None when there is none.
        guess: The solver's solution.
        iterations: IPOPT's, over all rounds.
        return_status: IPOPT's last.
        plane_violation: Largest distance of the solution beyond a half-plane [m].
        bound: What no vehicle of the same speed can do better; None where it is not known.
        kept: Numbers of the goals that its legs lead to, from 0; None for all.
        beyond: What is known of each goal out of reach.
    """

    legs: Legs
    yo_depths: tuple[YoDepths, ...]
    flight: Flight
    goals: GoalSteps
    miss: Array
    deviation: tuple[float, float]
    violation: Violation | None
    guess: MissionGuess
    iterations: int
    return_status: str
    plane_violation: float
    bound: Bound | None = None
    kept: tuple[int, ...] | None = None
    beyond: tuple[Bound, ...] = ()

    @property
    def is_settled(self) -> bool:
        """Whether IPOPT came to an end: what it left after its last iteration may be far from an optimum."""
        return self.return_status != "Maximum_Iterations_Exceeded"


def staying(task: MissionTask) -> Attempt:
    """Return the mission without legs, which stays at its start."""
    none, no_goals = np.zeros(0), (0,) * len(task.goals)
    flight = Flight(
        np.zeros(1),
        task.start[2:],
        task.start[None, None, :2],
        np.zeros(1, dtype=int),
        np.zeros(0, dtype=int),
    )
    legs, guess = Legs(none, none, (), none), MissionGuess(np.zeros((0, 2)), none, none)
    return Attempt(
        legs,
        (),
        flight,
        GoalSteps(no_goals, no_goals),
        task.from_start,
        (0.0, 0.0),
        None,
        guess,
        0,
        "not started",
        0.0,
    )


def goals_met(task: MissionTask, attempt: Attempt) -> bool:
    """Return whether every miss distance is within the tolerance, unless it has no weight, and the track near enough to its reference."""
    indifferent = task.settings.weights.closest == 0.0
    return excess_deviation(task, attempt) == 0.0 and (
        indifferent or bool(np.all(attempt.miss <= task.settings.tolerance))
    )


def excess_deviation(task: MissionTask, attempt: Attempt) -> float:
    """Return how much farther from the reference path an attempt leads than allowed [m]."""
    return (
        0.0
        if task.reference_path is None
        else max(0.0, attempt.deviation[0] - task.reference_path.limit)
    )


#: Effort after which a mission that is feasible is left as it is, and twice that after which one that is not is given up.
ENOUGH = 2500


def effort_of(attempts: Sequence[Attempt]) -> int:
    """Return IPOPT's iterations times legs: what attempts took, the same on any machine."""
    return sum(attempt.iterations * len(attempt.legs.headings) for attempt in attempts)


def is_feasible(task: MissionTask, attempt: Attempt) -> bool:
    """Return whether an attempt violates no constraint, is in time and meets its goals, unless their miss is weighed against a cost."""
    met = task.settings.weighs_distance or goals_met(task, attempt)
    return attempt.violation is None and met and overtime(task, attempt) == 0.0


def overtime(task: MissionTask, attempt: Attempt) -> float:
    """Return how much longer than the longest mission an attempt lasts [s]; 0 beside a reference path, which has a duration of its own."""
    late = float(attempt.flight.time[-1]) - task.settings.max_duration
    return max(late, 0.0) if task.reference_path is None else 0.0


def energy_of(task: MissionTask, attempt: Attempt) -> float:
    """Return the energy of an attempt [J]."""
    return float(task.vehicle.energy(attempt.flight.time[-1], apogee_depths(attempt.yo_depths)))


def lacking_energy(task: MissionTask, attempt: Attempt) -> float:
    """Return by how much an attempt takes more energy than the battery holds [J]."""
    return max(energy_of(task, attempt) - task.settings.battery, 0.0)


def ranking_key(task: MissionTask, attempt: Attempt) -> tuple[bool, float, float]:
    """Return the key that attempts are sorted by: feasible ones that the battery allows first, by cost; the others by what is missing."""
    settings = task.settings
    duration = float(attempt.flight.time[-1])
    feasible = is_feasible(task, attempt)
    miss = (
        0.0
        if feasible and not settings.aim.distance_first
        else float(np.max(attempt.miss)) + (_UNSAFE if attempt.violation else 0.0)
    )
    miss_sum, angles = float(np.sum(attempt.miss)), attempt.legs.angles
    cost = settings.aim.cost(
        Found(task.vehicle, angles, attempt.yo_depths, duration, energy_of(task, attempt), miss_sum)
    )
    if task.reference_path is not None:
        cost += task.reference_path.weight * duration / HOUR * (attempt.deviation[1] / KM) ** 2
        miss += excess_deviation(task, attempt)
    lacking = lacking_energy(task, attempt)
    return not feasible or lacking > 0.0, miss + overtime(task, attempt) + lacking / 1e3, cost


def best_of(task: MissionTask, attempts: list[Attempt]) -> Attempt:
    """Return the attempt that ranks first."""
    return min(attempts, key=lambda attempt: ranking_key(task, attempt))


def above_bound(task: MissionTask, attempt: Attempt) -> float | None:
    """Return how much later than any vehicle of its speed could a mission arrives [%]; None where the bound does not hold or is 0."""
    bound = attempt.bound
    # shallower dives than those asked for meet another mean current
    full = attempt.yo_depths == replace(task, turns=None).yo_depths(len(attempt.yo_depths))
    if (
        bound is None
        or not bound.is_tight
        or not 0.0 < bound.time < np.inf
        or not full
        or not goals_met(task, attempt)
    ):
        return None
    last = float(attempt.flight.time[attempt.goals.points(attempt.flight)[-1]])
    return 100.0 * (last / bound.time - 1.0)
