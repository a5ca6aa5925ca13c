"""``plan``: a mission on an estimate, and its figures in samples of the estimate."""

from dataclasses import dataclass, replace
from math import inf
from typing import Any

from planners import (
    Bathymetry,
    Glider,
    MissionOdds,
    MissionPlan,
    MissionRequest,
    MissionSettings,
    NoGo,
    Pilot,
    mission_odds,
    plan_scenarios,
    waypoints_of,
    with_odds,
)
from planners.mission.waypoints import Waypoints
from replay_kit.config.planner import PlannerConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Grid, Projection
from replay_kit.core.progress import announce
from replay_kit.workflows.planning.adapters import MissionPlanner
from replay_kit.workflows.planning.areas import area_notes, read_areas
from replay_kit.workflows.planning.bathymetry import bathymetry_notes, read_bathymetry
from replay_kit.workflows.planning.inputs import read_flow
from replay_kit.workflows.planning.request import JUDGING, PlanJob, objective_of


@dataclass(frozen=True, slots=True, eq=False)
class PlannedMission:
    """A mission, and what samples of the estimate make of it.

    Attributes:
        plan: The mission.
        projection: The local frame of its track.
        odds: Of its flights through samples; None without samples or legs.
        samples: They as in the JSON; None without samples or legs.
        waypoints: Short list of places to head for; None when none is asked for, or there are no legs.
        notes: What about the files of areas and of the bottom should be known.
        no_go: Areas that it keeps out of.
        bathymetry: Bottom that it stays above; None without.
        region: Of the estimate.
    """

    plan: MissionPlan
    projection: Projection
    odds: MissionOdds | None
    samples: dict[str, Any] | None
    waypoints: Waypoints | None
    notes: tuple[str, ...]
    no_go: tuple[NoGo, ...]
    bathymetry: Bathymetry | None
    region: Grid

    @property
    def ellipses(self) -> Array | None:
        """Shape (L, 5), of ``surfacing_ellipses``; None without samples or legs."""
        return None if self.odds is None else self.odds.ellipses


def make_mission(job: PlanJob, config: PlannerConfig) -> PlannedMission:
    """Return the mission of a job, with its odds in samples of the estimate.

    Args:
        job: What is asked for, checked.
        config: ``[planner]`` with the command's options laid over it.

    Raises:
        ConfigError: Options do not go together.
        PlanError: A goal cannot be planned for, or a file of areas is unusable.
        ForecastError: The bathymetry is unusable.
    """
    announce("reading the estimate")
    estimates = [read_flow(path) for path in job.flows]
    count, certain = _sample_count(estimates[0], config)
    job.check_samples(count)
    vehicle, settings = mission_settings(config, job.kind.objective, job.spline)
    settings = replace(settings, time_limit=inf if job.time_limit is None else job.time_limit)
    request = MissionRequest(
        job.start,
        job.goals,
        vehicle=vehicle,
        settings=settings,
        no_go=() if job.no_go is None else read_areas(job.no_go),
        bathymetry=None if job.bathymetry is None else read_bathymetry(job.bathymetry, estimates[0].grid),
        start_time_ns=estimates[0].time_ns or 0,
    )
    grid, notes = estimates[0].grid, () if job.no_go is None else area_notes(job.no_go, estimates[0].grid)
    if request.bathymetry is not None:
        notes += bathymetry_notes(request.bathymetry, grid)
    flow, drawn = estimates[0] if len(estimates) == 1 else estimates, estimates[0].sample(count, config.seed) if count else ()
    if job.risk is None:
        made = job.kind.plan(flow, request)
    else:
        made, _ = plan_scenarios(flow, drawn, request, allowed=job.risk, pilot=Pilot())
    few = None
    if job.waypoints and len(made.headings_deg):
        few = waypoints_of(flow, made, job.waypoint_tolerance, no_go=request.no_go, bathymetry=request.bathymetry)
    if certain:
        made = replace(made, message=f"{made.message}; the estimate states no uncertainty: how likely that is is not known")
    if not drawn or len(made.headings_deg) == 0:
        return PlannedMission(made, grid.projection, None, None, few, notes, request.no_go, request.bathymetry, grid)
    announce("flying the samples")
    odds = mission_odds(flow, drawn, made, request, None if job.kind.mooring is None else job.kind.stay)
    judged = with_odds(made, odds, job.arrive, job.accepted_risk)
    return PlannedMission(judged, grid.projection, odds, _figures(odds, job), few, notes, request.no_go, request.bathymetry, grid)


def _sample_count(estimate: FlowEstimate, config: PlannerConfig) -> tuple[int, bool]:
    """Return the number of samples, and whether there are none because the estimate has no uncertainty to draw them from."""
    if "samples" in config.model_fields_set:
        return config.samples, False
    certain = estimate.n_modes == 0
    return 0 if certain else JUDGING, certain


def _figures(odds: MissionOdds, job: PlanJob) -> dict[str, Any]:
    """Return the odds for ``--json``; figures without a further name are with corrected headings."""
    corrected, held = odds.corrected, odds.held
    return {
        "count": odds.count,
        "reached": corrected.reached,
        "reached_held": held.reached,
        "miss_median_m": corrected.miss_median,
        "miss_90_percent_m": corrected.miss_90_percent,
        "miss_90_percent_held_m": held.miss_90_percent,
        "safe": corrected.safe,
        "safe_held": held.safe,
        "violations": dict(corrected.violations),
        "allowed": job.risk,
    }


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
