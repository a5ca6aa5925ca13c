"""Plan of a mission: the best found, with commands, track and outcome in words; the best departure, a horizon, and open-loop flights."""

from collections.abc import Sequence
from dataclasses import replace
from math import inf

import numpy as np

from planners.program.solution import (
    arrives,
    deviation,
    is_feasible,
    lacking_energy,
    overtime,
    staying_mission,
)
from planners.program.starts import Answer, search
from planners.program.words import horizon_text, outcome_text, tried_text
from planners.request import Found, Line, MissionPlan, MissionRequest, Mooring
from planners.simulation.currents import Flow, Sample, currents_of, currents_of_samples
from planners.simulation.fly import COARSE, Flight, Legs, fly
from planners.task import Task, apogee_depths, task_of, turns_of, yo_depths
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import distance, to_geographic, to_local
from replay_kit.core.grid import Projection
from replay_kit.core.plan import Place, PlanStatus

Statistics = dict[str, float | int | str]


def plan_mission(
    flow: Flow, request: MissionRequest, *, warm: MissionPlan | None = None
) -> MissionPlan:
    """Return the best plan found for one or more goals, a line or a mooring.

    ``status`` and ``message`` of the result state whether the goals are reached and which limit binds.

    Args:
        flow: Current estimate, or estimates at increasing times, interpolated linearly.
        request: Start, goals, vehicle, settings and constraints.
        warm: Earlier plan for the same goals, used as a warm start if its remaining legs match the request. If feasible, only clearly
            faster routes are tried and no lower bound is computed.

    Raises:
        PlanError: The start or a goal is outside the region, on land or in a forbidden area; a depth does not fit; the miss distance has no
        weight; a line has no length; a mooring starts outside its radius or needs too many legs.
    """
    task = task_of(flow, request)
    if not task.is_finite:
        message = "the current is not a number; check the estimate's latent velocities"
        return _plan_of(
            task, Answer(staying_mission(task), [], None), "failed", message, {"attempts": 0}
        )
    return to_plan(task, search(task, warm))


def to_plan(task: Task, answer: Answer) -> MissionPlan:
    """Return the result of the search as a plan."""
    best = answer.best
    reached = arrives(task, best) and overtime(task, best) == lacking_energy(task, best) == 0.0
    if not best.count:
        reached = True
    status: PlanStatus = "unsafe" if best.violation else "reached" if reached else "unreachable"
    message = outcome_text(task, answer, above_bound(task, answer))
    return _plan_of(task, answer, status, message, _statistics(task, answer))


def _plan_of(
    task: Task, answer: Answer, status: PlanStatus, message: str, statistics: Statistics
) -> MissionPlan:
    best, request, projection = answer.best, task.request, task.region.grid.projection
    flight, vehicle = best.flight, best.task.vehicle
    track = np.column_stack([flight.place[0], flight.depth])
    time = flight.time[0]
    return MissionPlan(
        status=status,
        start=request.start,
        goals=request.goals,
        start_time_ns=request.start_time_ns,
        vehicle=vehicle,
        settings=task.settings,
        headings_deg=np.mod(np.rad2deg(best.legs.headings), 360.0),
        glide_angles_deg=np.rad2deg(best.legs.angles),
        pitches_deg=np.rad2deg(vehicle.pitch(best.legs.angles)),
        yo_depths=yo_depths(best.legs.turns),
        surfacings=np.column_stack(to_geographic(projection, *track[flight.ends, :2].T)),
        surfacing_times=time[flight.ends],
        goal_legs=best.goal_legs,
        goal_times=time[best.points],
        closest_approach=best.miss,
        duration=float(time[-1]),
        energy=best.energy,
        track_time=time,
        track=track,
        message=message,
        statistics=statistics,
        shape=task.shape,
    )


def _statistics(task: Task, answer: Answer) -> Statistics:
    tried, bound = answer.tried, answer.bound
    feasible = [one.seconds / 3600.0 for one in tried if is_feasible(task, one)]
    statistics: Statistics = {
        "attempts": len(tried),
        "iterations": sum(one.solved.iterations for one in tried),
        "tried": "; ".join(map(tried_text, tried)),
        "longest_met_h": max(feasible, default=float("nan")),
        "steps": answer.best.solved.steps,
    }
    if bound is not None and bound.is_tight and np.isfinite(bound.time):
        statistics |= {"bound_h": bound.time / 3600.0}
    if (above := above_bound(task, answer)) is not None:
        statistics |= {"above_bound_percent": above}
    if isinstance(task.shape, Line | Mooring):
        farthest, rms = deviation(task, answer.best)
        statistics |= {"farthest_m": farthest, "rms_m": rms}
    return statistics


def above_bound(task: Task, answer: Answer) -> float | None:
    """Return the relative excess of the arrival time over its lower bound [%]; None if the bound is invalid or 0."""
    bound, best = answer.bound, answer.best
    if not best.count:
        return None
    # shallower dives than those asked for meet another mean current
    full = np.array_equal(best.legs.turns, task.turns(np.full(best.count, task.settings.depth)))
    if bound is None or not bound.is_tight or not 0.0 < bound.time < inf or not full:
        return None
    if not arrives(task, best):
        return None
    return 100.0 * (float(best.flight.time[0, best.points[-1]]) / bound.time - 1.0)


# Share of a glide by which it goes on.
_MORE = 0.5


def fly_mission(flows: FlowEstimate | Sequence[Sample], plan: MissionPlan) -> tuple[Flight, Array]:
    """Return open-loop flights of a plan in K currents, and the miss distance of each goal at its planned time, shape (K, G) [m].

    Args:
        flows: Flows on the same nodes; time-dependent ones at the same increasing times. Their projection may differ from the plan's.
        plan: The mission.

    Raises:
        PlanError: The plan has no legs, or the flows are not on the same nodes.
    """
    currents = currents_of_samples([flows] if isinstance(flows, FlowEstimate) else flows)
    count, vehicle = len(currents.latent), plan.vehicle
    if count > 1 and (vehicle.speed_spread or vehicle.speed_error):
        each = [vehicle.paces(count, dive) for dive in range(len(plan.headings_deg))]
        currents = replace(currents, pace=np.mean(each, axis=0))
    legs, frame = legs_of_plan(plan), currents.flow.grid.projection
    start, *goals = (
        np.array(to_local(frame, place.longitude, place.latitude))
        for place in (plan.start, *plan.goals)
    )
    clock, parts = currents.clock(plan.start_time_ns), int(plan.statistics.get("steps", COARSE))
    deep = np.array([goal.depth for goal in plan.goals])
    flight = fly(currents, vehicle, (start, clock), legs, parts, deep)
    met = flight.place[:, np.searchsorted(flight.time[0], plan.goal_times - 1e-3)]
    return flight, np.linalg.norm(met - np.array(goals), axis=2)


def closest_approach(flow: Flow, plan: MissionPlan) -> float:
    """Return the closest approach of a plan's open-loop track to its last goal, in three dimensions [m].

    The last leg is extended by half its duration.
    """
    flight, _ = fly_mission([flow], _longer(plan))
    goal, projection = plan.goals[-1], currents_of(flow).flow.grid.projection
    at = np.array([*to_local(projection, goal.longitude, goal.latitude), goal.depth])
    track = np.column_stack([flight.place[0], flight.depth])
    begin, way = track[:-1], np.diff(track, axis=0)
    share = np.sum((at - begin) * way, axis=1) / np.maximum(np.sum(way**2, axis=1), 1e-9)
    nearest = begin + np.clip(share, 0.0, 1.0)[:, None] * way
    return float(np.min(np.linalg.norm(nearest - at, axis=1)))


def _longer(plan: MissionPlan) -> MissionPlan:
    """Return a glide extended as far as its depth allows; other plans unchanged."""
    if plan.settings.yos > 0:
        return plan
    first, last = plan.yo_depths[0][0], plan.yo_depths[0][-1]
    return replace(plan, yo_depths=((first, max(last + _MORE * (last - first), 0.0)),))


def legs_of_plan(plan: MissionPlan) -> Legs:
    """Return the commands of a plan.

    Raises:
        PlanError: The plan has no legs.
    """
    plan.require_legs()
    drifts = np.append(np.full(len(plan.yo_depths) - 1, plan.settings.surface_time), 0.0)
    return Legs(
        np.deg2rad(plan.headings_deg),
        np.deg2rad(plan.glide_angles_deg),
        turns_of(plan.yo_depths),
        drifts,
    )


# Of the statuses the better one first.
_RANKS = ("reached", "uncertain", "unreachable")


def best_departure(plans: Sequence[MissionPlan]) -> int:
    """Return the index of the best plan: plans that reach their goals first, then the earliest arrival.

    For objectives other than ``time``, the least cost decides: the weight ``time=1`` selects the shortest mission.
    """

    def rank(plan: MissionPlan) -> tuple[int, float]:
        named = _RANKS.index(plan.status) if plan.status in _RANKS else len(_RANKS)
        miss, aim = float(np.sum(plan.closest_approach)), plan.settings.aim
        if plan.status not in ("reached", "uncertain") or aim.distance_first:
            return named, miss
        if aim.earliest_arrival:
            return named, plan.start_time_ns / 1e9 + plan.duration
        return named, aim.cost(
            Found(
                plan.vehicle,
                np.deg2rad(plan.glide_angles_deg),
                plan.yo_depths,
                plan.duration,
                plan.energy,
                miss,
            )
        )

    return min(range(len(plans)), key=lambda k: rank(plans[k]))


def first_legs(plan: MissionPlan, count: int, projection: Projection) -> MissionPlan:
    """Return the first legs of a plan, without the drift after the last of them.

    Goals not yet met are scored at its end.

    Args:
        plan: Plan.
        count: Number of legs, at least one.
        projection: Local frame of its track.
    """
    drift = plan.settings.surface_time if count < len(plan.headings_deg) else 0.0
    ends = float(plan.surfacing_times[count - 1]) - drift
    at = [float(np.interp(ends, plan.track_time, plan.track[:, k])) for k in range(3)]
    longitude, latitude = (float(value) for value in to_geographic(projection, at[0], at[1]))
    before = plan.track_time < ends - 1e-6
    times = np.minimum(plan.goal_times, ends)
    passed = plan.goal_times <= ends
    off = [
        float(distance(longitude, latitude, goal.longitude, goal.latitude)) for goal in plan.goals
    ]
    apogees = apogee_depths(plan.yo_depths[:count])
    return replace(
        plan,
        headings_deg=plan.headings_deg[:count],
        glide_angles_deg=plan.glide_angles_deg[:count],
        pitches_deg=plan.pitches_deg[:count],
        yo_depths=plan.yo_depths[:count],
        surfacings=np.vstack([plan.surfacings[: count - 1], [longitude, latitude]]),
        surfacing_times=np.append(plan.surfacing_times[: count - 1], ends),
        goal_legs=tuple(min(leg, count) for leg in plan.goal_legs),
        goal_times=times,
        closest_approach=np.where(passed, plan.closest_approach, off),
        duration=ends,
        energy=float(plan.vehicle.energy(ends, apogees, plan.settings.surface_time * (count - 1))),
        track_time=np.append(plan.track_time[before], ends),
        track=np.vstack([plan.track[before], at]),
    )


def cut_at_horizon(plan: MissionPlan, seconds: float, projection: Projection) -> MissionPlan:
    """Return the legs of a plan that end before a horizon; the status is ``partial`` if a goal remains.

    A plan that ends earlier, or has no legs, is returned unchanged. The message states the last surfacing, the distance to the next goal,
    and the time of the remaining legs in the last known current.

    Args:
        plan: Complete plan.
        seconds: Horizon since the start [s].
        projection: Local frame of its track.

    Raises:
        PlanError: The first leg ends after the horizon.
    """
    kept, n_legs = int(np.sum(plan.surfacing_times <= seconds)), len(plan.headings_deg)
    if kept == n_legs:
        return plan
    if kept == 0:
        raise PlanError(
            f"the first leg ends after {plan.surfacing_times[0] / 3600.0:.1f} h, past the horizon of {seconds / 3600.0:.1f} h; expected "
            "room for one leg: choose a longer horizon, shallower dives or fewer of them"
        )
    cut = first_legs(plan, kept, projection)
    met = min(int(np.sum(plan.goal_times <= cut.duration)), len(plan.goals) - 1)
    left, hours = float(cut.closest_approach[met]), (plan.duration - cut.duration) / 3600.0
    return replace(
        cut,
        status="unsafe" if plan.status == "unsafe" else "partial",
        message=f"{horizon_text(plan, cut, seconds, met)}. The whole mission: {plan.message}",
        statistics={**plan.statistics, "left_m": left, "left_h": hours},
    )


def to_its_end(plan: MissionPlan) -> MissionPlan:
    """Return a plan with its last surfacing as the only goal, to score simulated flights of a truncated plan."""
    longitude, latitude = (float(value) for value in plan.surfacings[-1])
    return replace(
        plan,
        goals=(Place(longitude, latitude, 0.0),),
        goal_legs=(len(plan.headings_deg),),
        goal_times=plan.surfacing_times[-1:],
        closest_approach=np.zeros(1),
    )
