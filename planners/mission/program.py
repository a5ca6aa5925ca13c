"""A glider's mission as a nonlinear program: multiple shooting over its legs.

Unknown are heading and glide angle of each leg, where and when it begins, and what the limits are missed by. Places are in kilometres,
times in hours, angles in radians: all of order one to a hundred. Latent velocities, places, depths, weights and limits are parameters,
so that one graph serves every estimate on the same nodes.
"""

from collections import OrderedDict
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from planners.flow import graph_key
from planners.mission.leg import leg_function, stage_latent
from planners.mission.reference_path import Guide, GuideTerms
from planners.route.hazards import plane_violations
from planners.solver import HOUR, KM, MOST_ITERATIONS, OPTIONS, Program
from planners.spline import FlowSpline
from planners.vehicle import Glider
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate

# A kilometre of trespass costs so many times a kilometre missed along one axis.
_TRESPASS = 4.0


@dataclass(frozen=True, slots=True)
class MissionShape:
    """What makes two missions share a graph.

    Attributes:
        n_legs: Number of legs.
        n_steps: Steps of a leg under water.
        goal_legs: After which leg each goal is to be met, counted from 1.
        profiles: Which of the mission's profiles of depth each leg follows.
        n_planes: Half-planes that every step's end has to keep to; 0 for none.
        drifts: Whether there are drifts at the surface.
        goal_steps: After which of its leg's steps each goal is to be met, counted from 1; 0 for the leg's end. Empty: all at ends.
        guided: Whether the path is to stay near something.
    """

    n_legs: int
    n_steps: int
    goal_legs: tuple[int, ...]
    profiles: tuple[int, ...]
    n_planes: int
    drifts: bool
    goal_steps: tuple[int, ...] = ()
    guided: bool = False

    @property
    def n_places(self) -> int:
        """Places at which a leg is held to its half-planes."""
        return self.n_steps + int(self.drifts)


@dataclass(frozen=True, slots=True, eq=False)
class MissionData:
    """What one mission gives its program.

    Attributes:
        start: shape (2,) [m].
        start_time: [s], on the clock of the flow's times.
        goals: shape (G, 2) [m].
        depths: One for each profile, shape (n_steps + 1,) [m].
        drifts: shape (L,) [s], at the surface after each leg.
        planes: shape (L, n_places, P, 3): normal (east, north) and offset [m] of normal . place <= offset.
        time_weight: Of an hour.
        miss_weight: Of a squared kilometre between a goal and the path.
        penalty: Of a kilometre missed of a goal, or of a half-plane trespassed on.
        latent: As the flow function takes it.
        distance_weight: Of a kilometre between a goal and the path, instead of the penalty; None for the penalty.
        guide: What the path is to stay near.
        guide_weights: shape (L, n_places), of a squared kilometre between it and each place.
        guide_limits: shape (L, n_places) [m], how far from it each place may be.
        spline: Flown in instead of the latent velocities.
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
    guide: Guide | None = None
    guide_weights: Array = field(default_factory=lambda: np.zeros((0, 0)))
    guide_limits: Array = field(default_factory=lambda: np.zeros((0, 0)))
    spline: FlowSpline | None = None


@dataclass(frozen=True, slots=True, eq=False)
class MissionGuess:
    """Where the solver begins, and what it answers.

    Attributes:
        places: shape (L, 2) [m], at the ends of the legs.
        headings: shape (L,), clockwise from local north [rad].
        angles: shape (L,), glide angles [rad].
    """

    places: Array
    headings: Array
    angles: Array


@dataclass(frozen=True, slots=True, eq=False)
class MissionAnswer:
    """What the solver answered.

    Attributes:
        guess: Its point, from which another solve may begin.
        trespass: Beyond the worst half-plane [m].
        objective: In the program's units.
        iterations: IPOPT's.
        return_status: IPOPT's.
    """

    guess: MissionGuess
    trespass: float
    objective: float
    iterations: int
    return_status: str


_programs: OrderedDict[Any, Program] = OrderedDict()
_MOST_PROGRAMS = 8
# Cost of slacks that are not to count, and the distance [km] below which a weighed distance is a smooth bowl.
_SMALL, _BOWL = 1e-6, 1e-2


def solve_mission(
    flow: FlowEstimate,
    vehicle: Glider,
    shape: MissionShape,
    data: MissionData,
    guess: MissionGuess,
    times: Array | None,
    *,
    nearly_optimal: bool = False,
    most: int = MOST_ITERATIONS,
) -> MissionAnswer:
    """Return the local optimum that IPOPT finds from a guess.

    Args:
        flow: Any flow on the nodes; its latent velocities are those of ``data``.
        vehicle: What glides.
        shape: The graph.
        data: Its parameters.
        guess: Where to begin.
        times: As for ``flow_function``.
        nearly_optimal: Whether the guess is the optimum of nearly the same problem.
        most: Iterations.
    """
    program = _program(flow, vehicle, shape, times, data.spline)
    solver = program.solver_for(nearly_optimal, most)
    unknowns, lower, upper = _unknowns(vehicle, shape, data, guess)
    answer = solver(x0=unknowns, p=_parameters(flow, data), lbx=lower, ubx=upper, lbg=program.lower, ubg=program.upper)
    statistics = solver.stats()
    found = np.asarray(answer["x"]).ravel()
    legs = found[: 5 * shape.n_legs].reshape(shape.n_legs, 5)
    return MissionAnswer(
        MissionGuess(legs[:, :2] * KM, legs[:, 3], legs[:, 4]),
        float(found[-1]) * KM if shape.n_planes else 0.0,
        float(answer["f"]),
        int(statistics["iter_count"]),
        str(statistics["return_status"]),
    )


def _unknowns(vehicle: Glider, shape: MissionShape, data: MissionData, guess: MissionGuess) -> tuple[Array, Array, Array]:
    """Return a guess as the program's unknowns, leg after leg, then the slacks, with their lower and upper bounds."""
    way = np.array([np.sum(np.abs(np.diff(data.depths[profile]))) for profile in shape.profiles])
    duration = way / np.asarray(vehicle.speeds(np, guess.angles)[1]) + data.drifts
    legs = np.column_stack([guess.places / KM, np.cumsum(duration) / HOUR, guess.headings, guess.angles])
    n_slacks = 4 * len(shape.goal_legs) + int(shape.guided) + (1 if shape.n_planes else 0)
    free, (shallow, steep) = np.inf, vehicle.angles
    lower = np.concatenate([np.tile([-free, -free, -free, -free, shallow], shape.n_legs), np.zeros(n_slacks)])
    upper = np.concatenate([np.tile([free, free, free, free, steep], shape.n_legs), np.full(n_slacks, free)])
    if data.guide is not None:
        lower[5 * (shape.n_legs - 1) + 2] = data.guide.least_duration / HOUR
    ends = guess.places[np.array(shape.goal_legs) - 1]
    missed = (ends - data.goals) / KM
    slacks = np.stack([np.maximum(missed, 0.0), np.maximum(-missed, 0.0)], axis=1).ravel()
    return np.concatenate([legs.ravel(), slacks, np.zeros(n_slacks - slacks.size)]), lower, upper


def _parameters(flow: FlowEstimate, data: MissionData) -> Array:
    missed = [0.0, data.penalty] if data.distance_weight is None else [data.distance_weight, _SMALL]
    weights = [data.time_weight, data.miss_weight, data.penalty, *missed]
    guide: list[Array] = []
    if data.guide is not None:
        guide = [data.guide.origin / KM, data.guide.across.ravel(order="F"), data.guide_weights.ravel(), data.guide_limits.ravel() / KM]
    profiles = data.depths if data.spline is None else ()
    latent = [stage_latent(data.latent, flow.levels, flow.depth_functions, depths).ravel(order="F") for depths in profiles]
    parts = [data.start, [data.start_time], data.goals.ravel(), *data.depths, data.drifts, data.planes.ravel(), weights, *guide, *latent]
    return np.concatenate([np.asarray(part) for part in parts])


def _program(flow: FlowEstimate, vehicle: Glider, shape: MissionShape, times: Array | None, spline: FlowSpline | None) -> Program:
    key = (*graph_key(flow), vehicle, shape, None if times is None else times.tobytes(), spline)
    if key not in _programs:
        _programs[key] = _build(flow, vehicle, shape, times, spline)
        if len(_programs) > _MOST_PROGRAMS:
            _programs.popitem(last=False)
    _programs.move_to_end(key)
    return _programs[key]


def _build(flow: FlowEstimate, vehicle: Glider, shape: MissionShape, times: Array | None, spline: FlowSpline | None) -> Program:
    n_legs, n_steps, n_goals, n_planes = shape.n_legs, shape.n_steps, len(shape.goal_legs), shape.n_planes
    start, start_time, goals = ca.MX.sym("start", 2), ca.MX.sym("start_time"), ca.MX.sym("goals", 2, n_goals)
    drifts, weights, profiles = ca.MX.sym("drifts", n_legs), ca.MX.sym("weights", 5), range(max(shape.profiles) + 1)
    depths = [ca.MX.sym("depths", n_steps + 1) for _ in profiles]
    n_latent = len(flow.latent) if spline is None else 0
    latent = [ca.MX.sym("latent", n_latent, (2 * n_steps + 2) * (1 if times is None else times.size)) for _ in profiles]
    planes = [ca.MX.sym("planes", 3, n_planes * shape.n_places) for _ in range(n_legs)]
    legs = [ca.MX.sym("leg", 5) for _ in range(n_legs)]
    slacks: Any = ca.MX.sym("slacks", 4, n_goals)
    trespass = ca.MX.sym("trespass", 1 if n_planes else 0)
    guide = GuideTerms(n_legs, shape.n_places if shape.guided else 0)
    leg = leg_function(flow, vehicle, n_steps, times, shape.drifts, spline)
    place, time = start, ca.MX.zeros(1)
    meet, within, passed = [], [], []
    for k in range(n_legs):
        profile = shape.profiles[k]
        heading, angle = legs[k][3], legs[k][4]
        places, end_time = leg(place, start_time + time * HOUR, heading, angle, depths[profile], drifts[k], latent[profile])
        meet.append(ca.vertcat(places[:, -1] / KM - legs[k][:2], (end_time - start_time) / HOUR - legs[k][2]))
        if n_planes:
            within.append(plane_violations(places / KM, planes[k], n_planes) - trespass)
        guide.add(k, places / KM)
        passed.append(places)
        place, time = legs[k][:2] * KM, legs[k][2]
    misses = [slacks[:2, g] - slacks[2:, g] for g in range(n_goals)]
    for g, (number, step) in enumerate(zip(shape.goal_legs, shape.goal_steps or (0,) * n_goals, strict=True)):
        at = legs[number - 1][:2] if step == 0 else passed[number - 1][:, step - 1] / KM
        meet.append(at - goals[:, g] / KM - misses[g])
    missed = weights[1] * sum(ca.sumsqr(miss) for miss in misses)
    missed += weights[3] * sum(ca.sqrt(ca.sumsqr(miss) + _BOWL**2) for miss in misses)
    program: dict[str, Any] = {
        "x": ca.veccat(*legs, slacks, guide.stray, trespass),
        "p": ca.veccat(start, start_time, goals, *depths, drifts, *planes, weights, *guide.parameters, *latent),
        "f": weights[0] * time
        + missed
        + weights[4] * ca.sum1(ca.vec(slacks))
        + weights[2] * (_TRESPASS * ca.sum1(trespass) + guide.strayed)
        + guide.cost,
        "g": ca.vertcat(*meet, *within, *guide.beyond),
    }
    n_equal = 3 * n_legs + 2 * n_goals
    n_within = (n_planes + int(shape.guided)) * shape.n_places * n_legs
    lower = np.concatenate([np.zeros(n_equal), np.full(n_within, -np.inf)])
    return Program(ca.nlpsol("mission", "ipopt", program, OPTIONS), lower, np.zeros(n_equal + n_within), program)
