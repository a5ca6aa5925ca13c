"""When a mission best begins, and what of it ends before the forecast does."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from planners.mission.flight.currents import Flow
from planners.mission.result import to_plan
from planners.mission.search.search import rest_of, solve_attempts
from planners.mission.solve.attempt import Attempt, is_feasible
from planners.mission.solve.goals import with_n_legs
from planners.mission.solve.legs import solve_legs
from planners.mission.task import MissionTask, mission_task
from planners.mission.values import Found, MissionPlan, MissionRequest
from planners.mission.words import horizon_text
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import distance, to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.plan import Place

# Share by which a time in still water may be short of that in the current.
_ROUGHLY = 1.01
# Other numbers of legs solved from a neighbour at most; part of a leg that others make up for by steering better.
_OTHERS, _SOME = 3, 0.25
# Of the statuses the better one first.
_RANKS = ("reached", "uncertain", "unreachable")


def plan_departures(
    flow: Flow, request: MissionRequest, starts_ns: Sequence[int]
) -> tuple[MissionPlan, ...]:
    """Return the best mission found for each departure.

    The first is planned by itself. Each other one is solved from the plan before it, with a leg more or less where that is needed or might
    do, and planned by itself where that is no good plan either. Only plans by themselves are compared with the lower bound of the time.

    Args:
        flow: The current, or its estimates for increasing times.
        request: As for ``plan_mission``; its start time does not count.
        starts_ns: When the mission begins in turn, increasing [ns, UTC].

    Raises:
        PlanError: As for ``plan_mission``; or there is no departure, or they do not increase.
    """
    if not starts_ns or any(after <= before for before, after in pairwise(starts_ns)):
        raise PlanError(f"departures are {list(starts_ns)} ns; expected one or more that increase")
    plans = list[MissionPlan]()
    for start_ns in starts_ns:
        asked = replace(request, start_time_ns=start_ns)
        # leaving later, all legs of the plan before are still to be flown
        made = (
            _from_neighbour(flow, asked, replace(plans[-1], start_time_ns=start_ns))
            if plans
            else None
        )
        if made is None:
            task = mission_task(flow, asked)
            made = to_plan(task, solve_attempts(task))
        plans.append(made)
    return tuple(plans)


def best_departure(plans: Sequence[MissionPlan]) -> int:
    """Return which of some plans is the best: one that reaches the goals before others, then the one that arrives first.

    By another objective than ``time`` it is the one of least cost: the weight ``time=1`` asks for the shortest mission.
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


def _from_neighbour(flow: Flow, request: MissionRequest, before: MissionPlan) -> MissionPlan | None:
    """Return the mission with the legs of another departure's, solved for its own; None where that is no good plan."""
    if before.status != "reached":
        return None
    task = mission_task(flow, request)
    attempts = rest_of(task, before, fewer=True)
    alike = all(max(leg) == task.settings.depth for leg in before.yo_depths)
    if attempts and alike and request.settings.legs is None:
        attempts += _with_other_numbers(task, attempts[0])
    made = to_plan(task, attempts)
    return (
        made
        if made.status == "reached" and not (request.settings.legs is None and _spares_a_leg(made))
        else None
    )


def _with_other_numbers(task: MissionTask, attempt: Attempt) -> list[Attempt]:
    """Return attempts with more legs until one meets the goals, where an attempt misses them; with fewer as long as that might do."""
    found, last = list[Attempt](), attempt
    while len(found) < _OTHERS:
        feasible, n_legs = is_feasible(task, last), len(last.legs.headings)
        if found and feasible != is_feasible(task, attempt):
            break
        wanted = (
            _fewer_legs(to_plan(task, [last])) if feasible else n_legs + _missing_legs(task, last)
        )
        if wanted == n_legs or wanted > task.settings.most_legs:
            break
        other = with_n_legs(task, last, wanted)
        last = solve_legs(task, other.guess, other.goals, None, fewer=True)
        found.append(last)
    return found


def _missing_legs(task: MissionTask, attempt: Attempt) -> int:
    """Return how many more legs cover what an attempt misses at the speed it makes good, one at least."""
    made_good = float(np.linalg.norm(attempt.flight.place[0, -1] - task.start[:2])) / len(
        attempt.legs.headings
    )
    return max(
        1,
        int(
            np.ceil(
                (float(attempt.miss.max()) - task.settings.tolerance) / max(made_good, 1.0) - _SOME
            )
        ),
    )


def _spares_a_leg(plan: MissionPlan) -> bool:
    """Return whether a mission might do with a leg less."""
    return _fewer_legs(plan) < len(plan.headings_deg)


def _fewer_legs(plan: MissionPlan) -> int:
    """Return with how few legs a mission might do: at the shallowest glide angle they would take as long as it would in still water."""
    settings, vehicle, n_legs = plan.settings, plan.vehicle, len(plan.headings_deg)
    along, down = (float(speed) for speed in vehicle.speeds(np, vehicle.angles[0]))
    slower = float(np.mean(vehicle.speeds(np, np.deg2rad(plan.glide_angles_deg))[0])) / along
    longest = (
        2.0 * settings.yos * max(max(leg) for leg in plan.yo_depths) / down + settings.surface_time
    )
    return min(
        n_legs,
        max(len(plan.goals), int(np.ceil(plan.duration * slower / longest / _ROUGHLY - 1e-9))),
    )


def first_legs(plan: MissionPlan, count: int, projection: Projection) -> MissionPlan:
    """Return the first legs of a mission, up to when the last of them reaches the surface: without the drift after it.

    Its goals are those of the mission; those not met by then count at its end.

    Args:
        plan: The mission.
        count: Number of legs, at least one.
        projection: The local frame of its track.
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
    turns = sum(
        leg[i] > leg[i - 1] for leg in plan.yo_depths[:count] for i in range(1, len(leg) - 1)
    )
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
        energy=float(plan.vehicle.energy(ends, turns)),
        track_time=np.append(plan.track_time[before], ends),
        track=np.vstack([plan.track[before], at]),
    )


def cut_at_horizon(plan: MissionPlan, seconds: float, projection: Projection) -> MissionPlan:
    """Return the legs of a mission that end within a time; its status is ``partial`` where a goal is left.

    A mission that is over by then, or has no legs, is returned as it is. The message says where the vehicle surfaces last, how far the next
    goal is from there, and how long the rest takes if the current stays as it is known last.

    Args:
        plan: A mission to its goals.
        seconds: Since its start.
        projection: The local frame of its track.

    Raises:
        PlanError: Not even the first leg ends by then.
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
    """Return a mission whose only goal is where it ends at the surface: what samples of a mission that was cut are compared with."""
    longitude, latitude = (float(value) for value in plan.surfacings[-1])
    return replace(
        plan,
        goals=(Place(longitude, latitude, 0.0),),
        goal_legs=(len(plan.headings_deg),),
        goal_times=plan.surfacing_times[-1:],
        closest_approach=np.zeros(1),
    )
