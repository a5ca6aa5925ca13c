"""One number of legs solved: by IPOPT from a guess, flown densely, and held to half-planes when its path violates a constraint."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planners.front.route import Route
from planners.mission.attempt import Attempt, GoalSteps, LegsProblem, ranking_key
from planners.mission.check import check
from planners.mission.flight import Legs, refine_steps
from planners.mission.program import (
    MissionData,
    MissionGuess,
    MissionModel,
    MissionShape,
    MissionSolution,
    solve_mission,
)
from planners.mission.safety_margin import SafetyMargin
from planners.mission.solved_flight import fly_solution
from planners.mission.task import REFINED, MissionTask, turns_of
from planners.route.hazards import NearRings, Ring, near_rings
from planners.shooting.walls import Walls
from planners.solver import HOUR, KM
from replay_kit.core.arrays import Array
from replay_kit.core.progress import announce

# Hours that a kilometre of miss distance costs: more than any current takes to carry a glider over it.
_PENALTY = 50.0
# The same penalty at the end of a line, times this: long deviations would cost more than missing the end.
_END_OF_LINE = 40.0
# Weights (of an hour, of a squared kilometre missed) when only the miss distance counts: time decides among equals.
_CLOSEST = 1e-5, 1.0
# Rounds in which half-planes are placed anew around the path found, and half-planes for each of its points.
_ROUNDS, _PLANES = 6, 3
# Between the ends of a step half-planes follow it at one of these shares in each of so many parts.
_PARTS = 3
_BETWEEN = (np.arange(18) + 0.5) / 18.0
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
# A goal met this well is met [m].
_MET = 5.0
# Farther than any region is wide [m].
_FAR = 1e6


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
    closest, weighed = (
        settings.aim.distance_first,
        settings.weighs_distance or task.reference_path is not None,
    )
    unreachable = route is not None and not route.arrives and not weighed
    solution = _solve(problem, guess, closest=closest or unreachable, warm_start=route is None)
    best = _fly(problem, solution, 0)
    if unreachable and not closest:
        # the front has no route: time counts only if these legs arrive all the same
        closest = bool(np.any(best.miss > settings.tolerance))
        if not closest:
            solution = _solve(problem, solution.guess)
            best = _fly(problem, solution, best.iterations)
    if not closest and not weighed and np.any(best.miss > _MET):
        if fewer and np.any(best.miss > _FAR_OFF * settings.tolerance):
            return best
        # the goal is out of reach: from here the miss distance alone counts, not the balance of the penalties
        solution = _solve(problem, solution.guess, closest=True)
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
    problem, at, best, iterations = (
        LegsProblem(task, len(before.guess.headings), before.goals),
        before.guess,
        None,
        0,
    )
    missed = not task.settings.weighs_distance and bool(
        np.any(before.miss > task.settings.tolerance)
    )
    closest = missed or task.settings.aim.distance_first
    for _ in range(_ROUNDS_WITH_MARGIN):
        solution = _solve(
            problem,
            at,
            _with_margin(_standing_walls(problem, _points_along(problem, at)), margin),
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
        solution = _solve(
            problem,
            at,
            (_following_walls if again else _standing_walls)(problem, path),
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


def _with_margin(walls: Walls, margin: SafetyMargin) -> Walls:
    """Return half-planes that stay, moved by a safety margin."""
    assert walls.planes is not None, "half-planes that follow the places have no safety margin"
    planes = walls.planes.reshape(-1, *walls.planes.shape[2:]).copy()
    planes[..., 2] -= margin.margins(planes[..., :2])
    return replace(walls, planes=planes.reshape(walls.planes.shape))


def _standing_walls(problem: LegsProblem, path: Array) -> Walls:
    """Return half-planes that touch the rings nearest to the places of a path, shape (L, n_places, 2) [m]."""
    at, surfaced = np.repeat(path[:, :, None], _PLANES, axis=2), _surfaced(problem, path.shape[1])
    near = _near(problem, path, surfaced, _PLANES)
    return Walls(np.ones(at.shape[:3]), near.planes(at.reshape(-1, 2))[0].reshape(*at.shape[:3], 3))


def _following_walls(problem: LegsProblem, path: Array) -> Walls:
    """Return what the places of legs keep clear of, and each third of the steps between them where it is nearest to an obstacle."""
    surfaced = _surfaced(problem, path.shape[1])
    begins = np.concatenate(
        [np.vstack([problem.task.start[None, :2], path[:-1, -1]])[:, None], path[:, :-1]], axis=1
    )
    adrift = surfaced & np.concatenate([np.full((len(path), 1), False), surfaced[:, :-1]], axis=1)
    shares = np.tile(_BETWEEN, (*path.shape[:2], 1))
    along = begins[:, :, None] + shares[..., None] * (path - begins)[:, :, None]
    near = _near(problem, along, np.repeat(adrift[..., None], shares.shape[2], axis=2), 1)
    clear = near.clearance(along.reshape(-1, 2)).reshape(*path.shape[:2], _PARTS, -1)
    worst = np.argmin(clear, axis=3)[..., None] + np.arange(_PARTS)[:, None] * clear.shape[3]
    between, which = (
        np.take_along_axis(one.reshape(shares.shape), worst[..., 0], axis=2)
        for one in (shares, near.which)
    )
    ends = _near(problem, path, surfaced, _PLANES)
    both = np.concatenate([ends.which.reshape(*path.shape[:2], -1), which], axis=2)
    return Walls(
        np.concatenate([np.ones((*path.shape[:2], _PLANES)), between], axis=2),
        obstacles=replace(ends, which=both.ravel()),
    )


def _surfaced(problem: LegsProblem, n_places: int) -> NDArray[np.bool_]:
    """Return which places of the legs are at the surface, shape (L, n_places)."""
    # between the dives of a leg the glider is there, too
    return (
        np.array(
            [
                [*steps[1:], *steps[-1:].repeat(n_places - steps.size + 1)]
                for steps in problem.depths
            ]
        )
        <= 0.0
    )


def _near(
    problem: LegsProblem, places: Array, surfaced: NDArray[np.bool_], count: int
) -> NearRings:
    """Return the rings nearest to places of each leg, shape (L, ..., 2) [m]; at the surface or not, shape (L, ...)."""
    task, rings, turns = problem.task, list[Ring](), np.array(turns_of(problem.yo_depths))
    which = np.empty((*surfaced.shape, count), dtype=np.intp)
    for turn in np.unique(turns):
        legs, there = turns == turn, task.rings_at(float(turn))
        found = near_rings(there, places[legs].reshape(-1, 2), surfaced[legs].ravel(), count)
        which[legs] = np.where(found >= 0, found + len(rings), -1).reshape(which[legs].shape)
        rings += there
    return NearRings(tuple(rings), which.ravel(), task.settings.margin)


def _solve(
    problem: LegsProblem,
    guess: MissionGuess,
    walls: Walls | None = None,
    *,
    closest: bool = False,
    warm_start: bool = False,
) -> MissionSolution:
    """Return the solver's solution; with ``closest`` only the miss distance counts."""
    task, shape = problem.task, problem.shape(0 if walls is None else walls.count)
    time_weight, distance_weight, reference_weight = _weights(task)
    time_weight, miss_weight = _CLOSEST if closest else (time_weight, 0.0)
    if walls is not None:
        # a kilometre less of a large miss distance must not pay for a kilometre beyond a half-plane
        miss_weight /= max(
            float(np.max(np.linalg.norm(task.goals[:, :2] - task.start[:2], axis=1))) / KM, 1.0
        )
    line_end = _END_OF_LINE if shape.has_reference and distance_weight is None else 1.0
    data = MissionData(
        task.start[:2],
        task.start_time,
        task.goals[:, :2],
        tuple(problem.depths[problem.yo_depths.index(profile)] for profile in problem.profiles),
        problem.drifts,
        walls,
        time_weight,
        miss_weight,
        1e-6 if closest and walls is None else _PENALTY * line_end,
        task.currents.latent[0],
        None if closest else distance_weight,
        task.reference_path,
        *_reference_weights_and_limits(task, guess.angles, shape, problem.depths, reference_weight),
    )
    model = MissionModel(task.flow, task.vehicle, shape, task.currents.times, task.spline)
    solution = solve_mission(model, data, guess, warm_start=warm_start)
    if task.spline is None:
        return solution
    # what leaves the region is held back by half-planes next, whatever the current is out there
    places = solution.guess.places
    covered = task.spline.covers(places[task.region.inside_outline(places)])
    if covered and _strays(problem, solution.guess.angles) <= _MET:
        return solution
    # once more in the flow itself
    polished = solve_mission(
        replace(model, spline=None),
        data,
        solution.guess if covered else guess,
        warm_start=covered or warm_start,
    )
    return replace(polished, iterations=solution.iterations + polished.iterations)


def _strays(problem: LegsProblem, angles: Array) -> float:
    """Return how far the error of the spline may lead a mission astray [m]."""
    assert problem.task.spline is not None
    lengths = np.array([np.sum(np.abs(np.diff(steps))) for steps in problem.depths])
    lasts = np.sum(lengths / np.asarray(problem.task.vehicle.speeds(np, angles)[1])) + np.sum(
        problem.drifts
    )
    return float(lasts * problem.task.spline.largest_error)


def _weights(task: MissionTask) -> tuple[float, float | None, float]:
    """Return the weights of an hour, of a kilometre missed and of an hour a kilometre off the reference path, the largest of them 1."""
    weights = task.settings.weights
    hourly = weights.time + weights.energy * task.vehicle.hotel * HOUR / 1e3
    reference = 0.0 if task.reference_path is None else task.reference_path.weight
    largest = max(hourly, weights.closest or 0.0, reference)
    return (
        hourly / largest,
        None if weights.closest is None else weights.closest / largest,
        reference / largest,
    )


def _reference_weights_and_limits(
    task: MissionTask, angles: Array, shape: MissionShape, depths: Sequence[Array], weight: float
) -> tuple[Array, Array]:
    """Return the cost of a squared kilometre between the reference path and each place, and the limit [m]: shape (L, n_places) each."""
    reference = task.reference_path
    if reference is None:
        return np.zeros((0, 0)), np.zeros((0, 0))
    hours = np.zeros((shape.n_legs, shape.n_places))
    hours[:, : shape.n_steps] = [
        np.abs(np.diff(steps)) / float(task.vehicle.speeds(np, angle)[1]) / HOUR
        for steps, angle in zip(depths, angles, strict=True)
    ]
    if shape.drifts:
        hours[:-1, -1] = task.settings.surface_time / HOUR
    # the optimiser's steps are coarser than those of the check
    limit = min(max(reference.limit - task.settings.margin, 0.5 * reference.limit), _FAR)
    limits = np.full(hours.shape, limit)
    if reference.surfacings_only:
        hours[:, -1] = hours.sum(axis=1)
        hours[:, :-1], limits[:, :-1] = 0.0, _FAR
    return weight * hours, limits


def _points_along(problem: LegsProblem, guess: MissionGuess, route: Route | None = None) -> Array:
    """Return where each step of a guess ends, shape (L, n_places, 2) [m]: along its route, or straight from leg to leg without one."""
    n_places, n_legs = problem.shape(0).n_places, problem.n_legs
    share = np.arange(1, n_places + 1) / n_places
    if route is not None:
        times = route.times[-1] * (np.arange(n_legs)[:, None] + share) / n_legs
        return route.at(times.ravel()).reshape(n_legs, n_places, 2)
    begins = np.vstack([problem.task.start[None, :2], guess.places[:-1]])
    return np.asarray(begins[:, None] + share[:, None] * (guess.places - begins)[:, None])


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
