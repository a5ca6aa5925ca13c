"""One number of legs solved: from a guess by IPOPT, flown densely, held to half-planes when its path goes where it may not."""

from dataclasses import dataclass, replace

import numpy as np

from planners.flight import Flight, Legs, fly_legs, refined
from planners.front import Route
from planners.hazards import half_planes
from planners.mission_check import Finding, check
from planners.mission_program import KM, MissionAnswer, MissionData, MissionGuess, MissionShape, solve_mission
from planners.mission_task import REFINED, MissionTask
from planners.spread import Spread
from replay_kit.types import Array

# Hours that a kilometre missed costs: more than any current takes to carry a glider over it.
_PENALTY = 50.0
# Weights (of an hour, of a squared kilometre missed) of a mission that only comes close: time decides among equals.
_CLOSEST = 1e-5, 1.0
# Rounds of half-planes laid anew for the path found, and half-planes for each of its points.
_ROUNDS, _PLANES = 6, 3
# No more rounds after so many of the solver's iterations times legs: a minute of them makes a hopeless mission no better.
_EFFORT = 1500
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


@dataclass(frozen=True, slots=True, eq=False)
class Attempt:
    """One number of legs solved and flown.

    Attributes:
        legs: What the glider is told.
        flight: Where that leads.
        goal_legs: After which leg each goal is met, counted from 1.
        miss: shape (G,) [m], flown.
        finding: The first place where it may not be; None when there is none.
        guess: The solver's point.
        iterations: IPOPT's, over all rounds.
        return_status: IPOPT's last.
        trespass: Of the solver's point, beyond the worst half-plane [m].
    """

    legs: Legs
    flight: Flight
    goal_legs: tuple[int, ...]
    miss: Array
    finding: Finding | None
    guess: MissionGuess
    iterations: int
    return_status: str
    trespass: float


def solve_legs(task: MissionTask, guess: MissionGuess, goal_legs: tuple[int, ...], route: Route | None, *, fewer: bool = False) -> Attempt:
    """Return the optimum of a number of legs that IPOPT finds from a guess, held to half-planes if its path trespasses without.

    Args:
        task: The problem.
        guess: Where to begin.
        goal_legs: After which leg each goal is to be met, counted from 1.
        route: What the guess was made of, along which the first half-planes are laid; None for what is left of an earlier plan, which is
            nearly optimal.
        fewer: Whether more legs are known to lead there: then it is of no use how near these come, or how clear they keep.
    """
    turns, nearly_optimal = task.turns(len(guess.headings)), route is None
    closest = task.settings.objective == "closest"
    hopeless = route is not None and not route.arrives
    found = _solve(task, guess, turns, goal_legs, None, closest or hopeless, nearly_optimal)
    best = _flown(task, found, turns, goal_legs, found.iterations)
    if hopeless and not closest:
        # the graph knows no way: only if these legs come there all the same does time count
        closest = bool(np.any(best.miss > task.settings.tolerance))
        if not closest:
            found = _solve(task, found.guess, turns, goal_legs, None, False)
            best = _flown(task, found, turns, goal_legs, best.iterations + found.iterations)
    if not closest and np.any(best.miss > _MET):
        if fewer and np.any(best.miss > _FAR_OFF * task.settings.tolerance):
            return best
        # the goal is out of reach: from here as close to it as can be, not as the penalties would weigh it
        found = _solve(task, found.guess, turns, goal_legs, None, True)
        best = _flown(task, found, turns, goal_legs, best.iterations + found.iterations)
        closest = True
    if best.finding is None:
        return best
    return _kept_clear(task, best, guess, turns, closest, _along(task, guess, turns, route))


def solve_clear(task: MissionTask, before: Attempt, spread: Spread) -> Attempt:
    """Return the optimum kept clear by the margins that a spread asks for, found from an attempt without them."""
    turns, at, best, iterations = task.turns(len(before.guess.headings)), before.guess, None, 0
    closest = task.settings.objective == "closest" or bool(np.any(before.miss > task.settings.tolerance))
    for _ in range(_ROUNDS_WIDER):
        path = _along(task, at, turns, None)
        found = _solve(task, at, turns, before.goal_legs, path, closest, best is not None, spread)
        iterations += found.iterations
        if best is not None and found.objective > best.objective - _PROGRESS * abs(best.objective):
            break
        best, at = found, found.guess
    assert best is not None
    return _flown(task, best, turns, before.goal_legs, iterations)


def _kept_clear(
    task: MissionTask,
    free: Attempt,
    guess: MissionGuess,
    turns: tuple[tuple[float, ...], ...],
    closest: bool,
    path: Array,
) -> Attempt:
    """Return the best path found within half-planes, laid along a path and anew along each path found until that gains nothing more."""
    best, at, before, iterations = free, guess, np.inf, free.iterations
    for again in range(_ROUNDS):
        found = _solve(task, at, turns, free.goal_legs, path, closest, again > 0)
        iterations += found.iterations
        flown = _flown(task, found, turns, free.goal_legs, iterations)
        better = flown.finding is None and (best.finding is not None or worth(task, flown) < worth(task, best))
        best = flown if better or best is free else best
        gained = not np.isfinite(before) or found.objective < before - _PROGRESS * abs(before)
        moved = float(np.max(np.abs(found.guess.places - at.places)))
        spent = (iterations - free.iterations) * len(turns) > _EFFORT
        if moved < _SAME or spent or (best.finding is None and not gained):
            break
        at, before = found.guess, found.objective
        path = _along(task, at, turns, None)
    return replace(best, iterations=iterations)


def _solve(
    task: MissionTask,
    guess: MissionGuess,
    turns: tuple[tuple[float, ...], ...],
    goal_legs: tuple[int, ...],
    path: Array | None,
    closest: bool,
    nearly_optimal: bool = False,
    spread: Spread | None = None,
) -> MissionAnswer:
    """Return the solver's answer; ``path``, shape (L, n_places, 2) [m], is what half-planes are laid for; a spread widens margins."""
    different = tuple(dict.fromkeys(turns))
    drifts, n_steps = task.drifts(turns), task.n_steps(turns)
    depths = dict(zip(turns, task.depths(turns), strict=True))
    profiles = tuple(different.index(leg) for leg in turns)
    shape = MissionShape(len(turns), n_steps, goal_legs, profiles, 0 if path is None else _PLANES, bool(np.any(drifts)))
    planes = np.zeros((len(turns), shape.n_places, 0, 3))
    if path is not None:
        surfacing = np.tile(np.arange(shape.n_places) >= n_steps - 1, len(turns))
        flat = half_planes(task.rings, path.reshape(-1, 2), surfacing, _PLANES, task.settings.margin)
        if spread is not None:
            flat[..., 2] -= spread.margins(flat[..., :2])
        planes = flat.reshape(len(turns), shape.n_places, _PLANES, 3)
    time_weight, miss_weight = _CLOSEST if closest else (1.0, 0.0)
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
        1e-6 if closest and path is None else _PENALTY,
        task.currents.latent[0],
    )
    return solve_mission(task.flow, task.vehicle, shape, data, guess, task.currents.times, nearly_optimal=nearly_optimal)


def _along(task: MissionTask, guess: MissionGuess, turns: tuple[tuple[float, ...], ...], route: Route | None) -> Array:
    """Return where each step of a guess ends, shape (L, n_places, 2) [m]: along its route, or straight from leg to leg without one."""
    n_places, n_legs = task.n_steps(turns) + int(np.any(task.drifts(turns))), len(turns)
    share = np.arange(1, n_places + 1) / n_places
    if route is not None:
        times = route.times[-1] * (np.arange(n_legs)[:, None] + share) / n_legs
        return route.at(times.ravel()).reshape(n_legs, n_places, 2)
    begins = np.vstack([task.start[None, :2], guess.places[:-1]])
    return np.asarray(begins[:, None] + share[:, None] * (guess.places - begins)[:, None])


def _flown(
    task: MissionTask, answer: MissionAnswer, turns: tuple[tuple[float, ...], ...], goal_legs: tuple[int, ...], iterations: int
) -> Attempt:
    depths = tuple(refined(steps, REFINED) for steps in task.depths(turns))
    legs = Legs(answer.guess.headings, answer.guess.angles, depths, task.drifts(turns))
    flight = fly_legs(task.currents, task.vehicle, task.start[:2], legs, task.start_time)
    ends = flight.place[0, flight.ends]
    miss = np.linalg.norm(ends[np.array(goal_legs) - 1] - task.goals[:, :2], axis=1)
    return Attempt(
        legs, flight, goal_legs, miss, check(task, flight), replace(answer.guess), iterations, answer.return_status, answer.trespass
    )


def safe_and_met(task: MissionTask, attempt: Attempt) -> bool:
    """Return whether an attempt meets every goal within the tolerance and goes nowhere that it may not."""
    return attempt.finding is None and bool(np.all(attempt.miss <= task.settings.tolerance))


def energy_of(task: MissionTask, attempt: Attempt) -> float:
    """Return the energy of an attempt [J]."""
    turns = task.turns(len(attempt.legs.headings))
    apogees = sum(leg[i] for leg in turns for i in range(1, len(leg) - 1) if leg[i] > leg[i - 1])
    return float(task.vehicle.energy(attempt.flight.time[-1], apogees))


def worth(task: MissionTask, attempt: Attempt) -> tuple[bool, float, float]:
    """Return what attempts are sorted by: safe and at the goal first, then the objective; others by how far they miss."""
    met = safe_and_met(task, attempt)
    missed = 0.0 if met and task.settings.objective != "closest" else float(np.max(attempt.miss)) + (1e9 if attempt.finding else 0.0)
    cost = energy_of(task, attempt) if task.settings.objective == "energy" else float(attempt.flight.time[-1])
    return not met, missed, cost
