"""How likely a mission arrives: flown in samples of the estimate, with headings corrected at each surfacing and with headings held."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planners.mission.flight.currents import Flow, Sample
from planners.mission.flight.legs import Flight
from planners.mission.flight.pilot import Pilot
from planners.mission.flights import (
    MissionFlights,
    MonteCarloSummary,
    fly_samples,
    legs_of_plan,
    points_at,
    predict,
    summarise_flights,
    surfacing_ellipses,
)
from planners.mission.flights import currents_of_estimate as currents_around
from planners.mission.task import mission_task
from planners.mission.values import MissionPlan, MissionRequest, Mooring
from planners.mission.words import arrival_text, odds_text, violations_text
from replay_kit.core.arrays import Array


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
