"""A glider's mission as a nonlinear program: multiple shooting over its legs.

The unknowns are the heading and the glide angle of each leg, the place and the time of its end, and slack variables. Places are in
kilometres, times in hours, angles in radians: all of order one to a hundred. The functions and their derivatives are computed for all legs
at once; what is kept for further missions of the same shape is the order of their entries, and the solvers.
"""

from dataclasses import dataclass, field

import numpy as np

from planners.shooting.callbacks import Program
from planners.shooting.frames import FrameMap
from planners.shooting.functions import MissionCase, MissionFunctions, Reference
from planners.shooting.layout import Layout
from planners.shooting.schedule import schedule_of
from planners.shooting.spline import FlowSpline
from planners.shooting.stream import stream_of
from planners.shooting.walls import Walls
from planners.solver import HOUR, KM, Recent, one_at_a_time
from planners.vehicle import Glider
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate

#: A kilometre beyond the allowed distance costs as much as this many hours of the penalty of a kilometre missed.
REFERENCE_SLACK_COST = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class ReferencePath:
    """A place or a line that a track is to stay near.

    Attributes:
        name: Its name in messages.
        origin: shape (2,) [m], the place, or a point of the line; local east and north.
        across: shape (2, 2), projection of the vector from the origin on what counts: all of it, or its part across the line.
        limit: Largest distance allowed [m].
        weight: Cost of an hour at a distance of a kilometre; it grows with the squared distance.
        surfacings_only: Whether only the places of surfacing count, and not the track between them.
        least_duration: Of the mission [s].
    """

    name: str
    origin: Array
    across: Array
    limit: float
    weight: float
    surfacings_only: bool
    least_duration: float

    def distances(self, points: Array) -> Array:
        """Return the distances [m] of points, shape (n, 2) [m], from the place or line."""
        return np.asarray(np.linalg.norm((points - self.origin) @ self.across.T, axis=1))

    def farthest_and_rms(self, time: Array, points: Array, ends: Array) -> tuple[float, float]:
        """Return the largest distance of a track and its root mean square [m], over time or over the surfacings.

        Args:
            time: shape (n,) [s].
            points: shape (n, 2) [m].
            ends: Numbers of the points at which a leg ends.
        """
        if self.surfacings_only:
            distances = self.distances(points[ends])
            return float(distances.max()), float(np.sqrt(np.mean(distances**2)))
        distances = self.distances(points)
        return float(distances.max()), float(np.sqrt(np.trapezoid(distances**2, time) / time[-1]))


def near_place(
    place: Array, radius: float, duration: float, surfacings_only: bool
) -> ReferencePath:
    """Return the reference path of a mooring within a radius [m] of a place, shape (2,) [m], for a duration [s]."""
    return ReferencePath(
        "the mooring", place, np.eye(2), radius, 3600.0 / duration, surfacings_only, duration
    )


def along_line(begin: Array, end: Array, weight: float, width: float) -> ReferencePath:
    """Return the reference path of the line between two points, shape (2,) [m].

    Args:
        begin: Of the line.
        end: Of the line.
        weight: Cross-track penalty [h per h and km].
        width: Largest distance allowed [m].
    """
    along = (end - begin) / np.linalg.norm(end - begin)
    normal = np.array([along[1], -along[0]])
    return ReferencePath("the line", begin, np.outer(normal, normal), width, weight, False, 0.0)


# A kilometre beyond a half-plane costs as much as this many kilometres missed along one axis.
_PLANE_COST = 4.0
# Weight of slacks that are not to count.
_SMALL = 1e-6


@dataclass(frozen=True, slots=True)
class MissionShape:
    """What makes two missions share a program.

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

    def layout(self, changing: bool) -> Layout:
        """Return where the program's unknowns and constraints are, in a flow that changes or not."""
        steps = self.goal_steps or (0,) * len(self.goal_legs)
        goals = tuple((leg - 1, step) for leg, step in zip(self.goal_legs, steps, strict=True))
        return Layout(
            self.n_legs, goals, self.n_places, self.n_planes, self.has_reference, changing
        )


@dataclass(frozen=True, slots=True, eq=False)
class MissionModel:
    """What a mission is optimised in.

    Attributes:
        flow: Any flow of the same functions; the latent values are data.
        vehicle: The glider.
        shape: Numbers of legs, steps and goals.
        times: Of the latent values, shape (T,) [s]; None for a flow that does not change.
        spline: Used instead of the flow.
    """

    flow: FlowEstimate
    vehicle: Glider
    shape: MissionShape
    times: Array | None = None
    spline: FlowSpline | None = None

    @property
    def program(self) -> Program:
        """The program, made once for missions of one shape, in whatever flow."""
        layout = self.shape.layout(self.times is not None)
        projection = self.flow.grid.projection
        return _programs.get(
            (projection, self.vehicle, layout),
            lambda: Program(
                MissionFunctions(layout, FrameMap(projection, self.vehicle, layout.n_legs))
            ),
        )


@dataclass(frozen=True, slots=True, eq=False)
class MissionData:
    """The parameters of one mission's program.

    Attributes:
        start: shape (2,) [m].
        start_time: [s], on the clock of the flow's times.
        goals: shape (G, 2) [m].
        depths: One for each profile, shape (n_steps + 1,) [m].
        drifts: shape (L,) [s], at the surface after each leg.
        walls: What its places keep clear of; None for nothing.
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
    walls: Walls | None
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
        through: shape (L, 2, 2), derivatives of the places where legs end by those where they begin; None where nothing was solved.
        places: shape (L, n_places, 2) [m], at which half-planes count; None where nothing was solved.
    """

    guess: MissionGuess
    plane_violation: float
    objective: float
    iterations: int
    return_status: str
    through: Array | None
    places: Array | None = None


_programs = Recent[Program](8)


@one_at_a_time
def solve_mission(
    model: MissionModel, data: MissionData, guess: MissionGuess, *, warm_start: bool = False
) -> MissionSolution:
    """Return the local optimum that IPOPT finds from a guess.

    Args:
        model: What the program is made from.
        data: Its parameters.
        guess: Where to begin.
        warm_start: Whether the guess is the optimum of nearly the same problem.
    """
    program, shape = model.program, model.shape
    solver = program.solver(warm_start)
    unknowns, lower, upper = _unknowns(model.vehicle, shape, data, guess)
    program.functions.give(_case(model, data))
    answer = solver(x0=unknowns, lbx=lower, ubx=upper, lbg=program.lower, ubg=program.upper)
    statistics = solver.stats()
    found = np.asarray(answer["x"]).ravel()
    legs = found[: 5 * shape.n_legs].reshape(shape.n_legs, 5)
    return MissionSolution(
        MissionGuess(legs[:, :2] * KM, legs[:, 3], legs[:, 4]),
        float(found[-1]) * KM if shape.n_planes else 0.0,
        float(answer["f"]),
        int(statistics["iter_count"]),
        str(statistics["return_status"]),
        program.functions.first(found)[1].places[:, -1, :, :2],
        program.functions.places(found),
    )


def _unknowns(
    vehicle: Glider, shape: MissionShape, data: MissionData, guess: MissionGuess
) -> tuple[Array, Array, Array]:
    """Return a guess as the program's unknowns, leg after leg, then the slacks, with their lower and upper bounds."""
    distance = np.array(
        [np.sum(np.abs(np.diff(data.depths[profile]))) for profile in shape.profiles]
    )
    duration = distance / np.asarray(vehicle.speeds(np, guess.angles)[1]) + data.drifts
    legs = np.column_stack(
        [guess.places / KM, np.cumsum(duration) / HOUR, guess.headings, guess.angles]
    )
    n_slacks = 4 * len(shape.goal_legs) + int(shape.has_reference) + int(shape.n_planes > 0)
    shallow, steep = vehicle.angles
    lower = np.concatenate([np.tile([*[-np.inf] * 4, shallow], shape.n_legs), np.zeros(n_slacks)])
    upper = np.concatenate(
        [np.tile([*[np.inf] * 4, steep], shape.n_legs), np.full(n_slacks, np.inf)]
    )
    if data.reference_path is not None:
        lower[5 * (shape.n_legs - 1) + 2] = data.reference_path.least_duration / HOUR
    miss = (guess.places[np.array(shape.goal_legs) - 1] - data.goals) / KM
    slacks = np.stack([np.maximum(miss, 0.0), np.maximum(-miss, 0.0)], axis=1).ravel()
    return np.concatenate([legs.ravel(), slacks, np.zeros(n_slacks - slacks.size)]), lower, upper


def _case(model: MissionModel, data: MissionData) -> MissionCase:
    """Return the numbers of a mission as the program's functions take them."""
    shape, flow, reference = model.shape, model.flow, data.reference_path
    depths = [data.depths[profile] for profile in shape.profiles]
    schedule = schedule_of(
        depths, data.drifts, shape.drifts, flow.levels, flow.depth_functions, model.times
    )
    linear, each = (
        (0.0, data.penalty) if data.distance_weight is None else (data.distance_weight, _SMALL)
    )
    return MissionCase(
        stream_of(flow, data.latent) if model.spline is None else model.spline,
        schedule,
        schedule.lengths,
        data.drifts if shape.drifts else np.zeros(shape.n_legs),
        data.start,
        data.start_time,
        data.goals,
        data.walls,
        data.time_weight,
        (data.miss_weight, linear, each),
        data.penalty * _PLANE_COST,
        None if reference is None else _reference(reference, data),
    )


def _reference(path: ReferencePath, data: MissionData) -> Reference:
    """Return a reference path as the program's functions take it."""
    return Reference(
        path.origin / KM,
        path.across,
        data.reference_weights,
        data.reference_limits / KM,
        data.penalty * REFERENCE_SLACK_COST,
    )
