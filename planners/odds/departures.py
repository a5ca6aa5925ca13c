"""Choice of a departure, and truncation of a plan at the end of the forecast."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from planners.plan import plan_mission
from planners.program.words import horizon_text
from planners.request import Found, MissionPlan, MissionRequest
from planners.simulation.currents import Flow
from planners.task import apogee_depths
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import distance, to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.plan import Place

# Of the statuses the better one first.
_RANKS = ("reached", "uncertain", "unreachable")


def plan_departures(
    flow: Flow, request: MissionRequest, starts_ns: Sequence[int]
) -> tuple[MissionPlan, ...]:
    """Return the best plan found for each departure, each warm-started from the previous one.

    Args:
        flow: Current estimate, or estimates at increasing times.
        request: Request, see ``plan_mission``; its start time is ignored.
        starts_ns: Departure times, increasing [ns, UTC]; those reached after the deadline of the settings are skipped.

    Raises:
        PlanError: See ``plan_mission``; or departures are missing or do not increase.
    """
    if not starts_ns or any(after <= before for before, after in pairwise(starts_ns)):
        raise PlanError(f"departures are {list(starts_ns)} ns; expected one or more that increase")
    plans = list[MissionPlan]()
    for start_ns in starts_ns:
        if plans and request.settings.is_late:
            break
        # leaving later, all legs of the plan before are still to be flown; where time does not count, as many may be too many
        warm = [
            replace(plan, start_time_ns=start_ns)
            for plan in plans[-1:]
            if plan.status == "reached" and plan.settings.weights.time > 0.0
        ]
        asked = replace(request, start_time_ns=start_ns)
        plans.append(plan_mission(flow, asked, warm=next(iter(warm), None)))
    return tuple(plans)


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
