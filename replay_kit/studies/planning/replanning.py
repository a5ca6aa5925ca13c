"""Replanning at each surfacing, with what was measured on the way, against the plan made once at the start: twin missions.

A member of the ensemble that is left out is the truth. Both missions begin with the plan made on what the ensemble knows without a
measurement. One is flown blind to its end; the other is planned anew from each surfacing, on the estimate after the leg's profiles.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from replay_kit.config.run import RunConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import ForecastError, PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Ensemble
from replay_kit.core.plan import Place
from replay_kit.studies.missions.scene import own_estimator
from replay_kit.studies.missions.sea import withhold
from replay_kit.studies.planning.legs import Leg, distance_to, fly_leg, measured, place_at
from replay_kit.studies.planning.replan_rows import Flown, ReplanJob, ReplanRow
from replay_kit.studies.twins.field import Field, build_field
from replay_kit.studies.twins.vehicle import EPOCH_NS, random_places
from replay_kit.workflows.replay.build import flow_at

# A mission drawn keeps so far from the edge of the truth's water [m], as a plan has to be able to err.
_MARGIN = 5_000.0
# Legs of a mission drawn turn from its course by no more than this [degrees].
_TURNS = 60.0
_MAX_DRAWS = 200
_NS = 1_000_000_000


@dataclass(frozen=True, slots=True, eq=False)
class PlannedLegs:
    """A mission as this study needs it.

    Attributes:
        legs: What the glider is told, surfacing after surfacing.
        ends: Where each leg is predicted to end.
        miss: Predicted between the goal and the last of them [m].
        memory: What the planner wants back with the next question.
    """

    legs: tuple[Leg, ...]
    ends: tuple[Place, ...]
    miss: float
    memory: Any


class PlanLegs(Protocol):
    """Plans a mission; the command line hands one in."""

    def __call__(
        self, flow: FlowEstimate, start: Place, goal: Place, start_time_ns: int, warm: PlannedLegs | None, most_legs: int
    ) -> PlannedLegs:
        """Return the best mission found of no more than so many legs.

        Raises:
            PlanError: The start or the goal is outside of the region or on land.
        """
        ...


def run_replanning(
    series: Sequence[Ensemble], config: RunConfig, job: ReplanJob, plan: PlanLegs, advance: Callable[[int, int, str], None] | None = None
) -> tuple[ReplanRow, ...]:
    """Return the twin missions.

    Args:
        series: The forecast at its times, in order; one alone may have no time, and the truth then stays as it is.
        config: Settings of the estimator.
        job: Which missions.
        plan: The planner.
        advance: Called with missions done, missions in all, and what is being run.

    Raises:
        ConfigError: An option is wrong.
        ForecastError: No mission that stays in the truth's water was found.
        PlanError: The planner cannot plan at a mission's start.
    """
    job.check()
    n_members, rows = series[0].n_members, list[ReplanRow]()
    members = job.members or [k * n_members // min(job.missions, n_members) for k in range(min(job.missions, n_members))]
    for k in range(job.missions):
        member = members[k % len(members)]
        if advance is not None:
            advance(k, job.missions, f"mission {k}, member {member}")
        rows.append(_mission(series, config, job, plan, member, job.seed + k))
    return tuple(rows)


def _mission(series: Sequence[Ensemble], config: RunConfig, job: ReplanJob, plan: PlanLegs, member: int, seed: int) -> ReplanRow:
    case = withhold(series, member)
    sea, estimator = build_field(*case.truths), own_estimator(case, config)
    rng = np.random.default_rng((seed, member))
    # in a sea that changes half of the forecast's time is over: it errs, and lasts
    start_ns = (int(sea.time_ns[0]) + int(sea.time_ns[-1])) // 2 or EPOCH_NS
    start, goal, truth_duration = _drawn(sea, job, start_ns, rng)
    state = estimator.initial()
    first = plan(flow_at(estimator, state, start_ns), place_at(sea, start), goal, start_ns, None, job.most_legs)
    once = _fly_once(sea, start, start_ns, goal, first)
    replanned, errors = _fly_replanned(_Twin(sea, estimator, job, plan, goal, rng), start, start_ns, first)
    return ReplanRow(member, seed, distance_to(sea, start, goal), truth_duration, once, replanned, errors)


@dataclass(frozen=True, slots=True, eq=False)
class _Twin:
    """What a mission is planned anew with: truth, estimator, job, planner, goal, and the noise's source."""

    sea: Field
    # Any: each kind of estimator has a state of its own
    estimator: Any
    job: ReplanJob
    plan: PlanLegs
    goal: Place
    rng: np.random.Generator


def _fly_once(sea: Field, start: Array, start_ns: int, goal: Place, planned: PlannedLegs) -> Flown:
    """Return what comes of a plan flown blind to its end; a glider that leaves the truth's water ends where it surfaced last."""
    place, now, ended = start, start_ns, "plan ended"
    misses = [distance_to(sea, start, goal)]
    for leg in planned.legs:
        try:
            flight = fly_leg(sea, place, now, leg)
        except ForecastError as error:
            ended = str(error)
            break
        place, now = flight.place[-1], flight.end_ns
        misses.append(distance_to(sea, place, goal))
    return Flown(misses[-1], min(misses), (now - start_ns) / _NS, len(misses) - 1, ended)


def _fly_replanned(twin: _Twin, start: Array, start_ns: int, planned: PlannedLegs) -> tuple[Flown, tuple[float, ...]]:
    """Return what comes of planning anew at each surfacing, and by how far each leg's predicted end was off.

    The mission ends at the goal, or where its legs are used up, or where no plan leads any nearer to the goal.
    """
    place, now, state, ended = start, start_ns, twin.estimator.initial(), "legs used up"
    misses, errors = [distance_to(twin.sea, start, twin.goal)], []
    while len(misses) <= twin.job.most_legs:
        if not planned.legs or (len(misses) > 1 and planned.miss >= misses[-1]):
            ended = "no plan leads nearer"
            break
        try:
            flight = fly_leg(twin.sea, place, now, planned.legs[0])
            place, now = flight.place[-1], flight.end_ns
            misses.append(distance_to(twin.sea, place, twin.goal))
            errors.append(distance_to(twin.sea, place, planned.ends[0]))
            if misses[-1] <= twin.job.tolerance:
                ended = "arrived"
                break
            for step in twin.estimator.steps(state, measured(twin.sea, flight, twin.job.noise, twin.rng)):
                state = step[0]
            left = max(1, twin.job.most_legs + 1 - len(misses))
            planned = twin.plan(flow_at(twin.estimator, state, now), place_at(twin.sea, place), twin.goal, now, planned, left)
        except (ForecastError, PlanError) as error:
            ended = str(error)
            break
    return Flown(misses[-1], min(misses), (now - start_ns) / _NS, len(misses) - 1, ended), tuple(errors)


def _drawn(sea: Field, job: ReplanJob, start_ns: int, rng: np.random.Generator) -> tuple[Array, Place, float]:
    """Return a start, shape (2,) [m], a goal, and how long [s] the truth takes from one to the other, leg by leg at random headings."""
    depth = min(job.depth, float(sea.grid.levels[-1]))
    for _ in range(_MAX_DRAWS):
        place, now = random_places(sea, 1, rng)[0], start_ns
        start, course = place, rng.uniform(0.0, 360.0)
        try:
            _require_room(sea, start)
            for _ in range(job.legs):
                angle = np.deg2rad(rng.uniform(*job.angles))
                speeds = job.speed * float(np.cos(angle)), job.speed * float(np.sin(angle))
                flight = fly_leg(sea, place, now, Leg(course + rng.uniform(-_TURNS, _TURNS), *speeds, (0.0, depth, 0.0)))
                place, now = flight.place[-1], flight.end_ns
                _require_room(sea, place)
        except ForecastError:
            continue
        return start, place_at(sea, place), (now - start_ns) / _NS
    raise ForecastError(f"{sea.grid.projection}: found no mission of {job.legs} legs that stays in the truth's water; use a larger region")


def _require_room(sea: Field, place: Array) -> None:
    """Raise ForecastError when there is no water on all sides."""
    around = place + _MARGIN * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    if not np.isfinite(sea.velocity(around[:, 0], around[:, 1], 0.0, sea.time_ns[0])).all():
        raise ForecastError("too near to the edge of the truth's water")
