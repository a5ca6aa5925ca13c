"""The search for the best number of legs: a route from the front, the nonlinear program from it, fewer or more legs than it suggests.

1. Bound. The earliest arrival of any vehicle of this speed (``bound.py``): a mission whose bound is later than its most legs take is not
solved. It follows the way that comes nearest to the goal, each leg aimed where the glider comes up, and says how near that can be.

2. Route. The quickest way past all goals through the current averaged over the dives, round all obstacles. It gives the number of legs and
the initial guess; beside obstacles a way farther from them that takes hardly longer gives another.

3. Legs. n legs, as many as the route's time takes, are solved; then fewer as long as the goals are still met and the bound leaves room for
them; else n + 1, n + 2, 1.25 n, 1.5 n, 2 n. Least energy counts the pump's work of each number of dives; with a given number it is least
time. A goal at the surface is met where a leg ends, one below it by the dive that passes its depth, on the way down or up, whichever is
nearer to when the route does; the last one by a dive that ends there.

4. Constraints. When the path crosses land, an area, shallows or the region's edge, each step's end must lie within the half-planes that
touch the three nearest of them: first along the route, then following each place as it moves and the steps between, until there is no
more gain. Where that takes clearly longer than the route, one leg more is tried.

5. Bottom. Where no way round shallows is found or one across them is clearly shorter, or the mission begins or ends in them, the quickest
route through all water is cut into legs that turn above the bottom along them (``turning.py``).

6. Habit. A pilot who heads at the goal at each surfacing is flown in the same current; where that is quicker, its course is solved from.

7. Check. The path is integrated again, by Runge-Kutta with steps half as long, and its segments are checked exactly.

The rest of an earlier plan is solved first, without the bound; where the route takes clearly less time, its number of legs is tried too.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from planners.hazards.areas import Ring
from planners.mission.search.bound import bound_of
from planners.mission.search.passage import (
    Passage,
    Target,
    Water,
    along_route,
    habit,
    initial_guess,
    is_beside,
    longest_time,
    passage_past_goals,
    water_of,
    widest_passage,
)
from planners.mission.search.turning import approach_turning, solve_turning
from planners.mission.solve.attempt import (
    ENOUGH,
    Attempt,
    Bound,
    GoalSteps,
    Limit,
    best_of,
    effort_of,
    goals_met,
    is_feasible,
    staying,
)
from planners.mission.solve.goals import (
    add_leg,
    goal_legs_of,
    goal_steps_of,
    met_at_start,
    to_all,
    to_some,
)
from planners.mission.solve.legs import solve_legs
from planners.mission.task import LEAST_DIVE, MissionTask, turns_of
from planners.request import MissionPlan
from planners.shooting.program import MissionGuess
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import to_local
from replay_kit.core.progress import announce

# Legs with which a goal is approached that no route reaches: more of them only crawl against a current.
_LEGS_OUT_OF_REACH = 24
# Multiples of the likely number of legs that are tried where one or two more do not hold either.
_SHORTER = 1.25, 1.5, 2.0
# A mission among obstacles that takes so many times as long as the route is tried with a leg more.
_DETOUR = 1.015
# The rest of an earlier plan that takes so many times as long as the route is reconsidered.
_RECONSIDERED = 1.02
# Share of its time that a way across shallows takes at most to be tried beside the way round them.
_ACROSS = 0.97
# Share of a route's time on the lattice that it takes off it at least.
_ON_LATTICE = 0.985


def solve_attempts(task: MissionTask, warm: MissionPlan | None = None) -> list[Attempt]:
    """Return the attempts with each number of legs tried; none when the current is not a number.

    Args:
        task: The problem.
        warm: An earlier plan, whose rest is tried first.

    Raises:
        PlanError: The miss distance has no weight, so that there is no goal to plan for.
    """
    if task.settings.weights.closest == 0.0:
        raise PlanError(
            "a weight of 0 for the miss distance leaves no goal to plan for; give a larger weight, or none to meet it at any cost"
        )
    if not task.is_finite:
        return []
    if met := met_at_start(task):
        return (
            [staying(task)]
            if met == len(task.goals)
            else [_to_some(task, tuple(range(met, len(task.goals))), warm)]
        )
    attempts = [] if warm is None else _rest_of(task, warm)
    if any(is_feasible(task, attempt) for attempt in attempts):
        # a plan made at each surfacing is not compared with the bound, which would take longer than the plan
        water = water_of(task)
        attempts += _reconsidered(task, water, attempts[0])
        return attempts + _from_habit(task, water, attempts)
    water, bound = bound_of(task) if _is_bounded(task) else (water_of(task), None)
    if bound is not None and bound.goal >= 0:
        return [_without(task, water, bound)]
    attempts += _solve_anew(task, water, bound)
    attempts += _from_habit(task, water, attempts)
    attempts = [replace(attempt, bound=bound) for attempt in attempts]
    return _without_spoilers(task, attempts)


def _without_spoilers(task: MissionTask, attempts: list[Attempt]) -> list[Attempt]:
    """Return the mission to fewer goals where it meets more of them than one to all; else the attempts to all."""
    best = best_of(task, attempts)
    met = best.miss <= task.settings.tolerance
    if met.all() or len(met) == 1 or task.settings.weighs_distance or task.is_late:
        return attempts
    # the goal missed by most takes the time that others need
    kept = tuple(k for k in range(len(met)) if k != int(np.argmax(best.miss)))
    fewer = _to_some(task, kept)
    more = int(np.sum(fewer.miss <= task.settings.tolerance)) > int(np.sum(met))
    return [fewer] if more and fewer.violation is None else attempts


def _to_some(task: MissionTask, kept: tuple[int, ...], warm: MissionPlan | None = None) -> Attempt:
    """Return the best mission to some of the goals, as one to all."""
    fewer = to_some(task, kept)
    return to_all(task, kept, best_of(fewer, solve_attempts(fewer, warm)))


def _without(task: MissionTask, water: Water, bound: Bound) -> Attempt:
    """Return the best mission to the goals but for one out of reach; as near to that as it comes where no other is within reach."""
    others, this = tuple(k for k in range(len(task.goals)) if k != bound.goal), (bound.goal,)
    found = _to_some(task, others) if others else None
    beyond = (
        (bound,)
        if found is None
        else tuple(sorted((bound, *found.beyond), key=lambda one: one.goal))
    )
    if found is None or len(beyond) == len(task.goals):
        found = to_all(task, this, _approach(to_some(task, this), water, bound.limit))
    return replace(found, bound=None, beyond=beyond)


def _is_bounded(task: MissionTask) -> bool:
    """Return whether the earliest arrival bounds a mission: its goals must be met, by dives to one depth."""
    return not (task.settings.weighs_distance or task.reference_path is not None)


def _solve_anew(task: MissionTask, water: Water, bound: Bound | None) -> list[Attempt]:
    """Return the attempts that begin at routes of the front."""
    attempts, places = list[Attempt](), np.vstack([task.start, task.goals])[:, :2]
    if task.bottom.limit_at(places).min() >= task.settings.depth:
        attempts += _search_at_full_depth(task, water, bound)
    shallow = task.bottom.shallowest < task.settings.depth and not task.is_late
    if shallow and (_goes_on(task, attempts) or _is_detour(task, water, attempts)):
        attempts += solve_turning(task, water, task.rings)
    # where all routes take more legs than are allowed: as near as those come
    return attempts or approach_turning(task, water, task.rings)


def _is_detour(task: MissionTask, water: Water, attempts: list[Attempt]) -> bool:
    """Return whether a mission round shallows takes clearly longer than the way across them."""
    across = passage_past_goals(task, water, task.rings, depth=LEAST_DIVE, quick=True)
    lasts = float(best_of(task, attempts).flight.time[-1])
    return across.route.arrives and across.passed[-1] < _ACROSS * lasts


def _search_at_full_depth(task: MissionTask, water: Water, bound: Bound | None) -> list[Attempt]:
    """Return the attempts whose dives all have the depth of the settings."""
    attempts = _search(task, water, task.rings, bound)
    if _goes_on(task, attempts) and any(ring.surface_only for ring in task.rings):
        # an area too wide to be passed under water between two surfacings must be rounded
        attempts += _search(
            task, water, tuple(replace(ring, surface_only=False) for ring in task.rings), bound
        )
    if _goes_on(task, attempts) and any(ring.drawn for ring in task.rings):
        # half-planes may bend a route through an area clear of it where they do not hold one round it
        attempts += _search(
            task, water, tuple(ring for ring in task.rings if not ring.drawn), bound, once=True
        )
    return attempts


def _goes_on(task: MissionTask, attempts: list[Attempt]) -> bool:
    """Return whether something else is to be tried: nothing is feasible yet, and there is time or nothing was tried at all."""
    return not any(is_feasible(task, attempt) for attempt in attempts) and (
        not attempts or not task.is_late
    )


def _search(
    task: MissionTask,
    water: Water,
    rings: tuple[Ring, ...],
    bound: Bound | None,
    once: bool = False,
) -> list[Attempt]:
    """Return the attempts with the number of legs that a route clear of rings suggests and, unless once is enough, with fewer or more."""
    settings, passage = task.settings, passage_past_goals(task, water, rings)
    solve = _solver(task, water, passage)
    likely = likely_legs(task, passage.passed[-1])
    if not passage.route.arrives and settings.legs is None:
        likely = min(likely, _LEGS_OUT_OF_REACH)
    passed = passage.passed
    attempts = [solve(goal_legs_of(passed, settings.legs or likely), False)]
    if settings.legs is not None or not passage.route.arrives or once or task.is_late:
        return attempts
    # half-planes have more room along a wider way, and often end in a better optimum
    beside = is_beside(task, rings, passage)
    way = widest_passage(task, water, rings, passage) if beside else passage
    wider = None if way is passage else _solver(task, water, way)
    crosses = attempts[0].violation is not None
    widely = [wider(goal_legs_of(passed, likely), False)] if wider is not None and crosses else []
    attempts += widely
    for n_legs in range(likely - 1, _fewest_legs(task, bound) - 1, -1):
        if (
            task.is_late
            or not is_feasible(task, attempts[-1])
            or best_of(task, attempts) is not attempts[-1]
        ):
            break
        attempts.append(solve(goal_legs_of(passed, n_legs), True))
    last = attempts[0]
    for n_legs in _more_legs(task, likely):
        if task.is_late or any(
            done.violation is None and goals_met(task, done) and done.is_settled
            for done in attempts
        ):
            break
        next_one = n_legs == last.goals.legs[-1] + 1
        last = solve(
            add_leg(last.goals.legs, last.legs.angles)
            if next_one
            else goal_legs_of(passed, n_legs),
            False,
        )
        attempts.append(last)
    best = best_of(task, attempts)
    if (
        beside
        and _to_be_bettered(task, attempts, best)
        and best.flight.time[-1] > _DETOUR * passed[-1]
    ):
        # beside obstacles legs that bend more often may be quicker than fewer
        more = int(min(best.goals.legs[-1] + 1, settings.most_legs))
        if all(more != done.goals.legs[-1] for done in attempts):
            attempts.append(solve(add_leg(best.goals.legs, best.legs.angles), False))
            best = best_of(task, attempts)
    if wider is not None and best not in widely and _to_be_bettered(task, attempts, best):
        attempts.append(wider(best.goals.legs, False))
    return attempts


def _to_be_bettered(task: MissionTask, attempts: list[Attempt], best: Attempt) -> bool:
    """Return whether a feasible mission is worth more solves: in time, and after little effort or where IPOPT left it unfinished."""
    cheap = effort_of(attempts) < ENOUGH or not best.is_settled
    return is_feasible(task, best) and cheap and not task.is_late


def _solver(
    task: MissionTask, water: Water, passage: Passage
) -> Callable[[tuple[int, ...], bool], Attempt]:
    """Return the function that solves a passage with the goals met in given legs; its second argument says that more are known to do."""
    route = passage.route

    def solve(legs: tuple[int, ...], fewer: bool) -> Attempt:
        announce(f"planning: {legs[-1]} legs")
        guess = initial_guess(
            task, route, water, route.times[-1] * np.arange(legs[-1] + 1) / legs[-1]
        )
        return solve_legs(
            task, guess, goal_steps_of(task, passage.passed, legs), route, fewer=fewer
        )

    return solve


def likely_legs(task: MissionTask, seconds: float) -> int:
    """Return the number of legs that a passage of some time takes."""
    longest = task.leg_time(task.vehicle.angles[0])
    return int(np.clip(np.ceil(seconds / longest - 1e-6), len(task.goals), task.settings.most_legs))


def _fewest_legs(task: MissionTask, bound: Bound | None) -> int:
    """Return the least number of legs that can arrive: one for each goal, and as many as the bound's time takes."""
    longest, drift = task.leg_time(task.vehicle.angles[0]), task.settings.surface_time
    return max(
        len(task.goals), 1 if bound is None else int(np.ceil((bound.time + drift) / longest - 1e-6))
    )


def _more_legs(task: MissionTask, likely: int) -> list[int]:
    """Return the numbers of legs that are tried where the likely one does not hold, in turn."""
    one_by_one = range(likely + 1, likely + 2 + len(task.goals))
    wanted = {*one_by_one, *(int(np.ceil(factor * likely)) for factor in _SHORTER)}
    return sorted({int(min(n_legs, task.settings.most_legs)) for n_legs in wanted} - {likely})


def _approach(task: MissionTask, water: Water, limit: Limit) -> Attempt:
    """Return the mission that comes nearest to a goal out of reach: along the route of the front, or heading at the goal itself."""
    passage = passage_past_goals(task, water, task.rings)
    route, settings, goal = passage.route, task.settings, task.goals[0, :2]
    likely = likely_legs(task, passage.passed[-1])
    n_legs = settings.legs or (settings.max_legs if limit == "legs" else None)
    n_legs = n_legs or (likely if limit == "duration" else min(likely, _LEGS_OUT_OF_REACH))
    ahead = task.leg_time(task.vehicle.angles[0])

    def on_route(_at: Array, now: float, _goal: int) -> Array:
        # the last leg heads at the goal
        return goal if now + ahead >= route.times[-1] else route.at(np.array([now + ahead]))[0]

    def at_goal(_at: Array, _now: float, _goal: int) -> Array:
        return np.asarray(goal)

    def flown(target: Target) -> Attempt:
        course = along_route(task, water, n_legs, target)
        while course.violation is not None and settings.legs is None and course.violation.leg > 1:
            course = along_route(task, water, course.violation.leg - 1, target)
        return course

    announce("planning: a goal is out of reach")
    courses = [flown(on_route), flown(at_goal)]
    if best_of(task, courses).violation is not None and task.bottom.shallowest < settings.depth:
        courses += approach_turning(task, water, task.rings)
    return best_of(task, courses)


def _reconsidered(task: MissionTask, water: Water, rest: Attempt) -> list[Attempt]:
    """Return the attempts from a new route where that is clearly quicker than the rest of an earlier plan."""
    if (
        task.settings.legs is not None
        or task.reference_path is not None
        or task.settings.weights.time == 0.0
    ):
        return []
    legs, lasts = len(rest.legs.headings), float(rest.flight.time[-1])
    for quick in (True, False):
        # a route on the lattice is hardly longer than one off it
        passage = passage_past_goals(task, water, task.rings, quick=quick)
        share = _ON_LATTICE if quick else 1.0
        likely = likely_legs(task, share * passage.passed[-1])
        if (
            not passage.route.arrives
            or lasts <= share * _RECONSIDERED * passage.passed[-1]
            or likely >= legs
        ):
            return []
    solve, found = _solver(task, water, passage), list[Attempt]()
    for n_legs in (likely, likely + 1):
        if n_legs < legs and not any(is_feasible(task, attempt) for attempt in found):
            found.append(solve(goal_legs_of(passage.passed, n_legs), False))
    return found


def _from_habit(task: MissionTask, water: Water, attempts: list[Attempt]) -> list[Attempt]:
    """Return the course of a pilot who heads at the goal at each surfacing, and what is solved from it, where it is better than all."""
    if task.settings.legs is not None or not _is_bounded(task) or task.settings.aim.distance_first:
        return []
    # a course that takes longer than the best attempt is not flown to its end
    feasible = [
        float(attempt.flight.time[-1]) for attempt in attempts if is_feasible(task, attempt)
    ]
    latest = min([longest_time(task), *feasible])
    flown = habit(
        task,
        water,
        int(min(latest // task.leg_time(task.vehicle.angles[1]) + 1, task.settings.most_legs)),
        latest,
    )
    if (
        flown is None
        or not is_feasible(task, flown)
        or best_of(task, [*attempts, flown]) is not flown
    ):
        return []
    return [flown, solve_legs(task, flown.guess, flown.goals, None)]


def _rest_of(task: MissionTask, warm: MissionPlan) -> list[Attempt]:
    """Return the attempt with the legs of an earlier plan that are still to be flown; none when there are none, or not as many as asked."""
    begun = warm.legs_flown(task.request.start_time_ns)
    left = len(warm.headings_deg) - begun
    goal_legs = tuple(number - begun for number in warm.goal_legs if number > begun)
    if (
        left <= 0
        or len(goal_legs) != len(task.goals)
        or left > task.settings.most_legs
        or task.settings.legs not in (None, left)
    ):
        return []
    task = replace(task, turns=turns_of(warm.yo_depths[begun:]))
    begins = np.concatenate([[0.0], warm.surfacing_times])[np.array(goal_legs) + begun - 1]
    durations = warm.surfacing_times[np.array(goal_legs) + begun - 1] - begins
    goals = GoalSteps(
        goal_legs,
        task.goal_steps(goal_legs, left, (warm.goal_times[-len(goal_legs) :] - begins) / durations),
    )
    places = np.column_stack(to_local(task.region.grid.projection, *warm.surfacings[begun:].T))
    guess = MissionGuess(
        places, np.deg2rad(warm.headings_deg[begun:]), np.deg2rad(warm.glide_angles_deg[begun:])
    )
    return [solve_legs(task, guess, goals, None)]
