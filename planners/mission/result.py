"""The plan that the best of several attempts makes, and its outcome in words."""

from dataclasses import replace

import numpy as np

from planners.mission.solve.attempt import (
    Attempt,
    best_of,
    energy_of,
    goals_met,
    is_feasible,
    staying,
)
from planners.mission.task import MissionTask
from planners.mission.values import MissionPlan
from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.plan import PlanStatus
from replay_kit.core.text import time_text

Statistics = dict[str, float | int | str]
# A mission this close to the longest one considered is limited by it.
_NEARLY = 0.95


def to_plan(task: MissionTask, attempts: list[Attempt]) -> MissionPlan:
    """Return the best attempt as a plan: feasible ones first, then of least cost; a failed plan when there is no finite attempt."""
    finite = [attempt for attempt in attempts if np.all(np.isfinite(attempt.flight.place))]
    if not finite:
        what = "no path is finite" if attempts else "the current is not a number"
        return _failed_plan(task, f"{what}; check the estimate's latent velocities")
    best = best_of(task, finite)
    status: PlanStatus = (
        "unsafe" if best.violation else "reached" if goals_met(task, best) else "unreachable"
    )
    goal_times = best.flight.time[best.goals.points(best.flight)]
    tried = max(len(attempt.flight.ends) for attempt in finite)
    return _plan_of(
        task,
        best,
        status,
        goal_times,
        _outcome(task, best, goal_times, tried),
        _statistics(task, attempts, finite, best),
    )


def _plan_of(
    task: MissionTask,
    best: Attempt,
    status: PlanStatus,
    goal_times: Array,
    message: str,
    statistics: Statistics,
) -> MissionPlan:
    flight, request, projection = best.flight, task.request, task.region.grid.projection
    track = np.column_stack([flight.place[0], flight.depth])
    return MissionPlan(
        status=status,
        start=request.start,
        goals=request.goals,
        start_time_ns=request.start_time_ns,
        vehicle=task.vehicle,
        settings=task.settings,
        headings_deg=np.mod(np.rad2deg(best.legs.headings), 360.0),
        glide_angles_deg=np.rad2deg(best.legs.angles),
        pitches_deg=np.rad2deg(task.vehicle.pitch(best.legs.angles)),
        yo_depths=best.yo_depths,
        surfacings=np.column_stack(to_geographic(projection, *track[flight.ends, :2].T)),
        surfacing_times=flight.time[flight.ends],
        goal_legs=best.goals.legs,
        goal_times=goal_times,
        closest_approach=best.miss,
        duration=float(flight.time[-1]),
        energy=energy_of(task, best),
        track_time=flight.time,
        track=track,
        message=message,
        statistics=statistics,
    )


def _statistics(
    task: MissionTask, attempts: list[Attempt], finite: list[Attempt], best: Attempt
) -> Statistics:
    feasible = [
        float(attempt.flight.time[-1]) / 3600.0 for attempt in finite if is_feasible(task, attempt)
    ]
    statistics: Statistics = {
        "attempts": len(attempts),
        "iterations": sum(attempt.iterations for attempt in attempts),
        "tried": "; ".join(_tried(attempt) for attempt in attempts),
        "longest_met_h": max(feasible, default=float("nan")),
    }
    above = _above_bound(task, best)
    if best.bound is not None and best.bound.is_tight and np.isfinite(best.bound.time):
        statistics |= {"bound_h": best.bound.time / 3600.0}
    if above is not None:
        statistics |= {"above_bound_percent": above}
    if task.reference_path is not None:
        statistics |= {"farthest_m": best.deviation[0], "rms_m": best.deviation[1]}
    if task.spline is not None:
        statistics |= {
            "spline_error": task.spline.largest_error,
            "spline_rms_error": task.spline.rms_error,
        }
    return statistics


def _above_bound(task: MissionTask, attempt: Attempt) -> float | None:
    """Return how much later than any vehicle of its speed could a mission arrives [%]; None where the bound does not hold or is 0."""
    bound = attempt.bound
    # shallower dives than those asked for meet another mean current
    full = attempt.yo_depths == replace(task, turns=None).yo_depths(len(attempt.yo_depths))
    if (
        bound is None
        or not bound.is_tight
        or not 0.0 < bound.time < np.inf
        or not full
        or not goals_met(task, attempt)
    ):
        return None
    last = float(attempt.flight.time[attempt.goals.points(attempt.flight)[-1]])
    return 100.0 * (last / bound.time - 1.0)


def _tried(attempt: Attempt) -> str:
    safe = "" if attempt.violation is None else f", crosses {attempt.violation.what}"
    hours = attempt.flight.time[-1] / 3600.0
    return f"{len(attempt.legs.headings)} legs: {hours:.2f} h, {attempt.miss.max():.0f} m off{safe}, {attempt.return_status}"


def _failed_plan(task: MissionTask, message: str) -> MissionPlan:
    """Return the plan of a mission that cannot be flown; it stays at its start, without legs."""
    return _plan_of(
        task, staying(task), "failed", np.zeros(len(task.goals)), message, {"attempts": 0}
    )


def _outcome(task: MissionTask, attempt: Attempt, goal_times: Array, tried: int) -> str:
    """Return the outcome of a mission in words, with the limit that binds when it does not reach its goals or violates a constraint.

    Args:
        task: The problem.
        attempt: The best.
        goal_times: shape (G,) [s].
        tried: Largest number of legs that was tried.
    """
    settings, reference, miss, flight = (
        task.settings,
        task.reference_path,
        attempt.miss,
        attempt.flight,
    )
    if len(flight.ends) == 0:
        return _already_there(task)
    counts, (farthest, rms) = settings.weights.closest != 0.0, attempt.deviation
    parts, short = list[str](), ""
    if counts:
        names = ["the goal"] if len(miss) == 1 else [f"goal {k + 1}" for k in range(len(miss))]
        verbs = [
            "meets {} at" if distance <= settings.tolerance else "misses {} by" for distance in miss
        ]
        parts += [
            f"{verb.format(name)} {distance:.1f} m after {_hours(task, float(time))}"
            for verb, name, distance, time in zip(verbs, names, miss, goal_times, strict=True)
        ]
        short = (
            ""
            if np.all(miss <= settings.tolerance)
            else f", outside the tolerance of {settings.tolerance:g} m"
        )
    if reference is not None:
        lasts = _hours(task, float(flight.time[-1]))
        parts.append(
            f"{farthest:.0f} m from {reference.name} at most, {rms:.0f} m in the root mean square, for {lasts}"
        )
        short += "" if farthest <= reference.limit else f", farther than {reference.limit:g} m"
    above = _above_bound(task, attempt)
    if above is not None and counts:
        parts.append(
            f"{above:.1f} % above the earliest arrival that any vehicle of this speed could make"
        )
    n_legs = len(flight.ends)
    text = f"{n_legs} leg{'s' * (n_legs != 1)}; {', '.join(parts)}"
    if attempt.violation is not None:
        at = attempt.violation
        text += f"; not safe: crosses {at.what} at {at.longitude:.4f}, {at.latitude:.4f} in leg {at.leg} after {_hours(task, at.time)}"
    if task.is_late:
        text += f"; the time limit of {settings.time_limit:g} s ended the search: other numbers of legs and other ways are untried"
    return (
        f"{text}{short}{_out_of_reach(task, attempt)}; {_binding(task, attempt, tried)}"
        if short
        else text
    )


def _already_there(task: MissionTask) -> str:
    """Return why a mission takes no legs."""
    name, below = (
        "the goal" if len(task.goals) == 1 else "all goals",
        float(np.max(task.goals[:, 2] - task.start[2])),
    )
    deep = (
        "" if below <= 0.0 else f"; only the depth of a goal is left, {below:g} m below the start"
    )
    within = f"within {np.max(task.from_start):.1f} m of {name}, inside the tolerance of {task.settings.tolerance:g} m"
    return f"already there: the start is {within}; 0 legs{deep}"


def _out_of_reach(task: MissionTask, attempt: Attempt) -> str:
    """Return which goals are out of reach, and how near one can come to them; empty where none is known to be."""
    text = ""
    for bound in attempt.beyond:
        text += f"; {'the goal' if len(task.goals) == 1 else f'goal {bound.goal + 1}'} is out of reach: "
        if bound.limit == "legs":
            text += f"it needs more than {task.settings.legs or task.settings.max_legs} legs"
            continue
        who = "no vehicle of this speed comes" if bound.is_tight else "no way was found that comes"
        nearest, when = f"about {bound.nearest / 1e3:.1f} km", _hours(task, bound.when)
        text += f"within {_hours(task, bound.most)} {who} nearer than {nearest}, after {when}"
    return text


def _hours(task: MissionTask, seconds: float) -> str:
    """Return a time since the start in hours and, where the mission has a date, as a date."""
    begins = task.request.start_time_ns
    return f"{seconds / 3600.0:.1f} h" + (
        f" ({time_text(begins + round(seconds * 1e9))})" if begins else ""
    )


def _binding(task: MissionTask, attempt: Attempt, tried: int) -> str:
    """Return the limits that bind."""
    settings, flight, limits, parts = (
        task.settings,
        attempt.flight,
        {bound.limit for bound in attempt.beyond},
        list[str](),
    )
    if settings.weights.closest:
        return "limit: the weights, by which to come closer costs more than it gains, or what can be reached at all"
    if settings.legs is not None and task.reference_path is None:
        return f"limit: {settings.legs} legs at glide angles from {task.vehicle.min_angle:g} to {task.vehicle.max_angle:g} degrees"
    if "legs" in limits or (not limits and tried >= settings.most_legs):
        parts.append(f"limit: max_legs = {settings.max_legs} (--max-legs)")
    if "duration" in limits or (not limits and flight.time[-1] >= _NEARLY * settings.max_duration):
        parts.append(f"limit: max_duration = {settings.max_duration:g} s (--max-duration)")
    if "ways" in limits:
        parts.append(
            "a constraint closes every way: land, an area, water too shallow for a dive or the edge of the region"
        )
    if parts and "current" not in limits:
        return "; ".join(parts)
    ground = float(np.linalg.norm(flight.place[0, -1] - flight.place[0, 0])) / max(
        float(flight.time[-1]), 1.0
    )
    through = float(task.vehicle.speeds(np, task.vehicle.angles[0])[0])
    what = "the current" if "current" in limits else "the current or a constraint"
    return "; ".join(
        [
            *parts,
            f"{what} keeps a glider of {through:.2f} m/s from it: it makes good {ground:.2f} m/s",
        ]
    )
