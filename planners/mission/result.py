"""The plan that the best of several attempts makes."""

import numpy as np

from planners.mission.check import explain
from planners.mission.solve import Attempt, energy_of, goals_met, safe_and_met, worth
from planners.mission.task import MissionTask
from planners.mission.values import MissionPlan, MissionStatus
from replay_kit.core.geodesy import grid_bearing_of_true_north, to_geographic
from replay_kit.core.plan import Place


def to_plan(task: MissionTask, start: Place, goals: tuple[Place, ...], start_time_ns: int, attempts: list[Attempt]) -> MissionPlan:
    """Return the best attempt as a plan: safe and at its goals first, then of the least cost."""
    finite = [attempt for attempt in attempts if np.all(np.isfinite(attempt.flight.place))]
    if not finite:
        return failed_plan(task, start, goals, start_time_ns, "no path is finite; check the estimate's latent velocities")
    best = min(finite, key=lambda attempt: worth(task, attempt))
    flight, projection = best.flight, task.region.grid.projection
    track = np.column_stack([flight.place[0], flight.depth])
    longitude, latitude = to_geographic(projection, *track[flight.ends, :2].T)
    begins = np.concatenate([[0], flight.ends[:-1]])
    turn = grid_bearing_of_true_north(projection, *to_geographic(projection, *track[begins, :2].T))
    status: MissionStatus = "unsafe" if best.finding else "reached" if goals_met(task, best) else "unreachable"
    goal_times = flight.time[best.goals.points(flight)]
    met = [attempt for attempt in finite if safe_and_met(task, attempt)]
    return MissionPlan(
        status=status,
        start=start,
        goals=goals,
        start_time_ns=start_time_ns,
        vehicle=task.vehicle,
        settings=task.settings,
        headings_deg=np.mod(np.rad2deg(best.legs.headings - turn), 360.0),
        glide_angles_deg=np.rad2deg(best.legs.angles),
        pitches_deg=np.rad2deg(task.vehicle.pitch(best.legs.angles)),
        turns=task.turns(len(best.legs.headings)),
        surfacings=np.column_stack([longitude, latitude]),
        surfacing_times=flight.time[flight.ends],
        goal_legs=best.goals.legs,
        goal_times=goal_times,
        closest_approach=best.miss,
        duration=float(flight.time[-1]),
        energy=energy_of(task, best),
        track_time=flight.time,
        track=track,
        message=explain(task, best.flight, best.miss, best.away, best.finding, goal_times),
        statistics={
            "attempts": len(attempts),
            "iterations": sum(attempt.iterations for attempt in attempts),
            "tried": "; ".join(_tried(attempt) for attempt in attempts),
            "longest_met_h": max((float(attempt.flight.time[-1]) / 3600.0 for attempt in met), default=float("nan")),
            **({} if task.guide is None else {"farthest_m": best.away[0], "rms_m": best.away[1]}),
            **({} if task.spline is None else {"spline_error": task.spline.largest_error, "spline_rms_error": task.spline.rms_error}),
        },
    )


def _tried(attempt: Attempt) -> str:
    safe = "" if attempt.finding is None else f", crosses {attempt.finding.what}"
    hours = attempt.flight.time[-1] / 3600.0
    return f"{len(attempt.legs.headings)} legs: {hours:.2f} h, {attempt.miss.max():.0f} m off{safe}, {attempt.return_status}"


def failed_plan(task: MissionTask, start: Place, goals: tuple[Place, ...], start_time_ns: int, message: str) -> MissionPlan:
    """Return the plan that says that no mission could be flown; it stays where it is."""
    none = np.zeros(0)
    miss = np.linalg.norm(task.goals[:, :2] - task.start[:2], axis=1)
    nowhere = (np.zeros((0, 2)), none, (0,) * len(goals), np.zeros(len(goals)), miss, 0.0, 0.0, np.zeros(1), task.start[None].copy())
    return MissionPlan(
        "failed", start, goals, start_time_ns, task.vehicle, task.settings, none, none, none, (), *nowhere, message, {"attempts": 0}
    )
