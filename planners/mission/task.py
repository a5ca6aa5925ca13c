"""One mission in the local frame: its places, hazards and depth profiles, and an initial guess from a route."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planners.mission.flight import Currents, currents_of
from planners.mission.leg import leg_depths, step_stops, steps_needed
from planners.mission.program import MissionGuess
from planners.mission.reference_path import ReferencePath
from planners.mission.values import MissionRequest, MissionSettings
from planners.route.graph import Route, RouteGraph, build_route_graph
from planners.route.hazards import Ring, first_violation, hazard_rings
from planners.route.region import Region, locate, region_of
from planners.route.table import tabulate
from planners.spline import FlowSpline, spline_of
from planners.vehicle import Glider
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.depth import depth_weights
from replay_kit.core.flow.estimate import FlowEstimate

# Dense steps for each of the optimiser's.
REFINED = 2
# Speed ratio of a vehicle that has every doubt in its favour.
_MUCH_FASTER = 2.0
# Glide angles among which the one of a given leg time is chosen.
_ANGLES = 64

YoDepths = tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class MissionTask:
    """One planning problem in the local frame.

    Attributes:
        request: What is asked for.
        currents: The current, K = 1.
        region: The forecast's.
        rings: What the path must keep clear of.
        start: shape (3,) [m], local east, north, depth.
        goals: shape (G, 3) [m].
        start_time: On the clock of the currents' times [s].
        reference_path: That the track is to stay near; None without.
        spline: That the optimiser uses instead of the currents; the check uses the currents.
    """

    request: MissionRequest
    currents: Currents
    region: Region
    rings: tuple[Ring, ...]
    start: Array
    goals: Array
    start_time: float
    reference_path: ReferencePath | None = None
    spline: FlowSpline | None = None

    @property
    def vehicle(self) -> Glider:
        """The glider."""
        return self.request.vehicle

    @property
    def settings(self) -> MissionSettings:
        """How the mission is flown and planned."""
        return self.request.settings

    @property
    def flow(self) -> FlowEstimate:
        """A flow on the nodes."""
        return self.currents.flow

    @property
    def is_finite(self) -> bool:
        """Whether the current is a number everywhere."""
        return bool(np.all(np.isfinite(self.currents.latent)))

    def deep_enough(self, points: Array) -> NDArray[np.bool_]:
        """Return whether points, shape (n, 2) [m], are water down to the dives' depth in the forecast."""
        return self.region.wet(np.column_stack([points, np.full(len(points), self.settings.depth)]))

    def yo_depths(self, n_legs: int) -> tuple[YoDepths, ...]:
        """Return the depths [m] at which each of ``n_legs`` legs begins, turns and ends."""
        yo = (0.0, *(self.settings.depth, 0.0) * self.settings.yos)
        if n_legs == 0:
            return ()
        legs = [(float(self.start[2]), *yo[1:]), *[yo] * (n_legs - 1)]
        deep = float(self.goals[-1, 2])
        if deep > 0.0:
            # the last dive ends at the goal's depth on its way down; after other dives, or from below the surface, on its way up
            down_at_once = self.settings.yos == 1 and legs[-1][0] == 0.0
            legs[-1] = (0.0, deep) if down_at_once else (*legs[-1][:-1], deep)
        return tuple(legs)

    @property
    def stops(self) -> Array:
        """Depths [m] at which steps end: the flow's levels, and those of the goals met on the way."""
        return step_stops(self.flow.levels, self.goals[:, 2])

    def n_steps(self, yo_depths: tuple[YoDepths, ...]) -> int:
        """Return the number of steps that is enough for each leg."""
        return max(steps_needed(leg, self.stops, self.settings.steps) for leg in yo_depths)

    def depths(self, yo_depths: tuple[YoDepths, ...]) -> tuple[Array, ...]:
        """Return the depths [m] of each leg's steps."""
        n_steps = self.n_steps(yo_depths)
        return tuple(leg_depths(leg, self.stops, n_steps) for leg in yo_depths)

    def goal_steps(self, goal_legs: tuple[int, ...], n_legs: int, within: Array) -> tuple[int, ...]:
        """Return after which step of its leg each goal is met, counted from 1; 0 for the leg's end.

        Args:
            goal_legs: In which leg, counted from 1.
            n_legs: Number of legs.
            within: shape (G,), the share of its leg's distance at which each goal would best be met.
        """
        depths, steps = self.depths(self.yo_depths(n_legs)), []
        for k, (leg, share) in enumerate(zip(goal_legs, within, strict=True)):
            passes = np.flatnonzero(np.abs(depths[leg - 1][1:] - self.goals[k, 2]) < 1e-6) + 1
            if self.goals[k, 2] == 0.0 or k == len(self.goals) - 1:
                passes = np.zeros(1, dtype=int)
            distance = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(depths[leg - 1])))])
            steps.append(int(passes[np.argmin(np.abs(distance[passes] / distance[-1] - share))]))
        return tuple(steps)

    def drifts(self, n_legs: int) -> Array:
        """Return the drift time [s] after each leg: none at the end."""
        return np.append(np.full(n_legs - 1, self.settings.surface_time), 0.0)

    def leg_time(self, angle: float) -> float:
        """Return the duration of a leg at a glide angle [rad], with its drift [s]."""
        down = float(self.vehicle.speeds(np, angle)[1])
        return 2.0 * self.settings.yos * self.settings.depth / down + self.settings.surface_time

    def angle_of(self, leg_time: float) -> float:
        """Return the glide angle [rad] at which a leg comes nearest to a duration [s]."""
        angles = np.linspace(*self.vehicle.angles, _ANGLES)
        times = np.array([self.leg_time(float(angle)) for angle in angles])
        return float(angles[np.argmin(np.abs(times - leg_time))])


def mission_task(flow: FlowEstimate | Sequence[FlowEstimate], request: MissionRequest) -> MissionTask:
    """Return a mission in the local frame of its flow.

    Raises:
        PlanError: A place is outside of the region, on land or where the mission may not go, or the dives are deeper than the flow.
    """
    currents, settings = currents_of(flow), request.settings
    region = region_of(currents.flow.grid)
    _check_request(request, region)
    names = ["goal"] if len(request.goals) == 1 else [f"goal {k + 1}" for k in range(len(request.goals))]
    start = locate(region, request.start, "start")
    goals = np.array([locate(region, goal, name) for goal, name in zip(request.goals, names, strict=True)])
    rings = hazard_rings(region, settings.depth, request.no_go, request.bathymetry)
    for name, point in zip(["start", *names], [start, *goals], strict=True):
        crossed = first_violation(rings, point[None, :2], surfacing=name != "start" and point[2] == 0.0)
        if crossed is not None or not region.wet(np.array([[*point[:2], settings.depth]]))[0]:
            why = "land" if crossed is None else crossed[0]
            raise PlanError(f"{name} is where dives to {settings.depth:g} m may not go: {why}; move it, or dive less deep")
    if settings.spline and currents.times is not None:
        raise PlanError("a spline represents one estimate, not a flow that changes in time; plan such a mission without it")
    task = MissionTask(request, currents, region, rings, start, goals, time_on_clock(currents, request.start_time_ns))
    return replace(task, spline=spline_of(currents.flow, settings.spline)) if settings.spline and task.is_finite else task


def _check_request(request: MissionRequest, region: Region) -> None:
    """Raise PlanError when there are no goals, too few legs for them, or dives that do not fit goals and flow."""
    goals, settings = request.goals, request.settings
    if not goals:
        raise PlanError("a mission needs a goal; give one or several")
    most = min(settings.legs or settings.max_legs, settings.max_legs)
    if most < len(goals):
        raise PlanError(f"{len(goals)} goals need as many legs, as each is met at the end of one, but only {most} are allowed; allow more")
    if settings.depth > region.deepest:
        raise PlanError(f"dives to {settings.depth:g} m are deeper than the deepest level, {region.deepest:g} m; choose a lesser depth")
    deepest = max(goal.depth for goal in goals)
    if deepest > settings.depth:
        raise PlanError(f"the goal at {deepest:g} m is deeper than the dives, {settings.depth:g} m; choose deeper dives")


def time_on_clock(currents: Currents, time_ns: int) -> float:
    """Return a time [ns, UTC] on the clock of the currents' times [s]; 0 for currents that do not change, and for no time."""
    first = currents.flow.time_ns
    return 0.0 if currents.times is None or first is None or time_ns == 0 else (time_ns - first) / 1e9


def route_graph_of(task: MissionTask, rings: tuple[Ring, ...], *, speed_ratio: float = 1.0, over_land: bool = False) -> RouteGraph:
    """Return the graph of the mean current over the mission's dives, at its beginning.

    Args:
        task: The problem.
        rings: What the route keeps clear of.
        speed_ratio: Speed of the route's vehicle over that of the glider.
        over_land: Whether the route may cross land.
    """
    flow, table = task.flow, tabulate(task.flow, task.region)
    angle, depths = task.vehicle.angles[0], np.linspace(0.0, task.settings.depth, 101)
    if flow.depth_functions.kind == "hat":
        by_level = depth_weights(flow.depth_functions, depths, table.depths).mean(axis=0)
    else:
        nearest = np.argmin(np.abs(table.depths[None] - depths[:, None]), axis=1)
        by_level = np.bincount(nearest, minlength=table.depths.size) / depths.size
    drift_share = task.settings.surface_time / task.leg_time(angle)
    shares = (1.0 - drift_share) * by_level + drift_share * (np.arange(table.depths.size) == 0)
    along = float(task.vehicle.speeds(np, angle)[0])
    wet = (lambda points: np.ones(len(points), dtype=bool)) if over_land else task.deep_enough
    return build_route_graph(table, shares, rings, wet, speed_ratio * (1.0 - drift_share) * along)


def is_out_of_reach(task: MissionTask) -> bool:
    """Return whether even a much faster vehicle without constraints would not pass all goals within the largest number of legs.

    The graph only knows the mean current over the dives: that it finds no route for the glider itself proves nothing.
    """
    if task.settings.weighs_distance or task.reference_path is not None:
        return False
    longest = (task.settings.legs or task.settings.max_legs) * task.leg_time(task.vehicle.angles[0])
    return not find_route(task, route_graph_of(task, (), speed_ratio=_MUCH_FASTER, over_land=True), longest)[0].arrives


def find_route(task: MissionTask, graph: RouteGraph, longest: float) -> tuple[Route, Array]:
    """Return the quickest route past all goals, none of its parts longer than ``longest`` [s], and when it passes each goal [s]."""
    points, times, passed, arrives = [task.start[None, :2]], [np.zeros(1)], [], True
    for goal in task.goals:
        route = graph.route(points[-1][-1], goal[:2], longest)
        points.append(route.points[1:])
        times.append(times[-1][-1] + route.times[1:])
        passed.append(float(times[-1][-1]))
        arrives = arrives and route.arrives
    return Route(np.concatenate(points), np.concatenate(times), arrives), np.array(passed)


def initial_guess(task: MissionTask, route: Route, graph: RouteGraph, n_legs: int) -> MissionGuess:
    """Return the route cut into legs of equal time, with the headings that follow it in the mean current."""
    times = route.times[-1] * np.arange(n_legs + 1) / n_legs
    places = route.at(times)
    through = np.diff(places, axis=0) / max(times[1], 1.0) - graph.current_at(0.5 * (places[1:] + places[:-1]))
    return MissionGuess(places[1:], np.arctan2(through[:, 0], through[:, 1]), np.full(n_legs, task.angle_of(times[1])))
