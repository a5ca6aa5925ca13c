"""The planners bound to a configuration, behind the protocol that ``replay`` and the studies call."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypeVar

import numpy as np

import planners
from planners.departures import first_legs
from planners.flights import fly_mission
from planners.hazards.domain import Region, locate
from planners.output.mission import as_plan
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
from replay_kit.workflows.planning.bathymetry import depth_along, read_bathymetry, seabed_of
from replay_kit.workflows.planning.currents import KnownCurrent
from replay_kit.workflows.replay.stages.planner import HasGrid, Planner, PlanQuery, PlanResult

PlanOrMission = TypeVar("PlanOrMission", Plan, planners.MissionPlan)
#: Samples in which a plan is judged where no number is stated.
JUDGING = 100
# The estimates that a mission is planned on reach over so many times the way through still water.
_AHEAD = 2.0


def planner_of(config: PlannerConfig, region: Grid) -> Planner:
    """Return the planner of a configuration: of kind ``auto``, which a replay resolves, that of a glide.

    Args:
        config: ``[planner]``.
        region: Of the forecast; the bathymetry is read around it.

    Raises:
        ForecastError: The bathymetry is unusable.
        PlanError: The vehicle's numbers are such that nothing glides.
    """
    bound = MissionPlanner.of(config, glides=config.kind != "mission")
    if config.bathymetry_path is None:
        return bound
    bottom = read_bathymetry(config.bathymetry_path, region)
    return replace(bound, bathymetry=bottom, seabed=seabed_of(bottom, region))


def over_bottom(plan: Plan, bathymetry: planners.Bathymetry | None, projection: Projection) -> Plan:
    """Return a plan with the depth of the bottom under its track; unchanged without a bathymetry."""
    return (
        plan
        if bathymetry is None
        else replace(plan, bottom=depth_along(bathymetry, projection, plan.track))
    )


def with_origin(plan: PlanOrMission, origin: str) -> PlanOrMission:
    """Return a plan whose message and statistics say what of its dives no setting states; unchanged where all is stated."""
    if not origin:
        return plan
    return replace(
        plan, message=f"{plan.message}; {origin}", statistics={**plan.statistics, ORIGIN: origin}
    )


@dataclass(frozen=True, slots=True)
class MissionPlanner:
    """The mission planner bound to a configuration.

    Attributes:
        vehicle: What glides.
        settings: How; its number of legs is that of the first plan.
        config: What the settings state.
        flown: How the vehicle flew its dives so far; None where that is not known.
        judges: Whether missions have odds where no number of samples is stated.
        bathymetry: Bottom depth; None for the lowest level that is wet in the estimate.
        seabed: It, as results hold it.
    """

    vehicle: planners.Glider
    settings: planners.MissionSettings
    config: PlannerConfig
    flown: AsFlown | None = None
    judges: bool = False
    bathymetry: planners.Bathymetry | None = None
    seabed: Seabed | None = None

    @classmethod
    def of(cls, config: PlannerConfig, glides: bool = False) -> "MissionPlanner":
        """Return the planner of a configuration, of missions of dives or of glides.

        Raises:
            PlanError: The vehicle's numbers are such that nothing glides.
        """
        config = config.model_copy(update={"kind": "glide" if glides else "mission"})
        dives = config.diving()
        settings = planners.MissionSettings(
            depth=dives.depth,
            yos=0 if glides else dives.yos,
            surface_time=dives.surface_time,
            objective=config.objective,
            tolerance=config.tolerance,
            radius=config.radius,
            legs=config.legs,
            max_legs=config.max_legs,
            max_duration=config.max_duration,
            margin=config.margin,
            clearance=config.clearance,
        )
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
        )
        return cls(glider, settings, config)

    def as_flown(self, flown: AsFlown) -> "MissionPlanner":
        """Return the planner of a vehicle that flies as its dives so far, where the settings state nothing else."""
        return replace(self, flown=flown)

    def bound(self, flow: HasGrid, goals: Sequence[Place]) -> tuple["MissionPlanner", str]:
        """Return the planner with what no setting states of the dives to some goals, and that in words."""
        dives = self.config.diving(
            self.flown,
            max((goal.depth for goal in goals), default=0.0),
            float(flow.grid.levels[-1]),
        )
        vehicle = replace(
            self.vehicle,
            speed=dives.speed,
            min_angle=dives.min_angle,
            max_angle=dives.max_angle,
            speed_spread=dives.speed_spread,
            speed_error=dives.speed_error,
        )
        settings = (
            self.settings
            if self.glides
            else replace(
                self.settings,
                depth=dives.depth,
                yos=dives.yos,
                depths=dives.depths,
                speeds=dives.speeds,
                surface_time=dives.surface_time,
                radius=dives.radius,
            )
        )
        return replace(self, vehicle=vehicle, settings=settings), dives.origin

    @property
    def glides(self) -> bool:
        """Whether it plans glides: one leg from depth to depth, in the current as it is when it begins, without odds."""
        return self.settings.yos == 0

    def request(
        self,
        start: Place,
        goals: tuple[Place, ...],
        start_time_ns: int,
        no_go: tuple[planners.NoGo, ...] = (),
    ) -> planners.MissionRequest:
        """Return what the planners are asked for: a mission from a place to some goals, with this vehicle over this bottom."""
        return planners.MissionRequest(
            start, goals, self.vehicle, self.settings, no_go, self.bathymetry, start_time_ns
        )

    def plan(self, flow: FlowEstimate, query: PlanQuery) -> PlanResult:
        """Return the best mission found from start to goal, begun at once; its memory is the mission."""
        start, goal, start_time_ns = query.start, query.goal, query.start_time_ns
        before: planners.MissionPlan | None = None if query.warm is None else query.warm.memory
        bound, origin = self.bound(flow, (goal,))
        if before is not None and bound.settings.legs is not None:
            left = max(1, len(before.headings_deg) - before.legs_flown(start_time_ns))
            bound = replace(bound, settings=replace(bound.settings, legs=left))
        request = bound.request(start, (goal,), start_time_ns)
        if before is not None and before.statistics.get(ORIGIN, "") != origin:
            # the rest of it would be flown by other dives
            before = None
        known, seconds = KnownCurrent((flow,), self.config.flow_step), bound.span(start, (goal,))
        currents = flow if self.glides else known.flow(start_time_ns, seconds)
        mission = with_origin(planners.plan_mission(currents, request, warm=before), origin)
        stated = None if self.glides else self.config.samples
        count = sample_count(flow, stated) if self.judges else stated or 0
        drawn = known.samples(
            start_time_ns, seconds, count if len(mission.headings_deg) else 0, self.config.seed
        )
        judged, odds, following, flown = mission, None, None, (currents, drawn, mission, request)
        if drawn and self.judges:
            odds = planners.mission_odds(*flown)
            judged, following = (
                planners.with_odds(mission, odds, ARRIVING, ACCEPTED_RISK),
                odds.next_surfacing,
            )
        elif drawn:
            following = planners.next_surfacing(*flown)
        elif self.judges and count == 0:
            judged = without_odds(mission, flow)
        made = over_bottom(
            as_plan(judged, flow.grid.projection, odds), self.bathymetry, flow.grid.projection
        )
        return PlanResult(made, _next_surfacing(flow.grid.projection, mission, following), mission)

    def check(self, flow: HasGrid, goal: Place) -> None:
        """Raise PlanError when the goal is outside the region or on land, or a mission's dives do not fit."""
        region = Region(flow.grid, self.vehicle.max_depth)
        locate(region, goal, "goal")
        if self.glides:
            return
        depth = self.bound(flow, (goal,))[0].settings.depth
        if not goal.depth <= depth <= region.deepest:
            raise PlanError(
                f"[planner] depth is {depth:g} m; expected no less than the goal's, {goal.depth:g} m, and no more than "
                f"{region.floor(region.deepest)}"
            )

    def with_odds(self) -> "MissionPlanner":
        """Return the planner of missions that are judged as those of the command ``plan`` are."""
        return self if self.glides else replace(self, judges=True)

    def closest_approach(self, flow: FlowEstimate, planned: PlanResult) -> float:
        """Return how far from its goal [m] a mission ends when it is flown in a flow, as it changes where it does."""
        mission: planners.MissionPlan = planned.memory
        if len(mission.headings_deg) == 0:
            return float(mission.closest_approach[-1])
        if self.glides:
            return planners.closest_approach(flow, mission)
        met = KnownCurrent((flow,), self.config.flow_step).flow(
            mission.start_time_ns, mission.duration
        )
        return float(fly_mission([met], mission).miss[0, -1])

    def span(self, start: Place, goals: Sequence[Place]) -> float:
        """Return for how long a mission may need the current [s]: some times the way through still water, at most its longest duration."""
        along = float(self.vehicle.speeds(np, self.vehicle.angles[0])[0])
        places = [start, *goals]
        way = sum(
            float(distance(a.longitude, a.latitude, b.longitude, b.latitude))
            for a, b in pairwise(places)
        )
        return min(_AHEAD * way / along, self.settings.max_duration)


def sample_count(estimate: FlowEstimate, stated: int | None) -> int:
    """Return the number of samples in which a mission is judged: where none is stated 100, and none of an estimate without uncertainty."""
    if stated is not None:
        return stated
    return 0 if estimate.n_modes == 0 else JUDGING


def without_odds(mission: planners.MissionPlan, estimate: FlowEstimate) -> planners.MissionPlan:
    """Return a mission that is not flown in samples; where the estimate has none, its message says so."""
    if estimate.n_modes > 0:
        return mission
    return replace(
        mission,
        message=f"{mission.message}; the estimate states no uncertainty: how likely that is is not known",
    )


def _next_surfacing(
    projection: Projection, mission: planners.MissionPlan, ellipse: Array | None
) -> Surfacing | None:
    """Return where the first leg ends at the surface, with an ellipse where there are samples; None when no leg does."""
    glides = mission.settings.yos == 0
    if glides or len(mission.headings_deg) == 0 or mission.yo_depths[0][-1] > 0.0:
        return None
    first = first_legs(mission, 1, projection)
    (longitude, latitude), seconds = first.surfacings[0], float(first.surfacing_times[0])
    time_ns = mission.start_time_ns + round(seconds * 1e9)
    around = None if ellipse is None else Ellipse(*ellipse.tolist())
    return Surfacing(time_ns, float(longitude), float(latitude), around)
