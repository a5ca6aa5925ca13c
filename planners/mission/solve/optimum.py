"""The optimum of one number of legs that IPOPT finds: their weights, limits and currents as numbers of the program."""

from dataclasses import replace

import numpy as np

from planners.mission.solve.attempt import LegsProblem
from planners.mission.task import MissionTask
from planners.shooting.functions import MissionCase, Reference
from planners.shooting.program import MissionGuess, MissionSolution, mission_program, solve_mission
from planners.shooting.schedule import schedule_of
from planners.shooting.stream import stream_of
from planners.shooting.walls import Walls
from planners.solver import HOUR, KM
from replay_kit.core.arrays import Array

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
# A goal met this well is met [m].
MET = 5.0
# Farther than any region is wide [m].
_FAR = 1e6


def optimum(
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
    if covered and _strays(problem, solution.guess.angles) <= MET:
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
    hourly = weights.time + weights.energy * task.vehicle.power * HOUR / 1e3
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
