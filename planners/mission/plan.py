"""A glider's missions planned: to goals, near a place, along a line; and the plan that the best of several attempts makes."""

from dataclasses import replace

import numpy as np

from planners.hazards.domain import locate
from planners.mission.search.depths import solve_in_ranges
from planners.mission.search.search import solve_attempts
from planners.mission.solve.attempt import (
    Attempt,
    GoalSteps,
    above_bound,
    best_of,
    energy_of,
    goals_met,
    is_feasible,
    lacking_energy,
    overtime,
    staying,
)
from planners.mission.solve.legs import solve_legs
from planners.mission.task import LEAST_DIVE, MissionTask, mission_task
from planners.mission.words import attempt_text, outcome_text
from planners.request import Line, MissionPlan, MissionRequest, Mooring, Weights
from planners.route.current import Route
from planners.shooting.program import MissionGuess, along_line, near_place
from planners.simulation.currents import Flow
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import to_geographic, true_north_halfway
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


# The objective of a mooring is the mean squared distance [km^2]; time decides among equals, and its end does not count.
_MOORING = Weights(time=1e-5, closest=0.0)
# Legs of a mooring, all of which are solved at once, where no other limit is given.
_MOST_LEGS = 60
# Depths over which the mean current of a dive is taken, and glide angles tried for it.
_DEPTHS, _ANGLES = 51, 64
_LINE = Line()


def plan_mission(
    flow: Flow,
    request: MissionRequest,
    *,
    warm: MissionPlan | None = None,
) -> MissionPlan:
    """Return the best mission found from a start past one goal or several.

    The result is a value whatever the outcome: ``status`` and ``message`` say whether the goals are reached and which limit binds.

    Args:
        flow: The current, or its estimates for increasing times, between which it is linear.
        request: Start, goals, vehicle, settings and constraints.
        warm: An earlier plan for the same goals. The rest of it is tried first, if it has the number of legs asked for; when it is
            feasible, nothing else is tried but what the front or the habit finds clearly quicker, and there is no bound.

    Raises:
        PlanError: The start or a goal is outside of the region, on land or where the mission may not go, a depth does not fit, or
            the miss distance has no weight.
    """
    return to_plan(*solve_in_ranges(mission_task(flow, request), warm))


def plan_line(
    flow: Flow,
    request: MissionRequest,
    line: Line = _LINE,
    *,
    warm: MissionPlan | None = None,
) -> MissionPlan:
    """Return the best mission found along a line to the goal: the cross-track penalty is added to the objective.

    ``statistics`` has ``farthest_m`` and ``rms_m``, the cross-track distance of the track.

    Args:
        flow: The current, or its estimates for increasing times.
        request: As for ``plan_mission``, with one goal: the end of the line.
        line: Its beginning, weight and width.
        warm: An earlier plan of the same line, as for ``plan_mission``.

    Raises:
        PlanError: As for ``plan_mission``; or the line has no length.
    """
    task = mission_task(flow, request)
    begin = locate(
        task.region, request.start if line.begin is None else line.begin, "the line's beginning"
    )[:2]
    end = task.goals[0, :2]
    if float(np.linalg.norm(end - begin)) < 1.0:
        raise PlanError("a line needs two places that are apart")
    task = replace(task, reference_path=along_line(begin, end, line.weight, line.width))
    return to_plan(task, solve_attempts(task, warm))


def plan_mooring(flow: Flow, request: MissionRequest, mooring: Mooring) -> MissionPlan:
    """Return the mission found that stays within a radius of its goal for a duration with the least mean square distance from it.

    Its status is ``reached`` when it does stay within; ``statistics`` has ``farthest_m`` and ``rms_m``. The number of legs is that
    of the glide angle at which the glider holds its place against the mean current there, or comes nearest to it.

    Args:
        flow: The current, or its estimates for increasing times.
        request: As for ``plan_mission``, with one goal, whose depth is ignored; so is the objective.
        mooring: Radius and duration.

    Raises:
        PlanError: As for ``plan_mission``; or the start is not within the radius, or more legs are needed than are allowed.
    """
    settings, centre = request.settings, replace(request.goals[0], depth=0.0)
    task = mission_task(
        flow, replace(request, goals=(centre,), settings=replace(settings, objective=_MOORING))
    )
    place = task.goals[0, :2]
    # dives anywhere within the radius turn above the bottom
    depth = min(
        task.settings.depth,
        max(float(task.bottom.limit_at(place[None], mooring.radius)[0]), LEAST_DIVE),
    )
    task = replace(
        task, request=replace(task.request, settings=replace(task.settings, depth=depth))
    )
    task = replace(
        task,
        reference_path=near_place(place, mooring.radius, mooring.duration, mooring.surfacings_only),
    )
    distance = float(np.linalg.norm(task.start[:2] - place))
    if distance > mooring.radius:
        raise PlanError(
            f"the start is {distance:.0f} m from the mooring, outside of its radius of {mooring.radius:g} m; plan a mission there first"
        )
    if not task.is_finite:
        return to_plan(task, [])
    current = _mean_current(task, place, mooring.duration)
    angle = _holding_angle(task, float(np.linalg.norm(current)))
    n_legs = settings.legs or int(
        np.ceil((mooring.duration + settings.surface_time) / task.leg_time(angle) - 1e-6)
    )
    if n_legs > (most := settings.max_legs or _MOST_LEGS):
        raise PlanError(
            f"a mooring of {mooring.duration / 3600.0:g} h takes {n_legs} legs, but max_legs = {most}; allow more, or more dives a leg"
        )
    attempts = []
    for hops in (False, True):
        guess = _mooring_guess(task, current, np.full(n_legs, angle), hops)
        route = Route(
            np.vstack([task.start[:2], guess.places]),
            task.leg_time(angle) * np.arange(n_legs + 1.0),
            True,
        )
        attempts.append(solve_legs(task, guess, GoalSteps((n_legs,), (0,)), route))
    return to_plan(task, attempts)


def _mean_current(task: MissionTask, place: Array, duration: float) -> Array:
    """Return the current [m/s], shape (2,), at a place in the mean over a dive's depths, halfway through a duration [s]."""
    of_levels = task.currents.weights(np.linspace(0.0, task.settings.depth, _DEPTHS)).mean(axis=0)
    return np.asarray(
        task.currents.velocity(place[None], of_levels, task.start_time + 0.5 * duration)[0]
    )


def _holding_angle(task: MissionTask, current: float) -> float:
    """Return the glide angle [rad] at which the horizontal velocity through water is nearest to a current [m/s]."""
    angles = np.linspace(*task.vehicle.angles, _ANGLES)
    # a drift at the surface has to be made up for under water
    shares = np.array(
        [1.0 - task.settings.surface_time / task.leg_time(float(angle)) for angle in angles]
    )
    return float(
        angles[np.argmin(np.abs(shares * np.asarray(task.vehicle.speeds(np, angles)[0]) - current))]
    )


def _mooring_guess(task: MissionTask, current: Array, angles: Array, hops: bool) -> MissionGuess:
    """Return legs that each lead as near to the mooring as its length allows; with ``hops`` to either side of it in turn."""
    leg_time, angle = task.leg_time(float(angles[0])), float(angles[0])
    drift = current * leg_time
    reach = float(task.vehicle.speeds(np, angle)[0]) * (leg_time - task.settings.surface_time)
    side = np.array([0.5 * max(reach - float(np.linalg.norm(drift)), 0.0), 0.0]) * float(hops)
    at, places, headings = task.start[:2], [], []
    for k in range(angles.size):
        east, north = task.goals[0, :2] + (-1.0) ** k * side - at - drift
        headings.append(float(np.arctan2(east, north)))
        at = at + drift + reach * np.array([np.sin(headings[-1]), np.cos(headings[-1])])
        places.append(at)
    turn = true_north_halfway(
        task.region.grid.projection, np.array([task.start[:2], *places[:-1]]), np.array(places)
    )
    return MissionGuess(np.array(places), np.array(headings) - turn, angles)
