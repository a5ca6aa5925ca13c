"""``plan``: a mission on an estimate, and its figures in samples of the estimate."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from planners import Glider, MissionPlan, MissionRequest, MissionSettings, fly_scenarios, plan_scenarios, waypoints_of
from planners.mission.flights import fly_mission, surfacing_ellipses
from planners.mission.waypoints import Waypoints
from replay_kit.config.planner import PlannerConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import to_local
from replay_kit.core.grid import Projection
from replay_kit.workflows.planning.adapters import MissionPlanner
from replay_kit.workflows.planning.inputs import read_areas, read_bathymetry, read_flow
from replay_kit.workflows.planning.request import MissionKind, PlanJob, objective_of


@dataclass(frozen=True, slots=True, eq=False)
class PlannedMission:
    """A mission, and what samples of the estimate make of it.

    Attributes:
        plan: The mission.
        projection: The local frame of its track.
        ellipses: shape (L, 5), of ``surfacing_ellipses``; None without samples or legs.
        samples: Figures of the flights through samples, as in the JSON; None without samples or legs.
        waypoints: Short list of places to head for; None when none is asked for, or there are no legs.
    """

    plan: MissionPlan
    projection: Projection
    ellipses: Array | None
    samples: dict[str, Any] | None
    waypoints: Waypoints | None


def make_mission(job: PlanJob, config: PlannerConfig) -> PlannedMission:
    """Return the mission of a job.

    Args:
        job: What is asked for, checked.
        config: ``[planner]`` with the command's options laid over it.

    Raises:
        ConfigError: Options do not go together.
        PlanError: A goal cannot be planned for, or a file of areas is unusable.
        ForecastError: The bathymetry is unusable.
    """
    job.check_samples(config.samples)
    vehicle, settings = mission_settings(config, job.kind.objective, job.spline)
    estimates = [read_flow(path) for path in job.flows]
    drawn = estimates[0].sample(config.samples, config.seed) if config.samples else ()
    request = MissionRequest(
        job.start,
        job.goals,
        vehicle=vehicle,
        settings=settings,
        no_go=() if job.no_go is None else read_areas(job.no_go),
        bathymetry=None if job.bathymetry is None else read_bathymetry(job.bathymetry),
        start_time_ns=estimates[0].time_ns or 0,
    )
    flow, summary = estimates[0] if len(estimates) == 1 else estimates, None
    if job.risk is None:
        made = job.kind.plan(flow, request)
    else:
        made, summary = plan_scenarios(estimates[0], drawn, request, allowed=job.risk)
    projection, n_legs = estimates[0].grid.projection, len(made.headings_deg)
    few = None
    if job.waypoints and n_legs:
        few = waypoints_of(flow, made, job.waypoint_tolerance, no_go=request.no_go, bathymetry=request.bathymetry)
    if not drawn or not n_legs:
        return PlannedMission(made, projection, None, None, few)
    ellipses, figures = _figures_in_samples(drawn, made, job.kind)
    summary = summary or fly_scenarios(estimates[0], drawn, made, no_go=request.no_go, bathymetry=request.bathymetry)
    figures |= {"safe": summary.safe, "violations": dict(summary.violations), "allowed": job.risk}
    return PlannedMission(made, projection, ellipses, figures, few)


def mission_settings(config: PlannerConfig, objective: str | None, spline: int) -> tuple[Glider, MissionSettings]:
    """Return the vehicle and the settings of a configuration, with what only a mission planned by itself has.

    Args:
        config: ``[planner]`` with the command's options laid over it.
        objective: Name or weights; None for the configuration's.
        spline: Points per kernel length; 0 for no spline.

    Raises:
        ConfigError: The objective is neither a name nor weights.
        PlanError: The vehicle's numbers are such that nothing glides.
    """
    bound = MissionPlanner.of(config)
    # a plan by itself may be longer than those of a replay, unless that is configured
    longest = config.max_duration if "max_duration" in config.model_fields_set else MissionSettings().max_duration
    aim = bound.settings.objective if objective is None else objective_of(objective)
    return bound.vehicle, replace(bound.settings, objective=aim, spline=spline, max_duration=longest)


def _figures_in_samples(drawn: tuple[FlowEstimate, ...], made: MissionPlan, kind: MissionKind) -> tuple[Array, dict[str, Any]]:
    """Return the ellipses of the surfacings in samples of an estimate, and how far the flights miss the last goal or leave the mooring."""
    flights = fly_mission(drawn, made)
    off, within = flights.miss[:, -1], np.all(flights.miss <= made.settings.tolerance, axis=1)
    if kind.mooring is not None:
        place = np.array(to_local(drawn[0].grid.projection, made.goals[0].longitude, made.goals[0].latitude))
        counted = np.searchsorted(flights.time, made.surfacing_times - 1e-6) if kind.surfacings_only else slice(None)
        off = np.linalg.norm(flights.place[:, counted] - place, axis=2).max(axis=1)
        within = off <= kind.mooring[0]
    median, ninety = (float(np.quantile(off, q)) for q in (0.5, 0.9))
    figures = {"count": len(drawn), "reached": float(np.mean(within)), "miss_median_m": median, "miss_90_percent_m": ninety}
    return surfacing_ellipses(flights, made), figures
