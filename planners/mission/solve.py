"""One number of legs solved: from a guess by IPOPT, flown densely, held to half-planes when its path goes where it may not."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planners.mission.check import Finding, check
from planners.mission.flight import Flight, Legs, fly_legs, refined
from planners.mission.program import MissionAnswer, MissionData, MissionGuess, MissionShape, solve_mission
from planners.mission.safety_margin import Spread
from planners.mission.task import REFINED, MissionTask
from planners.route.graph import Route
from planners.route.hazards import half_planes
from planners.solver import HOUR, KM, MOST_ITERATIONS
from replay_kit.core.arrays import Array

# Hours that a kilometre missed costs: more than any current takes to carry a glider over it.
_PENALTY = 50.0
# So many times that at the end of a line: being off it for long would cost more than missing its end.
_END_OF_LINE = 40.0
# Weights (of an hour, of a squared kilometre missed) of a mission that only comes close: time decides among equals.
_CLOSEST = 1e-5, 1.0
# Rounds of half-planes laid anew for the path found, and half-planes for each of its points.
_ROUNDS, _PLANES = 6, 3
# No more rounds after so many of the solver's iterations times legs: a minute of them makes a hopeless mission no better.
_EFFORT = 1500
# The same, for each solve too, but so many iterations at least, where not even a faster vehicle would arrive.
_EFFORT_BRIEF, _LEAST_ITERATIONS = 900, 20
# Rounds where margins are wide: what they are made for is known roughly.
_ROUNDS_WIDER = 3
# Half-planes laid anew have to lower the cost by this share.
_PROGRESS = 1e-3
# Half-planes laid anew for ends that moved by less than this [m] would be the same.
_SAME = 1.0
# Legs that miss by so many tolerances where time counts do not come within one where only the miss does.
_FAR_OFF = 2.0
# A goal met this well is met [m].
_MET = 5.0
# Farther than any region is wide [m].
_FAR = 1e6


@dataclass(frozen=True, slots=True)
class GoalSteps:
    """When goals are met.

    Attributes:
        legs: In which leg, counted from 1.
        steps: After which of its steps, counted from 1; 0 for its end.
    """

    legs: tuple[int, ...]
    steps: tuple[int, ...]

    def points(self, flight: Flight) -> NDArray[np.intp]:
        """Return the numbers of a flight's points at which the goals are met."""
        begins, legs = np.concatenate([[0], flight.ends[:-1]]), np.array(self.legs) - 1
        return np.asarray(np.where(np.array(self.steps) == 0, flight.ends[legs], begins[legs] + REFINED * np.array(self.steps)))


@dataclass(frozen=True, slots=True, eq=False)
class Attempt:
    """One number of legs solved and flown.

    Attributes:
        legs: What the glider is told.
        flight: Where that leads.
        goals: When each goal is met.
        miss: shape (G,) [m], flown.
        away: Farthest distance from what it is to stay near, and its root mean square [m]; zeros when that is nothing.
        finding: The first place where it may not be; None when there is none.
        guess: The solver's point.
        iterations: IPOPT's, over all rounds.
        return_status: IPOPT's last.
        trespass: Of the solver's point, beyond the worst half-plane [m].
    """

    legs: Legs
    flight: Flight
    goals: GoalSteps
    miss: Array
    away: tuple[float, float]
    finding: Finding | None
    guess: MissionGuess
    iterations: int
    return_status: str
    trespass: float


def solve_legs(
    task: MissionTask, guess: MissionGuess, goals: GoalSteps, route: Route | None, *, fewer: bool = False, brief: bool = False
) -> Attempt:
    """Return the optimum of a number of legs that IPOPT finds from a guess, held to half-planes if its path trespasses without.

    Args:
        task: The problem.
        guess: Where to begin.
        goals: When each goal is to be met.
        route: What the guess was made of, along which the first half-planes are laid; None for what is left of an earlier plan, which is
            nearly optimal.
        fewer: Whether more legs are known to lead there: then it is of no use how near these come, or how clear they keep.
        brief: Whether the goals are known to be out of reach: then it is of no use how close to them these come in the end.
    """
    turns, nearly_optimal = task.turns(len(guess.headings)), route is None
    # where distance is weighed against other things, a goal that is not met is no failure
    closest, weighed = task.settings.objective == "closest", task.settings.weighs_distance or task.guide is not None
    hopeless = route is not None and not route.arrives and not weighed
    most = int(np.clip(_EFFORT_BRIEF // len(turns), _LEAST_ITERATIONS, MOST_ITERATIONS)) if brief else MOST_ITERATIONS
    found = _solve(task, guess, turns, goals, None, closest or hopeless, nearly_optimal, most=most)
    best = _flown(task, found, turns, goals, found.iterations)
    if hopeless and not closest:
        # the graph knows no way: only if these legs come there all the same does time count
        closest = bool(np.any(best.miss > task.settings.tolerance))
        if not closest:
            found = _solve(task, found.guess, turns, goals, None, False, most=most)
            best = _flown(task, found, turns, goals, best.iterations + found.iterations)
    if not closest and not weighed and np.any(best.miss > _MET):
        if fewer and np.any(best.miss > _FAR_OFF * task.settings.tolerance):
            return best
        # the goal is out of reach: from here as close to it as can be, not as the penalties would weigh it
        found = _solve(task, found.guess, turns, goals, None, True, most=most)
        best = _flown(task, found, turns, goals, best.iterations + found.iterations)
        closest = True
    if best.finding is None:
        return best
    return _kept_clear(task, best, guess, turns, closest, _along(task, guess, turns, route), most)


def solve_clear(task: MissionTask, before: Attempt, spread: Spread) -> Attempt:
    """Return the optimum kept clear by the margins that a spread asks for, found from an attempt without them."""
    turns, at, best, iterations = task.turns(len(before.guess.headings)), before.guess, None, 0
    missed = not task.settings.weighs_distance and bool(np.any(before.miss > task.settings.tolerance))
    for _ in range(_ROUNDS_WIDER):
        path = _along(task, at, turns, None)
        found = _solve(task, at, turns, before.goals, path, missed or task.settings.objective == "closest", best is not None, spread)
        iterations += found.iterations
        if best is not None and found.objective > best.objective - _PROGRESS * abs(best.objective):
            break
        best, at = found, found.guess
    assert best is not None
    return _flown(task, best, turns, before.goals, iterations)


def _kept_clear(
    task: MissionTask, free: Attempt, guess: MissionGuess, turns: tuple[tuple[float, ...], ...], closest: bool, path: Array, most: int
) -> Attempt:
    """Return the best path found within half-planes, laid along a path and anew along each path found until that gains nothing more."""
    best, at, before, iterations = free, guess, np.inf, free.iterations
    effort = _EFFORT if most == MOST_ITERATIONS else _EFFORT_BRIEF
    for again in range(_ROUNDS):
        found = _solve(task, at, turns, free.goals, path, closest, again > 0, most=most)
        iterations += found.iterations
        flown = _flown(task, found, turns, free.goals, iterations)
        better = flown.finding is None and (best.finding is not None or worth(task, flown) < worth(task, best))
        best = flown if better or best is free else best
        gained = not np.isfinite(before) or found.objective < before - _PROGRESS * abs(before)
        moved = float(np.max(np.abs(found.guess.places - at.places)))
        spent = (iterations - free.iterations) * len(turns) >= effort
        if moved < _SAME or spent or (best.finding is None and not gained):
            break
        at, before = found.guess, found.objective
        path = _along(task, at, turns, None)
    return replace(best, iterations=iterations)


def _solve(
    task: MissionTask,
    guess: MissionGuess,
    turns: tuple[tuple[float, ...], ...],
    goals: GoalSteps,
    path: Array | None,
    closest: bool,
    nearly_optimal: bool = False,
    spread: Spread | None = None,
    most: int = MOST_ITERATIONS,
) -> MissionAnswer:
    """Return the solver's answer; ``path``, shape (L, n_places, 2) [m], is what half-planes are laid for; a spread widens margins."""
    different = tuple(dict.fromkeys(turns))
    drifts, n_steps = task.drifts(turns), task.n_steps(turns)
    depths = dict(zip(turns, task.depths(turns), strict=True))
    profiles = tuple(different.index(leg) for leg in turns)
    n_planes, guided = 0 if path is None else _PLANES, task.guide is not None
    shape = MissionShape(len(turns), n_steps, goals.legs, profiles, n_planes, bool(np.any(drifts)), goals.steps, guided)
    planes = np.zeros((len(turns), shape.n_places, 0, 3))
    if path is not None:
        # between the dives of a leg the glider is at the surface, too
        passed = np.array([[*depths[leg][1:], *depths[leg][-1:].repeat(shape.n_places - n_steps)] for leg in turns])
        surfacing = (passed <= 0.0).ravel()
        flat = half_planes(task.rings, path.reshape(-1, 2), surfacing, _PLANES, task.settings.margin)
        if spread is not None:
            flat[..., 2] -= spread.margins(flat[..., :2])
        planes = flat.reshape(len(turns), shape.n_places, _PLANES, 3)
    time_weight, distance_weight, guide_weight = _weights(task)
    time_weight, miss_weight = _CLOSEST if closest else (time_weight, 0.0)
    if path is not None:
        # a kilometre nearer to a goal that is far off must not be worth a kilometre beyond a half-plane
        miss_weight /= max(float(np.max(np.linalg.norm(task.goals[:, :2] - task.start[:2], axis=1))) / KM, 1.0)
    data = MissionData(
        task.start[:2],
        task.start_time,
        task.goals[:, :2],
        tuple(depths[leg] for leg in different),
        drifts,
        planes,
        time_weight,
        miss_weight,
        1e-6 if closest and path is None else _PENALTY * (_END_OF_LINE if guided and distance_weight is None else 1.0),
        task.currents.latent[0],
        None if closest else distance_weight,
        task.guide,
        *_guide_places(task, guess.angles, shape, [depths[leg] for leg in turns], guide_weight),
        spline=task.spline,
    )
    return solve_mission(task.flow, task.vehicle, shape, data, guess, task.currents.times, nearly_optimal=nearly_optimal, most=most)


def _weights(task: MissionTask) -> tuple[float, float | None, float]:
    """Return the weights of an hour, of a kilometre missed and of an hour a kilometre off the guide, the largest of them 1."""
    weights = task.settings.weights
    hourly = weights.time + weights.energy * task.vehicle.hotel * HOUR / 1e3
    guide = 0.0 if task.guide is None else task.guide.weight
    largest = max(hourly, weights.closest or 0.0, guide)
    return hourly / largest, None if weights.closest is None else weights.closest / largest, guide / largest


def _guide_places(task: MissionTask, angles: Array, shape: MissionShape, depths: list[Array], weight: float) -> tuple[Array, Array]:
    """Return what a squared kilometre between the guide and each place costs, and how far from it each may be [m]: (L, n_places) each."""
    if task.guide is None:
        return np.zeros((0, 0)), np.zeros((0, 0))
    hours = np.zeros((shape.n_legs, shape.n_places))
    hours[:, : shape.n_steps] = [
        np.abs(np.diff(steps)) / float(task.vehicle.speeds(np, angle)[1]) / HOUR for steps, angle in zip(depths, angles, strict=True)
    ]
    if shape.drifts:
        hours[:-1, -1] = task.settings.surface_time / HOUR
    # the optimiser's steps are coarser than those of the check
    limit = min(max(task.guide.limit - task.settings.margin, 0.5 * task.guide.limit), _FAR)
    limits = np.full(hours.shape, limit)
    if task.guide.surfacings_only:
        hours[:, -1] = hours.sum(axis=1)
        hours[:, :-1], limits[:, :-1] = 0.0, _FAR
    return weight * hours, limits


def _along(task: MissionTask, guess: MissionGuess, turns: tuple[tuple[float, ...], ...], route: Route | None) -> Array:
    """Return where each step of a guess ends, shape (L, n_places, 2) [m]: along its route, or straight from leg to leg without one."""
    n_places, n_legs = task.n_steps(turns) + int(np.any(task.drifts(turns))), len(turns)
    share = np.arange(1, n_places + 1) / n_places
    if route is not None:
        times = route.times[-1] * (np.arange(n_legs)[:, None] + share) / n_legs
        return route.at(times.ravel()).reshape(n_legs, n_places, 2)
    begins = np.vstack([task.start[None, :2], guess.places[:-1]])
    return np.asarray(begins[:, None] + share[:, None] * (guess.places - begins)[:, None])


def _flown(task: MissionTask, answer: MissionAnswer, turns: tuple[tuple[float, ...], ...], goals: GoalSteps, iterations: int) -> Attempt:
    depths = tuple(refined(steps, REFINED) for steps in task.depths(turns))
    legs = Legs(answer.guess.headings, answer.guess.angles, depths, task.drifts(turns))
    flight = fly_legs(task.currents, task.vehicle, task.start[:2], legs, task.start_time)
    miss = np.linalg.norm(flight.place[0, goals.points(flight)] - task.goals[:, :2], axis=1)
    away = (0.0, 0.0) if task.guide is None else task.guide.farthest_and_rms(flight.time, flight.place[0], flight.ends)
    finding = check(task, flight)
    return Attempt(legs, flight, goals, miss, away, finding, answer.guess, iterations, answer.return_status, answer.trespass)


def goals_met(task: MissionTask, attempt: Attempt) -> bool:
    """Return whether an attempt meets every goal within the tolerance and strays nowhere; goals that weigh nothing count as met."""
    indifferent = task.settings.weights.closest == 0.0
    return strayed(task, attempt) == 0.0 and (indifferent or bool(np.all(attempt.miss <= task.settings.tolerance)))


def strayed(task: MissionTask, attempt: Attempt) -> float:
    """Return how much farther an attempt is than it may be from what it is to stay near [m]."""
    return 0.0 if task.guide is None else max(0.0, attempt.away[0] - task.guide.limit)


def safe_and_met(task: MissionTask, attempt: Attempt) -> bool:
    """Return whether an attempt goes nowhere that it may not and meets its goals, unless how closely is weighed against other things."""
    return attempt.finding is None and (task.settings.weighs_distance or goals_met(task, attempt))


def energy_of(task: MissionTask, attempt: Attempt) -> float:
    """Return the energy of an attempt [J]."""
    turns = task.turns(len(attempt.legs.headings))
    apogees = sum(leg[i] for leg in turns for i in range(1, len(leg) - 1) if leg[i] > leg[i - 1])
    return float(task.vehicle.energy(attempt.flight.time[-1], apogees))


def worth(task: MissionTask, attempt: Attempt) -> tuple[bool, float, float]:
    """Return what attempts are sorted by: safe and at the goal first, then the objective; others by how far they miss and stray."""
    settings, duration, met = task.settings, float(attempt.flight.time[-1]), safe_and_met(task, attempt)
    count_miss = not met or settings.objective == "closest"
    missed = float(np.max(attempt.miss)) + (1e9 if attempt.finding else 0.0) if count_miss else 0.0
    cost = settings.weights.cost(duration, energy_of(task, attempt), float(np.sum(attempt.miss)))
    if task.guide is not None:
        cost += task.guide.weight * duration / HOUR * (attempt.away[1] / KM) ** 2
        missed += strayed(task, attempt)
    return not met, missed, cost
