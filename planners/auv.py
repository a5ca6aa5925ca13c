"""A vehicle that moves freely, with a bounded speed through water: the quickest or most frugal path between two points.

The path is a chain of pieces of equal duration, each of constant velocity through water; unknown are these velocities, the duration and
where each piece ends. Places are in kilometres and times in hours.
"""

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from planners.flow import graph_key
from planners.front import build_front
from planners.hazards import Ring, no_go_ring, region_rings, trespassed
from planners.mission_program import HOUR, KM, OPTIONS
from planners.mission_values import NoGo
from planners.region import Region, locate, region_of
from planners.seed import tabulate
from planners.track import fly_glide
from planners.transcription import path_function
from replay_kit.errors import PlanError
from replay_kit.flow import FlowEstimate
from replay_kit.types import Array, Place

AuvStatus = Literal["reached", "unreachable", "unsafe"]
# Hours that a kilometre missed costs.
_PENALTY = 50.0
# Steps of the dense flight for each of the optimiser's, and spacing of its check [m].
_REFINED, _SPACING = 2, 10.0
_MOST_PROGRAMS = 4
# With free depths the best one is often that of a level, where hats bend and no gradient vanishes: that search ends after so many steps.
_FREE_STEPS = 25


@dataclass(frozen=True, slots=True)
class Auv:
    """A vehicle with a propeller.

    Attributes:
        speed: Most through water [m/s].
        drag: Power of propulsion over the cube of the speed [W s^3/m^3].
        hotel: Power of everything else [W].
    """

    speed: float = 1.0
    drag: float = 40.0
    hotel: float = 20.0


@dataclass(frozen=True, slots=True)
class AuvSettings:
    """How a free path is planned.

    Attributes:
        objective: Least time or least energy.
        pieces: Number of pieces of constant velocity through water.
        steps: RK4 steps of each.
        tolerance: A goal met this closely is reached [m].
        max_duration: Longest path considered [s].
        free_depth: Whether the depth is the optimiser's to choose; otherwise it leads evenly from the start's to the goal's.
    """

    objective: Literal["time", "energy"] = "time"
    pieces: int = 24
    steps: int = 2
    tolerance: float = 50.0
    max_duration: float = 4e5
    free_depth: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class AuvPlan:
    """A free path.

    Attributes:
        status: ``reached`` when it ends at the goal within the tolerance, ``unsafe`` when it goes where it may not.
        start: Where it begins.
        goal: Where it should end.
        velocity_through_water: shape (n_pieces, 3) [m/s], local east, north, down.
        duration: [s].
        energy: [J].
        closest_approach: Of its end to the goal [m].
        track_time: shape (n,) [s] since the start.
        track: shape (n, 3) [m], local east, north, depth.
        message: Words for a person.
        statistics: What the solver did.
    """

    status: AuvStatus
    start: Place
    goal: Place
    velocity_through_water: Array
    duration: float
    energy: float
    closest_approach: float
    track_time: Array
    track: Array
    message: str
    statistics: Mapping[str, float | int | str] = field(default_factory=dict)


_AUV, _SETTINGS = Auv(), AuvSettings()
_programs: OrderedDict[Any, tuple[Any, Array]] = OrderedDict()


def plan_path(
    flow: FlowEstimate, start: Place, goal: Place, *, vehicle: Auv = _AUV, settings: AuvSettings = _SETTINGS, no_go: tuple[NoGo, ...] = ()
) -> AuvPlan:
    """Return the best path found, of those begun at the route of a graph search and at a straight line.

    Args:
        flow: The current, held constant in time.
        start: Where it begins.
        goal: Where it should end.
        vehicle: What moves.
        settings: How.
        no_go: Areas that the first route avoids and that the path is checked against.

    Raises:
        PlanError: The start or the goal is outside of the region or on land, or the flow is not a number.
    """
    region = region_of(flow.grid)
    begin, end = locate(region, start, "start"), locate(region, goal, "goal")
    if not np.all(np.isfinite(flow.latent)):
        raise PlanError("the current is not a number; check the estimate's latent velocities")
    areas = tuple(no_go_ring(flow.grid.projection, area.polygon, area.name) for area in no_go)
    rings = region_rings(region, max(begin[2], end[2])) + areas
    problem = _Problem(flow, region, rings, vehicle, settings, begin, end)
    plans = []
    for guess in (_route(problem), np.linspace(begin, end, 100)):
        # first at the depths of the guess, which is a smooth problem; then at free ones; then at those that came of it
        plans.append(_to_plan(problem, start, goal, *_solve(problem, guess, free=False)))
        if settings.free_depth and flow.levels.size > 1:
            freed = _to_plan(problem, start, goal, *_solve(problem, plans[-1].track, free=True))
            plans.append(_to_plan(problem, start, goal, *_solve(problem, freed.track, free=False)))

    def worth(one: AuvPlan) -> tuple[bool, bool, float]:
        return one.closest_approach > settings.tolerance, one.status == "unsafe", getattr(one, _COST[settings.objective])

    return min(plans, key=worth)


_COST = {"time": "duration", "energy": "energy"}


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    flow: FlowEstimate
    region: Region
    rings: tuple[Ring, ...]
    vehicle: Auv
    settings: AuvSettings
    begin: Array
    end: Array


def _route(problem: _Problem) -> Array:
    """Return the quickest route in the current of the two depths, shape (n, 3) [m], its points at equal times."""
    table, begin, end = tabulate(problem.flow, problem.region), problem.begin, problem.end
    nearest = [int(np.argmin(np.abs(table.depths - depth))) for depth in (begin[2], end[2])]
    shares, deepest = np.bincount(nearest, minlength=table.depths.size) / 2.0, max(begin[2], end[2])

    def wet(points: Array) -> NDArray[np.bool_]:
        return problem.region.wet(np.column_stack([points, np.full(len(points), deepest)]))

    route = build_front(table, shares, problem.rings, wet, problem.vehicle.speed).route(begin[:2], end[:2], problem.settings.max_duration)
    times = np.linspace(0.0, route.times[-1], 100)
    return np.column_stack([route.at(times), np.linspace(begin[2], end[2], 100)])


def _solve(problem: _Problem, guess: Array, free: bool) -> tuple[Array, float, int, str]:
    """Return (velocities through water, duration [s], iterations, return status) of the optimum found from a guessed track.

    Args:
        problem: What is asked.
        guess: shape (n, 3) [m], points at equal times.
        free: Whether the depths may differ from the guess's.
    """
    settings, vehicle, n = problem.settings, problem.vehicle, problem.settings.pieces
    solver, equal = _program(problem.flow, settings, free)
    ends = np.column_stack([np.interp(np.arange(1, n + 1) / n, np.linspace(0.0, 1.0, len(guess)), guess[:, i]) for i in range(3)])
    way = float(np.sum(np.linalg.norm(np.diff(guess, axis=0), axis=1)))
    duration = min(max(way / vehicle.speed, 60.0), settings.max_duration)
    ground = np.diff(np.vstack([problem.begin, ends]), axis=0) / (duration / n)
    through = ground - np.column_stack([problem.flow.velocity(*ends.T), np.zeros(n)])
    through *= np.minimum(1.0, 0.95 * vehicle.speed / np.maximum(np.linalg.norm(through, axis=1), 1e-9))[:, None]
    first = np.concatenate([np.column_stack([ends / KM, through]).ravel(), [np.log(duration / HOUR)], np.zeros(6)])
    shallow, deep = (np.zeros(n), np.full(n, problem.region.deepest)) if free else (ends[:, 2], ends[:, 2])
    sides = []
    for sign, depths, time in ((-1.0, shallow, 60.0), (1.0, deep, settings.max_duration)):
        bound = np.full((n, 6), sign * np.inf)
        bound[:, 2] = depths / KM
        sides.append(np.concatenate([bound.ravel(), [np.log(time / HOUR)], np.zeros(6) if sign < 0.0 else np.full(6, np.inf)]))
    weights = (1.0, 0.0) if settings.objective == "time" else (vehicle.hotel / 10.0, vehicle.drag / 10.0)
    parameters = np.concatenate([problem.begin, problem.end, weights, problem.flow.latent.ravel(order="F")])
    least, most = np.concatenate([equal, np.full(n, -np.inf)]), np.concatenate([equal, np.full(n, vehicle.speed**2)])
    answer = solver(x0=first, p=parameters, lbx=sides[0], ubx=sides[1], lbg=least, ubg=most)
    statistics, found = solver.stats(), np.asarray(answer["x"]).ravel()
    lasts = float(np.exp(found[6 * n])) * HOUR
    return found[: 6 * n].reshape(n, 6)[:, 3:], lasts, int(statistics["iter_count"]), str(statistics["return_status"])


def _to_plan(problem: _Problem, start: Place, goal: Place, through: Array, duration: float, iterations: int, return_status: str) -> AuvPlan:
    settings, vehicle = problem.settings, problem.vehicle
    time, track = _fly(problem.flow, settings, problem.begin, through, duration)
    what = _crossed(problem.region, problem.rings, track)
    missed = float(np.linalg.norm(track[-1] - problem.end))
    met = missed <= settings.tolerance
    message = f"ends {missed:.1f} m from the goal after {duration / HOUR:.2f} h" + ("" if what is None else f"; not safe: crosses {what}")
    if not met:
        message += f"; outside the tolerance of {settings.tolerance:g} m: the current or max_duration keeps it from there"
    status: AuvStatus = "unsafe" if what is not None else "reached" if met else "unreachable"
    energy = float(np.mean(vehicle.hotel + vehicle.drag * np.linalg.norm(through, axis=1) ** 3)) * duration
    statistics: dict[str, float | int | str] = {"iterations": iterations, "return_status": return_status}
    return AuvPlan(status, start, goal, through, duration, energy, missed, time, track, message, statistics)


def _program(flow: FlowEstimate, settings: AuvSettings, free: bool) -> tuple[Any, Array]:
    """Return the solver of a flow's nodes, and the zeros that its equations are to meet."""
    key = (*graph_key(flow), settings.pieces, settings.steps, free)
    if key not in _programs:
        _programs[key] = _build(flow, settings.pieces, settings.steps, {**OPTIONS, "ipopt.max_iter": _FREE_STEPS} if free else OPTIONS)
        if len(_programs) > _MOST_PROGRAMS:
            _programs.popitem(last=False)
    return _programs[key]


def _build(flow: FlowEstimate, n: int, steps: int, options: dict[str, Any]) -> tuple[Any, Array]:
    begin, end, weights, latent = (
        ca.MX.sym("begin", 3),
        ca.MX.sym("end", 3),
        ca.MX.sym("weights", 2),
        ca.MX.sym("latent", *flow.latent.shape),
    )
    pieces, log_duration, slacks = [ca.MX.sym("piece", 6) for _ in range(n)], ca.MX.sym("log_duration"), ca.MX.sym("slacks", 6)
    duration, path = ca.exp(log_duration), path_function(flow, steps)
    at, meet = begin, []
    for piece in pieces:
        after = path(at, piece[3:], ca.repmat(duration * HOUR / (n * steps), steps, 1), latent)[:, -1]
        meet.append(after / KM - piece[:3])
        at = piece[:3] * KM
    meet.append(pieces[-1][:3] - end / KM - (slacks[:3] - slacks[3:]))
    power = weights[0] + weights[1] * sum((ca.sumsqr(piece[3:]) + 1e-8) ** 1.5 for piece in pieces) / n
    program: dict[str, Any] = {
        "x": ca.veccat(*pieces, log_duration, slacks),
        "p": ca.veccat(begin, end, weights, latent),
        "f": power * duration + _PENALTY * ca.sum1(slacks),
        "g": ca.vertcat(*meet, *(ca.sumsqr(piece[3:]) for piece in pieces)),
    }
    return ca.nlpsol("auv", "ipopt", program, options), np.zeros(3 * n + 3)


def _fly(flow: FlowEstimate, settings: AuvSettings, begin: Array, through: Array, duration: float) -> tuple[Array, Array]:
    """Return (time [s], track [m]) of the pieces flown densely."""
    steps, each = _REFINED * settings.steps, duration / len(through)
    time, track = [np.zeros(1)], [begin[None]]
    for k, velocity in enumerate(through):
        flown = fly_glide(flow, track[-1][-1], velocity, np.linspace(0.0, each, steps + 1))
        time.append(k * each + flown.time[1:])
        track.append(flown.position[1:])
    return np.concatenate(time), np.concatenate(track)


def _crossed(region: Region, rings: tuple[Ring, ...], track: Array) -> str | None:
    """Return what a track crosses that it may not, by points no farther apart than ten metres; None when it crosses nothing."""
    pieces = np.maximum(np.ceil(np.linalg.norm(np.diff(track, axis=0), axis=1) / _SPACING).astype(int), 1)
    number = np.concatenate([[0.0], *(i + np.arange(1, n + 1) / n for i, n in enumerate(pieces))])
    dense = np.column_stack([np.interp(number, np.arange(len(track)), track[:, i]) for i in range(3)])
    ring = trespassed(rings[:1] + tuple(ring for ring in rings[1:] if ring.name != "land"), dense[:, :2], surfacing=True)
    if ring is not None:
        return ring[0]
    return None if region.wet(dense).all() else "land"
