"""A mission that keeps clear of what is forbidden in most samples of what an estimate does not know, not in the estimate alone.

Headings that are held whatever comes cannot make the spread of where they lead smaller: what a plan can do is to keep farther away,
place by place by what the samples deviate there. A pilot who corrects the mission at each surfacing makes the spread itself smaller.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtr

from planners.mission.check import clearances
from planners.mission.feedback import Pilot, fly_corrected
from planners.mission.flight import Currents, Flight, Legs, currents_of_samples, fly_legs
from planners.mission.flights import legs_of_plan
from planners.mission.plan import attempts_of, goal_legs_of, goal_steps_of
from planners.mission.program import MissionGuess
from planners.mission.result import failed_plan, to_plan
from planners.mission.safety_margin import Spread
from planners.mission.solve import Attempt, safe_and_met, solve_clear, worth
from planners.mission.task import MissionTask, mission_task
from planners.mission.values import MissionPlan, MissionSettings
from planners.route.hazards import Bathymetry, NoGo
from planners.vehicle import Glider
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.plan import Place

_VEHICLE, _SETTINGS = Glider(), MissionSettings()
# Most margins tried, by how much more than the samples fall short they are widened, and by how much at least [m].
_PLANS, _MORE, _LEAST = 4, 1.15, 50.0
# A plan is good enough when so few samples trespass as would by this chance at most if more than the allowed share of all did.
_BY_CHANCE = 0.15
# Legs more than before that are tried where a wider margin leaves the goal out of reach.
_LONGER = 2
# A margin kept this well is kept [m].
_KEPT = 5.0


@dataclass(frozen=True, slots=True)
class Chances:
    """What comes of a mission in samples of the current.

    Attributes:
        reached: Share that meets every goal within the tolerance.
        safe: Share that goes nowhere that it may not.
        miss_median: Of the last goal [m].
        miss_90_percent: Nine of ten miss the last goal by less [m].
        trespass: Share that goes where it may not, by the name of what it enters; what none enters is not in it.
    """

    reached: float
    safe: float
    miss_median: float
    miss_90_percent: float
    trespass: Mapping[str, float]


_NONE = Chances(0.0, 0.0, float("nan"), float("nan"), {})


def plan_scenarios(
    flow: FlowEstimate,
    samples: Sequence[FlowEstimate],
    start: Place,
    goals: Place | tuple[Place, ...],
    *,
    allowed: float = 0.1,
    pilot: Pilot | None = None,
    vehicle: Glider = _VEHICLE,
    settings: MissionSettings = _SETTINGS,
    no_go: tuple[NoGo, ...] = (),
    bathymetry: Bathymetry | None = None,
    start_time_ns: int = 0,
) -> tuple[MissionPlan, Chances]:
    """Return the mission planned on the estimate with the margins that keep the samples clear, and what comes of it in them.

    When no margin tried keeps enough of them clear, the plan that keeps most is returned: ``Chances.safe`` says how many.

    Args:
        flow: The estimate.
        samples: Flows on its nodes, as ``flow.sample`` draws them: some twenty or more.
        start: As for ``plan_mission``, as are the others.
        goals: Where it should go.
        allowed: Share of the samples that may trespass.
        pilot: Who corrects the mission at each surfacing; None when its headings are held whatever comes.
        vehicle: What glides.
        settings: How; its margin is the least one.
        no_go: Areas that are not to be entered.
        bathymetry: Depth of the bottom.
        start_time_ns: When it begins [ns, UTC].

    Raises:
        PlanError: As for ``plan_mission``; or there are no samples, or they are not on the nodes of the estimate.
    """
    asked, currents = goals if isinstance(goals, tuple) else (goals,), _currents_of(flow, samples)
    task = mission_task(flow, (start, asked), vehicle, settings, (no_go, bathymetry), start_time_ns)
    attempts = attempts_of(task, None, start_time_ns)
    if not attempts:
        return failed_plan(task, start, asked, start_time_ns, "the current is not a number; check the estimate's latent velocities"), _NONE
    attempt, tried = min(attempts, key=lambda one: worth(task, one)), list[tuple[Attempt, Chances, float, bool]]()
    more = 0.0
    for _ in range(_PLANS):
        legs = replace(attempt.legs, depths=task.depths(task.turns(len(attempt.legs.headings))))
        flight, predicted = flights_of(task, currents, legs, pilot)
        chances, clear = chances_of(task, flight, points_at(predicted, attempt.flight.time[attempt.goals.points(attempt.flight)]))
        kept = few_enough(int(np.sum(clear <= 0.0)), len(clear), allowed)
        tried.append((attempt, chances, more, kept))
        if kept:
            break
        if len(tried) > 1:
            # so many that one trespasses which should not
            short = np.sort(-clear)[::-1][most_enough(len(clear), allowed)]
            more += max(_MORE * float(short), _LEAST)
        attempt = _wider(task, attempt, Spread(flight.place[:, 1:] - predicted.place[:, 1:], 1.0 - allowed, more))
    # a plan that is sure to hold what is allowed is the best, or else the safest; only the last one tried can be sure
    best = max(tried, key=lambda one: (one[3], one[1].safe, safe_and_met(task, one[0])))
    plan = to_plan(task, start, asked, start_time_ns, [best[0]])
    counts = {"margins_tried": len(tried), "attempts": len(attempts) + len(tried) - 1, "margin_beside_spread_m": best[2]}
    return replace(plan, statistics={**plan.statistics, **counts}), best[1]


def fly_scenarios(
    flow: FlowEstimate,
    samples: Sequence[FlowEstimate],
    plan: MissionPlan,
    *,
    pilot: Pilot | None = None,
    no_go: tuple[NoGo, ...] = (),
    bathymetry: Bathymetry | None = None,
) -> Chances:
    """Return what comes of a mission in samples of the current.

    Args:
        flow: The estimate: what a pilot knows of the current.
        samples: Flows on its nodes.
        plan: The mission.
        pilot: Who corrects it at each surfacing; None when its headings are held whatever comes.
        no_go: Areas that are not to be entered.
        bathymetry: Depth of the bottom.

    Raises:
        PlanError: The mission has no legs, it does not fit the flow, or the samples are not on the nodes of the estimate.
    """
    legs = legs_of_plan(plan, flow, 1)
    task = mission_task(flow, (plan.start, plan.goals), plan.vehicle, plan.settings, (no_go, bathymetry), plan.start_time_ns)
    flight, predicted = flights_of(task, _currents_of(flow, samples), legs, pilot)
    return chances_of(task, flight, points_at(predicted, plan.goal_times))[0]


def few_enough(trespassing: int, count: int, allowed: float) -> bool:
    """Return whether so few of some samples trespass that hardly more than the allowed share of all does; none is always few enough."""
    return trespassing == 0 or float(bdtr(trespassing, count, allowed)) <= _BY_CHANCE


def most_enough(count: int, allowed: float) -> int:
    """Return the largest number of samples that may trespass; see ``few_enough``."""
    return max(number for number in range(count) if few_enough(number, count, allowed))


def points_at(predicted: Flight, times: Array) -> NDArray[np.intp]:
    """Return the numbers of a flight's points at some times, shape (G,) [s]; all flights of the same legs have the same points."""
    return np.asarray(np.argmin(np.abs(predicted.time - times[:, None]), axis=1))


def chances_of(task: MissionTask, flight: Flight, points: NDArray[np.intp]) -> tuple[Chances, Array]:
    """Return what comes of K flights, and how far each keeps clear of everything [m], shape (K,): not above 0 where it trespasses.

    Args:
        task: The problem.
        flight: The flights.
        points: shape (G,), numbers of their points at which the goals are to be met.
    """
    miss = np.linalg.norm(flight.place[:, points] - task.goals[:, :2], axis=2)
    by_name = clearances(task, flight)
    clear = np.min(list(by_name.values()), axis=0)
    trespass = {name: float(np.mean(one <= 0.0)) for name, one in by_name.items() if np.any(one <= 0.0)}
    median, ninety = (float(np.quantile(miss[:, -1], share)) for share in (0.5, 0.9))
    reached = float(np.mean(np.all(miss <= task.settings.tolerance, axis=1)))
    return Chances(reached, float(np.mean(clear > 0.0)), median, ninety, trespass), clear


def flights_of(task: MissionTask, currents: Currents, legs: Legs, pilot: Pilot | None) -> tuple[Flight, Flight]:
    """Return the flights of legs in K currents, and the predicted one."""
    predicted = fly_legs(task.currents, task.vehicle, task.start[:2], legs, task.start_time)
    if pilot is None:
        flight = fly_legs(currents, task.vehicle, task.start[:2], legs)
    else:
        targets = predicted.place[0, predicted.ends]
        flight = fly_corrected(task.currents, currents, task.vehicle, task.start[:2], legs, targets, pilot).flight
    return flight, predicted


def _currents_of(flow: FlowEstimate, samples: Sequence[FlowEstimate]) -> Currents:
    """Return the samples' currents, all on the nodes of the estimate."""
    if not samples:
        raise PlanError("a plan for samples of the estimate needs some; draw them with flow.sample(20, seed)")
    both = currents_of_samples([flow, *samples])
    return replace(both, latent=both.latent[1:])


def _wider(task: MissionTask, before: Attempt, spread: Spread) -> Attempt:
    """Return the attempt kept clear by wider margins; with more legs where the goal is out of reach otherwise."""
    found = solve_clear(task, before, spread)
    n_legs = len(before.legs.headings)
    for longer in range(n_legs + 1, min(n_legs + _LONGER, task.settings.max_legs) + 1):
        if (safe_and_met(task, found) and found.trespass < _KEPT) or task.settings.legs is not None:
            break
        more = solve_clear(task, _cut_anew(task, before, longer), spread)
        found = min(found, more, key=lambda one: (not safe_and_met(task, one), one.trespass))
    return found


def _cut_anew(task: MissionTask, attempt: Attempt, n_legs: int) -> Attempt:
    """Return an attempt whose guess has so many legs of equal time along the same path."""
    flight, lasts = attempt.flight, float(attempt.flight.time[-1])
    at = lasts * np.arange(1, n_legs + 1) / n_legs
    places = np.column_stack([np.interp(at, flight.time, flight.place[0, :, i]) for i in (0, 1)])
    headings = np.interp(at - 0.5 * at[0], flight.time, np.unwrap(attempt.legs.headings)[flight.leg])
    candidates = np.linspace(*task.vehicle.angles, 64)
    lasting = np.array([task.leg_time(float(angle)) for angle in candidates])
    angles = np.full(n_legs, candidates[np.argmin(np.abs(lasting - at[0]))])
    passed = flight.time[attempt.goals.points(flight)]
    goals = goal_steps_of(task, passed, goal_legs_of(passed, n_legs))
    return replace(attempt, guess=MissionGuess(places, headings, angles), goals=goals)
