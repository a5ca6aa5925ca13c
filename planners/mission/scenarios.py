"""A mission that keeps clear of hazards in most samples of the estimate, not in the estimate alone.

Headings that are held whatever the current cannot make the deviations of the track smaller: such a plan can only keep farther away, place
by place by the deviations of the samples there, with the one-sided tolerance factor for few samples (confidence 99 %); the margin is
widened further until the violations among the samples pass a binomial test. Where that leaves the goal, ways are planned anew with a wider
margin everywhere but near start and goal. A pilot who corrects the mission at each surfacing makes the
deviations smaller, and one with time in reserve even more so.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice

import numpy as np
from scipy.special import bdtr

from planners.mission.flight.pilot import Pilot
from planners.mission.flights import MonteCarloSummary, currents_of_estimate
from planners.mission.odds import Trial, as_whole, judged, with_more_legs
from planners.mission.plan import to_plan
from planners.mission.search.search import solve_attempts
from planners.mission.solve.attempt import Attempt, best_of, is_feasible
from planners.mission.solve.goals import aimed_at, with_n_legs
from planners.mission.solve.legs import solve_with_margin
from planners.mission.solve.optimum import SafetyMargin
from planners.mission.task import MissionTask, mission_task
from planners.request import MissionPlan, MissionRequest
from planners.simulation.currents import Currents, Flow, Sample

# Plans made with wider and wider margins at most; each margin grows by this factor of what is missing, and by so much at least [m].
_PLANS, _GROWTH, _LEAST = 4, 1.15, 50.0
# Significance of the binomial test: the probability of so few violations among the samples if the allowed share of all violated.
_SIGNIFICANCE = 0.15
# Additional legs that are tried where a wider margin leaves the goal out of reach.
_LONGER = 2
# Missions with time in reserve that are tried where no margin keeps the risk, and hours that are worth stating.
_RESERVES, _TOLD = 3, 0.05
# A margin kept this well is kept [m].
_KEPT = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    """A plan with one margin, flown in the samples.

    Attributes:
        flown: It.
        extra: Its margin beside the samples' deviations, or beside that of the settings [m].
        passes: Whether its violations pass the binomial test.
        missing: Clearance that is missing to the first sample that must not violate a constraint [m].
    """

    flown: Trial
    extra: float
    passes: bool
    missing: float

    @property
    def attempt(self) -> Attempt:
        """The plan."""
        return self.flown.attempt


def plan_scenarios(
    flow: Flow,
    samples: Sequence[Sample],
    request: MissionRequest,
    *,
    allowed: float = 0.1,
    pilot: Pilot | None = None,
) -> tuple[MissionPlan, MonteCarloSummary]:
    """Return the mission planned on the estimate with a margin that keeps the samples clear, and its summary over the samples.

    A plan that meets its goals comes before one that keeps clear by missing them: where wider margins lead past a goal,
    ways farther round are planned. When nothing tried keeps enough samples clear, the plan that keeps most is returned:
    ``MonteCarloSummary.safe`` says how many.

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
    currents, whole = currents_of_estimate(flow, samples), mission_task(flow, request)
    attempts = solve_attempts(whole)
    if not attempts:
        return to_plan(whole, []), MonteCarloSummary(0.0, 0.0, float("nan"), float("nan"), {})
    first, trials, extra = best_of(whole, attempts), list[_Trial](), 0.0
    if not first.yo_depths:
        last = float(first.miss[-1])
        return to_plan(whole, attempts), MonteCarloSummary(1.0, 1.0, last, last, {})
    task, attempt = aimed_at(whole, first)
    tried = partial(_try, task, currents, allowed, pilot)
    trials.append(tried(attempt, extra))
    met = [is_feasible(task, attempt)]
    # what a margin leads astray, a wider one does not lead back
    while not (trials[-1].passes or task.is_late or len(trials) == _PLANS or met[-1] < met[0]):
        if len(trials) > 1:
            extra += max(_GROWTH * trials[-1].missing, _LEAST)
        margin = SafetyMargin(trials[-1].flown.deviations, 1.0 - allowed, extra)
        attempt = _widen_margin(task, attempt, margin)
        trials.append(tried(attempt, extra))
        met.append(is_feasible(task, attempt))
    if met[-1] < met[0] and not any(_keeps(task, trial, allowed) for trial in trials):
        # half-planes hold a way that is near to one without a margin: a wider way round may still lead to the goal
        trials += _wider_ways(task, trials[0].missing, tried)
    if pilot is not None and met[0] and not any(_keeps(task, trial, allowed) for trial in trials):
        # a pilot with time in reserve strays less
        for longer in islice(with_more_legs(task, trials[0].attempt), _RESERVES):
            trials.append(tried(longer, 0.0))
            if trials[-1].passes or task.is_late:
                break
    # a plan that reaches its goal comes before one that does not; then one that passes the test, or else the safest
    best = max(
        trials,
        key=lambda trial: (
            is_feasible(task, trial.attempt),
            trial.passes,
            trial.flown.summary.safe,
        ),
    )
    found = as_whole(whole, first, best.attempt)
    plan = to_plan(whole, [found])
    hours = float(found.flight.time[-1] - first.flight.time[-1]) / 3600.0
    if abs(hours) >= _TOLD:
        costs = "more" if hours > 0.0 else "less"
        text = f"{plan.message}; to keep the risk takes {abs(hours):.1f} h {costs} than the quickest way"
        plan = replace(plan, message=text)
    counts = {
        "risk_costs_h": hours,
        "margins_tried": len(trials),
        "attempts": len(attempts) + len(trials) - 1,
        "extra_margin_m": best.extra,
    }
    summary = replace(best.flown.summary, reached=0.0) if first.beyond else best.flown.summary
    return replace(plan, statistics={**plan.statistics, **counts}), summary


def _try(
    task: MissionTask,
    currents: Currents,
    allowed: float,
    pilot: Pilot | None,
    attempt: Attempt,
    extra: float,
) -> _Trial:
    """Return a plan flown in the samples."""
    flown = judged(task, currents, pilot, attempt)
    clear = flown.clear
    passes = passes_binomial_test(int(np.sum(clear <= 0.0)), len(clear), allowed)
    missing = float(np.sort(-clear)[::-1][most_violations_allowed(len(clear), allowed)])
    return _Trial(flown, extra, passes, missing)


def _keeps(task: MissionTask, trial: _Trial, allowed: float) -> bool:
    """Return whether a plan meets its goals and violates a constraint in no more than the allowed share of the samples."""
    return is_feasible(task, trial.attempt) and 1.0 - trial.flown.summary.safe <= allowed + 1e-9


def _wider_ways(
    task: MissionTask, missing: float, tried: Callable[[Attempt, float], _Trial]
) -> list[_Trial]:
    """Return the trials of plans made anew with wider margins, until one passes or keeps no more samples clear than the one before.

    Where the way is closed, they are narrower again.
    """
    trials, open_, extra = list[_Trial](), 0.0, max(_GROWTH * missing, _LEAST)
    for _ in range(_PLANS):
        wide = replace(
            task,
            request=replace(
                task.request, settings=replace(task.settings, margin=task.settings.margin + extra)
            ),
        )
        attempt = best_of(wide, solve_attempts(wide))
        if is_feasible(wide, attempt):
            trials.append(tried(attempt, extra))
            open_, extra = extra, extra + max(_GROWTH * trials[-1].missing, _LEAST)
        else:
            extra = 0.5 * (open_ + extra)
        stays = len(trials) > 1 and trials[-1].flown.summary.safe <= trials[-2].flown.summary.safe
        if task.is_late or stays or (trials and trials[-1].passes):
            break
    return trials


def passes_binomial_test(violations: int, count: int, allowed: float) -> bool:
    """Return whether so few violations among some samples make it unlikely that more than the allowed share of all would violate.

    No violation always passes.
    """
    return violations == 0 or float(bdtr(violations, count, allowed)) <= _SIGNIFICANCE


def most_violations_allowed(count: int, allowed: float) -> int:
    """Return the largest number of violations among ``count`` samples that passes the binomial test."""
    return max(number for number in range(count) if passes_binomial_test(number, count, allowed))


def _widen_margin(task: MissionTask, before: Attempt, margin: SafetyMargin) -> Attempt:
    """Return the attempt with a wider margin; with more legs where the goal is out of reach otherwise."""
    found = solve_with_margin(task, before, margin)
    n_legs = len(before.legs.headings)
    for longer in range(n_legs + 1, n_legs + _LONGER + 1):
        if (
            longer > task.settings.most_legs
            or (is_feasible(task, found) and found.plane_violation < _KEPT)
            or task.settings.legs is not None
        ):
            break
        more = solve_with_margin(task, with_n_legs(task, before, longer), margin)
        best = min(found, more, key=lambda one: (not is_feasible(task, one), one.plane_violation))
        if best is found:
            break
        found = best
    return found
