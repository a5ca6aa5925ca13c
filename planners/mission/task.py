"""One mission in the local frame: its places, its forbidden rings, its legs' depths, and a guess made from a route."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planners.mission.flight import Currents, currents_of
from planners.mission.leg import leg_depths, step_stops, steps_needed
from planners.mission.program import MissionGuess
from planners.mission.reference_path import Guide
from planners.mission.values import MissionSettings
from planners.route.graph import Front, Route, build_front
from planners.route.hazards import Bathymetry, NoGo, Ring, first_violation, hazard_rings
from planners.route.region import Region, locate, region_of
from planners.route.table import tabulate
from planners.spline import FlowSpline, spline_of
from planners.vehicle import Glider
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.depth import depth_weights
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.plan import Place

# Dense steps for each of the optimiser's.
REFINED = 2
# So many times as fast as it is a vehicle has every doubt in its favour.
_MUCH_FASTER = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class MissionTask:
    """One planning problem.

    Attributes:
        currents: The current, K = 1.
        region: The forecast's.
        rings: Where the path may not go.
        vehicle: What glides.
        settings: How.
        start: shape (3,) [m], local east, north, depth.
        goals: shape (G, 3) [m].
        start_time: On the clock of the currents' times [s].
        guide: What the path is to stay near, if anything.
        spline: What the optimiser flies in instead of the currents; the check is of the currents.
    """

    currents: Currents
    region: Region
    rings: tuple[Ring, ...]
    vehicle: Glider
    settings: MissionSettings
    start: Array
    goals: Array
    start_time: float
    guide: Guide | None = None
    spline: FlowSpline | None = None

    @property
    def flow(self) -> FlowEstimate:
        """A flow on the nodes."""
        return self.currents.flow

    def deep_enough(self, points: Array) -> NDArray[np.bool_]:
        """Return whether points, shape (n, 2) [m], are water down to the dives' depth in the forecast."""
        return self.region.wet(np.column_stack([points, np.full(len(points), self.settings.depth)]))

    def turns(self, n_legs: int) -> tuple[tuple[float, ...], ...]:
        """Return the depths [m] at which each of so many legs begins, turns and ends."""
        yo = (0.0, *(self.settings.depth, 0.0) * self.settings.yos)
        legs = [yo] * n_legs
        legs[0] = (float(self.start[2]), *yo[1:])
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

    def n_steps(self, turns: tuple[tuple[float, ...], ...]) -> int:
        """Return the steps of a leg that are enough for each."""
        return max(steps_needed(leg, self.stops, self.settings.steps) for leg in turns)

    def depths(self, turns: tuple[tuple[float, ...], ...]) -> tuple[Array, ...]:
        """Return the depths [m] of each leg's steps."""
        n_steps = self.n_steps(turns)
        return tuple(leg_depths(leg, self.stops, n_steps) for leg in turns)

    def goal_steps(self, goal_legs: tuple[int, ...], n_legs: int, within: Array) -> tuple[int, ...]:
        """Return after which of its leg's steps each goal is met, counted from 1; 0 for the leg's end.

        Args:
            goal_legs: In which leg, counted from 1.
            n_legs: Number of legs.
            within: shape (G,), the share of its leg's way at which each goal would best be met.
        """
        depths, steps = self.depths(self.turns(n_legs)), []
        for k, (leg, share) in enumerate(zip(goal_legs, within, strict=True)):
            passes = np.flatnonzero(np.abs(depths[leg - 1][1:] - self.goals[k, 2]) < 1e-6) + 1
            if self.goals[k, 2] == 0.0 or k == len(self.goals) - 1:
                passes = np.zeros(1, dtype=int)
            way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(depths[leg - 1])))])
            steps.append(int(passes[np.argmin(np.abs(way[passes] / way[-1] - share))]))
        return tuple(steps)

    def drifts(self, turns: tuple[tuple[float, ...], ...]) -> Array:
        """Return the time [s] adrift after each leg: none at the end."""
        drifts = np.full(len(turns), self.settings.surface_time)
        drifts[-1] = 0.0
        return drifts

    def leg_time(self, angle: float) -> float:
        """Return how long a leg takes at a glide angle [rad], with its drift [s]."""
        down = float(self.vehicle.speeds(np, angle)[1])
        return 2.0 * self.settings.yos * self.settings.depth / down + self.settings.surface_time


def mission_task(
    flow: FlowEstimate | Sequence[FlowEstimate],
    places: tuple[Place, tuple[Place, ...]],
    vehicle: Glider,
    settings: MissionSettings,
    areas: tuple[tuple[NoGo, ...], Bathymetry | None],
    start_time_ns: int,
) -> MissionTask:
    """Return a mission in the local frame of its flow.

    Raises:
        PlanError: A place is outside of the region, on land or where the mission may not go, or the dives are deeper than the flow.
    """
    currents = currents_of(flow)
    region = region_of(currents.flow.grid)
    start, goals = places
    if not goals:
        raise PlanError("a mission needs a goal; give one or several")
    if min(settings.legs or settings.max_legs, settings.max_legs) < len(goals):
        most = min(settings.legs or settings.max_legs, settings.max_legs)
        raise PlanError(f"{len(goals)} goals need as many legs, as each is met at the end of one, but only {most} are allowed; allow more")
    if settings.depth > region.deepest:
        raise PlanError(f"dives to {settings.depth:g} m are deeper than the deepest level, {region.deepest:g} m; choose a lesser depth")
    names = ["goal"] if len(goals) == 1 else [f"goal {k + 1}" for k in range(len(goals))]
    deepest = max(goal.depth for goal in goals)
    if deepest > settings.depth:
        raise PlanError(f"the goal at {deepest:g} m is deeper than the dives, {settings.depth:g} m; choose deeper dives")
    begin, ends = locate(region, start, "start"), np.array([locate(region, goal, name) for goal, name in zip(goals, names, strict=True)])
    rings = hazard_rings(region, settings.depth, *areas)
    for name, point in zip(["start", *names], [begin, *ends], strict=True):
        inside = first_violation(rings, point[None, :2], surfacing=name != "start" and point[2] == 0.0)
        if inside is not None or not region.wet(np.array([[*point[:2], settings.depth]]))[0]:
            why = "land" if inside is None else inside[0]
            raise PlanError(f"{name} is where dives to {settings.depth:g} m may not go: {why}; move it, or dive less deep")
    if settings.spline and currents.times is not None:
        raise PlanError("a spline holds for one estimate, not for a flow that changes; plan such a mission without")
    spline = spline_of(currents.flow, settings.spline) if settings.spline and np.all(np.isfinite(currents.latent)) else None
    return MissionTask(currents, region, rings, vehicle, settings, begin, ends, time_on_clock(currents, start_time_ns), spline=spline)


def time_on_clock(currents: Currents, time_ns: int) -> float:
    """Return a time [ns, UTC] on the clock of the currents' times [s]; 0 for currents that do not change, and for no time."""
    first = currents.flow.time_ns
    return 0.0 if currents.times is None or first is None or time_ns == 0 else (time_ns - first) / 1e9


def front_of(task: MissionTask, rings: tuple[Ring, ...], *, faster: float = 1.0, anywhere: bool = False) -> Front:
    """Return the graph of the mean current of the mission's dives, at its beginning.

    Args:
        task: The problem.
        rings: What it keeps clear of.
        faster: How many times as fast as it is the vehicle is taken to be.
        anywhere: Whether it goes over land as well.
    """
    flow, table = task.flow, tabulate(task.flow, task.region)
    angle = task.vehicle.angles[0]
    sampled = np.linspace(0.0, task.settings.depth, 101)
    by_level = depth_weights(flow.depth_functions, sampled, table.depths if flow.depth_functions.kind == "hat" else flow.levels).mean(
        axis=0
    )
    if flow.depth_functions.kind != "hat":
        nearest = np.argmin(np.abs(table.depths[None] - sampled[:, None]), axis=1)
        by_level = np.bincount(nearest, minlength=table.depths.size) / sampled.size
    adrift = task.settings.surface_time / task.leg_time(angle)
    shares = (1.0 - adrift) * by_level + adrift * (np.arange(table.depths.size) == 0)
    along = float(task.vehicle.speeds(np, angle)[0])
    wet = (lambda points: np.ones(len(points), dtype=bool)) if anywhere else task.deep_enough
    return build_front(table, shares, rings, wet, faster * (1.0 - adrift) * along)


def out_of_reach(task: MissionTask) -> bool:
    """Return whether a much faster vehicle that nothing stops would not pass all goals in the time of the most legs allowed either.

    The graph knows the current's mean over the dives alone: that it finds no way for the vehicle as it is proves nothing.
    """
    if task.settings.weighs_distance or task.guide is not None:
        return False
    longest = (task.settings.legs or task.settings.max_legs) * task.leg_time(task.vehicle.angles[0])
    return not route_of(task, front_of(task, (), faster=_MUCH_FASTER, anywhere=True), longest)[0].arrives


def route_of(task: MissionTask, front: Front, longest: float) -> tuple[Route, Array]:
    """Return the quickest route past all goals, none of its parts longer than ``longest`` [s], and when it passes them [s]."""
    points, times, passed, arrives = [task.start[None, :2]], [np.zeros(1)], [], True
    for goal in task.goals:
        route = front.route(points[-1][-1], goal[:2], longest)
        points.append(route.points[1:])
        times.append(times[-1][-1] + route.times[1:])
        passed.append(float(times[-1][-1]))
        arrives = arrives and route.arrives
    return Route(np.concatenate(points), np.concatenate(times), arrives), np.array(passed)


def guess_of(task: MissionTask, route: Route, front: Front, n_legs: int) -> MissionGuess:
    """Return the route cut into legs of equal time, with the headings that follow it in the mean current."""
    times = route.times[-1] * np.arange(n_legs + 1) / n_legs
    places = route.at(times)
    angles = np.linspace(*task.vehicle.angles, 64)
    lasting = np.array([task.leg_time(float(angle)) for angle in angles])
    angle = float(angles[np.argmin(np.abs(lasting - times[1]))])
    through = np.diff(places, axis=0) / max(times[1], 1.0) - front.current_at(0.5 * (places[1:] + places[:-1]))
    return MissionGuess(places[1:], np.arctan2(through[:, 0], through[:, 1]), np.full(n_legs, angle))
