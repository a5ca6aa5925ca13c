"""The planners bound to a configuration, behind the protocol that ``replay`` and the studies call."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

import planners
from planners.mission.flight import Sample
from planners.mission.flights import fly_mission, surfacing_ellipses
from planners.mission.horizon import first_legs
from planners.output.mission import as_glide
from planners.route.region import locate, region_of
from replay_kit.config.planner import PlannerConfig
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import distance
from replay_kit.core.grid import Grid, Projection
from replay_kit.core.plan import Place, Plan
from replay_kit.core.seabed import Seabed
from replay_kit.core.surfacing import Ellipse, Surfacing
from replay_kit.workflows.planning.bathymetry import read_bathymetry
from replay_kit.workflows.planning.currents import KnownCurrent
from replay_kit.workflows.planning.request import ACCEPTED_RISK, ARRIVING
from replay_kit.workflows.planning.seabed import depth_along, seabed_of
from replay_kit.workflows.replay.planner import Planner, PlanResult

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
    bound: GlidePlanner | MissionPlanner = (
        MissionPlanner.of(config) if config.kind == "mission" else GlidePlanner.of(config)
    )
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


@dataclass(frozen=True, slots=True)
class GlidePlanner:
    """The glide planner bound to a configuration.

    Attributes:
        settings: How it is planned.
        bathymetry: Bottom depth, which a glide keeps above; None leaves it out of account.
        seabed: It, as results hold it.
    """

    settings: planners.GlideSettings
    bathymetry: planners.Bathymetry | None = None
    seabed: Seabed | None = None

    @classmethod
    def of(cls, config: PlannerConfig) -> "GlidePlanner":
        """Return the planner of a configuration."""
        settings = planners.GlideSettings(
            speed=config.speed,
            tolerance=config.tolerance,
            max_duration=config.max_duration,
            max_depth=config.depth_limit,
            clearance=config.clearance,
        )
        return cls(settings)

    def plan(
        self,
        flow: FlowEstimate,
        start: Place,
        goal: Place,
        start_time_ns: int,
        warm: PlanResult | None,
    ) -> PlanResult:
        """Return the best glide found from start towards goal."""
        before = None if warm is None else warm.plan
        made = planners.plan(
            flow,
            start,
            goal,
            settings=replace(self.settings, bathymetry=self.bathymetry),
            start_time_ns=start_time_ns,
            warm=before,
        )
        return PlanResult(over_bottom(made, self.bathymetry, flow.grid.projection))

    def check(self, flow: FlowEstimate, goal: Place) -> None:
        """Raise PlanError when the goal is outside the region, on land or below the vehicle's limit."""
        locate(region_of(flow.grid, self.settings.max_depth), goal, "goal")

    def closest_approach(self, flow: FlowEstimate, planned: PlanResult) -> float:
        """Return how close [m] a plan passes its goal when it is flown in a flow."""
        _, _, closest_approach = planners.fly(flow, planned.plan)
        return closest_approach


@dataclass(frozen=True, slots=True)
class MissionPlanner:
    """The mission planner bound to a configuration.

    Attributes:
        vehicle: What glides.
        settings: How; its number of legs is that of the first plan.
        flow_step: Between the estimates for later times [s].
        samples: Of the estimate, in which each mission is flown for its odds and ellipses; 0 for none.
        seed: Of the samples.
        bathymetry: Bottom depth; None for the lowest level that is wet in the estimate.
        seabed: It, as results hold it.
    """

    vehicle: planners.Glider
    settings: planners.MissionSettings
    flow_step: float
    samples: int = 0
    seed: int = 0
    bathymetry: planners.Bathymetry | None = None
    seabed: Seabed | None = None

    @classmethod
    def of(cls, config: PlannerConfig) -> "MissionPlanner":
        """Return the planner of a configuration.

        Raises:
            PlanError: The vehicle's numbers are such that nothing glides.
        """
        settings = planners.MissionSettings(
            depth=config.depth,
            yos=config.dives,
            surface_time=config.surface_time,
            objective=config.objective,
            tolerance=config.tolerance,
            legs=config.legs,
            max_legs=config.max_legs,
            max_duration=config.max_duration,
            margin=config.margin,
            clearance=config.clearance,
        )
        glider = planners.Glider(
            config.speed, None, config.min_angle, config.max_angle, max_depth=config.depth_limit
        )
        return cls(glider, settings, config.flow_step, config.samples, config.seed)

    def plan(
        self,
        flow: FlowEstimate,
        start: Place,
        goal: Place,
        start_time_ns: int,
        warm: PlanResult | None,
    ) -> PlanResult:
        """Return the best mission found from start to goal, begun at once; its memory is the mission."""
        before = None if warm is None else warm.memory
        settings = self.settings
        if before is not None and settings.legs is not None:
            settings = replace(
                settings, legs=max(1, len(before.headings_deg) - before.legs_flown(start_time_ns))
            )
        request = planners.MissionRequest(
            start,
            (goal,),
            vehicle=self.vehicle,
            settings=settings,
            bathymetry=self.bathymetry,
            start_time_ns=start_time_ns,
        )
        known, seconds = KnownCurrent((flow,), self.flow_step), self.span(start, (goal,))
        currents = known.flow(start_time_ns, seconds)
        mission = planners.plan_mission(currents, request, warm=before)
        drawn = known.samples(
            start_time_ns, seconds, self.samples if len(mission.headings_deg) else 0, self.seed
        )
        odds = planners.mission_odds(currents, drawn, mission, request) if drawn else None
        judged = (
            mission if odds is None else planners.with_odds(mission, odds, ARRIVING, ACCEPTED_RISK)
        )
        made = over_bottom(
            as_glide(judged, flow.grid.projection, odds), self.bathymetry, flow.grid.projection
        )
        return PlanResult(made, _next_surfacing(flow.grid.projection, mission, drawn), mission)

    def check(self, flow: FlowEstimate, goal: Place) -> None:
        """Raise PlanError when the goal is outside the region or on land, or a mission's dives do not fit."""
        region = region_of(flow.grid, self.vehicle.max_depth)
        locate(region, goal, "goal")
        if not goal.depth <= self.settings.depth <= region.deepest:
            raise PlanError(
                f"[planner] depth is {self.settings.depth:g} m; expected no less than the goal's, {goal.depth:g} m, and no more than "
                f"{region.floor}"
            )

    def closest_approach(self, flow: FlowEstimate, planned: PlanResult) -> float:
        """Return how far from its goal [m] a mission ends when it is flown in a flow, as it changes where it does."""
        mission: planners.MissionPlan = planned.memory
        met = KnownCurrent((flow,), self.flow_step).flow(mission.start_time_ns, mission.duration)
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


def _next_surfacing(
    projection: Projection, mission: planners.MissionPlan, drawn: Sequence[Sample]
) -> Surfacing | None:
    """Return where the first leg ends at the surface, with an ellipse where there are samples; None when no leg does."""
    if len(mission.headings_deg) == 0 or mission.yo_depths[0][-1] > 0.0:
        return None
    first = first_legs(mission, 1, projection)
    (longitude, latitude), seconds = first.surfacings[0], float(first.surfacing_times[0])
    time_ns = mission.start_time_ns + round(seconds * 1e9)
    ellipse = (
        Ellipse(*surfacing_ellipses(fly_mission(drawn, first), first)[0].tolist())
        if drawn
        else None
    )
    return Surfacing(time_ns, float(longitude), float(latitude), ellipse)
