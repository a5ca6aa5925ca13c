"""A glider's mission planned: a route from the graph, the nonlinear program from it, the path flown densely and checked."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from planners.mission.program import MissionGuess
from planners.mission.result import failed_plan, to_plan
from planners.mission.solve import Attempt, GoalSteps, goals_met, safe_and_met, solve_legs, worth
from planners.mission.task import MissionTask, front_of, guess_of, mission_task, out_of_reach, route_of
from planners.mission.values import MissionPlan, MissionSettings
from planners.route.hazards import Bathymetry, NoGo, Ring
from planners.vehicle import Glider
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import grid_bearing_of_true_north, to_local
from replay_kit.core.plan import Place

_VEHICLE, _SETTINGS = Glider(), MissionSettings()
# Legs more than a route suggests that are tried, beside one for each goal.
_MORE_LEGS = 1
# Legs with which a goal is approached that the graph finds out of reach: more of them only crawl against a current.
_LEGS_OUT_OF_REACH = 24
# So many times the likely number of legs is tried where fewer trespass.
_SHORTER = 1.5, 2.0


def plan_mission(
    flow: FlowEstimate | Sequence[FlowEstimate],
    start: Place,
    goals: Place | tuple[Place, ...],
    *,
    vehicle: Glider = _VEHICLE,
    settings: MissionSettings = _SETTINGS,
    no_go: tuple[NoGo, ...] = (),
    bathymetry: Bathymetry | None = None,
    start_time_ns: int = 0,
    warm: MissionPlan | None = None,
) -> MissionPlan:
    """Return the best mission found from a start past one goal or several.

    The result is a value whatever the outcome: ``status`` and ``message`` say whether the goals are reached and what prevents it.

    Args:
        flow: The current, or its estimates for increasing times, between which it is linear.
        start: Where it begins.
        goals: Where it should go, in order. One at the surface is met where a leg ends; one below it by a dive that passes its depth, the
            last one by a dive that ends there.
        vehicle: What glides.
        settings: How.
        no_go: Areas that are not to be entered.
        bathymetry: Depth of the bottom, beside the forecast's land.
        start_time_ns: When it begins [ns, UTC].
        warm: An earlier plan for the same goals; what is left of it is tried first, if that is no other number of legs than is asked for,
            and when that leads there nothing else is.

    Raises:
        PlanError: The start or a goal is outside of the region, on land or where the mission may not go, a depth does not fit, or
            goals weigh nothing.
    """
    asked = goals if isinstance(goals, tuple) else (goals,)
    task = mission_task(flow, (start, asked), vehicle, settings, (no_go, bathymetry), start_time_ns)
    return plan_task(task, start, asked, start_time_ns, warm)


def plan_task(task: MissionTask, start: Place, goals: tuple[Place, ...], start_time_ns: int, warm: MissionPlan | None) -> MissionPlan:
    """Return the best plan found for a mission in its local frame; the arguments are those of ``plan_mission``."""
    attempts = attempts_of(task, warm, start_time_ns)
    if not attempts:
        return failed_plan(task, start, goals, start_time_ns, "the current is not a number; check the estimate's latent velocities")
    return to_plan(task, start, goals, start_time_ns, attempts)


def attempts_of(task: MissionTask, warm: MissionPlan | None, start_time_ns: int) -> list[Attempt]:
    """Return what came of each number of legs tried; nothing when the current is not a number.

    Raises:
        PlanError: Goals weigh nothing, so that there is none to plan for.
    """
    if task.settings.weights.closest == 0.0:
        raise PlanError(
            "a weight of 0 for missing a goal leaves none to plan for; give it more, or none to have it met whatever that costs"
        )
    attempts = [] if warm is None else _from_earlier(task, warm, start_time_ns)
    if any(safe_and_met(task, attempt) for attempt in attempts):
        return attempts
    if not np.all(np.isfinite(task.currents.latent)):
        return []
    attempts += _search(task, task.rings)
    if not any(safe_and_met(task, attempt) for attempt in attempts) and any(ring.surface_only for ring in task.rings):
        # an area too wide to be passed under water between two surfacings has to be gone round
        attempts += _search(task, tuple(replace(ring, surface_only=False) for ring in task.rings))
    if not any(safe_and_met(task, attempt) for attempt in attempts) and any(ring.drawn for ring in task.rings):
        # in a strong current the graph's edges are too few to pass close by an area; the way through it may be bent clear
        attempts += _search(task, tuple(ring for ring in task.rings if not ring.drawn), once=True)
    return attempts


def _search(task: MissionTask, rings: tuple[Ring, ...], once: bool = False) -> list[Attempt]:
    """Return what came of each number of legs tried: as the route clear of rings suggests, then, unless once is enough, fewer or more."""
    settings, front = task.settings, front_of(task, rings)
    route, passed = route_of(task, front, settings.max_duration)
    shallow = task.leg_time(task.vehicle.angles[0])
    if not route.arrives and settings.legs is None:
        route, passed = route_of(task, front, min(settings.max_duration, _LEGS_OUT_OF_REACH * shallow))
    likely = int(np.clip(np.ceil(passed[-1] / shallow - 1e-6), len(task.goals), settings.max_legs))

    brief = not route.arrives and out_of_reach(task)

    def attempt(legs: tuple[int, ...], fewer: bool = False) -> Attempt:
        guess = guess_of(task, route, front, legs[-1])
        return solve_legs(task, guess, goal_steps_of(task, passed, legs), route, fewer=fewer, brief=brief)

    attempts = [attempt(goal_legs_of(passed, settings.legs or likely))]
    if settings.legs is not None or not route.arrives or once:
        return attempts
    for n_legs in range(likely - 1, len(task.goals) - 1, -1):
        if not safe_and_met(task, attempts[-1]) or _best(task, attempts) is not attempts[-1]:
            break
        attempts.append(attempt(goal_legs_of(passed, n_legs), fewer=True))
    last = attempts[0]
    for _ in range(likely, min(likely + _MORE_LEGS + len(task.goals), settings.max_legs)):
        if any(done.finding is None and goals_met(task, done) for done in attempts):
            break
        last = attempt(one_leg_more(last.goals.legs, last.legs.angles))
        attempts.append(last)
    # a path that cannot turn as the route does may with shorter legs
    for n_legs in (round(factor * likely) for factor in _SHORTER if any(done.finding for done in attempts)):
        if not last.goals.legs[-1] < n_legs <= settings.max_legs or any(safe_and_met(task, done) for done in attempts):
            continue
        attempts.append(attempt(goal_legs_of(passed, n_legs)))
    return attempts


def _best(task: MissionTask, attempts: list[Attempt]) -> Attempt:
    return min(attempts, key=lambda attempt: worth(task, attempt))


def goal_legs_of(passed: Array, n_legs: int) -> tuple[int, ...]:
    """Return after which leg each goal is met, counted from 1: the nearest to when a route passes it, but each goal after a leg of its own.

    Args:
        passed: shape (G,) [s], increasing; the last is the route's end.
        n_legs: Number of legs, at least G.
    """
    numbers: list[int] = []
    for k, share in enumerate(passed / passed[-1]):
        least, most = (numbers[-1] if numbers else 0) + 1, n_legs - (len(passed) - 1 - k)
        numbers.append(int(np.clip(np.round(n_legs * share), least, most)))
    return tuple(numbers)


def goal_steps_of(task: MissionTask, passed: Array, legs: tuple[int, ...]) -> GoalSteps:
    """Return when each goal is met.

    Args:
        task: The problem.
        passed: shape (G,), when the goals are passed [s]; the last ends the mission.
        legs: In which leg each is met, counted from 1.
    """
    within = legs[-1] * passed / passed[-1] - (np.array(legs) - 1.0)
    return GoalSteps(legs, task.goal_steps(legs, legs[-1], within))


def one_leg_more(goal_legs: tuple[int, ...], angles: Array) -> tuple[int, ...]:
    """Return after which leg each goal is met with one leg more, on the way to the goal to which the glide angles are least.

    Args:
        goal_legs: Before, counted from 1.
        angles: shape (L,), glide angles of the legs.
    """
    ways = [float(np.mean(angles[begin:end])) for begin, end in pairwise((0, *goal_legs))]
    short = int(np.argmin(ways))
    return tuple(number + int(k >= short) for k, number in enumerate(goal_legs))


def _from_earlier(task: MissionTask, warm: MissionPlan, start_time_ns: int) -> list[Attempt]:
    """Return what comes of the legs of an earlier plan that are still to be flown; nothing when none are, or not as many as are asked."""
    begun = warm.legs_flown(start_time_ns)
    left = len(warm.headings_deg) - begun
    goal_legs = tuple(number - begun for number in warm.goal_legs if number > begun)
    if left <= 0 or len(goal_legs) != len(task.goals) or left > task.settings.max_legs or task.settings.legs not in (None, left):
        return []
    begins = np.concatenate([[0.0], warm.surfacing_times])[np.array(goal_legs) + begun - 1]
    lasts = warm.surfacing_times[np.array(goal_legs) + begun - 1] - begins
    goals = GoalSteps(goal_legs, task.goal_steps(goal_legs, left, (warm.goal_times[-len(goal_legs) :] - begins) / lasts))
    longitude, latitude = warm.surfacings[begun:].T
    places = np.column_stack(to_local(task.region.grid.projection, longitude, latitude))
    turn = grid_bearing_of_true_north(task.region.grid.projection, longitude, latitude)
    headings = np.deg2rad(warm.headings_deg[begun:]) + turn
    return [solve_legs(task, MissionGuess(places, headings, np.deg2rad(warm.glide_angles_deg[begun:])), goals, None)]
