"""A mission cut where the forecast ends: the legs up to there, where the vehicle then is, and what is left of the way."""

from dataclasses import replace

import numpy as np

from planners.mission.values import MissionPlan
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import distance, to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.plan import Place
from replay_kit.core.text import place_text


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
    left, name = (
        float(cut.closest_approach[met]),
        "the goal" if len(plan.goals) == 1 else f"goal {met + 1}",
    )
    hours = (plan.duration - cut.duration) / 3600.0
    message = (
        f"as far as the horizon of {seconds / 3600.0:.1f} h: {kept} of {n_legs} legs, after {cut.duration / 3600.0:.1f} "
        f"h at {place_text(*cut.surfacings[-1].tolist())}; left to {name}: {left / 1e3:.1f} km, and {hours:.1f} h to the end if the "
        "current stays as it is known last"
    )
    return replace(
        cut,
        status="unsafe" if plan.status == "unsafe" else "partial",
        message=f"{message}. The whole mission: {plan.message}",
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
