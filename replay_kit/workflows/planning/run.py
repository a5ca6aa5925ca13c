"""``plan``: a mission on an estimate, or one per glider, with figures from simulated flights."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf
from time import monotonic
from typing import Any

import numpy as np

from planners.odds.mission import MissionOdds, mission_odds, with_odds
from planners.odds.rank import plan_by_odds
from planners.plan import (
    best_departure,
    cut_at_horizon,
    fly_mission,
    plan_departures,
    plan_mission,
    to_its_end,
)
from planners.request import MissionPlan, MissionRequest, MissionSettings, Mooring
from planners.several import JointMissions, assign, plan_missions, share_of_nearer, times_to_goals
from planners.simulation.currents import Flow, Sample, local_notes
from planners.waypoints import Waypoints, waypoints_of
from replay_kit.config.plan import PlanRequest
from replay_kit.config.planner import PlannerConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.plan import share_interval
from replay_kit.core.words.progress import announce
from replay_kit.core.words.text import time_text
from replay_kit.workflows.planning.adapters import (
    MissionPlanner,
    sample_count,
    span_of,
    with_origin,
    without_odds,
)
from replay_kit.workflows.planning.currents import KnownCurrent
from replay_kit.workflows.planning.request import PlannedOn, check_samples, objective_of, shape_of

# An area counts that holds within so many times the duration of a mission, as samples of it may last longer.
_LATE = 1.2
# Wider tolerances of a list of waypoints that are tried where it is not safe, in its own.
_WIDER = (2.0, 4.0, 8.0)


@dataclass(frozen=True, slots=True, eq=False)
class PlannedMission:
    """Planned mission with its odds.

    Attributes:
        job: Request of the plan.
        on: Inputs of the plan.
        plan: The mission.
        odds: Odds of a glider steered along it or its waypoints; None without samples or legs.
        waypoints: Short list of waypoints; None if not requested, or without legs.
        notes: Notes for the user.
        drawn: Number of samples drawn.
        helps: Tolerance of another, safe list of waypoints [m]; None if this one is safe, or none was found.
        held: Fraction of samples that arrive with headings held at every surfacing; None if not requested.
        departures: Compared departures, in order, each with the fraction of samples that arrive, None without samples.
    """

    job: PlanRequest
    on: PlannedOn
    plan: MissionPlan
    odds: MissionOdds | None
    waypoints: Waypoints | None
    notes: tuple[str, ...]
    drawn: int
    helps: float | None = None
    held: float | None = None
    departures: tuple[tuple[MissionPlan, float | None], ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Together:
    """Plans of several vehicles, or of a single one without a name.

    Attributes:
        planned: Planned mission by vehicle name.
        goals: Number of the goal by vehicle name, counted from 1; None without one.
        left: Numbers of unassigned goals.
        separation: Separation of each two missions, one row each.
    """

    planned: Mapping[str, PlannedMission]
    goals: Mapping[str, int | None]
    left: tuple[int, ...] = ()
    separation: tuple[Mapping[str, Any], ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class _Asked:
    """Request of missions, with current, samples and unstated dive settings."""

    job: PlanRequest
    on: PlannedOn
    flow: Flow
    drawn: Sequence[Sample]
    origin: str


def make_plans(job: PlanRequest, config: PlannerConfig, on: PlannedOn) -> Together:
    """Return the mission of a job, without a name, or those of its gliders by name, with their odds.

    Args:
        job: Checked request.
        config: ``[planner]``, overridden by the options of the command.
        on: Content of its files.

    Raises:
        ConfigError: Options are incompatible.
        PlanError: A goal cannot be planned for, or a time is outside the forecast.
    """
    if job.glider:
        return _of_gliders(job, config, on)
    return Together({"": _mission(job, config, on)}, {})


def _mission(
    job: PlanRequest, config: PlannerConfig, on: PlannedOn, span: float = 0.0
) -> PlannedMission:
    """Return one mission, in a current that changes for at least so long [s]."""
    known = on.known
    count = sample_count(known.first, config.samples)
    check_samples(job, count, known.first.n_modes > 0)
    begin_ns, notes = _begin(job, known)
    planner = mission_planner(job, config, on, job.of_glider or "")
    request, origin = planner.request(on.region, job.start_place, job.goals, begin_ns, on.no_go)
    request, notes = replace(request, shape=shape_of(job)), notes + on.notes
    if (latest := job.arrive_by_s(begin_ns)) is not None:
        longest = min(request.settings.max_duration, latest)
        settings = replace(request.settings, arrive_by=latest, max_duration=longest)
        request = replace(request, settings=settings)
    if origin and (flown := planner.flown) is not None:
        notes += flown.notes()
    level, depth = float(on.region.levels[-1]), request.settings.depth
    if depth > level:
        notes += (
            f"dives to {depth:g} m go below the forecast's {level:g} m: the current there is taken as at that level, its "
            "error grows by the shear above",
        )
    seconds, for_odds = max(span, _seconds(job, request)), job.objective == "odds"
    flow, drawn = (
        known.flow(begin_ns, seconds),
        known.samples(begin_ns, seconds, count, config.seed),
    )
    # odds that a mission was chosen by are too high: it is judged in other samples
    searched = known.samples(begin_ns, seconds, count, config.seed + 1) if for_odds else drawn
    request, made, compared = _within_times(job, request, flow, searched)
    if longer := known.longer(begin_ns, seconds, compared or (made,)):
        return _mission(job, config, on, longer)
    if compared:
        request = replace(request, start_time_ns=made.start_time_ns)
    if left := len(job.departures_ns) - len(compared):
        notes += (f"--time-limit excluded the last {left} departures",)
    if job.waypoints and len(made.headings_deg) == 0:
        notes += ("no waypoints are written: the plan has no legs",)
    asked = _Asked(job, on, flow, drawn, origin)
    planned = _judged(asked, request, made, notes)
    each = replace(asked, job=job.model_copy(update={"waypoints": False, "held": False}))
    departures = [_judged(each, request, plan, ()) for plan in compared]
    rows = ((one.plan, None if one.odds is None else one.odds.reached) for one in departures)
    return replace(planned, departures=tuple(rows))


def _of_gliders(
    job: PlanRequest, config: PlannerConfig, on: PlannedOn, span: float = 0.0
) -> Together:
    """Return the missions of several vehicles, which keep their separation; ``span`` as of one."""
    known, starts, named = on.known, job.glider_places, job.goals_of_gliders
    goals, names = tuple(place for _, place in named), tuple(starts)
    begin_ns, notes = known.begin(job.start_time_ns)
    made = {
        name: mission_planner(job, config, on, name).request(
            on.region, start, goals, begin_ns, on.no_go
        )
        for name, start in starts.items()
    }
    each = [request for request, _ in made.values()]
    seconds = max(span, *(span_of(replace(one, goals=(goal,))) for one in each for goal in goals))
    count, flow = sample_count(known.first, config.samples), known.flow(begin_ns, seconds)
    # shares that ways were chosen by are too low: they are stated in other samples
    drawn, searched = (known.samples(begin_ns, seconds, count, config.seed + k) for k in range(2))
    apart = job.separation or 0.0
    announce("assigning goals")
    times = _of_its_own(times_to_goals(flow, each, goals), names, [name for name, _ in named])
    chosen = dict(zip(names, assign(times), strict=True))
    going = {name: goal for name, goal in chosen.items() if goal is not None}
    if not going:
        raise PlanError(
            "no vehicle can reach a goal within the longest mission considered; plan each alone to see how near it comes"
        )
    requests = [
        replace(each[names.index(name)], goals=(goals[goal],)) for name, goal in going.items()
    ]
    announce("planning the missions")
    joint = plan_missions(flow, searched if apart else (), requests, apart, job.accepted_risk)
    if longer := known.longer(begin_ns, seconds, joint.plans):
        return _of_gliders(job, config, on, longer)
    asked = _Asked(job, on, flow, drawn, "")
    planned = {
        name: _judged(replace(asked, origin=made[name][1]), request, plan, (*notes, *on.notes))
        for name, plan, request in zip(going, joint.plans, joint.requests, strict=True)
    }
    return Together(
        planned,
        {name: None if goal is None else goal + 1 for name, goal in chosen.items()},
        tuple(k + 1 for k in range(len(goals)) if k not in going.values()),
        tuple(_apart(asked, joint, tuple(going))),
    )


def mission_planner(
    job: PlanRequest, config: PlannerConfig, on: PlannedOn, vehicle: str
) -> MissionPlanner:
    """Return the planner of independent missions of a vehicle."""
    more = mission_settings(job, config)
    return MissionPlanner(config, flown=on.flown.get(vehicle), bathymetry=on.bathymetry, more=more)


def mission_settings(job: PlanRequest, config: PlannerConfig) -> dict[str, Any]:
    """Return the settings of independent missions that are absent from ``[planner]``.

    Raises:
        ConfigError: The objective is neither a name nor weights.
    """
    # a plan by itself may be longer than those of a replay, unless that is configured
    stated = "max_duration" in config.model_fields_set
    limit = inf if job.time_limit is None else job.time_limit
    return {
        "objective": config.objective if job.objective is None else objective_of(job.objective),
        "max_duration": config.max_duration if stated else MissionSettings().max_duration,
        "time_limit": limit,
        "deadline": monotonic() + limit,
        "battery": inf if job.battery is None else job.battery * 1e6,
    }


def _begin(job: PlanRequest, known: KnownCurrent) -> tuple[int, tuple[str, ...]]:
    """Return the start of a mission [ns, UTC], its times checked against the forecast, and notes on it."""
    for time_ns in job.departures_ns:
        known.check_time("--depart", time_ns)
    begin_ns, notes = (
        (job.departures_ns[0], ()) if job.departures_ns else known.begin(job.start_time_ns)
    )
    if job.departures_ns and not known.changes:
        raise PlanError(
            f"--depart: expected a current that changes, got one that is frozen at {time_text(known.first.time_ns)}; "
            "give the result of a replay through a forecast's times, or several files"
        )
    last, horizon = known.ends_ns, job.horizon_s
    if horizon is not None and last is not None and begin_ns + horizon * 1e9 > last:
        raise PlanError(
            f"--horizon: expected at most {(last - begin_ns) / 3.6e12:.1f} h, to the end of the forecast at {time_text(last)}, got "
            f"{horizon / 3600.0:g} h; choose a shorter one, or leave it out"
        )
    return begin_ns, notes


def _seconds(job: PlanRequest, request: MissionRequest) -> float:
    """Return the period for which the current is needed [s], from the first departure to the last arrival."""
    if isinstance(request.shape, Mooring):
        return request.shape.duration
    between = (job.departures_ns[-1] - job.departures_ns[0]) / 1e9 if job.departures_ns else 0.0
    return min(between + span_of(request), inf if job.horizon_s is None else job.horizon_s)


def _within_times(
    job: PlanRequest, request: MissionRequest, flow: Flow, drawn: Sequence[Sample]
) -> tuple[MissionRequest, MissionPlan, tuple[MissionPlan, ...]]:
    """Return the request, the mission and the plans of all departures, with areas that take effect during it avoided throughout."""
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
    """Return the mission, and the plans of all departures if several are compared."""
    by_odds = job.risk is not None or job.objective == "odds"
    if request.settings.has_ranges and (job.departures_ns or by_odds):
        # depth and speed of the mission that neither compares departures nor keeps a margin nor a reserve
        best = plan_mission(flow, request)
        settings = replace(best.settings, depths=None, speeds=None)
        request = replace(request, vehicle=best.vehicle, settings=settings)
    if job.departures_ns:
        plans = plan_departures(flow, request, job.departures_ns)
        return plans[best_departure(plans)], plans
    made = plan_by_odds(flow, drawn, request, job.risk) if by_odds else plan_mission(flow, request)
    if job.horizon_s is None:
        return made, ()
    first = flow if isinstance(flow, FlowEstimate) else flow[0]
    return cut_at_horizon(made, job.horizon_s, first.grid.projection), ()


def _judged(
    asked: _Asked, request: MissionRequest, made: MissionPlan, notes: tuple[str, ...]
) -> PlannedMission:
    """Return a mission with its requested waypoints, and with simulated flights, along the waypoints if any."""
    job, currents, few, of_list, helps = asked.job, (asked.flow, asked.drawn), None, None, None
    known, begin_ns = asked.on.known, made.start_time_ns
    notes += known.notes(begin_ns, begin_ns + round(made.duration * 1e9))
    notes += local_notes(known.local, begin_ns)
    if job.waypoints and len(made.headings_deg):
        few, of_list = waypoints_of(asked.flow, made, request, job.waypoint_tolerance, asked.drawn)
        if not _is_safe(few, of_list, job):
            helps = _other_tolerance(asked, request, made)
    if not asked.drawn:
        made = without_odds(made, known.first)
    made = with_origin(made, asked.origin)
    planned = PlannedMission(job, asked.on, made, None, few, notes, len(asked.drawn), helps)
    if not asked.drawn or len(made.headings_deg) == 0:
        return planned
    announce("flying the samples")
    # one that was cut is to come to where it was cut
    flown = to_its_end(made) if made.status == "partial" else made
    odds = of_list or mission_odds(*currents, flown, request)
    planned = replace(planned, plan=with_odds(made, odds, job.arrive, job.accepted_risk), odds=odds)
    if not job.held:
        return planned
    radius = made.settings.radius or made.settings.tolerance
    held = float((fly_mission(asked.drawn, made)[1] <= radius).all(axis=1).mean())
    told = f"{100.0 * held:.0f} % arrive with headings held at every surfacing"
    return replace(planned, held=held, notes=(*notes, told))


def _is_safe(few: Waypoints, odds: MissionOdds | None, job: PlanRequest) -> bool:
    """Return whether a list of waypoints violates no constraint, also in the samples, if any."""
    violating = 0.0 if odds is None else 1.0 - odds.safe
    return few.violation is None and violating <= job.accepted_risk + 1e-9


def _other_tolerance(asked: _Asked, request: MissionRequest, made: MissionPlan) -> float | None:
    """Return the first of some wider tolerances with a safe list [m]; a glider that may deviate further keeps steadier headings."""
    usual = asked.job.waypoint_tolerance or made.settings.tolerance
    for tolerance in (times * usual for times in _WIDER):
        if request.settings.is_late:
            break
        if _is_safe(*waypoints_of(asked.flow, made, request, tolerance, asked.drawn), asked.job):
            return tolerance
    return None


def _apart(asked: _Asked, joint: JointMissions, names: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Yield the separation of each two missions, one row each, for console and JSON."""
    least = asked.job.separation or 0.0
    for one in joint.nearness:
        share = None
        if asked.drawn and least:
            # of samples that the ways were not chosen by
            share = share_of_nearer(asked.flow, asked.drawn, joint, one.vehicles, least)
        yield {
            "vehicles": [names[k] for k in one.vehicles],
            "least_distance_m": one.distance,
            "time": time_text(one.time_ns),
            "separation_m": least or None,
            "nearer_in_samples": share,
            "nearer_interval": None if share is None else share_interval(share, len(asked.drawn)),
            "kept": not one.distance < least,
        }


def _of_its_own(times: Array, vehicles: Sequence[str], goals_of: Sequence[str]) -> Array:
    """Return times in which a vehicle's own goal is out of reach of all others, and other goals of that vehicle."""
    allowed = np.ones(times.shape, dtype=bool)
    for k, vehicle in enumerate(vehicles):
        own = np.array([name == vehicle for name in goals_of])
        allowed[k] = own if own.any() else np.array([not name for name in goals_of])
    return np.where(allowed, times, np.inf)
