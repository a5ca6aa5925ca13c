"""``plan``: a mission on an estimate, or one per glider, with figures from simulated flights."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf
from time import monotonic
from typing import Any

import numpy as np

from planners.odds.mission import MissionOdds, mission_odds, with_odds
from planners.odds.rank import plan_by_odds
from planners.plan import best_departure, cut_at_horizon, fly_mission, plan_mission, to_its_end
from planners.request import MissionPlan, MissionRequest, MissionSettings, Mooring
from planners.several import JointMissions, assign, plan_missions, share_of_nearer, times_to_goals
from planners.simulation.currents import Flow, Sample, local_notes
from planners.waypoints import Waypoints, waypoints_of
from replay_kit.config.plan import PlanRequest
from replay_kit.config.planner import PlannerConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.plan import Place, share_interval
from replay_kit.core.words.progress import announce
from replay_kit.core.words.text import time_text
from replay_kit.workflows.planning.adapters import (
    MissionPlanner,
    sample_count,
    span_of,
    with_origin,
    without_odds,
)
from replay_kit.workflows.planning.request import PlannedOn, check_samples, objective_of, shape_of

# An area counts that holds within so many times the duration of a mission, as samples of it may last longer.
_LATE = 1.2
# Other tolerances of a list of waypoints that are tried where it is not safe, in its own.
_OTHERS = (2.0, 4.0, 8.0, 0.5, 0.25)


@dataclass(frozen=True, slots=True, eq=False)
class PlannedMission:
    """Planned mission with its odds.

    Attributes:
        job: Request of the plan.
        on: Inputs of the plan.
        plan: The mission.
        odds: Odds along it or its waypoints; None without samples or legs.
        waypoints: List of waypoints; None if not requested, or without legs.
        notes: Notes for the user.
        drawn: Number of samples drawn.
        helps: Tolerance of another, safe list [m]; None if this one is safe, or none was found.
        held: Fraction that arrives with headings held; None if not requested.
        departures: Missions of the compared departures, in order.
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
    departures: tuple["PlannedMission", ...] = ()


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
    """Request of a vehicle, values that no setting states, as text, and notes on them."""

    request: MissionRequest
    origin: str
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Judge:
    """Request of missions, with the current and the samples that they are judged in."""

    job: PlanRequest
    on: PlannedOn
    flow: Flow
    drawn: Sequence[Sample]


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
    if not job.departures_ns:
        return _made(job, config, on)
    for time_ns in job.departures_ns:
        on.known.check_time("--depart", time_ns)
    if not on.known.changes:
        raise PlanError(
            f"--depart: expected a current that changes, got one that is frozen at {time_text(on.known.first.time_ns)}; "
            "give the result of a replay through a forecast's times, or several files"
        )
    until = monotonic() + (inf if job.time_limit is None else job.time_limit)
    each, alone = list[PlannedMission](), dict[str, Any](depart=None, waypoints=False, held=False)
    for time_ns in job.departures_ns:
        limit = until - monotonic() if each and job.time_limit else job.time_limit
        if limit is not None and limit <= 0.0:
            break
        alone |= {"start_time": time_text(time_ns), "time_limit": limit}
        each.append(_made(job.model_copy(update=alone), config, on).planned[""])
    k = best_departure([one.plan for one in each])
    if job.waypoints or job.held:
        alone = {"depart": None, "start_time": each[k].job.start_time}
        each[k] = _made(job.model_copy(update=alone), config, on).planned[""]
    left = len(job.departures_ns) - len(each)
    notes = (f"--time-limit excluded the last {left} departures",) * bool(left)
    best = replace(each[k], departures=tuple(each), notes=(*notes, *each[k].notes))
    return Together({"": best}, {})


def _made(job: PlanRequest, config: PlannerConfig, on: PlannedOn) -> Together:
    """Return the missions of a job with one departure; see ``make_plans``."""
    known = on.known
    count = sample_count(known.first, config.samples)
    check_samples(job, count, known.first.n_modes > 0)
    starts = job.glider_places or {"": job.start_place}
    begins = {name: known.begin(job.start_time_ns, name or job.of_glider or "") for name in starts}
    begin_ns, last_begin_ns = (end(time for time, _ in begins.values()) for end in (min, max))
    last_ns, horizon = known.ends_ns, job.horizon_s
    if horizon is not None and last_ns is not None and begin_ns + horizon * 1e9 > last_ns:
        raise PlanError(
            f"--horizon: expected at most {(last_ns - begin_ns) / 3.6e12:.1f} h, to the end of the forecast at {time_text(last_ns)}, got "
            f"{horizon / 3600.0:g} h; choose a shorter one, or leave it out"
        )
    asked = {name: _asked(job, config, on, name, at, begins[name]) for name, at in starts.items()}
    seconds = _seconds(job, [one.request for one in asked.values()])
    seconds += (last_begin_ns - begin_ns) / 1e9
    while True:
        judge = _Judge(
            job,
            on,
            known.flow(begin_ns, seconds),
            known.samples(begin_ns, seconds, count, config.seed),
        )
        searched = judge.drawn
        if job.objective == "odds" or job.separation:
            # shares that a mission or a way was chosen by are too high: they are stated in other samples
            searched = known.samples(begin_ns, seconds, count, config.seed + 1)
        chosen, joint = _chosen(job, asked, judge.flow, searched)
        longer = known.longer(begin_ns, seconds, joint.plans)
        if not longer:
            break
        seconds = longer
    names = [name for name, goal in chosen.items() if goal is not None]
    planned = {
        name: _judged(judge, replace(asked[name], request=request), plan)
        for name, request, plan in zip(names, joint.requests, joint.plans, strict=True)
    }
    if not job.glider:
        return Together(planned, {})
    going = {name: None if goal is None else goal + 1 for name, goal in chosen.items()}
    left = {*range(1, len(job.goal) + 1)} - {*going.values()}
    return Together(planned, going, (*sorted(left),), tuple(_apart(judge, joint, names)))


def _asked(
    job: PlanRequest,
    config: PlannerConfig,
    on: PlannedOn,
    name: str,
    start: Place,
    begin: tuple[int, tuple[str, ...]],
) -> _Asked:
    """Return the request of a vehicle to all goals; ``begin`` is its start [ns, UTC] and the notes on it."""
    begin_ns, notes = begin
    flown = on.flown.get(name or job.of_glider or "")
    kind, more = config.model_copy(update={"kind": "mission"}), mission_settings(job, config)
    planner = MissionPlanner(kind, flown=flown, bathymetry=on.bathymetry, more=more)
    goals = tuple(place for _, place in job.goals_of_gliders)
    request, origin = planner.request(on.region, start, goals, begin_ns, on.no_go)
    request, settings = replace(request, shape=shape_of(job)), request.settings
    notes += on.notes
    if (latest := job.arrive_by_s(begin_ns)) is not None:
        longest = min(settings.max_duration, latest)
        settings = replace(settings, arrive_by=latest, max_duration=longest)
    if origin and flown is not None:
        notes += flown.notes()
    level, depth = float(on.region.levels[-1]), settings.depth
    if depth > level:
        notes += (
            f"dives to {depth:g} m go below the forecast's {level:g} m: the current there is taken as at that level, its "
            "error grows by the shear above",
        )
    return _Asked(replace(request, settings=settings), origin, notes)


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


def _seconds(job: PlanRequest, requests: Sequence[MissionRequest]) -> float:
    """Return the period for which the current is needed [s]."""
    if isinstance(mooring := requests[0].shape, Mooring):
        return mooring.duration
    if job.glider:
        requests = [replace(one, goals=(goal,)) for one in requests for goal in one.goals]
    return min(max(map(span_of, requests)), inf if job.horizon_s is None else job.horizon_s)


def _chosen(
    job: PlanRequest, asked: Mapping[str, _Asked], flow: Flow, drawn: Sequence[Sample]
) -> tuple[dict[str, int | None], JointMissions]:
    """Return the number of each vehicle's goal, None without one, and the missions of those with a goal; one goes to all."""
    each = [one.request for one in asked.values()]
    if not job.glider:
        request, made = _within_times(job, each[0], flow, drawn)
        return dict.fromkeys(asked, 0), JointMissions((made,), (request,), ())
    goals, apart = each[0].goals, job.separation or 0.0
    announce("assigning goals")
    owners = [name for name, _ in job.goals_of_gliders]
    times = _only_own_goals(times_to_goals(flow, each, goals), [*asked], owners)
    chosen = dict(zip(asked, assign(times), strict=True))
    requests = [
        replace(request, goals=(goals[goal],))
        for request, goal in zip(each, chosen.values(), strict=True)
        if goal is not None
    ]
    if not requests:
        raise PlanError(
            "no vehicle can reach a goal within the longest mission considered; plan each alone to see how near it comes"
        )
    announce("planning the missions")
    samples = drawn if apart else ()
    return chosen, plan_missions(flow, samples, requests, apart, job.accepted_risk)


def _within_times(
    job: PlanRequest, request: MissionRequest, flow: Flow, drawn: Sequence[Sample]
) -> tuple[MissionRequest, MissionPlan]:
    """Return the request and its mission, with areas that take effect during it avoided throughout."""
    areas, counted = request.no_go, tuple(area for area in request.no_go if not area.is_timed)
    while True:
        request = replace(request, no_go=counted)
        made = _planned(job, request, flow, drawn)
        begin_ns, lasts_ns = made.start_time_ns, round(_LATE * made.duration * 1e9)
        late = [area for area in areas if area.holds(begin_ns, begin_ns + lasts_ns)]
        late = [area for area in late if area not in counted]
        if not late:
            return request, made
        counted = (*counted, late[0])


def _planned(
    job: PlanRequest, request: MissionRequest, flow: Flow, drawn: Sequence[Sample]
) -> MissionPlan:
    """Return the mission of a request."""
    by_odds = job.risk is not None or job.objective == "odds"
    if request.settings.has_ranges and by_odds:
        # depth and speed of the mission that keeps neither a margin nor a reserve
        best = plan_mission(flow, request)
        settings = replace(best.settings, depths=None, speeds=None)
        request = replace(request, vehicle=best.vehicle, settings=settings)
    made = plan_by_odds(flow, drawn, request, job.risk) if by_odds else plan_mission(flow, request)
    if job.horizon_s is None:
        return made
    first = flow if isinstance(flow, FlowEstimate) else flow[0]
    return cut_at_horizon(made, job.horizon_s, first.grid.projection)


def _judged(judge: _Judge, asked: _Asked, made: MissionPlan) -> PlannedMission:
    """Return a mission with its requested waypoints, and with simulated flights, along the waypoints if any."""
    job, known, drawn, begin_ns = judge.job, judge.on.known, judge.drawn, made.start_time_ns
    has_legs, few, odds, helps, held = len(made.headings_deg) > 0, None, None, None, None
    notes = asked.notes
    if job.waypoints and not has_legs:
        notes += ("no waypoints are written: the plan has no legs",)
    notes += known.notes(begin_ns, begin_ns + round(made.duration * 1e9))
    notes += local_notes(known.local, begin_ns)
    if job.waypoints and has_legs:
        few, odds = waypoints_of(judge.flow, made, asked.request, job.waypoint_tolerance, drawn)
        if not _is_safe(few, odds, job):
            helps = _other_tolerance(judge, asked.request, made)
    if not drawn:
        made = without_odds(made, known.first)
    made = with_origin(made, asked.origin)
    if drawn and has_legs:
        announce("flying the samples")
        # one that was cut is to come to where it was cut
        flown = to_its_end(made) if made.status == "partial" else made
        odds = odds or mission_odds(judge.flow, drawn, flown, asked.request)
        to = " that head for the waypoints" * (few is not None)
        made = with_odds(made, odds, job.arrive, job.accepted_risk, to)
        if job.held:
            radius = made.settings.radius or made.settings.tolerance
            held = float((fly_mission(drawn, made)[1] <= radius).all(axis=1).mean())
            notes += (f"{100.0 * held:.0f} % arrive with headings held at every surfacing",)
    return PlannedMission(job, judge.on, made, odds, few, notes, len(drawn), helps, held)


def _is_safe(few: Waypoints, odds: MissionOdds | None, job: PlanRequest) -> bool:
    """Return whether a list of waypoints violates no constraint, also in the samples, if any."""
    violating = 0.0 if odds is None else 1.0 - odds.safe
    return few.violation is None and violating <= job.accepted_risk + 1e-9


def _other_tolerance(judge: _Judge, request: MissionRequest, made: MissionPlan) -> float | None:
    """Return the first of some other tolerances with a safe list [m]: wider ones give steadier headings, smaller ones nearer tracks."""
    usual = judge.job.waypoint_tolerance or made.settings.tolerance
    for tolerance in (times * usual for times in _OTHERS):
        if not request.settings.is_late and _is_safe(
            *waypoints_of(judge.flow, made, request, tolerance, judge.drawn), judge.job
        ):
            return tolerance
    return None


def _apart(judge: _Judge, joint: JointMissions, names: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Yield the separation of each two missions, one row each, for console and JSON."""
    least = judge.job.separation or 0.0
    for pair in joint.nearness:
        share = None
        if judge.drawn and least:
            # of samples that the ways were not chosen by
            share = share_of_nearer(judge.flow, judge.drawn, joint, pair.vehicles, least)
        yield {
            "vehicles": [names[k] for k in pair.vehicles],
            "least_distance_m": pair.distance,
            "time": time_text(pair.time_ns),
            "separation_m": least or None,
            "nearer_in_samples": share,
            "nearer_interval": None if share is None else share_interval(share, len(judge.drawn)),
            "kept": not pair.distance < least,
        }


def _only_own_goals(times: Array, vehicles: Sequence[str], goals_of: Sequence[str]) -> Array:
    """Return times in which a vehicle's own goal is out of reach of all others, and other goals of that vehicle."""
    allowed = np.ones(times.shape, dtype=bool)
    for k, vehicle in enumerate(vehicles):
        of_vehicle = np.array([name == vehicle for name in goals_of])
        allowed[k] = of_vehicle if of_vehicle.any() else np.array([not name for name in goals_of])
    return np.where(allowed, times, np.inf)
