"""One mission in the local frame: its places, hazards and depth profiles."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import inf
from time import monotonic

import numpy as np

from planners.hazards.areas import NoGo, Ring, check_outside
from planners.hazards.bottom import DEPTH_TOLERANCE, Bathymetry, Bottom, bottom_of, fixed_rings
from planners.hazards.domain import Region, locate_all
from planners.request import MissionPlan, MissionRequest, MissionSettings
from planners.route.current import Complex
from planners.route.obstacles import as_complex
from planners.shooting.program import ReferencePath
from planners.shooting.spline import FlowSpline, spline_of
from planners.simulation.currents import Currents, Flow, currents_of
from planners.track import fractions_of_duration
from planners.vehicle import Glider
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate

# Dense steps for each of the optimiser's.
REFINED = 2
# Glide angles among which the one of a given leg time is chosen.
_ANGLES = 64
# Least distance around start and goals that the spline of the flow covers [m].
_AROUND = 1e5
# Dives that turn above this are of no use [m].
LEAST_DIVE = 10.0
YoDepths = tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class MissionTask:
    """One planning problem in the local frame.

    Attributes:
        request: What is asked for.
        currents: The current, K = 1.
        region: The forecast's.
        rings: What the path must keep clear of at any depth.
        bottom: What limits the depth of its dives.
        start: shape (3,) [m], local east, north, depth.
        goals: shape (G, 3) [m].
        start_time: On the clock of the currents' times [s].
        reference_path: That the track is to stay near; None without.
        spline: That the optimiser uses instead of the currents; the check uses the currents.
        deadline: On the machine's clock, after which nothing else is tried [s].
        turns: Depth at which the dives of each leg turn [m], where the bottom limits them; None where all turn at that of the settings.
    """

    request: MissionRequest
    currents: Currents
    region: Region
    rings: tuple[Ring, ...]
    bottom: Bottom
    start: Array
    goals: Array
    start_time: float
    reference_path: ReferencePath | None = None
    spline: FlowSpline | None = None
    deadline: float = inf
    turns: tuple[float, ...] | None = None

    @property
    def is_late(self) -> bool:
        """Whether the time limit of the search is over."""
        return monotonic() > self.deadline

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

    @property
    def places(self) -> Complex:
        """Start and goals, shape (1 + G,) [m], east + i north."""
        return as_complex(np.vstack([self.start, self.goals])[:, :2])

    @property
    def from_start(self) -> Array:
        """Horizontal distances of the goals from the start, shape (G,) [m]."""
        return np.asarray(np.linalg.norm(self.goals[:, :2] - self.start[:2], axis=1))

    def rings_at(self, depth: float) -> tuple[Ring, ...]:
        """Return what a path that reaches a depth [m] must keep clear of."""
        return (*self.rings, *self.bottom.rings(depth))

    def yo_depths(self, n_legs: int) -> tuple[YoDepths, ...]:
        """Return the depths [m] at which each of ``n_legs`` legs begins, turns and ends."""
        if n_legs == 0:
            return ()
        turns = (self.settings.depth,) * n_legs if self.turns is None else self.turns
        assert len(turns) == n_legs, "each leg has a depth at which its dives turn"
        legs = [(0.0, *(turn, 0.0) * self.settings.yos) for turn in turns]
        legs[0] = (float(self.start[2]), *legs[0][1:])
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
        return max(
            steps_needed(leg, self.stops, self.settings.steps) for leg in dict.fromkeys(yo_depths)
        )

    def depths(self, yo_depths: tuple[YoDepths, ...]) -> tuple[Array, ...]:
        """Return the depths [m] of each leg's steps."""
        n_steps = self.n_steps(yo_depths)
        profiles = {leg: leg_depths(leg, self.stops, n_steps) for leg in dict.fromkeys(yo_depths)}
        return tuple(profiles[leg] for leg in yo_depths)

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

    def leg_time(self, angle: float, depth: float | None = None) -> float:
        """Return the duration of a leg at a glide angle [rad] to a depth [m], by default that of the settings, with its drift [s]."""
        down = float(self.vehicle.speeds(np, angle)[1])
        deep = self.settings.depth if depth is None else depth
        return 2.0 * self.settings.yos * deep / down + self.settings.surface_time

    def angle_of(self, leg_time: float, depth: float | None = None) -> float:
        """Return the glide angle [rad] at which a leg to a depth [m] comes nearest to a duration [s]."""
        angles = np.linspace(*self.vehicle.angles, _ANGLES)
        times = np.array([self.leg_time(float(angle), depth) for angle in angles])
        return float(angles[np.argmin(np.abs(times - leg_time))])


def turns_of(yo_depths: tuple[YoDepths, ...]) -> tuple[float, ...]:
    """Return the depth at which the dives of each leg turn [m]."""
    return tuple(max(leg[1:]) for leg in yo_depths)


def task_of_plan(
    flow: Flow, plan: MissionPlan, no_go: tuple[NoGo, ...], bathymetry: Bathymetry | None
) -> MissionTask:
    """Return the task of a mission that is planned, in a flow that may be another and with what it must keep clear of."""
    places = plan.start, plan.goals, plan.vehicle, plan.settings
    return mission_task(
        flow, MissionRequest(*places, no_go, bathymetry, start_time_ns=plan.start_time_ns)
    )


def mission_task(flow: Flow, request: MissionRequest) -> MissionTask:
    """Return a mission in the local frame of its flow.

    Raises:
        PlanError: A place is outside of the region, on land or where the mission may not go, or the dives are deeper than the flow is or
            the vehicle may go.
    """
    currents, settings = currents_of(flow), request.settings
    region = Region(currents.flow.grid, request.vehicle.max_depth)
    _check_request(request, region)
    located = locate_all(region, request.start, request.goals)
    start, *others = located.values()
    goals = np.array(others)
    bottom = bottom_of(region, request.bathymetry, settings.clearance)
    rings = fixed_rings(region, request.no_go, bottom)
    for name, point in located.items():
        _check_place(rings, bottom, name, point)
    # a region that is less deep everywhere needs no search for how deep each dive may be
    depth = min(
        settings.depth, max(bottom.deepest, LEAST_DIVE, float(np.max(goals[:, 2])), float(start[2]))
    )
    request = replace(request, settings=replace(settings, depth=depth))
    clock = currents.clock(request.start_time_ns)
    deadline = monotonic() + settings.time_limit
    task = MissionTask(
        request, currents, region, rings, bottom, start, goals, clock, deadline=deadline
    )
    if not settings.spline or not task.is_finite:
        return task
    return replace(
        task,
        spline=spline_of(
            currents.flow, currents.latent[0], settings.spline, *_surroundings(start, goals)
        ),
    )


def _surroundings(start: Array, goals: Array) -> tuple[Array, Array]:
    """Return the corners of a box, shape (2,) [m] each, that a mission from a start past goals hardly ever leaves."""
    known = np.concatenate([start[None, :2], goals[:, :2]])
    low, high = known.min(axis=0), known.max(axis=0)
    around = max(_AROUND, 0.5 * float(np.max(high - low)))
    return low - around, high + around


def _check_place(rings: tuple[Ring, ...], bottom: Bottom, name: str, point: Array) -> None:
    """Raise PlanError where a mission may not begin or end: in an area, or where the bottom leaves no room for a dive."""
    surfacing = name != "start" and point[2] == 0.0
    check_outside([ring for ring in rings if surfacing or not ring.surface_only], name, point)
    deepest, needed = float(bottom.limit_at(point[None, :2])[0]), max(float(point[2]), LEAST_DIVE)
    if deepest < needed - DEPTH_TOLERANCE:
        room = (
            f"the bottom less a clearance of {bottom.clearance:g} m leaves {deepest:g} m"
            if np.isfinite(deepest)
            else "land"
        )
        raise PlanError(
            f"{name} is where dives to {needed:g} m may not go: {room}; move it to deeper water"
        )


def _check_request(request: MissionRequest, region: Region) -> None:
    """Raise PlanError when there are no goals, too few legs for them, or dives that do not fit goals and flow."""
    goals, settings = request.goals, request.settings
    if not goals:
        raise PlanError("a mission needs a goal; give one or several")
    most = min(settings.legs or settings.most_legs, settings.most_legs)
    if most < len(goals):
        raise PlanError(
            f"{len(goals)} goals need as many legs, as each is met at the end of one, but only {most:g} are allowed; allow more"
        )
    if settings.depth > region.deepest:
        raise PlanError(
            f"dives to {settings.depth:g} m are deeper than {region.floor}; choose a lesser depth"
        )
    deepest = max(goal.depth for goal in goals)
    if deepest > settings.depth:
        raise PlanError(
            f"the goal at {deepest:g} m is deeper than the dives, {settings.depth:g} m; choose deeper dives"
        )


def leg_depths(depths: tuple[float, ...], levels: Array, n_steps: int) -> Array:
    """Return the depths [m] of a leg's steps, shape (n_steps + 1,), its turning points and each level crossed among them.

    Args:
        depths: Where the leg begins, turns and ends [m].
        levels: shape (Z,) [m]; hats bend there, and a step across a bend would lose the integrator's order.
        n_steps: Number of steps.
    """
    distance = np.abs(np.diff(depths))
    # Steps go in proportion to the distance, but no part has fewer than it has levels.
    least = np.array(
        [1 + np.sum((levels > min(a, b)) & (levels < max(a, b))) for a, b in pairwise(depths)]
    )
    counts = least.copy()
    for _ in range(n_steps - int(least.sum())):
        counts[np.argmax(distance / counts)] += 1
    parts = [
        a + (b - a) * fractions_of_duration(a, b, levels, int(n))
        for a, b, n in zip(depths[:-1], depths[1:], counts, strict=True)
    ]
    return np.concatenate([*(part[:-1] for part in parts), [depths[-1]]])


def step_stops(levels: Array, goal_depths: Array) -> Array:
    """Return the depths [m] at which steps end: the levels, shape (Z,), and those of goals below the surface."""
    return np.union1d(levels, goal_depths[goal_depths > 0.0])


def apogee_depths(yo_depths: Sequence[YoDepths]) -> float:
    """Return the sum of the depths of the apogees of legs [m], where the pump works."""
    return float(
        sum(leg[i] for leg in yo_depths for i in range(1, len(leg) - 1) if leg[i] > leg[i - 1])
    )


def steps_needed(depths: tuple[float, ...], levels: Array, each: int) -> int:
    """Return the number of steps of a leg: ``each`` for a dive or climb, and one for each level crossed."""
    crossed = sum(
        int(np.sum((levels > min(a, b)) & (levels < max(a, b)))) for a, b in pairwise(depths)
    )
    return crossed + each * (len(depths) - 1)


def refine_steps(depths: Array, factor: int) -> Array:
    """Return the depths of a leg's steps with each step divided by a factor."""
    return np.interp(
        np.arange((depths.size - 1) * factor + 1) / factor, np.arange(depths.size), depths
    )
