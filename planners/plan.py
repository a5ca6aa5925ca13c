"""Mission planning: the best plan found, with commands, predicted track and outcome in words."""

from math import inf

import numpy as np

from planners.program.ranking import arrives, deviation, is_feasible, lacking_energy, overtime
from planners.program.solution import staying
from planners.program.starts import Answer, search
from planners.program.words import outcome_text, tried_text
from planners.request import Line, MissionPlan, MissionRequest, Mooring
from planners.simulation.currents import Flow
from planners.task import Task, task_of, yo_depths
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.plan import PlanStatus

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
        return _plan_of(task, Answer(staying(task), [], None), "failed", message, {"attempts": 0})
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
