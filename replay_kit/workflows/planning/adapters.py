"""The planners bound to a configuration, behind the protocol that ``replay`` and the studies call."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

import planners
from planners.mission.flights import fly_mission, surfacing_ellipses
from planners.output.mission import as_glide
from planners.route.region import locate, region_of
from replay_kit.config.planner import PlannerConfig
from replay_kit.core.errors import ConfigError, PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import distance, to_geographic
from replay_kit.core.plan import Place
from replay_kit.core.surfacing import Ellipse, Surfacing
from replay_kit.workflows.planning.bathymetry import read_bathymetry
from replay_kit.workflows.replay.planner import Planner, PlanResult

# The estimates that a mission is planned on reach over so many times the way through still water.
_AHEAD = 1.5


def planner_of(config: PlannerConfig) -> Planner:
    """Return the planner of a configuration.

    Raises:
        ConfigError: A bathymetry is given for a glide, which does not turn above it.
        ForecastError: The bathymetry is unusable.
        PlanError: The vehicle's numbers are such that nothing glides.
    """
    if config.kind == "mission":
        bound = MissionPlanner.of(config)
        return bound if config.bathymetry_path is None else replace(bound, bathymetry=read_bathymetry(config.bathymetry_path))
    if config.bathymetry is not None:
        raise ConfigError("[planner] bathymetry: only a mission turns above the bottom; set kind to mission (--planner mission)")
    return GlidePlanner.of(config)


@dataclass(frozen=True, slots=True)
class GlidePlanner:
    """The glide planner bound to a configuration."""

    settings: planners.GlideSettings

    @classmethod
    def of(cls, config: PlannerConfig) -> "GlidePlanner":
        """Return the planner of a configuration."""
        return cls(planners.GlideSettings(speed=config.speed, tolerance=config.tolerance, max_duration=config.max_duration))

    def plan(self, flow: FlowEstimate, start: Place, goal: Place, start_time_ns: int, warm: PlanResult | None) -> PlanResult:
        """Return the best glide found from start towards goal."""
        before = None if warm is None else warm.plan
        return PlanResult(planners.plan(flow, start, goal, settings=self.settings, start_time_ns=start_time_ns, warm=before))

    def check(self, flow: FlowEstimate, goal: Place) -> None:
        """Raise PlanError when the goal is outside the region or on land."""
        locate(region_of(flow.grid), goal, "goal")

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
        samples: Of the estimate, for the next surfacing's ellipse; 0 for none.
        seed: Of the samples.
        bathymetry: Bottom depth; None for the lowest level that is wet in the estimate.
    """

    vehicle: planners.Glider
    settings: planners.MissionSettings
    flow_step: float
    samples: int = 0
    seed: int = 0
    bathymetry: planners.Bathymetry | None = None

    @classmethod
    def of(cls, config: PlannerConfig) -> "MissionPlanner":
        """Return the planner of a configuration.

        Raises:
            PlanError: The vehicle's numbers are such that nothing glides.
        """
        flight = planners.SteadyFlight() if config.flight_model else None
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
        glider = planners.Glider(config.speed, flight, config.min_angle, config.max_angle)
        return cls(glider, settings, config.flow_step, config.samples, config.seed)

    def plan(self, flow: FlowEstimate, start: Place, goal: Place, start_time_ns: int, warm: PlanResult | None) -> PlanResult:
        """Return the best mission found from start to goal, begun at once; its memory is the mission."""
        before = None if warm is None else warm.memory
        settings = self.settings
        if before is not None and settings.legs is not None:
            settings = replace(settings, legs=max(1, len(before.headings_deg) - before.legs_flown(start_time_ns)))
        mission = planners.plan_mission(
            self._over_time(flow, start, goal, start_time_ns),
            planners.MissionRequest(
                start, (goal,), vehicle=self.vehicle, settings=settings, bathymetry=self.bathymetry, start_time_ns=start_time_ns
            ),
            warm=before,
        )
        return PlanResult(as_glide(mission, flow.grid.projection), self._next_surfacing(flow, mission), mission)

    def check(self, flow: FlowEstimate, goal: Place) -> None:
        """Raise PlanError when the goal is outside the region or on land, or a mission's dives do not fit."""
        region = region_of(flow.grid)
        locate(region, goal, "goal")
        if not goal.depth <= self.settings.depth <= region.deepest:
            raise PlanError(
                f"[planner] depth is {self.settings.depth:g} m; expected no less than the goal's, {goal.depth:g} m, and no more than the "
                f"deepest level's, {region.deepest:g} m"
            )

    def closest_approach(self, flow: FlowEstimate, planned: PlanResult) -> float:
        """Return how far from its goal [m] a mission ends when it is flown in a flow."""
        return float(fly_mission(flow, planned.memory).miss[0, -1])

    def _over_time(self, flow: FlowEstimate, start: Place, goal: Place, start_time_ns: int) -> FlowEstimate | Sequence[FlowEstimate]:
        """Return the estimate for the time of the mission: one that does not change, or several."""
        if flow.later is None or flow.time_ns is None:
            return flow
        step = int(self.flow_step * 1e9)
        after = flow.at(start_time_ns + step)
        if np.array_equal(after.latent, flow.latent):
            return flow
        along = float(self.vehicle.speeds(np, self.vehicle.angles[0])[0])
        ahead = float(distance(start.longitude, start.latitude, goal.longitude, goal.latitude)) / along
        steps = int(np.ceil(min(_AHEAD * ahead, self.settings.max_duration) / self.flow_step))
        now = flow if flow.time_ns == start_time_ns else flow.at(start_time_ns)
        return [now, after, *(flow.at(start_time_ns + k * step) for k in range(2, steps + 1))]

    def _next_surfacing(self, flow: FlowEstimate, mission: planners.MissionPlan) -> Surfacing | None:
        """Return where the first leg ends at the surface; None when there is no leg, or it ends below."""
        if len(mission.headings_deg) == 0 or mission.yo_depths[0][-1] > 0.0:
            return None
        first = _first_leg(mission)
        at = [float(np.interp(first.surfacing_times[0], mission.track_time, mission.track[:, k])) for k in (0, 1)]
        longitude, latitude = to_geographic(flow.grid.projection, *at)
        time_ns = mission.start_time_ns + round(float(first.surfacing_times[0]) * 1e9)
        return Surfacing(time_ns, float(longitude), float(latitude), self._ellipse(flow, first))

    def _ellipse(self, flow: FlowEstimate, first: planners.MissionPlan) -> Ellipse | None:
        if self.samples == 0:
            return None
        row = surfacing_ellipses(fly_mission(flow.sample(self.samples, self.seed), first), first)[0]
        return Ellipse(*(float(value) for value in row))


def _first_leg(mission: planners.MissionPlan) -> planners.MissionPlan:
    """Return the mission of the first leg alone, up to when it reaches the surface: without the drift."""
    drift = mission.settings.surface_time if len(mission.headings_deg) > 1 else 0.0
    surfaces = mission.surfacing_times[:1] - drift
    return replace(
        mission,
        headings_deg=mission.headings_deg[:1],
        glide_angles_deg=mission.glide_angles_deg[:1],
        pitches_deg=mission.pitches_deg[:1],
        yo_depths=mission.yo_depths[:1],
        surfacings=mission.surfacings[:1],
        surfacing_times=surfaces,
        goals=mission.goals[-1:],
        goal_legs=(1,),
        goal_times=surfaces,
    )
