"""How likely a mission arrives, in samples of the estimate; and a mission for the odds, with more legs than the quickest has.

It is flown with headings corrected at each surfacing and with headings held.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from planners.mission.flight.legs import Flight
from planners.mission.flight.pilot import Pilot
from planners.mission.flights import (
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
from planners.mission.flights import currents_of_estimate as currents_around
from planners.mission.plan import to_plan
from planners.mission.search.search import solve_attempts
from planners.mission.solve.attempt import Attempt, best_of, is_feasible
from planners.mission.solve.goals import aimed_at, to_all, with_n_legs
from planners.mission.solve.legs import solve_legs
from planners.mission.task import MissionTask, mission_task, turns_of
from planners.mission.words import arrival_text, odds_text, violations_text
from planners.request import MissionPlan, MissionRequest, Mooring
from planners.simulation.currents import Currents, Flow, Sample
from replay_kit.core.arrays import Array
from replay_kit.core.progress import announce


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
    mooring: Mooring | None = None,
) -> MissionOdds:
    """Return the odds of a mission.

    Args:
        flow: The estimate, or estimates for increasing times: what the pilot knows of the current.
        samples: Three or more on its nodes, as for ``plan_scenarios``: those that change are flown as they are, what others differ by from
            the first estimate persists.
        plan: The mission.
        request: What it was planned for.
        mooring: That it stays near; it counts as reached where the flight does.

    Raises:
        PlanError: The mission has no legs, or there are too few samples.
    """
    task = mission_task(flow, replace(request, settings=plan.settings))
    legs = legs_of_plan(plan, task.flow, 1)
    currents = currents_around(flow, samples)
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
        flight.time,
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


# Legs more than the quickest mission's that are tried in turn, as shares of its number, and how many are one at least.
_MORE = 0.1, 0.2, 0.35, 0.5, 0.75, 1.0
# Candidates in turn that are no better before the search ends.
_PATIENCE = 2
# Share of the samples that more must arrive for a longer mission to be better than a shorter one.
_CLEARLY = 0.04


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A mission flown in samples.

    Attributes:
        attempt: It.
        summary: Of its flights.
        clear: shape (K,), the least clearance of each [m]: 0 or less where it violates a constraint.
        deviations: shape (K, n, 2) [m], of the flights from the predicted one.
    """

    attempt: Attempt
    summary: MonteCarloSummary
    clear: Array
    deviations: Array


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
    currents, whole = currents_of_estimate(flow, samples), mission_task(flow, request)
    attempts = solve_attempts(whole)
    if not attempts:
        return to_plan(whole, attempts)
    first = best_of(whole, attempts)
    if not first.yo_depths or not is_feasible(whole, first) or request.settings.legs is not None:
        return to_plan(whole, attempts)
    task, attempt = aimed_at(whole, first)
    steered = pilot or Pilot()
    best = quickest = judged(task, currents, steered, attempt)
    worse = tried = 0
    for longer in with_more_legs(task, attempt):
        trial, tried = judged(task, currents, steered, longer), tried + 1
        gain = trial.summary.succeeded - best.summary.succeeded
        if gain > _CLEARLY:
            best, worse = trial, 0
        else:
            worse += 1
        if worse == _PATIENCE or best.summary.succeeded == 1.0 or task.is_late:
            break
    plan = to_plan(whole, [as_whole(whole, first, best.attempt)])
    more = {
        "attempts": len(attempts) + tried,
        "odds_costs_h": (plan.duration - float(quickest.attempt.flight.time[-1])) / 3600.0,
    }
    return replace(plan, statistics={**plan.statistics, **more})


def with_more_legs(task: MissionTask, attempt: Attempt) -> Iterator[Attempt]:
    """Yield the missions along the way of an attempt with more and more legs that meet the goals in time."""
    n_legs, before = len(attempt.legs.headings), attempt
    counts = {n_legs + max(int(np.ceil(share * n_legs)), k + 1) for k, share in enumerate(_MORE)}
    for count in sorted(counts):
        if count > task.settings.most_legs:
            return
        announce(f"planning for the odds: {count} legs")
        longer = with_n_legs(task, before, count)
        turns = turns_of(longer.yo_depths)
        shaped = task if set(turns) == {task.settings.depth} else replace(task, turns=turns)
        found = solve_legs(shaped, longer.guess, longer.goals, None)
        if is_feasible(task, found) and found.flight.time[-1] <= task.settings.max_duration:
            before = found
            yield found


def judged(task: MissionTask, currents: Currents, pilot: Pilot | None, attempt: Attempt) -> Trial:
    """Return a mission flown in the samples."""
    legs = replace(attempt.legs, depths=task.depths(attempt.yo_depths))
    predicted = predict(task, legs)
    flight = fly_samples(task, currents, legs, predicted, pilot)
    met = points_at(predicted, attempt.flight.time[attempt.goals.points(attempt.flight)])
    summary, clear = summarise_flights(task, flight, met)
    return Trial(attempt, summary, clear, flight.place[:, 1:] - predicted.place[:, 1:])


def as_whole(whole: MissionTask, first: Attempt, found: Attempt) -> Attempt:
    """Return an attempt to the goals that a first one leads to as one to all, with what the first knows of those out of reach."""
    return (
        found
        if first.kept is None
        else replace(to_all(whole, first.kept, found), beyond=first.beyond)
    )
