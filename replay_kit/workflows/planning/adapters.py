"""Planners bound to a configuration, behind the protocol of ``replay`` and the studies."""

from dataclasses import asdict, dataclass, field, fields, replace
from itertools import pairwise
from typing import Any

import numpy as np

import planners
from planners.hazards.domain import Region, locate
from planners.output import as_plan
from planners.plan import first_legs
from replay_kit.config.plan import ACCEPTED_RISK, ARRIVING
from replay_kit.config.planner import PlannerConfig
from replay_kit.core.arrays import Array
from replay_kit.core.as_flown import AsFlown
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import distance
from replay_kit.core.grid import Grid, Projection, Seabed
from replay_kit.core.plan import ORIGIN, Place, Plan
from replay_kit.core.surfacing import Ellipse, Surfacing
from replay_kit.workflows.planning.bathymetry import depth_at, read_bathymetry, seabed_of
from replay_kit.workflows.planning.currents import KnownCurrent
from replay_kit.workflows.replay.inputs.planner import HasGrid, PlanQuery, PlanResult

#: Samples in which a plan is judged where no number is stated.
JUDGING = 100
# The estimates that a mission is planned on reach over so many times the way through still water.
_AHEAD = 2.0


def planner_of(config: PlannerConfig, region: Grid) -> "MissionPlanner":
    """Return the planner of a configuration; kind ``auto`` plans glides until dives of a glider are known.

    Args:
        config: ``[planner]``.
        region: Grid of the forecast, around which the bathymetry is read.

    Raises:
        ForecastError: The bathymetry is unusable.
    """
    made = MissionPlanner(config)
    if config.bathymetry_path is None:
        return made
    bottom = read_bathymetry(config.bathymetry_path, region)
    return replace(made, bathymetry=bottom, seabed=seabed_of(bottom, region))


def over_bottom(plan: Plan, bathymetry: planners.Bathymetry | None, projection: Projection) -> Plan:
    """Return a plan with the bottom depth under its track; unchanged without a bathymetry."""
    if bathymetry is None:
        return plan
    return replace(plan, bottom=depth_at(bathymetry, projection, *plan.track[:, :2].T))


def with_origin(plan: planners.MissionPlan, origin: str) -> planners.MissionPlan:
    """Return a plan whose message and statistics name the dive settings not stated; unchanged if all are stated."""
    if not origin:
        return plan
    return replace(
        plan, message=f"{plan.message}; {origin}", statistics={**plan.statistics, ORIGIN: origin}
    )


@dataclass(frozen=True, slots=True)
class MissionPlanner:
    """Mission planner bound to a configuration.

    Attributes:
        config: ``[planner]``, with the kind of plans.
        flown: Flight parameters of the dives so far; None if unknown.
        judges: Whether missions have odds by default.
        bathymetry: Bottom depth; None for the estimate's lowest wet level.
        seabed: Bottom depth, as in results.
        more: Mission settings absent from ``[planner]``.
    """

    config: PlannerConfig
    flown: AsFlown | None = None
    judges: bool = False
    bathymetry: planners.Bathymetry | None = None
    seabed: Seabed | None = None
    more: dict[str, Any] = field(default_factory=dict)

    @property
    def glides(self) -> bool:
        """Whether it plans glides: one leg from depth to depth, in the current at its start, without odds."""
        return self.config.kind != "mission"

    def as_flown(self, flown: AsFlown) -> "MissionPlanner":
        """Return the planner with flight parameters as flown where the settings state none; of missions if the dives are a glider's."""
        return replace(self, flown=flown, config=self.config.resolved(flown.is_plausible))

    def with_odds(self) -> "MissionPlanner":
        """Return the planner of missions with odds, as those of ``plan``."""
        return self if self.glides else replace(self, judges=True)

    def request(
        self,
        grid: Grid,
        start: Place,
        goals: tuple[Place, ...],
        start_time_ns: int,
        no_go: tuple[planners.NoGo, ...] = (),
    ) -> tuple[planners.MissionRequest, str]:
        """Return the request of a mission from a place to goals, and the values that no setting states, as text.

        Raises:
            PlanError: The vehicle cannot glide with these settings.
        """
        config = self.config.resolved(of_glider=False)
        goal_depth = max(goal.depth for goal in goals)
        dives = config.diving(self.flown, goal_depth, float(grid.levels[-1]))
        glider = planners.Glider(
            dives.speed,
            None,
            dives.min_angle,
            dives.max_angle,
            # a propeller needs no pump
            volume=0.0 if config.thrust else planners.Glider().volume,
            hotel=config.hotel,
            thrust=config.thrust,
            max_depth=config.depth_limit,
            speed_spread=dives.speed_spread,
            speed_error=dives.speed_error,
        )
        if self.glides:
            # flown once, whatever the dives before it were
            dives = replace(config.diving(), yos=0, depths=None, speeds=None, origin=dives.origin)
        # what the dives settle counts before what is stated
        named = {one.name for one in fields(planners.MissionSettings)}
        values = {**dict(config), **asdict(dives)}
        stated = {name: value for name, value in values.items() if name in named}
        settings = planners.MissionSettings(**stated | self.more)
        request = planners.MissionRequest(
            start, goals, glider, settings, no_go, self.bathymetry, start_time_ns
        )
        return request, dives.origin

    def plan(self, flow: FlowEstimate, query: PlanQuery) -> PlanResult:
        """Return the best mission found from start to goal, begun at once, with the mission as memory."""
        begin_ns, projection = query.start_time_ns, flow.grid.projection
        before: planners.MissionPlan | None = None if query.warm is None else query.warm.memory
        if before is not None and (before.settings.yos == 0) != self.glides:
            # the vehicle has proved to be a glider since
            before = None
        request, origin = self.request(flow.grid, query.start, (query.goal,), begin_ns)
        if before is not None and request.settings.legs is not None:
            left = max(1, len(before.headings_deg) - before.legs_flown(begin_ns))
            request = replace(request, settings=replace(request.settings, legs=left))
        if before is not None and before.statistics.get(ORIGIN, "") != origin:
            # the rest of it would be flown by other dives
            before = None
        known, seconds = KnownCurrent((flow,), self.config.flow_step), span_of(request)
        while True:
            currents = flow if self.glides else known.flow(begin_ns, seconds)
            mission = planners.plan_mission(currents, request, warm=before)
            longer = 0.0 if self.glides else known.longer(begin_ns, seconds, (mission,))
            if not longer:
                break
            seconds = longer
        mission = with_origin(mission, origin)
        stated = 0 if self.glides else self.config.samples
        count = sample_count(flow, stated) if self.judges else stated or 0
        has_legs = len(mission.headings_deg) > 0
        drawn = known.samples(begin_ns, seconds, count * has_legs, self.config.seed)
        judged, odds, following, flown = mission, None, None, (currents, drawn, mission, request)
        if drawn and self.judges:
            odds = planners.mission_odds(*flown)
            judged = planners.with_odds(mission, odds, ARRIVING, ACCEPTED_RISK)
            following = odds.next_surfacing
        elif drawn:
            following = planners.next_surfacing(*flown)
        elif self.judges and count == 0:
            judged = without_odds(mission, flow)
        made = over_bottom(as_plan(judged, projection, odds), self.bathymetry, projection)
        return PlanResult(made, _next_surfacing(projection, mission, following), mission)

    def check(self, flow: HasGrid, goal: Place) -> None:
        """Raise PlanError if the goal is outside the region or on land, the vehicle cannot glide, or a mission's dives do not fit."""
        region = Region(flow.grid, self.config.depth_limit)
        locate(region, goal, "goal")
        depth = self.request(flow.grid, goal, (goal,), 0)[0].settings.depth
        if not (self.glides or goal.depth <= depth <= region.deepest):
            raise PlanError(
                f"[planner] depth is {depth:g} m; expected no less than the goal's, {goal.depth:g} m, and no more than "
                f"{region.floor(region.deepest)}"
            )


def span_of(request: planners.MissionRequest) -> float:
    """Return the period for which a mission may need the current [s]: a multiple of the still-water duration, up to its maximum."""
    vehicle, places = request.vehicle, [request.start, *request.goals]
    along = float(vehicle.speeds(np, vehicle.angles[0])[0])
    way = sum(
        float(distance(a.longitude, a.latitude, b.longitude, b.latitude))
        for a, b in pairwise(places)
    )
    return min(_AHEAD * way / along, request.settings.max_duration)


def sample_count(estimate: FlowEstimate, stated: int | None) -> int:
    """Return the number of simulated flights of a mission: by default 100, and none without an uncertainty of the estimate."""
    if stated is not None:
        return stated
    return 0 if estimate.n_modes == 0 else JUDGING


def without_odds(mission: planners.MissionPlan, estimate: FlowEstimate) -> planners.MissionPlan:
    """Return a mission without simulated flights; its message says if the estimate has no samples."""
    if estimate.n_modes > 0:
        return mission
    return replace(
        mission,
        message=f"{mission.message}; the estimate states no uncertainty, so its odds are unknown",
    )


def _next_surfacing(
    projection: Projection, mission: planners.MissionPlan, ellipse: Array | None
) -> Surfacing | None:
    """Return the surfacing at the end of the first leg, with an ellipse if there are samples; None without such a leg."""
    glides = mission.settings.yos == 0
    if glides or len(mission.headings_deg) == 0 or mission.yo_depths[0][-1] > 0.0:
        return None
    first = first_legs(mission, 1, projection)
    (longitude, latitude), seconds = first.surfacings[0], float(first.surfacing_times[0])
    time_ns = mission.start_time_ns + round(seconds * 1e9)
    around = None if ellipse is None else Ellipse(*ellipse.tolist())
    return Surfacing(time_ns, float(longitude), float(latitude), around)
