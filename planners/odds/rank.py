"""Plans ranked by their odds: more legs for better odds, wider margins for a smaller risk."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from math import comb

import numpy as np

from planners.odds.mission import (
    MissionOdds,
    currents_of_estimate,
    latest_arrival,
    odds_of,
    route_along,
)
from planners.plan import plan_mission, to_plan
from planners.program.legs import AGAIN, as_passage, cut_route
from planners.program.solution import Solution, flown_again, is_feasible
from planners.program.starts import Search, search
from planners.request import MissionPlan, MissionRequest
from planners.simulation.currents import Currents, Flow, Sample
from planners.task import Task, task_of, yo_depths

# Legs more than the quickest mission's that are tried in turn, as shares of its number; candidates in turn that are no better before the
# search ends; share of the samples that more must arrive for a longer mission to be better.
_MORE, _PATIENCE, _CLEARLY = (0.1, 0.2, 0.35, 0.5, 0.75, 1.0), 2, 0.04
# Wider margins tried at most; each grows by this factor of what is missing, and by so much at least [m].
_WIDER, _GROWTH, _LEAST = 4, 1.15, 50.0
# Significance of the binomial test: the probability of so few violations among the samples if the allowed share of all violated.
_SIGNIFICANCE = 0.15
# Longer missions that are tried where no margin keeps the risk, and hours that are worth stating.
_RESERVES, _TOLD = 3, 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """Candidate plan with its odds.

    Attributes:
        found: Solution.
        odds: Odds of the solution.
        extra: Margin in addition to that of the settings [m].
    """

    found: Solution
    odds: MissionOdds
    extra: float = 0.0

    def passes(self, allowed: float) -> bool:
        """Return whether the violations pass the binomial test of an allowed fraction."""
        return passes_binomial_test(int(np.sum(self.odds.clear <= 0.0)), self.odds.count, allowed)

    def missing(self, allowed: float) -> float:
        """Return the clearance lacking for the allowed fraction of violations [m]."""
        count = most_violations_allowed(self.odds.count, allowed)
        return float(np.sort(-self.odds.clear)[::-1][count])


def plan_by_odds(
    flow: Flow, samples: Sequence[Sample], request: MissionRequest, allowed: float | None = None
) -> MissionPlan:
    """Return the plan with significantly the best odds or, for an accepted risk, one within it; among equals the shortest.

    ``statistics`` holds the excess over the shortest duration. Evaluate its odds with independent samples.

    Args:
        flow: Estimate, or estimates at increasing times.
        samples: Samples, see ``mission_odds``.
        request: Request; its margin is the smallest tried.
        allowed: Accepted fraction of violations; None to rank by arrivals.

    Raises:
        PlanError: See ``plan_mission`` and ``mission_odds``.
    """
    task = task_of(flow, request)
    currents = currents_of_estimate(flow, samples, task.settings.depth)
    if not task.is_finite:
        return plan_mission(flow, request)
    answer = search(task)
    first = answer.best
    fixed = allowed is None and request.settings.legs is not None
    if not first.count or answer.beyond or not is_feasible(task, first) or fixed:
        return to_plan(task, answer)
    deadline, tried = latest_arrival(request.settings, first.seconds), list(answer.tried)
    quickest = _judged(task, currents, first, deadline)
    if allowed is None:
        best, name = _most_arriving(task, currents, quickest, deadline, tried), "odds_costs_h"
    else:
        best, name = _safest(task, currents, quickest, (deadline, allowed), tried), "risk_costs_h"
    plan = to_plan(task, replace(answer, best=best.found, tried=tried))
    hours = (best.found.seconds - first.seconds) / 3600.0
    if allowed is not None and abs(hours) >= _TOLD:
        costs = "more" if hours > 0.0 else "less"
        text = f"{plan.message}; keeping the risk takes {abs(hours):.1f} h {costs} than the fastest route"
        plan = replace(plan, message=text)
    return replace(plan, statistics={**plan.statistics, name: hours, "extra_margin_m": best.extra})


def _most_arriving(
    task: Task, currents: Currents, best: Candidate, deadline: float, tried: list[Solution]
) -> Candidate:
    worse = 0
    if best.odds.succeeded == 1.0:
        return best
    for longer in _with_more_legs(task, best.found):
        one = _judged(task, currents, longer, deadline)
        tried.append(longer)
        better = one.odds.succeeded - best.odds.succeeded > _CLEARLY
        best, worse = (one, 0) if better else (best, worse + 1)
        if worse == _PATIENCE or best.odds.succeeded == 1.0 or task.is_late:
            break
    return best


def _safest(
    task: Task,
    currents: Currents,
    first: Candidate,
    asked: tuple[float, float],
    tried: list[Solution],
) -> Candidate:
    (deadline, allowed), made, open_, extra = asked, [first], 0.0, 0.0
    missing = first.missing(allowed)
    for _ in range(_WIDER):
        if made[-1].passes(allowed) or task.is_late:
            break
        extra = extra if extra > open_ else open_ + max(_GROWTH * missing, _LEAST)
        settings = replace(task.settings, margin=task.settings.margin + extra)
        found = search(replace(task, request=replace(task.request, settings=settings)))
        tried += found.tried
        if is_feasible(task, found.best):
            made.append(_judged(task, currents, found.best, deadline, extra))
            open_, missing = extra, made[-1].missing(allowed)
        else:
            extra = 0.5 * (open_ + extra)
    if not any(one.passes(allowed) for one in made):
        # a glider with time in reserve strays less
        for longer in islice(_with_more_legs(task, first.found), _RESERVES):
            made.append(_judged(task, currents, longer, deadline))
            tried.append(longer)
            if made[-1].passes(allowed) or task.is_late:
                break
    return max(made, key=lambda one: (one.passes(allowed), one.odds.safe))


def _with_more_legs(task: Task, first: Solution) -> Iterator[Solution]:
    """Yield solutions along the same route with increasing numbers of legs that arrive in time."""
    one, before = Search(first.task, None), first
    counts = {
        first.count + max(int(np.ceil(share * first.count)), k + 1) for k, share in enumerate(_MORE)
    }
    assert first.start is not None
    depth = float(np.min(first.start.depths))
    for count in sorted(counts):
        if count > task.settings.most_legs:
            return
        found = flown_again(
            one.attempt(cut_route(first.task, f"longer{AGAIN}", as_passage(before), count, depth))
        )
        if is_feasible(task, found):
            before = found
            yield found


def _judged(
    task: Task, currents: Currents, found: Solution, deadline: float, extra: float = 0.0
) -> Candidate:
    """Return a solution with its odds in the samples."""
    task_of_vehicle = replace(task, request=replace(task.request, vehicle=found.task.vehicle))
    legs, ends = found.legs, found.flight.place[0, found.flight.ends]
    depths, heading = yo_depths(legs.turns), float(legs.headings[0])
    route = route_along(task_of_vehicle, ends, heading, legs.angles, depths, found.goal_legs)
    return Candidate(found, odds_of(task_of_vehicle, currents, route, deadline), extra)


def passes_binomial_test(violations: int, count: int, allowed: float) -> bool:
    """Return whether a number of violations rejects, by a binomial test, that their probability exceeds the allowed one.

    Zero violations always pass.
    """
    terms = (
        comb(count, k) * allowed**k * (1.0 - allowed) ** (count - k) for k in range(violations + 1)
    )
    return violations == 0 or sum(terms) <= _SIGNIFICANCE


def most_violations_allowed(count: int, allowed: float) -> int:
    """Return the largest number of violations in ``count`` samples that passes the binomial test."""
    return max(number for number in range(count) if passes_binomial_test(number, count, allowed))
