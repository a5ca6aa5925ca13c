"""The plan that the best of several attempts makes."""

import numpy as np

from planners.mission.solve.attempt import (
    Attempt,
    above_bound,
    best_of,
    energy_of,
    goals_met,
    is_feasible,
    lacking_energy,
    overtime,
    staying,
)
from planners.mission.task import MissionTask
from planners.mission.values import MissionPlan
from planners.mission.words import attempt_text, outcome_text
from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.plan import PlanStatus

Statistics = dict[str, float | int | str]


def to_plan(task: MissionTask, attempts: list[Attempt]) -> MissionPlan:
    """Return the best attempt as a plan: feasible ones first, then of least cost; a failed plan when there is no finite attempt."""
    finite = [attempt for attempt in attempts if np.all(np.isfinite(attempt.flight.place))]
    if not finite:
        what = "no path is finite" if attempts else "the current is not a number"
        return _failed_plan(task, f"{what}; check the estimate's latent velocities")
    best = best_of(task, finite)
    arrives = goals_met(task, best) and overtime(task, best) == lacking_energy(task, best) == 0.0
    status: PlanStatus = "unsafe" if best.violation else "reached" if arrives else "unreachable"
    goal_times = best.flight.time[best.goals.points(best.flight)]
    tried = max(len(attempt.flight.ends) for attempt in finite)
    return _plan_of(
        task,
        best,
        status,
        goal_times,
        outcome_text(task, best, goal_times, tried),
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
        "tried": "; ".join(attempt_text(attempt) for attempt in attempts),
        "longest_met_h": max(feasible, default=float("nan")),
    }
    above = above_bound(task, best)
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


def _failed_plan(task: MissionTask, message: str) -> MissionPlan:
    """Return the plan of a mission that cannot be flown; it stays at its start, without legs."""
    return _plan_of(
        task, staying(task), "failed", np.zeros(len(task.goals)), message, {"attempts": 0}
    )
