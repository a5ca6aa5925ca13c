"""``plan``: a mission on an estimate, and its figures in samples of the estimate."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf, isfinite
from typing import Any

from planners.departures import best_departure, cut_at_horizon, plan_departures, to_its_end
from planners.flights import fly_mission
from planners.odds.mission import MissionOdds, mission_odds, with_odds
from planners.odds.rank import plan_by_odds
from planners.plan import plan_mission
from planners.request import MissionPlan, MissionRequest, MissionSettings
from planners.simulation.currents import Flow, Sample, local_notes
from planners.waypoints import Waypoints, waypoints_of
from replay_kit.config.plan import PlanRequest
from replay_kit.config.planner import PlannerConfig
from replay_kit.core.as_flown import AsFlown
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.plan import share_interval
from replay_kit.core.progress import announce
from replay_kit.core.text import time_text
from replay_kit.workflows.planning.adapters import (
    MissionPlanner,
    sample_count,
    with_origin,
    without_odds,
)
from replay_kit.workflows.planning.inputs import PlannedOn
from replay_kit.workflows.planning.request import check_samples, line_of, mooring_of, objective_of

# An area counts that holds within so many times the duration of a mission, as samples of it may last longer.
_LATE = 1.2


@dataclass(frozen=True, slots=True)
class Departure:
    """One of several departures that were compared.

    Attributes:
        start_time_ns: When it begins [ns, UTC].
        status: Of its mission.
        duration: [s].
        energy: [J].
        legs: Their number.
        miss: Of the last goal [m].
        reached: Share of the simulated flights that arrive; None without samples.
    """

    start_time_ns: int
    status: str
    duration: float
    energy: float
    legs: int
    miss: float
    reached: float | None

    @classmethod
    def of(cls, plan: MissionPlan, reached: float | None) -> "Departure":
        """Return the departure of a mission, with the share of the samples that arrive."""
        count, miss = len(plan.headings_deg), float(plan.closest_approach[-1])
        return cls(
            plan.start_time_ns, plan.status, plan.duration, plan.energy, count, miss, reached
        )


@dataclass(frozen=True, slots=True, eq=False)
class PlannedMission:
    """A mission, and what samples of the estimate make of it.

    Attributes:
        plan: The mission.
        on: What it is made on.
        odds: Of the glider that is steered along it, or along its waypoints; None without samples or legs.
        samples: They as in the JSON; None without samples or legs.
        waypoints: Short list of places to head for; None when none is asked for, or there are no legs.
        notes: What should be known of it.
        drawn: Number of samples drawn.
        departures: That were compared, in order; none where only one was planned.
    """

    plan: MissionPlan
    on: PlannedOn
    odds: MissionOdds | None
    samples: dict[str, Any] | None
    waypoints: Waypoints | None
    notes: tuple[str, ...]
    drawn: int
    departures: tuple[Departure, ...] = ()


def make_mission(job: PlanRequest, config: PlannerConfig, on: PlannedOn) -> PlannedMission:
    """Return the mission of a job, with its odds in samples of the estimate.

    Args:
        job: What is asked for, checked.
        config: ``[planner]`` with the command's options laid over it.
        on: What its files hold.

    Raises:
        ConfigError: Options do not go together.
        PlanError: A goal cannot be planned for, or a time is outside of the forecast.
    """
    known = on.known
    count = sample_count(known.first, config.samples)
    check_samples(job, count, known.first.n_modes > 0)
    bound, origin = mission_planner(job, config, on.flown).bound(known.first, job.goals)
    request, notes = _request(job, replace(bound, bathymetry=on.bathymetry), on)
    notes += on.notes
    if (latest := job.arrive_by_s(request.start_time_ns)) is not None:
        longest = min(bound.settings.max_duration, latest)
        settings = replace(bound.settings, arrive_by=latest, max_duration=longest)
        bound = replace(bound, settings=settings)
        request = replace(request, settings=bound.settings)
    if origin and on.flown is not None:
        notes += on.flown.notes()
    level = float(known.first.grid.levels[-1])
    if bound.settings.depth > level:
        notes += (
            f"dives to {bound.settings.depth:g} m go below the forecast's {level:g} m: the current there is taken as at that level, its "
            "error grows by the shear above",
        )
    begin_ns, seconds = request.start_time_ns, _seconds(job, bound)
    flow = known.flow(begin_ns, seconds)
    drawn = known.samples(begin_ns, seconds, count, config.seed)
    # odds that a mission was chosen by are too high: it is judged in other samples
    searched = (
        known.samples(begin_ns, seconds, count, config.seed + 1)
        if job.objective == "odds"
        else drawn
    )
    request, made, compared = _within_times(job, request, flow, searched)
    if compared:
        request = replace(request, start_time_ns=made.start_time_ns)
    few, of_list = None, None
    if len(made.headings_deg) == 0:
        if job.waypoints:
            notes += ("no waypoints are written: the plan has no legs",)
    elif job.waypoints:
        few, of_list = waypoints_of(flow, made, request, job.waypoint_tolerance, drawn)
    notes += known.notes(
        made.start_time_ns, made.start_time_ns + round(made.duration * 1e9)
    ) + local_notes(known.local, made.start_time_ns)
    if count == 0:
        made = without_odds(made, known.first)
    made, compared = with_origin(made, origin), tuple(with_origin(one, origin) for one in compared)
    planned = PlannedMission(made, on, None, None, few, notes, count)
    if not drawn or len(made.headings_deg) == 0:
        return replace(planned, departures=tuple(Departure.of(plan, None) for plan in compared))
    announce("flying the samples")
    judged, odds = _judged(job, request, (flow, drawn), made, of_list)
    shaped = job.mooring is not None or job.line or compared or job.risk is not None
    if judged.status == "uncertain" and job.objective in (None, "time") and not shaped:
        hint = "--objective odds looks for a mission that more samples arrive with"
        planned = replace(planned, notes=(*planned.notes, hint))
    held = _held(made, drawn) if job.held else None
    if held is not None:
        told = f"{100.0 * held:.0f} % arrive with headings held at every surfacing"
        planned = replace(planned, notes=(*planned.notes, told))
    departures = tuple(_departure(job, request, (flow, drawn), plan) for plan in compared)
    return replace(
        planned,
        plan=judged,
        odds=odds,
        samples={**samples_json(odds, job), "held": held},
        departures=departures,
    )


def _request(
    job: PlanRequest, bound: MissionPlanner, on: PlannedOn
) -> tuple[MissionRequest, tuple[str, ...]]:
    """Return what is asked of the planner, its times checked against the forecast, and what should be known of when it begins."""
    known = on.known
    for time_ns in job.departures_ns:
        known.check_time("--depart", time_ns)
    begin_ns, notes = (
        (job.departures_ns[0], ()) if job.departures_ns else known.begin(job.start_time_ns)
    )
    if job.departures_ns and not known.changes:
        raise PlanError(
            f"--depart: expected a current that changes, got one that is frozen at {time_text(known.first.time_ns)}, in which all "
            "departures are the same; give the result of a replay through a forecast's times, or several files"
        )
    last = known.ends_ns
    horizon = job.horizon_s
    if horizon is not None and last is not None and begin_ns + horizon * 1e9 > last:
        raise PlanError(
            f"--horizon: expected at most {(last - begin_ns) / 3.6e12:.1f} h, to the end of the forecast at {time_text(last)}, got "
            f"{horizon / 3600.0:g} h; choose a shorter one, or leave it out to plan the rest in the last current known"
        )
    asked = bound.request(job.start_place, job.goals, begin_ns, on.no_go)
    return replace(asked, shape=mooring_of(job) or line_of(job)), notes


def _seconds(job: PlanRequest, bound: MissionPlanner) -> float:
    """Return for how long the current is needed [s]: that of the mission, from the first departure to the last arrival."""
    if (mooring := mooring_of(job)) is not None:
        return mooring.duration
    between = (job.departures_ns[-1] - job.departures_ns[0]) / 1e9 if job.departures_ns else 0.0
    span = between + bound.span(job.start_place, job.goals)
    return span if job.horizon_s is None else min(span, job.horizon_s)


def _within_times(
    job: PlanRequest, request: MissionRequest, flow: Flow, drawn: Sequence[Sample]
) -> tuple[MissionRequest, MissionPlan, tuple[MissionPlan, ...]]:
    """Return the mission that keeps out of areas whose time it lasts into, throughout; its request, and the plans of all departures."""
    areas, counted = request.no_go, tuple(area for area in request.no_go if not area.is_timed)
    while True:
        request = replace(request, no_go=counted)
        made, compared = _planned(job, request, flow, drawn)
        late = (
            area
            for area in areas
            if area not in counted
            and any(
                area.holds(one.start_time_ns, one.start_time_ns + round(_LATE * one.duration * 1e9))
                for one in compared or (made,)
            )
        )
        if (further := next(late, None)) is None:
            return request, made, compared
        counted = (*counted, further)


def _planned(
    job: PlanRequest, request: MissionRequest, flow: Flow, drawn: Sequence[Sample]
) -> tuple[MissionPlan, tuple[MissionPlan, ...]]:
    """Return the mission, and the plans of all departures where several are compared."""
    ranges = request.settings.depths, request.settings.speeds
    for_odds = job.objective == "odds"
    if any(ranges) and (job.departures_ns or job.risk is not None or for_odds):
        # depth and speed of the mission that neither compares departures nor keeps a margin nor a reserve
        best = plan_mission(flow, request)
        settings = replace(best.settings, depths=None, speeds=None)
        request = replace(request, vehicle=best.vehicle, settings=settings)
    if job.departures_ns:
        plans = plan_departures(flow, request, job.departures_ns)
        return plans[best_departure(plans)], plans
    made = (
        plan_by_odds(flow, drawn, request, job.risk)
        if job.risk is not None or for_odds
        else plan_mission(flow, request)
    )
    if job.horizon_s is None:
        return made, ()
    first = flow if isinstance(flow, FlowEstimate) else flow[0]
    return cut_at_horizon(made, job.horizon_s, first.grid.projection), ()


def _judged(
    job: PlanRequest,
    request: MissionRequest,
    currents: tuple[Flow, Sequence[Sample]],
    made: MissionPlan,
    odds: MissionOdds | None = None,
) -> tuple[MissionPlan, MissionOdds]:
    """Return a mission with its odds in its status and message, and the odds; one that was cut is to come to where it was cut."""
    if odds is None:
        flown = to_its_end(made) if made.status == "partial" else made
        odds = mission_odds(*currents, flown, request)
    return with_odds(made, odds, job.arrive, job.accepted_risk), odds


def _departure(
    job: PlanRequest,
    request: MissionRequest,
    currents: tuple[Flow, Sequence[Sample]],
    made: MissionPlan,
) -> Departure:
    """Return the row of one departure, with its odds."""
    if len(made.headings_deg) == 0:
        return Departure.of(made, None)
    judged, odds = _judged(job, request, currents, made)
    return Departure.of(judged, odds.reached)


def _held(made: MissionPlan, drawn: Sequence[Sample]) -> float:
    """Return the share of samples in which a mission arrives with its headings held at every surfacing."""
    radius = made.settings.radius or made.settings.tolerance
    return float((fly_mission(drawn, made).miss <= radius).all(axis=1).mean())


def samples_json(odds: MissionOdds, job: PlanRequest) -> dict[str, Any]:
    """Return the odds for ``--json``."""
    figures = {
        "count": odds.count,
        "radius_m": odds.radius,
        "deadline_s": odds.deadline,
        "reached": odds.reached,
        "arrival_median_s": odds.arrival_median,
        "arrival_90_percent_s": odds.arrival_90_percent,
        "miss_median_m": odds.miss_median,
        "miss_90_percent_m": odds.miss_90_percent,
        "safe": odds.safe,
    }
    return {
        **{name: value if isfinite(value) else None for name, value in figures.items()},
        "reached_interval": share_interval(odds.reached, odds.count),
        "violations": dict(odds.violations),
        "allowed": job.risk,
    }


def mission_planner(
    job: PlanRequest, config: PlannerConfig, flown: AsFlown | None = None
) -> MissionPlanner:
    """Return the planner of a mission that is planned by itself.

    Args:
        job: What is asked for.
        config: ``[planner]`` with the command's options laid over it.
        flown: How the vehicle flew the dives of the log; None where that is not known.

    Raises:
        ConfigError: The objective is neither a name nor weights.
        PlanError: The vehicle's numbers are such that nothing glides.
    """
    planner, objective = MissionPlanner.of(config), job.objective
    settings = replace(
        planner.settings,
        objective=planner.settings.objective if objective is None else objective_of(objective),
        # a plan by itself may be longer than those of a replay, unless that is configured
        max_duration=config.max_duration
        if "max_duration" in config.model_fields_set
        else MissionSettings().max_duration,
        time_limit=inf if job.time_limit is None else job.time_limit,
        battery=inf if job.battery is None else job.battery * 1e6,
    )
    return replace(planner, settings=settings, flown=flown)
