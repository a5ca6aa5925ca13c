"""Departures compared: the same mission begun at several times, each planned from its neighbour."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from planners.mission.attempt import Attempt, is_feasible
from planners.mission.flight import Sample
from planners.mission.objectives.objective import Found
from planners.mission.plan import plan_mission
from planners.mission.result import to_plan
from planners.mission.scenarios import with_n_legs
from planners.mission.search import rest_of
from planners.mission.solve import solve_legs
from planners.mission.task import MissionTask, mission_task
from planners.mission.values import MissionPlan, MissionRequest
from replay_kit.core.errors import PlanError

# Share by which a time in still water may be short of that in the current.
_ROUGHLY = 1.01
# Of the statuses the better one first.
_RANKS = ("reached", "uncertain", "unreachable")


def plan_departures(flow: Sample, request: MissionRequest, starts_ns: Sequence[int]) -> tuple[MissionPlan, ...]:
    """Return the best mission found for each departure.

    The first is planned by itself. Each other one is solved from the plan before it, with a leg more or less where that is needed or might
    do, and planned by itself where that is no good plan either. Only plans by themselves are told against the lower bound of the time.

    Args:
        flow: The current, or its estimates for increasing times.
        request: As for ``plan_mission``; its start time does not count.
        starts_ns: When the mission begins in turn, increasing [ns, UTC].

    Raises:
        PlanError: As for ``plan_mission``; or there is no departure, or they do not increase.
    """
    if not starts_ns or any(after <= before for before, after in pairwise(starts_ns)):
        raise PlanError(f"departures are {list(starts_ns)} ns; expected one or more that increase")
    plans = list[MissionPlan]()
    for start_ns in starts_ns:
        asked = replace(request, start_time_ns=start_ns)
        # leaving later, all legs of the plan before are still to be flown
        made = _from_neighbour(flow, asked, replace(plans[-1], start_time_ns=start_ns)) if plans else None
        plans.append(plan_mission(flow, asked) if made is None else made)
    return tuple(plans)


def best_departure(plans: Sequence[MissionPlan]) -> int:
    """Return which of some plans is the best: one that reaches the goals before others, then of least cost by its objective."""

    def rank(plan: MissionPlan) -> tuple[int, float]:
        named = _RANKS.index(plan.status) if plan.status in _RANKS else len(_RANKS)
        miss, aim = float(np.sum(plan.closest_approach)), plan.settings.aim
        if plan.status not in ("reached", "uncertain") or aim.distance_first:
            return named, miss
        return named, aim.cost(Found(plan.vehicle, np.deg2rad(plan.glide_angles_deg), plan.yo_depths, plan.duration, plan.energy, miss))

    return min(range(len(plans)), key=lambda k: rank(plans[k]))


def _from_neighbour(flow: Sample, request: MissionRequest, before: MissionPlan) -> MissionPlan | None:
    """Return the mission with the legs of another departure's, solved for its own; None where that is no good plan."""
    if before.status != "reached":
        return None
    task = mission_task(flow, request)
    attempts = rest_of(task, before)
    alike = all(max(leg) == task.settings.depth for leg in before.yo_depths)
    if attempts and alike and request.settings.legs is None:
        attempts += _with_another_number(task, attempts[0])
    made = to_plan(task, attempts)
    return made if made.status == "reached" and not (request.settings.legs is None and _spares_a_leg(made)) else None


def _with_another_number(task: MissionTask, attempt: Attempt) -> list[Attempt]:
    """Return an attempt with a leg more where one misses its goals, with a leg less where that might do; none where neither is so."""
    feasible, n_legs = is_feasible(task, attempt), len(attempt.legs.headings)
    wanted = n_legs - 1 if feasible else n_legs + 1
    if wanted > task.settings.max_legs or (feasible and not _spares_a_leg(to_plan(task, [attempt]))):
        return []
    other = with_n_legs(task, attempt, wanted)
    return [solve_legs(task, other.guess, other.goals, None, fewer=feasible)]


def _spares_a_leg(plan: MissionPlan) -> bool:
    """Return whether a mission might do with a leg less: at the shallowest glide angle it would be over in the time of one less."""
    settings, vehicle, n_legs = plan.settings, plan.vehicle, len(plan.headings_deg)
    if n_legs <= len(plan.goals):
        return False
    along, down = (float(speed) for speed in vehicle.speeds(np, vehicle.angles[0]))
    slower = float(np.mean(vehicle.speeds(np, np.deg2rad(plan.glide_angles_deg))[0])) / along
    longest = 2.0 * settings.yos * max(max(leg) for leg in plan.yo_depths) / down + settings.surface_time
    return plan.duration * slower <= _ROUGHLY * (n_legs - 1) * longest
