"""Departures compared: the same mission begun at several times, each planned from its neighbour."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from planners.mission.flight import Sample
from planners.mission.plan import plan_mission
from planners.mission.values import MissionPlan, MissionRequest
from replay_kit.core.errors import PlanError

# Of the statuses the better one first.
_RANKS = ("reached", "uncertain", "unreachable")


def plan_departures(flow: Sample, request: MissionRequest, starts_ns: Sequence[int]) -> tuple[MissionPlan, ...]:
    """Return the best mission found for each departure.

    The first is planned by itself; each other one starts from the plan before it, and is planned by itself where that plan's number of legs
    is too large.

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
        before = replace(plans[-1], start_time_ns=start_ns) if plans and plans[-1].status == "reached" else None
        made = plan_mission(flow, asked, warm=before)
        plans.append(_or_anew(flow, asked, made) if before is not None else made)
    return tuple(plans)


def best_departure(plans: Sequence[MissionPlan]) -> int:
    """Return which of some plans is the best: one that reaches the goals before others, then of least cost by its objective."""

    def rank(plan: MissionPlan) -> tuple[int, float]:
        named = _RANKS.index(plan.status) if plan.status in _RANKS else len(_RANKS)
        miss = float(np.sum(plan.closest_approach))
        counts = plan.status in ("reached", "uncertain") and plan.settings.objective != "closest"
        return named, plan.settings.weights.cost(plan.duration, plan.energy, miss) if counts else miss

    return min(range(len(plans)), key=lambda k: rank(plans[k]))


def _or_anew(flow: Sample, request: MissionRequest, made: MissionPlan) -> MissionPlan:
    """Return a plan, or a cheaper one found without an earlier plan: sought where a leg less, at the shallowest angle, takes no less time.

    A least number of legs leaves no room for one less; an earlier plan whose number is too large is no guide.
    """
    settings, n_legs = request.settings, len(made.headings_deg)
    if settings.legs is not None or made.status != "reached" or n_legs <= len(request.goals):
        return made
    _, down = request.vehicle.speeds(np, request.vehicle.angles[0])
    longest = 2.0 * settings.yos * max(max(leg) for leg in made.yo_depths) / float(down) + settings.surface_time
    if made.duration > (n_legs - 1) * longest:
        return made
    anew = plan_mission(flow, request)
    return anew if best_departure([anew, made]) == 0 else made
