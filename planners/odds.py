"""How likely a mission arrives, in samples of the estimate; and missions for the odds: with more legs, or with wider margins.

It is flown with headings corrected at each surfacing and with headings held.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from math import comb

import numpy as np

from planners.flights import (
    MissionFlights,
    MonteCarloSummary,
    currents_of_estimate,
    fly_samples,
    legs_of_plan,
    points_at,
    predict,
    summarise_flights,
    surfacing_ellipses,
)
from planners.plan import plan_mission, to_plan
from planners.program.solve import Solution, again
from planners.program.starts import AGAIN, Search, as_passage, cut, is_feasible, search
from planners.request import MissionPlan, MissionRequest, Mooring
from planners.simulation.currents import Currents, Flow, Sample
from planners.simulation.fly import Flight
from planners.simulation.steer import Pilot
from planners.task import Task, task_of
from planners.words import arrival_text, odds_text, violations_text
from replay_kit.core.arrays import Array

# Legs more than the quickest mission's that are tried in turn, as shares of its number, and how many are one at least.
_MORE = 0.1, 0.2, 0.35, 0.5, 0.75, 1.0
# Candidates in turn that are no better before the search ends.
_PATIENCE = 2
# Share of the samples that more must arrive for a longer mission to be better than a shorter one.
_CLEARLY = 0.04


@dataclass(frozen=True, slots=True, eq=False)
class MissionOdds:
    """A mission in samples of the estimate.

    Attributes:
        count: Number of samples.
        corrected: Its summary with headings corrected at each surfacing, as a pilot does.
        held: Its summary with headings held whatever the current.
        ellipses: shape (L, 5), of ``surfacing_ellipses``, with headings held.
    """

    count: int
    corrected: MonteCarloSummary
    held: MonteCarloSummary
    ellipses: Array


def mission_odds(
    flow: Flow,
    samples: Sequence[Sample],
    plan: MissionPlan,
    request: MissionRequest,
) -> MissionOdds:
    """Return the odds of a mission.

    Args:
        flow: The estimate, or estimates for increasing times: what the pilot knows of the current.
        samples: Three or more on its nodes, as for ``plan_scenarios``: those that change are flown as they are, what others differ by from
            the first estimate persists.
        plan: The mission.
        request: What it was planned for.

    Raises:
        PlanError: The mission has no legs, or there are too few samples.
    """
    mooring = plan.shape if isinstance(plan.shape, Mooring) else None
    task = task_of(
        flow, replace(request, vehicle=plan.vehicle, settings=plan.settings, shape=plan.shape)
    )
    legs = legs_of_plan(plan)
    currents = currents_of_estimate(flow, samples)
    summaries = list[MonteCarloSummary]()
    predicted = predict(task, legs)
    for pilot in (Pilot(), None):
        flight = fly_samples(task, currents, legs, predicted, pilot)
        summary = summarise_flights(task, flight, points_at(predicted, plan.goal_times))[0]
        summaries.append(
            summary if mooring is None else _moored(summary, flight, task.goals[0, :2], mooring)
        )
    nothing = np.zeros((len(samples), 0, 2))
    flights = MissionFlights(
        flight.time[0],
        flight.depth,
        flight.place,
        nothing,
        nothing[..., 0],
        task.region.grid.projection,
    )
    corrected, held = summaries
    return MissionOdds(len(samples), corrected, held, surfacing_ellipses(flights, plan))


def _moored(
    summary: MonteCarloSummary, flight: Flight, place: Array, mooring: Mooring
) -> MonteCarloSummary:
    """Return a summary whose misses are the largest distances from a mooring at a place, shape (2,) [m]."""
    counted = flight.place[:, flight.ends] if mooring.surfacings_only else flight.place
    farthest = np.linalg.norm(counted - place, axis=2).max(axis=1)
    median, ninety = (float(np.quantile(farthest, share)) for share in (0.5, 0.9))
    return replace(
        summary,
        reached=float(np.mean(farthest <= mooring.radius)),
        miss_median=median,
        miss_90_percent=ninety,
    )


def with_odds(plan: MissionPlan, odds: MissionOdds, arrive: float, risk: float) -> MissionPlan:
    """Return a mission whose status and message say how likely it arrives.

    Args:
        plan: The mission.
        odds: Of it.
        arrive: Share of the samples that must arrive for it to be ``reached``; below, it is ``uncertain``.
        risk: Share that may violate a constraint; above, it is ``unsafe``.
    """
    corrected, violating = odds.corrected, 1.0 - odds.corrected.safe
    status = plan.status
    text = odds_text(plan, odds.count, corrected.reached, odds.held.reached)
    if status != "partial":
        text += arrival_text(plan, corrected.arrival_90_percent)
    text += violations_text(violating, corrected.violations)
    # shares of a few samples are rounded by the last bit
    if violating > risk + 1e-9 and status == "reached":
        status, text = "unsafe", f"{text}, more than the {100.0 * risk:.0f} % accepted"
    elif corrected.reached < arrive - 1e-9 and status == "reached":
        status, text = "uncertain", f"{text}; {100.0 * arrive:.0f} % are asked for"
    return replace(plan, status=status, message=f"{text}. In the estimate itself: {plan.message}")


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A mission flown in samples.

    Attributes:
        found: It.
        summary: Of its flights.
        clear: shape (K,), the least clearance of each [m]: 0 or less where it violates a constraint.
        extra: Its margin beside that of the settings [m].
    """

    found: Solution
    summary: MonteCarloSummary
    clear: Array
    extra: float = 0.0

    def passes(self, allowed: float) -> bool:
        """Return whether so few violate a constraint that more than the allowed share of all is unlikely to."""
        return passes_binomial_test(int(np.sum(self.clear <= 0.0)), len(self.clear), allowed)

    def missing(self, allowed: float) -> float:
        """Return the clearance that is missing to the first sample that must not violate a constraint [m]."""
        count = most_violations_allowed(len(self.clear), allowed)
        return float(np.sort(-self.clear)[::-1][count])


def plan_for_odds(
    flow: Flow, samples: Sequence[Sample], request: MissionRequest, *, pilot: Pilot | None = None
) -> MissionPlan:
    """Return the mission that most samples of the estimate arrive with: without a violation, and by ``arrive_by`` if there is one.

    All numbers of legs are flown in the same samples. A longer mission is taken where clearly more of them arrive; of missions alike the
    shortest. Where the goals are out of reach in the estimate itself, the mission is that of ``plan_mission``. ``statistics`` has
    ``odds_costs_h``, by how much longer than the quickest mission it is.

    Args:
        flow: The estimate, or estimates for increasing times.
        samples: As for ``plan_scenarios``. The share that arrives of those that a mission was chosen by is too high: state that of others.
        request: As for ``plan_mission``.
        pilot: Who corrects the mission at each surfacing; None for the usual one.

    Raises:
        PlanError: As for ``plan_mission``; or there are no samples, or they are not on the nodes of the estimate.
    """
    currents, task = currents_of_estimate(flow, samples), task_of(flow, request)
    if not task.is_finite:
        return plan_mission(flow, request)
    answer, steered = search(task), pilot or Pilot()
    first = answer.best
    fixed = request.settings.legs is not None
    if not first.count or answer.beyond or not is_feasible(task, first) or fixed:
        return to_plan(task, answer)
    best = judged(task, currents, steered, first)
    worse, tried = 0, list(answer.tried)
    for longer in with_more_legs(task, first):
        trial = judged(task, currents, steered, longer)
        tried.append(longer)
        better = trial.summary.succeeded - best.summary.succeeded > _CLEARLY
        best, worse = (trial, 0) if better else (best, worse + 1)
        if worse == _PATIENCE or best.summary.succeeded == 1.0 or task.is_late:
            break
    plan = to_plan(task, replace(answer, best=best.found, tried=tried))
    costs = {"odds_costs_h": (best.found.seconds - first.seconds) / 3600.0}
    return replace(plan, statistics={**plan.statistics, **costs})


def with_more_legs(task: Task, first: Solution) -> Iterator[Solution]:
    """Yield the missions along the way of a solution with more and more legs that meet the goals in time."""
    one, before = Search(first.task, None), first
    counts = {
        first.count + max(int(np.ceil(share * first.count)), k + 1) for k, share in enumerate(_MORE)
    }
    assert first.start is not None
    depth = float(np.min(first.start.depths))
    for count in sorted(counts):
        if count > task.settings.most_legs:
            return
        found = again(
            one.attempt(cut(first.task, f"longer{AGAIN}", as_passage(before), count, depth))
        )
        if is_feasible(task, found):
            before = found
            yield found


def judged(
    task: Task, currents: Currents, pilot: Pilot | None, found: Solution, extra: float = 0.0
) -> Trial:
    """Return a mission flown in the samples."""
    of = replace(task, request=replace(task.request, vehicle=found.task.vehicle))
    predicted = predict(of, found.legs)
    flight = fly_samples(of, currents, found.legs, predicted, pilot)
    met = points_at(predicted, found.flight.time[0, found.points])
    return Trial(found, *summarise_flights(of, flight, met), extra)


# Plans made with wider and wider margins at most; each margin grows by this factor of what is missing, and by so much at least [m].
_PLANS, _GROWTH, _LEAST = 4, 1.15, 50.0
# Significance of the binomial test: the probability of so few violations among the samples if the allowed share of all violated.
_SIGNIFICANCE = 0.15
# Missions with time in reserve that are tried where no margin keeps the risk, and hours that are worth stating.
_RESERVES, _TOLD = 3, 0.05


def plan_scenarios(
    flow: Flow,
    samples: Sequence[Sample],
    request: MissionRequest,
    *,
    allowed: float = 0.1,
    pilot: Pilot | None = None,
) -> tuple[MissionPlan, MonteCarloSummary]:
    """Return the mission planned on the estimate with a margin that keeps the samples clear, and its summary over the samples.

    Margins are widened by what is missing until the violations among the samples pass a binomial test; narrowed again where they close the
    way. A pilot with time in reserve strays less: longer missions are tried too. When nothing tried keeps enough samples clear, the plan
    that keeps most is returned: ``MonteCarloSummary.safe`` says how many.

    Args:
        flow: The estimate, or estimates for increasing times.
        samples: Flows on its nodes: about twenty or more. Those that change are flown as they are, of each its flows at the same
            increasing times, as ``sample_through`` draws them; what others, as ``flow.sample`` of the first draws them, differ by persists.
        request: As for ``plan_mission``; the margin of its settings is the least one.
        allowed: Share of the samples that may violate a constraint.
        pilot: Who corrects the mission at each surfacing; None when its headings are held whatever the current.

    Raises:
        PlanError: As for ``plan_mission``; or there are no samples, or they are not on the nodes of the estimate.
    """
    currents, task = currents_of_estimate(flow, samples), task_of(flow, request)
    if not task.is_finite:
        nothing = float("nan")
        return plan_mission(flow, request), MonteCarloSummary(0.0, 0.0, nothing, nothing, {})
    answer = search(task)
    first = answer.best
    if not first.count:
        last = float(first.miss[-1])
        return to_plan(task, answer), MonteCarloSummary(1.0, 1.0, last, last, {})
    trials, tried = [judged(task, currents, pilot, first)], list(answer.tried)
    met, open_, extra = is_feasible(task, first) and not answer.beyond, 0.0, 0.0
    missing = trials[0].missing(allowed)
    for _ in range(_PLANS if met else 0):
        if trials[-1].passes(allowed) or task.is_late:
            break
        extra = extra if extra > open_ else open_ + max(_GROWTH * missing, _LEAST)
        settings = replace(task.settings, margin=task.settings.margin + extra)
        found = search(replace(task, request=replace(task.request, settings=settings)))
        tried += found.tried
        if is_feasible(task, found.best):
            trials.append(judged(task, currents, pilot, found.best, extra))
            open_, missing = extra, trials[-1].missing(allowed)
        else:
            extra = 0.5 * (open_ + extra)
    if pilot is not None and met and not any(trial.passes(allowed) for trial in trials):
        for longer in islice(with_more_legs(task, first), _RESERVES):
            trials.append(judged(task, currents, pilot, longer))
            tried.append(longer)
            if trials[-1].passes(allowed) or task.is_late:
                break
    # a plan that passes the test, or else the safest
    best = max(trials, key=lambda trial: (trial.passes(allowed), trial.summary.safe))
    plan = to_plan(task, replace(answer, best=best.found, tried=tried))
    hours = (best.found.seconds - first.seconds) / 3600.0
    if abs(hours) >= _TOLD:
        costs = "more" if hours > 0.0 else "less"
        text = f"{plan.message}; to keep the risk takes {abs(hours):.1f} h {costs} than the quickest way"
        plan = replace(plan, message=text)
    counts = {
        "risk_costs_h": hours,
        "margins_tried": len(trials),
        "extra_margin_m": best.extra,
    }
    summary = replace(best.summary, reached=0.0) if answer.beyond else best.summary
    return replace(plan, statistics={**plan.statistics, **counts}), summary


def passes_binomial_test(violations: int, count: int, allowed: float) -> bool:
    """Return whether so few violations among some samples make it unlikely that more than the allowed share of all would violate.

    No violation always passes.
    """
    terms = (
        comb(count, k) * allowed**k * (1.0 - allowed) ** (count - k) for k in range(violations + 1)
    )
    return violations == 0 or sum(terms) <= _SIGNIFICANCE


def most_violations_allowed(count: int, allowed: float) -> int:
    """Return the largest number of violations among ``count`` samples that passes the binomial test."""
    return max(number for number in range(count) if passes_binomial_test(number, count, allowed))
