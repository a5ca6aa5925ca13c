"""One number of legs solved: by IPOPT from a guess, flown densely, and held to half-planes when its path violates a constraint."""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from planners.front.route import Route
from planners.mission.flight.currents import Currents
from planners.mission.flight.legs import Flight, Legs, fly_legs
from planners.mission.solve.attempt import Attempt, GoalSteps, LegsProblem, ranking_key
from planners.mission.solve.check import check
from planners.mission.solve.half_planes import (
    SafetyMargin,
    following_walls,
    standing_walls,
    with_margin,
)
from planners.mission.task import REFINED, MissionTask, refine_steps, turns_of
from planners.shooting.frames import FrameMap
from planners.shooting.functions import MissionCase, Reference
from planners.shooting.program import MissionGuess, MissionSolution, mission_program, solve_mission
from planners.shooting.schedule import DRIFT_STEPS, schedule_of
from planners.shooting.stream import stream_of
from planners.shooting.together import fly_together
from planners.shooting.walls import Walls
from planners.solver import HOUR, KM
from planners.vehicle import Glider
from replay_kit.core.arrays import Array
from replay_kit.core.grid import Projection
from replay_kit.core.progress import announce

# Hours that a kilometre of miss distance costs: more than any current takes to carry a glider over it.
_PENALTY = 50.0
# The same penalty at the end of a line, times this: long deviations would cost more than missing the end.
_END_OF_LINE = 40.0
# A kilometre beyond a half-plane costs as much as this many kilometres missed along one axis.
_PLANE_COST = 4.0
# A kilometre beyond the distance allowed from a reference path costs as much as this many hours of the penalty of a kilometre missed.
_SLACK_COST = 0.2
# Weight of slacks that are not to count.
_SMALL = 1e-6
# Weights (of an hour, of a squared kilometre missed) when only the miss distance counts: time decides among equals.
_CLOSEST = 1e-5, 1.0
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
        solution = _solve(
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


def _solve(
    problem: LegsProblem,
    guess: MissionGuess,
    walls: Walls | None = None,
    *,
    closest: bool = False,
    warm_start: bool = False,
) -> MissionSolution:
    """Return the solver's solution; with ``closest`` only the miss distance counts."""
    task, layout = problem.task, problem.layout(0 if walls is None else walls.count)
    time_weight, distance_weight, reference_weight = _weights(task)
    time_weight, miss_weight = _CLOSEST if closest else (time_weight, 0.0)
    if walls is not None:
        # a kilometre less of a large miss distance must not pay for a kilometre beyond a half-plane
        miss_weight /= max(float(np.max(task.from_start)) / KM, 1.0)
    line_end = _END_OF_LINE if layout.has_reference and distance_weight is None else 1.0
    penalty = 1e-6 if closest and walls is None else _PENALTY * line_end
    linear, each = (
        (0.0, penalty) if closest or distance_weight is None else (distance_weight, _SMALL)
    )
    flow, latent, drifts = task.flow, task.currents.latent[0], problem.drifts
    case = MissionCase(
        stream_of(flow, latent) if task.spline is None else task.spline,
        schedule_of(
            problem.depths,
            drifts,
            bool(np.any(drifts)),
            flow.levels,
            flow.depth_functions,
            task.currents.times,
        ),
        drifts,
        task.start[:2],
        task.start_time,
        task.goals[:, :2],
        walls,
        time_weight,
        (miss_weight, linear, each),
        penalty * _PLANE_COST,
        _reference(problem, guess.angles, reference_weight, penalty * _SLACK_COST),
    )
    program = mission_program(flow.grid.projection, task.vehicle, layout)
    solution = solve_mission(program, task.vehicle, case, guess, warm_start=warm_start)
    if task.spline is None:
        return solution
    # what leaves the region is held back by half-planes next, whatever the current is out there
    places = solution.guess.places
    covered = task.spline.covers(places[task.region.inside_outline(places)])
    if covered and _strays(problem, solution.guess.angles) <= _MET:
        return solution
    # once more in the flow itself
    polished = solve_mission(
        program,
        task.vehicle,
        replace(case, stream=stream_of(flow, latent)),
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


def _reference(
    problem: LegsProblem, angles: Array, weight: float, slack_cost: float
) -> Reference | None:
    """Return the reference path as the program takes it: a squared kilometre from it costs the weight for the hours spent there."""
    task, path, layout = problem.task, problem.task.reference_path, problem.layout()
    if path is None:
        return None
    hours = np.zeros((layout.n_legs, layout.n_places))
    for of_leg, steps, angle in zip(hours, problem.depths, angles, strict=True):
        down = float(task.vehicle.speeds(np, angle)[1])
        of_leg[: steps.size - 1] = np.abs(np.diff(steps)) / down / HOUR
    if np.any(problem.drifts):
        hours[:-1, -1] = task.settings.surface_time / HOUR
    # the optimiser's steps are coarser than those of the check
    limit = min(max(path.limit - task.settings.margin, 0.5 * path.limit), _FAR)
    limits = np.full(hours.shape, limit)
    if path.surfacings_only:
        hours[:, -1] = hours.sum(axis=1)
        hours[:, :-1], limits[:, :-1] = 0.0, _FAR
    return Reference(
        path.origin / KM, path.across, weight * hours, limits / KM, slack_cost, path.least_duration
    )


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
