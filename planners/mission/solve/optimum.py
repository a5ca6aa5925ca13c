"""The optimum of one number of legs that IPOPT finds, and the half-planes that keep its places clear of obstacles.

A half-plane is moved by a safety margin; weights, limits and currents are numbers of the program.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import nctdtrit, ndtri

from planners.hazards.areas import NearRings, Ring, near_rings
from planners.mission.solve.attempt import LegsProblem
from planners.mission.task import MissionTask, turns_of
from planners.shooting.functions import MissionCase, Reference
from planners.shooting.program import MissionGuess, MissionSolution, mission_program, solve_mission
from planners.shooting.schedule import schedule_of
from planners.shooting.stream import stream_of
from planners.shooting.walls import Walls
from planners.solver import HOUR, KM
from replay_kit.core.arrays import Array

# Half-planes for each point of a path.
_PLANES = 3
# Confidence that a margin from few samples covers the share it is made for.
_CONFIDENCE = 0.99
# A larger share than this cannot be told from all.
_MOST = 0.999


@dataclass(frozen=True, slots=True, eq=False)
class SafetyMargin:
    """Margins from the deviations of K flights from the predicted one.

    Attributes:
        deviations: shape (K, n, 2) [m], at places evenly numbered along the mission, the start not counted.
        share: Share of all flights that must keep clear.
        extra: Margin in addition to the deviation of this share [m].
    """

    deviations: Array
    share: float
    extra: float

    def margins(self, normals: Array) -> Array:
        """Return the additional distance kept at each place, shape (n, P) [m], for normals of half-planes, shape (n, P, 2).

        The places may be more or fewer than those of the flights.
        """
        numbers = np.linspace(0.0, 1.0, self.deviations.shape[1] + 1)[1:]
        at = np.linspace(0.0, 1.0, len(normals) + 1)[1:]
        moved = np.array(
            [[np.interp(at, numbers, flight[:, i]) for i in (0, 1)] for flight in self.deviations]
        )
        towards = np.einsum("kcn,npc->knp", moved, normals)
        deviation_std = np.std(towards, axis=0, ddof=1) if len(towards) > 1 else 0.0
        limits = np.linalg.norm(normals, axis=2) > 0.0
        needed = (
            np.mean(towards, axis=0) + tolerance_factor(len(towards), self.share) * deviation_std
        )
        return np.where(limits, np.maximum(needed, 0.0) + self.extra, 0.0)


def tolerance_factor(count: int, share: float) -> float:
    """Return the one-sided tolerance factor of a normal sample at a confidence of 99 %.

    The mean of the sample plus so many of its standard deviations is above the quantile ``share`` of the population with that
    confidence: mean and standard deviation are themselves estimated from few values.

    Args:
        count: Number of values.
        share: Of the population, to be covered.
    """
    share = min(share, _MOST)
    if count < 2:
        return float(ndtri(share))
    return float(nctdtrit(count - 1, ndtri(share) * np.sqrt(count), _CONFIDENCE) / np.sqrt(count))


# Between the ends of a step half-planes follow it at one of these shares in each of so many parts.
_PARTS = 3
_BETWEEN = (np.arange(18) + 0.5) / 18.0


def with_margin(walls: Walls, margin: SafetyMargin) -> Walls:
    """Return half-planes that stay, moved by a safety margin."""
    assert walls.planes is not None, "half-planes that follow the places have no safety margin"
    planes = walls.planes.reshape(-1, *walls.planes.shape[2:]).copy()
    planes[..., 2] -= margin.margins(planes[..., :2])
    return replace(walls, planes=planes.reshape(walls.planes.shape))


def standing_walls(problem: LegsProblem, path: Array) -> Walls:
    """Return half-planes that touch the rings nearest to the places of a path, shape (L, n_places, 2) [m]."""
    at, surfaced = np.repeat(path[:, :, None], _PLANES, axis=2), _surfaced(problem, path.shape[1])
    near = _near(problem, path, surfaced, _PLANES)
    return Walls(np.ones(at.shape[:3]), near.planes(at.reshape(-1, 2))[0].reshape(*at.shape[:3], 3))


def following_walls(problem: LegsProblem, path: Array) -> Walls:
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
