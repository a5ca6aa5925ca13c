"""A vehicle that moves freely, with a bounded speed through water: the quickest or most frugal path between two points.

The path is a chain of pieces of equal duration, each of constant velocity through water. One that violates a constraint is solved again
within half-planes, as missions are; they limit the ends of steps, and where a step between two cuts a corner the margin is doubled. With
free depths the optimum often lies on a level, where hat functions bend and no gradient vanishes: the search of depths is cut short, and
the rest is solved at the depths found.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from planners.flow import latent_over_time
from planners.front.current import current_lattice, spacing_over
from planners.front.front import sea_of, spread
from planners.front.obstacles import as_complex, obstacles_of
from planners.front.relax import relax
from planners.path.program import AuvProblem, PathSolution, solve_path
from planners.path.settings import AuvSettings, PathRequest
from planners.route.bottom import Bottom, bottom_of, fixed_rings
from planners.route.hazards import Ring, check_outside, first_crossing
from planners.route.region import locate, region_of
from planners.solver import HOUR
from planners.track import fly_glide, time_since
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.depth import depth_weights
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.plan import Place

AuvStatus = Literal["reached", "unreachable", "unsafe"]
# Steps of the dense flight for each of the optimiser's.
_REFINED = 2
# Rounds in which half-planes are placed anew around the path found, each of which must lower the cost by this share.
_ROUNDS, _PROGRESS = 6, 1e-3
# How far the path may bend between the points of its dense track [m].
_SKIN = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class AuvPlan:
    """A free path.

    Attributes:
        status: ``reached`` when it ends at the goal within the tolerance, ``unsafe`` when it violates a constraint.
        start: Where it begins.
        goal: Where it should end.
        velocity_through_water: shape (n_pieces, 3) [m/s], local east, north, down.
        duration: [s].
        energy: [J].
        closest_approach: Of its end to the goal [m].
        track_time: shape (n,) [s] since the start.
        track: shape (n, 3) [m], local east, north, depth.
        message: The outcome in words.
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


def plan_path(flow: FlowEstimate | Sequence[FlowEstimate], request: PathRequest) -> AuvPlan:
    """Return the best path found, of those begun at the route of the front and at a straight line.

    Args:
        flow: The current, or its estimates for increasing times, between which it is linear; constant before the first and after the last.
        request: Start, goal, vehicle, settings and constraints.

    Raises:
        PlanError: The start or the goal is outside of the region, on land, in an area, below the vehicle's limit or below the bottom
            less the clearance, the flow is not a number, or its estimates are not of one region and of increasing times.
    """
    start, goal, settings = request.start, request.goal, request.settings
    flows = (flow,) if isinstance(flow, FlowEstimate) else tuple(flow)
    if len(flows) > 1:
        latent_over_time(flows)
    region = region_of(flows[0].grid, request.vehicle.max_depth)
    begin, end = locate(region, start, "start"), locate(region, goal, "goal")
    if not all(np.all(np.isfinite(one.latent)) for one in flows):
        raise PlanError("the current is not a number; check the estimate's latent velocities")
    # a free path has no surfacings: every area counts at all depths
    areas = tuple(replace(area, surface_only=False) for area in request.no_go)
    bottom = bottom_of(region, request.bathymetry, settings.clearance)
    for name, point in (("start", begin), ("goal", end)):
        bottom.check(name, point)
    fixed, deep = fixed_rings(region, areas, bottom), float(max(begin[2], end[2]))
    for name, point in (("start", begin), ("goal", end)):
        check_outside(fixed, name, point)
    rings, times = (*fixed, *bottom.rings(deep)), (flows[1:], request.start_time_ns)
    problem = AuvProblem(
        flows[0], region, rings, bottom, request.vehicle, settings, begin, end, *times
    )

    def made(guess: Array, free: bool, held: tuple[Array, float] | None = None) -> AuvPlan:
        return _to_plan(problem, start, goal, solve_path(problem, guess, free, held))

    plans, route = [], _route(problem)
    for guess in (route, np.linspace(begin, end, 100)):
        # first at the depths of the guess, which is a smooth problem; then at free ones; then at those that came of it
        plans.append(made(guess, free=False))
        if settings.free_depth and flows[0].levels.size > 1:
            plans.append(made(made(plans[-1].track, free=True).track, free=False))
    if any(plan.status == "unsafe" for plan in plans):
        # the route is clear; the depths are those found without it, and the deeper they are the more is land
        depths = np.interp(
            np.linspace(0.0, 1.0, len(route)),
            np.linspace(0.0, 1.0, len(plans[0].track)),
            plans[0].track[:, 2],
        )
        route = np.column_stack([route[:, :2], depths])
        problem = replace(problem, rings=(*fixed, *bottom.rings(float(depths.max()))))
        plans += _solve_within_half_planes(
            settings, route, lambda along, margin: made(along, False, (along, margin))
        )
    return min(plans, key=lambda plan: _ranking_key(settings, plan))


def _ranking_key(settings: AuvSettings, plan: AuvPlan) -> tuple[bool, bool, float]:
    return (
        plan.closest_approach > settings.tolerance,
        plan.status == "unsafe",
        getattr(plan, _COST[settings.objective]),
    )


def _solve_within_half_planes(
    settings: AuvSettings, route: Array, made: Callable[[Array, float], AuvPlan]
) -> list[AuvPlan]:
    """Return the paths found within half-planes, placed along a route and anew along each path found until there is no more gain.

    Half-planes hold the ends of steps; where a step between two cuts a corner the margin is doubled.
    """
    plans, along, margin, before = list[AuvPlan](), route, settings.margin, np.inf
    for _ in range(_ROUNDS):
        plans.append(made(along, margin))
        along, cost = plans[-1].track, float(getattr(plans[-1], _COST[settings.objective]))
        if plans[-1].status == "unsafe":
            margin *= 2.0
        elif cost > (1.0 - _PROGRESS) * before:
            break
        before = cost
    return plans


_COST = {"time": "duration", "energy": "energy"}


def _route(problem: AuvProblem) -> Array:
    """Return the quickest route in the current of the two depths, shape (n, 3) [m], its points at equal times."""
    flow, begin, end, settings = problem.flow, problem.begin, problem.end, problem.settings
    depths = np.array([begin[2], end[2]])
    times, latent = problem.over_time
    since = np.zeros(1) if times is None else times - time_since(flow, problem.start_time_ns)
    shares = depth_weights(flow.depth_functions, depths, flow.levels).mean(axis=0)
    places = as_complex(np.vstack([begin, end])[:, :2])
    sea = sea_of(
        current_lattice(flow, latent, since, spacing_over(flow), shares),
        problem.vehicle.speed,
        places,
        obstacles_of(problem.rings, settings.margin, places),
    )
    first = sea.current.places.size
    front = spread(
        sea, np.array([first]), np.zeros(1), settings.max_duration, np.array([first + 1])
    )
    arrives = bool(np.isfinite(front.times[first + 1]))
    route = front.route_to(
        first + 1 if arrives else front.nearest_to(complex(places[1])), 0.0, arrives
    )
    route = relax(sea, route, 0.0)
    times = np.linspace(0.0, route.times[-1], 100)
    return np.column_stack([route.at(times), np.linspace(begin[2], end[2], 100)])


def _to_plan(problem: AuvProblem, start: Place, goal: Place, solution: PathSolution) -> AuvPlan:
    settings, vehicle, through, duration = (
        problem.settings,
        problem.vehicle,
        solution.velocity,
        solution.duration,
    )
    time, track = _fly(problem, through, duration)
    what = _crossed(problem.bottom, problem.rings, track)
    miss = float(np.linalg.norm(track[-1] - problem.end))
    met = miss <= settings.tolerance
    message = f"ends {miss:.1f} m from the goal after {duration / HOUR:.2f} h" + (
        "" if what is None else f"; not safe: crosses {what}"
    )
    if not met:
        message += f"; outside the tolerance of {settings.tolerance:g} m: the current or max_duration keeps it from there"
    status: AuvStatus = "unsafe" if what is not None else "reached" if met else "unreachable"
    energy = (
        float(np.mean(vehicle.hotel + vehicle.drag * np.linalg.norm(through, axis=1) ** 3))
        * duration
    )
    statistics: dict[str, float | int | str] = {
        "iterations": solution.iterations,
        "return_status": solution.return_status,
    }
    return AuvPlan(
        status, start, goal, through, duration, energy, miss, time, track, message, statistics
    )


def _fly(problem: AuvProblem, through: Array, duration: float) -> tuple[Array, Array]:
    """Return (time [s], track [m]) of the pieces flown densely."""
    steps, each = _REFINED * problem.settings.steps, duration / len(through)
    time, track = [np.zeros(1)], [problem.begin[None]]
    began_ns = problem.start_time_ns or problem.flow.time_ns or 0
    for k, velocity in enumerate(through):
        clock = np.linspace(0.0, each, steps + 1)
        flown = fly_glide(
            problem.currents, track[-1][-1], velocity, clock, began_ns + round(k * each * 1e9)
        )
        time.append(k * each + flown.time[1:])
        track.append(flown.position[1:])
    return np.concatenate(time), np.concatenate(track)


def _crossed(bottom: Bottom, rings: tuple[Ring, ...], track: Array) -> str | None:
    """Return the hazard that a track crosses first, with a metre to spare beside its segments; None when it crosses none."""
    segments, depths = (
        np.stack([track[:-1, :2], track[1:, :2]], axis=1),
        np.column_stack([track[:-1, 2], track[1:, 2]]),
    )
    skin = np.full(len(segments), _SKIN)
    # shallows count for the depths of the path, not at all of them
    area = first_crossing([ring for ring in rings if ring.outside or ring.drawn], segments, skin)
    below = bottom.is_below(segments, depths, skin)
    if area is not None and not below[: area[1]].any():
        return area[0]
    return bottom.name_at(segments[np.argmax(below)]) if below.any() else None
