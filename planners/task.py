"""Optimal-control problem of one mission in the local frame: positions, constraints and depths of legs."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf
from time import monotonic

import numpy as np
from numpy.typing import NDArray

from planners.hazards.areas import Ring, check_outside
from planners.hazards.domain import (
    DEPTH_TOLERANCE,
    Bottom,
    Region,
    bottom_of,
    fixed_rings,
    locate,
    locate_all,
)
from planners.request import Line, MissionRequest, MissionSettings, Mooring
from planners.simulation.currents import Currents, Flow, currents_of
from planners.vehicle import Glider
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate

# Glide angles among which the one of a given leg time is chosen.
_ANGLES = 64
# Depth that a glide passes at least [m].
_LEVEL = 0.01
#: Dives that turn above this are of no use [m].
LEAST_DIVE = 10.0
#: Depths [m] at which a leg begins, turns and ends.
YoDepths = tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """Mission in the local frame.

    Attributes:
        request: Mission request.
        currents: Current, K = 1.
        region: Region of the forecast.
        rings: Constraints that hold at any depth.
        bottom: Depth limits of dives.
        start: Start, shape (3,) [m], local east, north, depth.
        goals: Goals, shape (G, 3) [m].
        start_time: Start time on the clock of the currents [s].
        line_begin: Beginning of the line to follow, shape (2,) [m]; zeros without a line.
        deadline: End of the search on the machine's clock [s].
    """

    request: MissionRequest
    currents: Currents
    region: Region
    rings: tuple[Ring, ...]
    bottom: Bottom
    start: Array
    goals: Array
    start_time: float
    line_begin: Array
    deadline: float = inf

    @property
    def is_late(self) -> bool:
        """Whether the time limit of the search has passed."""
        return monotonic() > self.deadline

    @property
    def vehicle(self) -> Glider:
        """Glider."""
        return self.request.vehicle

    @property
    def settings(self) -> MissionSettings:
        """Mission settings."""
        return self.request.settings

    @property
    def shape(self) -> Line | Mooring | None:
        """Line or mooring to stay near; None without."""
        return self.request.shape

    @property
    def flow(self) -> FlowEstimate:
        """Flow whose nodes and functions all times share."""
        return self.currents.flow

    @property
    def is_finite(self) -> bool:
        """Whether the current is finite everywhere."""
        return bool(np.all(np.isfinite(self.currents.latent)))

    @property
    def is_glide(self) -> bool:
        """Whether the mission is a single glide at constant velocity through water, from depth to depth."""
        return self.settings.yos == 0

    @property
    def places(self) -> NDArray[np.complex128]:
        """Positions of start and goals, shape (1 + G,) [m], east + i north."""
        east, north, _ = np.vstack([self.start, self.goals]).T
        return np.asarray(east + 1j * north)

    def currents_through(self) -> tuple[Array, Array]:
        """Return the times of the current during the mission, shape (T,) [s since its start], and its latent values, shape (M, Z T)."""
        return self.currents.through(self.start_time, self.settings.max_duration)

    @property
    def from_start(self) -> Array:
        """Horizontal distances of the goals from the start, shape (G,) [m]."""
        return np.asarray(np.linalg.norm(self.goals[:, :2] - self.start[:2], axis=1))

    @property
    def longest(self) -> float:
        """Largest mission duration [s]."""
        legs = self.settings.legs or self.settings.most_legs
        return min(legs * self.leg_time(), self.settings.max_duration)

    @property
    def shallowest_angle(self) -> float:
        """Least glide angle [rad]."""
        return self.vehicle.angles[0]

    def solid(self, depth: float | None) -> tuple[Ring, ...]:
        """Return the rings to avoid, with water too shallow for a depth [m]; None for the rings alone."""
        return self.rings if depth is None else (*self.rings, *self.bottom.rings(depth))

    def turns(self, depths: Array) -> Array:
        """Return the depths at which legs begin, turn and end, shape (P + 1, L) [m], padded with the last.

        Args:
            depths: Dive depth of each leg, shape (L,) [m].
        """
        yos, deep = self.settings.yos, float(self.goals[-1, 2])
        if self.is_glide:
            # one that stays at its depth has a duration all the same
            return np.array([[self.start[2]], [deep + _LEVEL * (deep == self.start[2])]])
        found = np.zeros((2 * yos + 1, depths.size))
        found[1::2] = depths
        found[0, 0] = self.start[2]
        if deep > 0.0 and self.ends_in_dive(depths.size):
            found[1:, -1] = deep
        elif deep > 0.0:
            found[-1, -1] = deep
        return found

    def ends_in_dive(self, n_legs: int) -> bool:
        """Return whether the last leg descends to a goal below the surface in its first dive."""
        begins_below = n_legs == 1 and self.start[2] > 0.0
        return bool(self.goals[-1, 2] > 0.0) and self.settings.yos == 1 and not begins_below

    def drifts(self, n_legs: int) -> Array:
        """Return the drift time after each leg [s]; 0 after the last."""
        return np.append(np.full(n_legs - 1, self.settings.surface_time), 0.0)

    def leg_time(self, angle: float | None = None, depth: float | None = None) -> float:
        """Return the duration of a leg with its drift [s]; by default at the shallowest glide angle [rad] and the set depth."""
        if self.is_glide:
            return self.settings.max_duration
        chosen = self.shallowest_angle if angle is None else angle
        down = float(self.vehicle.speeds(np, chosen)[1])
        deep = self.settings.depth if depth is None else depth
        return 2.0 * self.settings.yos * deep / down + self.settings.surface_time

    def angle_of(self, leg_time: float, depth: float) -> float:
        """Return the glide angle [rad] that best matches a leg duration [s] at a depth [m]."""
        angles = np.linspace(*self.vehicle.angles, _ANGLES)
        times = np.array([self.leg_time(float(angle), depth) for angle in angles])
        return float(angles[np.argmin(np.abs(times - leg_time))])


def yo_depths(turns: Array) -> tuple[YoDepths, ...]:
    """Return the depths of each leg from shape (P + 1, L) [m], without padding."""
    found = []
    for leg in turns.T.tolist():
        while len(leg) > 2 and leg[-1] == leg[-2]:
            leg = leg[:-1]
        found.append(tuple(leg))
    return tuple(found)


def turns_of(legs: Sequence[YoDepths]) -> Array:
    """Return the depths of legs, shape (P + 1, L) [m], padded with the last."""
    most = max(map(len, legs))
    return np.array([(*leg, *(leg[-1],) * (most - len(leg))) for leg in legs]).T


def apogee_depths(legs: Sequence[YoDepths]) -> float:
    """Return the summed apogee depth of legs [m], where the pump works."""
    return float(sum(leg[i] for leg in legs for i in range(1, len(leg) - 1) if leg[i] > leg[i - 1]))


def task_of(flow: Flow, request: MissionRequest) -> Task:
    """Return a request in the local frame of its flow.

    Raises:
        PlanError: A position is outside the region, on land or in a forbidden area; the dives are deeper than the flow or the vehicle's
        limit; a line has no length; or a mooring starts outside its radius.
    """
    currents, settings = currents_of(flow), request.settings
    region = Region(currents.flow.grid, request.vehicle.max_depth)
    _check_request(request, region)
    if isinstance(request.shape, Mooring):
        request = replace(request, goals=(replace(request.goals[0], depth=0.0),))
    located = locate_all(region, request.start, request.goals)
    start, *others = located.values()
    goals, line_begin = np.array(others), np.zeros(2)
    bottom = bottom_of(region, request.bathymetry, settings.clearance)
    rings = fixed_rings(region, request.no_go, bottom)
    for name, point in located.items():
        _check_place(rings, bottom, name, point, settings.yos == 0)
    if isinstance(request.shape, Line):
        begin = request.shape.begin or request.start
        line_begin = locate(region, begin, "the line's beginning")[:2]
        if float(np.linalg.norm(goals[0, :2] - line_begin)) < 1.0:
            raise PlanError("a line needs two places that are apart")
    elif isinstance(request.shape, Mooring):
        away, radius = float(np.linalg.norm(start[:2] - goals[0, :2])), request.shape.radius
        if away > radius:
            raise PlanError(
                f"the start is {away:.0f} m from the mooring, outside of its radius of {radius:g} m; plan a mission there first"
            )
        # dives anywhere within the radius turn above the bottom
        room = max(float(bottom.limit_at(goals[:1, :2], radius)[0]), LEAST_DIVE)
        settings = replace(settings, depth=min(settings.depth, room))
    # a region that is less deep everywhere needs no search for how deep each dive may be
    room = max(bottom.deepest, LEAST_DIVE, float(np.max(goals[:, 2])), float(start[2]))
    settings = replace(settings, depth=min(settings.depth, room))
    if settings.depths is not None:
        least, most = settings.depths
        needed = max(least, LEAST_DIVE, float(np.max(goals[:, 2])), float(start[2]))
        if needed > min(most, settings.depth):
            raise PlanError(
                f"dives of {least:g} to {most:g} m: expected a depth from {needed:g} m, the least of the range, the start and the goals, "
                f"to {min(most, settings.depth):g} m, the most that range and bottom allow; choose a wider range"
            )
    clock = currents.clock(request.start_time_ns)
    deadline = min(monotonic() + settings.time_limit, settings.deadline)
    request = replace(request, settings=settings)
    return Task(request, currents, region, rings, bottom, start, goals, clock, line_begin, deadline)


def _check_place(
    rings: tuple[Ring, ...], bottom: Bottom, name: str, point: Array, glides: bool
) -> None:
    """Raise PlanError if a start or goal lies in a forbidden area or in water too shallow for a dive."""
    surfacing = name != "start" and point[2] == 0.0
    forbidden = [ring for ring in rings if surfacing or not ring.surface_only]
    # a glide may begin and end on the edge
    check_outside([ring for ring in forbidden if not (glides and ring.outside)], name, point)
    deepest = float(bottom.limit_at(point[None, :2])[0])
    needed = max(float(point[2]), 0.0 if glides else LEAST_DIVE)
    if deepest < needed - DEPTH_TOLERANCE:
        room = (
            f"the bottom less a clearance of {bottom.clearance:g} m leaves {deepest:g} m"
            if np.isfinite(deepest)
            else "land"
        )
        raise PlanError(
            f"{name} is too shallow for dives to {needed:g} m: {room}; move it to deeper water"
        )


def _check_request(request: MissionRequest, region: Region) -> None:
    """Raise PlanError if goals are missing, legs too few, or dives incompatible with goals and flow."""
    goals, settings = request.goals, request.settings
    if not goals:
        raise PlanError("a mission needs a goal; give one or several")
    if request.shape is not None and len(goals) > 1:
        raise PlanError("a line or a mooring has one goal: its end, its place; give one")
    if settings.weights.closest == 0.0:
        raise PlanError(
            "a weight of 0 for the miss distance leaves no goal to plan for; give a larger weight, or none to meet it at any cost"
        )
    if settings.yos == 0:
        return
    most = min(settings.legs or settings.most_legs, settings.most_legs)
    if most < len(goals):
        raise PlanError(
            f"{len(goals)} goals need as many legs, as each is met at the end of one, but only {most:g} are allowed; allow more"
        )
    if settings.depth > region.deepest:
        raise PlanError(
            f"dives to {settings.depth:g} m are deeper than {region.floor(region.deepest)}; choose a lesser depth"
        )
    deepest = max(goal.depth for goal in goals)
    if deepest > settings.depth:
        raise PlanError(
            f"the goal at {deepest:g} m is deeper than the dives, {settings.depth:g} m; choose deeper dives"
        )
