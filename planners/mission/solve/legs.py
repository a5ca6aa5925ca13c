"""One number of legs solved: its optimum flown densely, and held to half-planes when its path violates a constraint."""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from planners.mission.flight.legs import Flight, Legs, fly_legs
from planners.mission.solve.attempt import Attempt, GoalSteps, LegsProblem, ranking_key
from planners.mission.solve.check import check
from planners.mission.solve.optimum import (
    MET,
    SafetyMargin,
    following_walls,
    optimum,
    standing_walls,
    with_margin,
)
from planners.mission.task import REFINED, MissionTask, refine_steps, turns_of
from planners.route.current import Route
from planners.shooting.layout import FrameMap
from planners.shooting.program import MissionGuess, MissionSolution
from planners.shooting.schedule import DRIFT_STEPS, schedule_of
from planners.shooting.stream import stream_of
from planners.shooting.together import fly_together
from planners.simulation.currents import Currents
from planners.vehicle import Glider
from replay_kit.core.arrays import Array
from replay_kit.core.grid import Projection
from replay_kit.core.progress import announce

# Rounds in which half-planes are placed anew around the path found.
_ROUNDS = 6
# No further rounds after so many iterations times legs: more of them do not help a mission without a solution.
_EFFORT = 1500
# Rounds with a safety margin: it is known only roughly.
_ROUNDS_WITH_MARGIN = 3
# New half-planes must lower the cost by this share.
_PROGRESS = 1e-3
# A path beyond its half-planes by more than this does not come within them in further rounds without gain [m].
_HELD = 5.0
# Half-planes placed around leg ends that moved by less than this [m] would be the same.
_SAME = 1.0
# Legs that miss by so many tolerances where time counts do not come within one where only the miss distance does.
_FAR_OFF = 2.0


def solve_legs(
    task: MissionTask,
    guess: MissionGuess,
    goals: GoalSteps,
    route: Route | None,
    *,
    fewer: bool = False,
) -> Attempt:
    """Return the optimum of a number of legs that IPOPT finds from a guess, held to half-planes if its path violates a constraint.

    Args:
        task: The problem.
        guess: Where to begin.
        goals: When each goal is to be met.
        route: The route that the guess follows, along which the first half-planes are placed; None for the rest of an earlier plan, which
            is nearly optimal.
        fewer: Whether more legs are known to meet the goals: an attempt that misses them by far is then not refined.
    """
    n_legs, settings = len(guess.headings), task.settings
    problem = LegsProblem(task, n_legs, goals)
    # where the miss distance is weighed against other costs, a goal that is not met is no failure
    closest = settings.aim.distance_first
    weighed = settings.weighs_distance or task.reference_path is not None
    unreachable = route is not None and not route.arrives and not weighed
    solution = optimum(problem, guess, closest=closest or unreachable, warm_start=route is None)
    best = _fly(problem, solution, 0)
    if unreachable and not closest:
        # the front has no route: time counts only if these legs arrive all the same
        closest = bool(np.any(best.miss > settings.tolerance))
        if not closest:
            solution = optimum(problem, solution.guess)
            best = _fly(problem, solution, best.iterations)
    if not closest and not weighed and np.any(best.miss > MET):
        if fewer and np.any(best.miss > _FAR_OFF * settings.tolerance):
            return best
        # the goal is out of reach: from here the miss distance alone counts, not the balance of the penalties
        solution = optimum(problem, solution.guess, closest=True)
        best = _fly(problem, solution, best.iterations)
        closest = True
    return (
        best
        if best.violation is None
        else _solve_within_half_planes(
            problem, best, guess, _points_along(problem, guess, route), closest
        )
    )


def fly_guess(problem: LegsProblem, guess: MissionGuess) -> Attempt:
    """Return a guess flown as it is."""
    return _fly(problem, MissionSolution(guess, 0.0, np.inf, 0, "not solved", None), 0)


def solve_with_margin(task: MissionTask, before: Attempt, margin: SafetyMargin) -> Attempt:
    """Return the optimum that keeps a safety margin, found from an attempt without it."""
    task = replace(task, turns=turns_of(before.yo_depths))
    problem = LegsProblem(task, len(before.guess.headings), before.goals)
    at = before.guess
    best = None
    iterations = 0
    missed = not task.settings.weighs_distance and bool(
        np.any(before.miss > task.settings.tolerance)
    )
    closest = missed or task.settings.aim.distance_first
    for _ in range(_ROUNDS_WITH_MARGIN):
        solution = optimum(
            problem,
            at,
            with_margin(standing_walls(problem, _points_along(problem, at)), margin),
            closest=closest,
            warm_start=best is not None,
        )
        iterations += solution.iterations
        if best is not None and solution.objective > best.objective - _PROGRESS * abs(
            best.objective
        ):
            break
        best, at = solution, solution.guess
    assert best is not None
    return _fly(problem, best, iterations - best.iterations)


def _solve_within_half_planes(
    problem: LegsProblem, free: Attempt, guess: MissionGuess, path: Array, closest: bool
) -> Attempt:
    """Return the best path found within half-planes: along a path, then following the places until other obstacles bring no more gain."""
    task, best, at, before, iterations = problem.task, free, guess, np.inf, free.iterations
    for again in range(_ROUNDS):
        announce(f"planning: {problem.n_legs} legs, round {again + 1} along obstacles")
        solution = optimum(
            problem,
            at,
            (following_walls if again else standing_walls)(problem, path),
            closest=closest,
            warm_start=again > 0,
        )
        flown = _fly(problem, solution, iterations)
        iterations = flown.iterations
        better = flown.violation is None and (
            best.violation is not None or ranking_key(task, flown) < ranking_key(task, best)
        )
        best = flown if better or best is free else best
        gained = not np.isfinite(before) or solution.objective < before - _PROGRESS * abs(before)
        moved = float(np.max(np.abs(solution.guess.places - at.places)))
        spent = (iterations - free.iterations) * problem.n_legs >= _EFFORT
        held = best.violation is None or solution.plane_violation > _HELD
        if moved < _SAME or spent or (held and not gained):
            break
        at, before = solution.guess, solution.objective
        assert solution.places is not None, "what was solved has places"
        path = solution.places
    return replace(best, iterations=iterations)


def _points_along(problem: LegsProblem, guess: MissionGuess, route: Route | None = None) -> Array:
    """Return where each step of a guess ends, shape (L, n_places, 2) [m]: along its route, or straight from leg to leg without one."""
    n_places, n_legs = problem.layout().n_places, problem.n_legs
    share = np.arange(1, n_places + 1) / n_places
    if route is not None:
        times = route.times[-1] * (np.arange(n_legs)[:, None] + share) / n_legs
        return route.at(times.ravel()).reshape(n_legs, n_places, 2)
    begins = np.vstack([problem.task.start[None, :2], guess.places[:-1]])
    return begins[:, None] + share[:, None] * (guess.places - begins)[:, None]


def _fly(problem: LegsProblem, solution: MissionSolution, iterations: int) -> Attempt:
    """Return a solution flown densely and checked, after so many iterations of earlier solves."""
    task, goals, guess = problem.task, problem.goals, solution.guess
    legs = Legs(
        guess.headings,
        guess.angles,
        tuple(refine_steps(steps, REFINED) for steps in problem.depths),
        problem.drifts,
    )
    flight = fly_solution(
        task.currents, task.vehicle, task.start[:2], legs, task.start_time, solution
    )
    miss = np.linalg.norm(flight.place[0, goals.points(flight)] - task.goals[:, :2], axis=1)
    reference = task.reference_path
    deviation = (
        (0.0, 0.0)
        if reference is None
        else reference.farthest_and_rms(flight.time, flight.place[0], flight.ends)
    )
    total = iterations + solution.iterations
    violation, status = check(task, flight), solution.return_status
    return Attempt(
        legs,
        problem.yo_depths,
        flight,
        goals,
        miss,
        deviation,
        violation,
        guess,
        total,
        status,
        solution.plane_violation,
    )


def fly_solution(
    currents: Currents,
    vehicle: Glider,
    start: Array,
    legs: Legs,
    start_time: float,
    solution: MissionSolution,
) -> Flight:
    """Return the flight of the legs of a solution, as ``fly_legs`` does to a thousandth of a millimetre.

    Args:
        currents: One flow.
        vehicle: The glider.
        start: shape (2,) [m].
        legs: Its commands.
        start_time: On the clock of the currents' times [s].
        solution: Where its legs begin and end.
    """
    flow, adrift, guess = currents.flow, bool(np.any(legs.drifts)), solution.guess
    schedule = schedule_of(
        legs.depths, legs.drifts, adrift, flow.levels, flow.depth_functions, currents.times
    )
    begins = np.column_stack([np.vstack([start, guess.places[:-1]]), legs.headings, legs.angles])
    frames = _frames(flow.grid.projection, vehicle, len(begins))
    flown = fly_together(
        stream_of(flow, currents.latent[0]),
        schedule,
        frames,
        (begins, start_time),
        solution.through,
    )
    if flown is None:
        return fly_legs(currents, vehicle, start, legs, start_time)
    places, times = flown
    # each leg but the first begins where and when the one before it ends; one without a drift has no steps adrift
    kept = np.full(places.shape[:2], True)
    kept[1:, 0] = False
    kept[legs.drifts <= 0.0, schedule.n_wet + 1 :] = False
    depths = np.concatenate(
        [np.array(legs.depths), np.zeros((len(begins), DRIFT_STEPS * int(adrift)))], axis=1
    )
    number = np.broadcast_to(np.arange(len(begins))[:, None], kept.shape)
    return Flight(
        times[kept] - start_time,
        depths[kept],
        places[kept][None],
        number[kept],
        np.cumsum(kept.sum(axis=1)) - 1,
    )


@lru_cache(maxsize=64)
def _frames(projection: Projection, vehicle: Glider, count: int) -> FrameMap:
    return FrameMap(projection, vehicle, count)
