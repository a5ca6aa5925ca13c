"""The search for the best number of legs: a route from the graph, the nonlinear program from it, fewer or more legs than it suggests.

1. Route. The quickest way through the current averaged over the dives, by Dijkstra's search over a graph with 32 neighbours a point. It
gives the number of legs and the initial guess, and leads round land. A goal that the graph finds out of reach is approached with 24 legs
at most.

2. Legs. That number of legs is solved, then fewer as long as the goals are still met, else more, each where the glide is flattest. Least
energy counts the pump's work of each number of dives; with a given number it is least time. A goal at the surface is met where a leg
ends, one below it by the dive that passes its depth, on the way down or up, whichever is nearer to when the route does; the last one by a
dive that ends there.

3. Constraints. When the path crosses land, an area, shallows or the region's edge, each step's end must lie within the half-planes that
touch the three nearest of them; they are placed anew around each path found until there is no more gain.

4. Bottom. Where no way round shallows is found, or the mission begins or ends in them, the quickest route through all water is cut into
legs that turn above the bottom along them (``turning.py``).

5. Check. The path is integrated again, by Runge-Kutta with steps half as long, and its segments are checked exactly.

Where not even a vehicle twice as fast, over land and through all areas, would arrive in the time of the most legs, each solve has 900
iterations divided by the number of legs, or 20, and half-planes are placed once or twice, which is enough to find how close the mission
comes. Elsewhere nothing is cut short, because missions sometimes reach goals that the graph finds out of reach.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from planners.mission.attempt import Attempt, GoalSteps, best_of, goals_met, is_feasible
from planners.mission.program import MissionGuess
from planners.mission.solve import solve_legs
from planners.mission.task import MissionTask, find_route, initial_guess, is_out_of_reach, route_graph_of, turns_of
from planners.mission.turning import solve_turning
from planners.mission.values import MissionPlan
from planners.route.hazards import Ring
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import to_local
from replay_kit.core.progress import announce

# Legs tried beyond those that a route suggests, besides one for each goal.
_MORE_LEGS = 1
# Legs with which a goal is approached that the graph finds out of reach: more of them only crawl against a current.
_LEGS_OUT_OF_REACH = 24
# Multiples of the likely number of legs that are tried where fewer violate a constraint.
_SHORTER = 1.5, 2.0


def solve_attempts(task: MissionTask, warm: MissionPlan | None = None) -> list[Attempt]:
    """Return the attempts with each number of legs tried; none when the current is not a number.

    Args:
        task: The problem.
        warm: An earlier plan; when the rest of it is feasible, it is the only attempt.

    Raises:
        PlanError: The miss distance has no weight, so that there is no goal to plan for.
    """
    if task.settings.weights.closest == 0.0:
        raise PlanError(
            "a weight of 0 for the miss distance leaves no goal to plan for; give a larger weight, or none to meet it at any cost"
        )
    attempts = [] if warm is None else _rest_of(task, warm)
    if any(is_feasible(task, attempt) for attempt in attempts):
        return attempts
    if not task.is_finite:
        return []
    places = np.vstack([task.start, task.goals])[:, :2]
    if task.bottom.limit_at(places).min() >= task.settings.depth:
        attempts += _search_at_full_depth(task)
    if _goes_on(task, attempts) and task.bottom.shallowest < task.settings.depth:
        # no way leads round the shallows, or none is quick enough: dives turn above them
        attempts += solve_turning(task, task.rings)
    return attempts


def _search_at_full_depth(task: MissionTask) -> list[Attempt]:
    """Return the attempts whose dives all have the depth of the settings."""
    attempts = _search(task, task.rings)
    if _goes_on(task, attempts) and any(ring.surface_only for ring in task.rings):
        # an area too wide to be passed under water between two surfacings must be rounded
        attempts += _search(task, tuple(replace(ring, surface_only=False) for ring in task.rings))
    if _goes_on(task, attempts) and any(ring.drawn for ring in task.rings):
        # in a strong current the graph has too few edges to pass close by an area; half-planes may bend the route through it clear
        attempts += _search(task, tuple(ring for ring in task.rings if not ring.drawn), once=True)
    return attempts


def _goes_on(task: MissionTask, attempts: list[Attempt]) -> bool:
    """Return whether something else is to be tried: nothing is feasible yet, and there is time or nothing was tried at all."""
    return not any(is_feasible(task, attempt) for attempt in attempts) and (not attempts or not task.is_late)


def _search(task: MissionTask, rings: tuple[Ring, ...], once: bool = False) -> list[Attempt]:
    """Return the attempts with the number of legs that a route clear of rings suggests and, unless once is enough, with fewer or more."""
    settings, graph = task.settings, route_graph_of(task, rings)
    route, passed = find_route(task, graph, settings.max_duration)
    longest_leg = task.leg_time(task.vehicle.angles[0])
    if not route.arrives and settings.legs is None:
        route, passed = find_route(task, graph, min(settings.max_duration, _LEGS_OUT_OF_REACH * longest_leg))
    likely = int(np.clip(np.ceil(passed[-1] / longest_leg - 1e-6), len(task.goals), settings.max_legs))
    brief = not route.arrives and is_out_of_reach(task)

    def attempt(legs: tuple[int, ...], fewer: bool = False) -> Attempt:
        announce(f"planning: {legs[-1]} legs")
        guess = initial_guess(task, route, graph, route.times[-1] * np.arange(legs[-1] + 1) / legs[-1])
        return solve_legs(task, guess, goal_steps_of(task, passed, legs), route, fewer=fewer, brief=brief)

    attempts = [attempt(goal_legs_of(passed, settings.legs or likely))]
    if settings.legs is not None or not route.arrives or once or task.is_late:
        return attempts
    for n_legs in range(likely - 1, len(task.goals) - 1, -1):
        if task.is_late or not is_feasible(task, attempts[-1]) or best_of(task, attempts) is not attempts[-1]:
            break
        attempts.append(attempt(goal_legs_of(passed, n_legs), fewer=True))
    last = attempts[0]
    for _ in range(likely, min(likely + _MORE_LEGS + len(task.goals), settings.max_legs)):
        if task.is_late or any(done.violation is None and goals_met(task, done) for done in attempts):
            break
        last = attempt(add_leg(last.goals.legs, last.legs.angles))
        attempts.append(last)
    # shorter legs can follow turns of the route that long ones cut off
    for n_legs in (round(factor * likely) for factor in _SHORTER if any(done.violation for done in attempts)):
        wanted = not task.is_late and not any(is_feasible(task, done) for done in attempts)
        if wanted and last.goals.legs[-1] < n_legs <= settings.max_legs:
            attempts.append(attempt(goal_legs_of(passed, n_legs)))
    return attempts


def goal_legs_of(passed: Array, n_legs: int) -> tuple[int, ...]:
    """Return after which leg each goal is met, counted from 1: the one nearest in time to the route, each goal after a leg of its own.

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


def add_leg(goal_legs: tuple[int, ...], angles: Array) -> tuple[int, ...]:
    """Return after which leg each goal is met with one more leg, on the way to the goal with the shallowest glide angles.

    Args:
        goal_legs: Before, counted from 1.
        angles: shape (L,), glide angles of the legs.
    """
    mean_angles = [float(np.mean(angles[begin:end])) for begin, end in pairwise((0, *goal_legs))]
    shallowest = int(np.argmin(mean_angles))
    return tuple(number + int(k >= shallowest) for k, number in enumerate(goal_legs))


def _rest_of(task: MissionTask, warm: MissionPlan) -> list[Attempt]:
    """Return the attempt with the legs of an earlier plan that are still to be flown; none when there are none, or not as many as asked."""
    begun = warm.legs_flown(task.request.start_time_ns)
    left = len(warm.headings_deg) - begun
    goal_legs = tuple(number - begun for number in warm.goal_legs if number > begun)
    if left <= 0 or len(goal_legs) != len(task.goals) or left > task.settings.max_legs or task.settings.legs not in (None, left):
        return []
    task = replace(task, turns=turns_of(warm.yo_depths[begun:]))
    begins = np.concatenate([[0.0], warm.surfacing_times])[np.array(goal_legs) + begun - 1]
    durations = warm.surfacing_times[np.array(goal_legs) + begun - 1] - begins
    goals = GoalSteps(goal_legs, task.goal_steps(goal_legs, left, (warm.goal_times[-len(goal_legs) :] - begins) / durations))
    places = np.column_stack(to_local(task.region.grid.projection, *warm.surfacings[begun:].T))
    guess = MissionGuess(places, np.deg2rad(warm.headings_deg[begun:]), np.deg2rad(warm.glide_angles_deg[begun:]))
    return [solve_legs(task, guess, goals, None)]
