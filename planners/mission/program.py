"""A glider's mission as a nonlinear program: multiple shooting over its legs.

The unknowns are the heading and the glide angle of each leg, the place and the time of its end, and slack variables. Places are in
kilometres, times in hours, angles in radians: all of order one to a hundred. Latent velocities, places, depths, weights and limits are
parameters, so that one graph serves every estimate on the same nodes.
"""

from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from planners.flow import graph_key
from planners.mission.leg import leg_function, stage_latent
from planners.mission.reference_path import ReferencePath, ReferencePathTerms
from planners.route.hazards import plane_violations
from planners.solver import HOUR, KM, MOST_ITERATIONS, OPTIONS, Program, Recent
from planners.spline import FlowSpline
from planners.vehicle import Glider
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate

# A kilometre beyond a half-plane costs as much as this many kilometres missed along one axis.
_PLANE_COST = 4.0
# Weight of slacks that are not to count, and the distance [km] below which a weighted distance is a smooth bowl.
_SMALL, _BOWL = 1e-6, 1e-2


@dataclass(frozen=True, slots=True)
class MissionShape:
    """What makes two missions share a graph.

    Attributes:
        n_legs: Number of legs.
        n_steps: Steps of a leg under water.
        goal_legs: After which leg each goal is met, counted from 1.
        profiles: Which of the mission's depth profiles each leg follows.
        n_planes: Half-planes that limit the end of each step; 0 for none.
        drifts: Whether there are drifts at the surface.
        goal_steps: After which step of its leg each goal is met, counted from 1; 0 for the leg's end. Empty: all at ends.
        has_reference: Whether there is a reference path.
    """

    n_legs: int
    n_steps: int
    goal_legs: tuple[int, ...]
    profiles: tuple[int, ...]
    n_planes: int
    drifts: bool
    goal_steps: tuple[int, ...] = ()
    has_reference: bool = False

    @property
    def n_places(self) -> int:
        """Places of a leg at which half-planes and the reference path count."""
        return self.n_steps + int(self.drifts)


@dataclass(frozen=True, slots=True, eq=False)
class MissionModel:
    """What the graph of a mission is built from.

    Attributes:
        flow: Any flow on the nodes; the latent velocities are parameters.
        vehicle: The glider.
        shape: Numbers of legs, steps and goals.
        times: As for ``field_function``.
        spline: Used instead of the flow.
    """

    flow: FlowEstimate
    vehicle: Glider
    shape: MissionShape
    times: Array | None = None
    spline: FlowSpline | None = None

    @property
    def program(self) -> Program:
        """The program, built once for models that share a graph."""
        key = (*graph_key(self.flow), self.vehicle, self.shape, None if self.times is None else self.times.tobytes(), self.spline)
        return _programs.get(key, lambda: _build(self))


@dataclass(frozen=True, slots=True, eq=False)
class MissionData:
    """The parameters of one mission's program.

    Attributes:
        start: shape (2,) [m].
        start_time: [s], on the clock of the flow's times.
        goals: shape (G, 2) [m].
        depths: One for each profile, shape (n_steps + 1,) [m].
        drifts: shape (L,) [s], at the surface after each leg.
        planes: shape (L, n_places, P, 3): normal (east, north) and offset [m] of normal . place <= offset.
        time_weight: Of an hour.
        miss_weight: Of a squared kilometre of miss distance.
        penalty: Of a kilometre missed, or beyond a half-plane.
        latent: Latent velocities as the flow function takes them.
        distance_weight: Of a kilometre of miss distance, instead of the penalty; None for the penalty.
        reference_path: That the track is to stay near.
        reference_weights: shape (L, n_places), of a squared kilometre between it and each place.
        reference_limits: shape (L, n_places) [m], largest distance of each place from it.
    """

    start: Array
    start_time: float
    goals: Array
    depths: tuple[Array, ...]
    drifts: Array
    planes: Array
    time_weight: float
    miss_weight: float
    penalty: float
    latent: Array
    distance_weight: float | None = None
    reference_path: ReferencePath | None = None
    reference_weights: Array = field(default_factory=lambda: np.zeros((0, 0)))
    reference_limits: Array = field(default_factory=lambda: np.zeros((0, 0)))


@dataclass(frozen=True, slots=True, eq=False)
class MissionGuess:
    """An initial guess or a solution of the program.

    Attributes:
        places: shape (L, 2) [m], at the ends of the legs.
        headings: shape (L,), clockwise from true north [rad].
        angles: shape (L,), glide angles [rad].
    """

    places: Array
    headings: Array
    angles: Array


@dataclass(frozen=True, slots=True, eq=False)
class MissionSolution:
    """The solver's result.

    Attributes:
        guess: The local optimum, from which another solve may begin.
        plane_violation: Largest distance beyond a half-plane [m].
        objective: In the program's units.
        iterations: IPOPT's.
        return_status: IPOPT's.
    """

    guess: MissionGuess
    plane_violation: float
    objective: float
    iterations: int
    return_status: str


_programs = Recent[Program](8)


def solve_mission(
    model: MissionModel, data: MissionData, guess: MissionGuess, *, warm_start: bool = False, max_iterations: int = MOST_ITERATIONS
) -> MissionSolution:
    """Return the local optimum that IPOPT finds from a guess.

    Args:
        model: What the graph is built from.
        data: Its parameters.
        guess: Where to begin.
        warm_start: Whether the guess is the optimum of nearly the same problem.
        max_iterations: Of IPOPT.
    """
    program, shape = model.program, model.shape
    solver = program.solver_for(warm_start, max_iterations)
    unknowns, lower, upper = _unknowns(model.vehicle, shape, data, guess)
    answer = solver(x0=unknowns, p=_parameters(model, data), lbx=lower, ubx=upper, lbg=program.lower, ubg=program.upper)
    statistics = solver.stats()
    found = np.asarray(answer["x"]).ravel()
    legs = found[: 5 * shape.n_legs].reshape(shape.n_legs, 5)
    return MissionSolution(
        MissionGuess(legs[:, :2] * KM, legs[:, 3], legs[:, 4]),
        float(found[-1]) * KM if shape.n_planes else 0.0,
        float(answer["f"]),
        int(statistics["iter_count"]),
        str(statistics["return_status"]),
    )


def _unknowns(vehicle: Glider, shape: MissionShape, data: MissionData, guess: MissionGuess) -> tuple[Array, Array, Array]:
    """Return a guess as the program's unknowns, leg after leg, then the slacks, with their lower and upper bounds."""
    distance = np.array([np.sum(np.abs(np.diff(data.depths[profile]))) for profile in shape.profiles])
    duration = distance / np.asarray(vehicle.speeds(np, guess.angles)[1]) + data.drifts
    legs = np.column_stack([guess.places / KM, np.cumsum(duration) / HOUR, guess.headings, guess.angles])
    n_slacks = 4 * len(shape.goal_legs) + int(shape.has_reference) + int(shape.n_planes > 0)
    shallow, steep = vehicle.angles
    lower = np.concatenate([np.tile([*[-np.inf] * 4, shallow], shape.n_legs), np.zeros(n_slacks)])
    upper = np.concatenate([np.tile([*[np.inf] * 4, steep], shape.n_legs), np.full(n_slacks, np.inf)])
    if data.reference_path is not None:
        lower[5 * (shape.n_legs - 1) + 2] = data.reference_path.least_duration / HOUR
    miss = (guess.places[np.array(shape.goal_legs) - 1] - data.goals) / KM
    slacks = np.stack([np.maximum(miss, 0.0), np.maximum(-miss, 0.0)], axis=1).ravel()
    return np.concatenate([legs.ravel(), slacks, np.zeros(n_slacks - slacks.size)]), lower, upper


def _parameters(model: MissionModel, data: MissionData) -> Array:
    flow, reference = model.flow, data.reference_path
    miss_weights = [0.0, data.penalty] if data.distance_weight is None else [data.distance_weight, _SMALL]
    parts = [data.start, [data.start_time], data.goals.ravel(), *data.depths, data.drifts, data.planes.ravel()]
    parts += [[data.time_weight, data.miss_weight, data.penalty, *miss_weights]]
    if reference is not None:
        parts += [reference.origin / KM, reference.across.ravel(order="F")]
        parts += [data.reference_weights.ravel(), data.reference_limits.ravel() / KM]
    if model.spline is None:
        parts += [stage_latent(data.latent, flow.levels, flow.depth_functions, depths).ravel(order="F") for depths in data.depths]
    return np.concatenate([np.asarray(part) for part in parts])


def _build(model: MissionModel) -> Program:
    shape, n_times = model.shape, 1 if model.times is None else model.times.size
    n_legs, n_steps, n_goals, n_planes = shape.n_legs, shape.n_steps, len(shape.goal_legs), shape.n_planes
    start, start_time, goals = ca.MX.sym("start", 2), ca.MX.sym("start_time"), ca.MX.sym("goals", 2, n_goals)
    drifts, weights, profiles = ca.MX.sym("drifts", n_legs), ca.MX.sym("weights", 5), range(max(shape.profiles) + 1)
    depths = [ca.MX.sym("depths", n_steps + 1) for _ in profiles]
    latent = [ca.MX.sym("latent", len(model.flow.latent) if model.spline is None else 0, (2 * n_steps + 2) * n_times) for _ in profiles]
    planes = [ca.MX.sym("planes", 3, n_planes * shape.n_places) for _ in range(n_legs)]
    legs = [ca.MX.sym("leg", 5) for _ in range(n_legs)]
    slacks: Any = ca.MX.sym("slacks", 4, n_goals)
    plane_slack = ca.MX.sym("plane_slack", int(n_planes > 0))
    reference = ReferencePathTerms(n_legs, shape.n_places if shape.has_reference else 0)
    leg = leg_function(model.flow, model.vehicle, n_steps, model.times, shape.drifts, model.spline)
    place, time = start, ca.MX.zeros(1)
    equal, limited, tracks = [], [], []
    for k, profile in enumerate(shape.profiles):
        heading, angle = legs[k][3], legs[k][4]
        places, end_time = leg(place, start_time + time * HOUR, heading, angle, depths[profile], drifts[k], latent[profile])
        equal.append(ca.vertcat(places[:, -1] / KM - legs[k][:2], (end_time - start_time) / HOUR - legs[k][2]))
        if n_planes:
            limited.append(plane_violations(places / KM, planes[k], n_planes) - plane_slack)
        reference.add(k, places / KM)
        tracks.append(places)
        place, time = legs[k][:2] * KM, legs[k][2]
    misses = [slacks[:2, g] - slacks[2:, g] for g in range(n_goals)]
    for g, (number, step) in enumerate(zip(shape.goal_legs, shape.goal_steps or (0,) * n_goals, strict=True)):
        at = legs[number - 1][:2] if step == 0 else tracks[number - 1][:, step - 1] / KM
        equal.append(at - goals[:, g] / KM - misses[g])
    miss_cost = weights[1] * sum(ca.sumsqr(miss) for miss in misses)
    miss_cost += weights[3] * sum(ca.sqrt(ca.sumsqr(miss) + _BOWL**2) for miss in misses)
    slack_cost = _PLANE_COST * ca.sum1(plane_slack) + reference.slack_cost
    program: dict[str, Any] = {
        "x": ca.veccat(*legs, slacks, reference.slack, plane_slack),
        "p": ca.veccat(start, start_time, goals, *depths, drifts, *planes, weights, *reference.parameters, *latent),
        "f": weights[0] * time + miss_cost + weights[4] * ca.sum1(ca.vec(slacks)) + weights[2] * slack_cost + reference.cost,
        "g": ca.vertcat(*equal, *limited, *reference.excess),
    }
    n_equal = 3 * n_legs + 2 * n_goals
    n_limited = (n_planes + int(shape.has_reference)) * shape.n_places * n_legs
    lower = np.concatenate([np.zeros(n_equal), np.full(n_limited, -np.inf)])
    return Program(ca.nlpsol("mission", "ipopt", program, OPTIONS), lower, np.zeros(n_equal + n_limited), program)
