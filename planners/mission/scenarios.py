"""A mission that keeps clear of hazards in most samples of the estimate, not in the estimate alone.

Headings that are held whatever the current cannot make the deviations of the track smaller: such a plan can only keep farther away, place
by place by the deviations of the samples there, with the one-sided tolerance factor for few samples (confidence 99 %); the margin is
widened further until the violations among the samples pass a binomial test. Where that leaves the goal, ways are planned anew with a wider
margin everywhere but near start and goal. A pilot who corrects the mission at each surfacing makes the
deviations smaller.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtr

from planners.flow import graph_key
from planners.mission.attempt import Attempt, best_of, is_feasible
from planners.mission.check import clearances
from planners.mission.feedback import Pilot, fly_corrected
from planners.mission.flight import (
    Currents,
    Flight,
    Flow,
    Legs,
    Sample,
    currents_of,
    currents_of_samples,
    flows_of,
    fly_legs,
    with_courses,
)
from planners.mission.flights import legs_of_plan
from planners.mission.goal_legs import goal_legs_of, goal_steps_of
from planners.mission.leg import fly_midpoints
from planners.mission.program import MissionGuess
from planners.mission.result import to_plan
from planners.mission.safety_margin import SafetyMargin
from planners.mission.search import solve_attempts
from planners.mission.solve import solve_with_margin
from planners.mission.some_goals import aimed_at, to_all
from planners.mission.task import MissionTask, mission_task, turns_of
from planners.mission.values import MissionPlan, MissionRequest, MonteCarloSummary
from planners.route.bottom import Bathymetry
from planners.route.hazards import NoGo
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate

# Plans made with wider and wider margins at most; each margin grows by this factor of what is missing, and by so much at least [m].
_PLANS, _GROWTH, _LEAST = 4, 1.15, 50.0
# Significance of the binomial test: the probability of so few violations among the samples if the allowed share of all violated.
_SIGNIFICANCE = 0.15
# Additional legs that are tried where a wider margin leaves the goal out of reach.
_LONGER = 2
# A margin kept this well is kept [m].
_KEPT = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    """A plan with one margin, flown in the samples.

    Attributes:
        attempt: It.
        summary: Of its flights.
        extra: Its margin beside the samples' deviations, or beside that of the settings [m].
        passes: Whether its violations pass the binomial test.
        missing: Clearance that is missing to the first sample that must not violate a constraint [m].
        deviations: shape (K, n, 2) [m], of the flights from the predicted one.
    """

    attempt: Attempt
    summary: MonteCarloSummary
    extra: float
    passes: bool
    missing: float
    deviations: Array


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
    currents, whole = currents_around(flow, samples), mission_task(flow, request)
    attempts = solve_attempts(whole)
    if not attempts:
        return to_plan(whole, []), MonteCarloSummary(0.0, 0.0, float("nan"), float("nan"), {})
    first, trials, extra = best_of(whole, attempts), list[_Trial](), 0.0
    if not first.yo_depths:
        last = float(first.miss[-1])
        return to_plan(whole, attempts), MonteCarloSummary(1.0, 1.0, last, last, {})
    task, attempt = aimed_at(whole, first)
    tried = partial(_try, task, currents, allowed, pilot)
    for _ in range(_PLANS):
        trials.append(tried(attempt, extra))
        if trials[-1].passes or task.is_late:
            break
        if len(trials) > 1:
            extra += max(_GROWTH * trials[-1].missing, _LEAST)
        attempt = _widen_margin(
            task, attempt, SafetyMargin(trials[-1].deviations, 1.0 - allowed, extra)
        )
    met = [is_feasible(task, trial.attempt) for trial in trials]
    if (
        met[0]
        and not all(met)
        and not any(
            met[k] and 1.0 - trial.summary.safe <= allowed + 1e-9 for k, trial in enumerate(trials)
        )
    ):
        # half-planes hold a way that is near to one without a margin: a wider way round may still lead to the goal
        trials += _wider_ways(task, trials[0].missing, tried)
    # a plan that reaches its goal comes before one that does not; then one that passes the test, or else the safest
    best = max(
        trials,
        key=lambda trial: (is_feasible(task, trial.attempt), trial.passes, trial.summary.safe),
    )
    found = (
        best.attempt
        if first.kept is None
        else replace(to_all(whole, first.kept, best.attempt), beyond=first.beyond)
    )
    plan = to_plan(whole, [found])
    counts = {
        "margins_tried": len(trials),
        "attempts": len(attempts) + len(trials) - 1,
        "extra_margin_m": best.extra,
    }
    summary = replace(best.summary, reached=0.0) if first.beyond else best.summary
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
    legs = replace(attempt.legs, depths=task.depths(attempt.yo_depths))
    predicted = predict(task, legs)
    flight = fly_samples(task, currents, legs, predicted, pilot)
    met = points_at(predicted, attempt.flight.time[attempt.goals.points(attempt.flight)])
    summary, clear = summarise_flights(task, flight, met)
    passes = passes_binomial_test(int(np.sum(clear <= 0.0)), len(clear), allowed)
    missing = float(np.sort(-clear)[::-1][most_violations_allowed(len(clear), allowed)])
    return _Trial(
        attempt, summary, extra, passes, missing, flight.place[:, 1:] - predicted.place[:, 1:]
    )


def _wider_ways(
    task: MissionTask, missing: float, tried: Callable[[Attempt, float], _Trial]
) -> list[_Trial]:
    """Return the trials of plans made anew with wider margins, until one passes; where the way is closed, with narrower ones again."""
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
        if task.is_late or (trials and trials[-1].passes):
            break
    return trials


def fly_scenarios(
    flow: Flow,
    samples: Sequence[Sample],
    plan: MissionPlan,
    *,
    pilot: Pilot | None = None,
    no_go: tuple[NoGo, ...] = (),
    bathymetry: Bathymetry | None = None,
) -> MonteCarloSummary:
    """Return the summary of a mission flown in samples of the current.

    Args:
        flow: The estimate, or estimates for increasing times: what a pilot knows of the current.
        samples: As for ``plan_scenarios``.
        plan: The mission.
        pilot: Who corrects it at each surfacing; None when its headings are held whatever the current.
        no_go: Areas that must not be entered.
        bathymetry: Bottom depth.

    Raises:
        PlanError: The mission has no legs, it does not fit the flow, or the samples are not on the nodes of the estimate.
    """
    legs = legs_of_plan(plan, flow if isinstance(flow, FlowEstimate) else flow[0], 1)
    task = mission_task(
        flow,
        MissionRequest(
            plan.start,
            plan.goals,
            plan.vehicle,
            plan.settings,
            no_go,
            bathymetry,
            plan.start_time_ns,
        ),
    )
    predicted = predict(task, legs)
    flight = fly_samples(task, currents_around(flow, samples), legs, predicted, pilot)
    return summarise_flights(task, flight, points_at(predicted, plan.goal_times))[0]


def passes_binomial_test(violations: int, count: int, allowed: float) -> bool:
    """Return whether so few violations among some samples make it unlikely that more than the allowed share of all would violate.

    No violation always passes.
    """
    return violations == 0 or float(bdtr(violations, count, allowed)) <= _SIGNIFICANCE


def most_violations_allowed(count: int, allowed: float) -> int:
    """Return the largest number of violations among ``count`` samples that passes the binomial test."""
    return max(number for number in range(count) if passes_binomial_test(number, count, allowed))


def points_at(predicted: Flight, times: Array) -> NDArray[np.intp]:
    """Return the numbers of a flight's points at some times, shape (G,) [s]; all flights of the same legs have the same points."""
    return np.asarray(np.argmin(np.abs(predicted.time - times[:, None]), axis=1))


def summarise_flights(
    task: MissionTask, flight: Flight, points: NDArray[np.intp]
) -> tuple[MonteCarloSummary, Array]:
    """Return the summary of K flights and the least clearance of each [m], shape (K,): 0 or less where it violates a constraint.

    Args:
        task: The problem.
        flight: The flights.
        points: shape (G,), numbers of their points at which the goals are to be met.
    """
    miss = np.linalg.norm(flight.place[:, points] - task.goals[:, :2], axis=2)
    by_name = clearances(task, flight)
    clear = np.min(list(by_name.values()), axis=0)
    violations = {
        name: float(np.mean(one <= 0.0)) for name, one in by_name.items() if np.any(one <= 0.0)
    }
    median, ninety = (float(np.quantile(miss[:, -1], share)) for share in (0.5, 0.9))
    reached = float(np.mean(np.all(miss <= task.settings.tolerance, axis=1)))
    return MonteCarloSummary(
        reached, float(np.mean(clear > 0.0)), median, ninety, violations
    ), clear


def predict(task: MissionTask, legs: Legs) -> Flight:
    """Return the flight of legs in the estimate."""
    return fly_legs(task.currents, task.vehicle, task.start[:2], legs, task.start_time)


def fly_samples(
    task: MissionTask, currents: Currents, legs: Legs, predicted: Flight, pilot: Pilot | None
) -> Flight:
    """Return the flights of legs in K currents, by the midpoint method; a pilot leads them where the prediction goes."""
    known, met = (one.since(task.request.start_time_ns) for one in (task.currents, currents))
    if pilot is None:
        return fly_legs(met, task.vehicle, task.start[:2], legs, 0.0, fly_midpoints)
    return fly_corrected(known, met, task.vehicle, predicted, legs, pilot).flight


def currents_around(flow: Flow, samples: Sequence[Sample]) -> Currents:
    """Return the samples' currents, all on the nodes of the estimate.

    Samples that change are flown as they are. Where the estimate changes and they do not, they change as it does: what they differ by
    from its first time persists.
    """
    if not samples:
        raise PlanError(
            "a plan for samples of the estimate needs some; draw them with flow.sample(20, seed)"
        )
    return with_courses(_flows_around(flow, flows_of(samples)), samples)


def _flows_around(flow: Flow, samples: Sequence[Flow]) -> Currents:
    first = flow if isinstance(flow, FlowEstimate) else flow[0]
    if not isinstance(samples[0], FlowEstimate):
        changing = currents_of_samples(samples)
        if graph_key(changing.flow) != graph_key(first):
            raise PlanError(
                "the samples are not on the nodes, levels, kernel and depth functions of the estimate; draw them from it"
            )
        return changing
    both = currents_of_samples([first, *samples])
    if isinstance(flow, FlowEstimate):
        return replace(both, latent=both.latent[1:])
    known = currents_of(flow)
    return replace(
        known, latent=known.latent + np.tile(both.latent[1:] - both.latent[:1], (1, 1, len(flow)))
    )


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
        found = min(found, more, key=lambda one: (not is_feasible(task, one), one.plane_violation))
    return found


def with_n_legs(task: MissionTask, attempt: Attempt, n_legs: int) -> Attempt:
    """Return an attempt whose guess has ``n_legs`` legs of equal time along the same path."""
    flight, duration = attempt.flight, float(attempt.flight.time[-1])
    at = duration * np.arange(1, n_legs + 1) / n_legs
    places = np.column_stack([np.interp(at, flight.time, flight.place[0, :, i]) for i in (0, 1)])
    headings = np.interp(
        at - 0.5 * at[0], flight.time, np.unwrap(attempt.legs.headings)[flight.leg]
    )
    passed = flight.time[attempt.goals.points(flight)]
    # a leg over several turns as high as the highest of their dives
    ends, turns = flight.time[flight.ends], np.array(turns_of(attempt.yo_depths))
    first, last = (
        np.searchsorted(ends, at - at[0], side="right"),
        np.minimum(np.searchsorted(ends, at), len(ends) - 1),
    )
    limited = replace(
        task,
        turns=tuple(
            float(turns[begin : end + 1].min()) for begin, end in zip(first, last, strict=True)
        ),
    )
    goals = goal_steps_of(limited, passed, goal_legs_of(passed, n_legs))
    return replace(
        attempt,
        yo_depths=limited.yo_depths(n_legs),
        guess=MissionGuess(places, headings, np.full(n_legs, task.angle_of(at[0]))),
        goals=goals,
    )
