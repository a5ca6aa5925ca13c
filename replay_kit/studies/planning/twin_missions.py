"""Twin missions: replanned at each surfacing with the leg's measurements, and with the single plan made at the start.

A member of the ensemble that is left out is the truth. Both missions begin with the plan made on the ensemble without a measurement. One
follows it to its end; the other is replanned from each surfacing, on the estimate after the leg's profiles.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from replay_kit.config.run import RunConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import ForecastError, PlanError
from replay_kit.core.grid import Ensemble
from replay_kit.core.plan import Place
from replay_kit.core.tasks import each_call
from replay_kit.estimator import Estimator
from replay_kit.studies.jobs.progress import Advance
from replay_kit.studies.missions.scene import own_estimator, withhold
from replay_kit.studies.planning.job import PlanningJob
from replay_kit.studies.planning.legs import (
    Leg,
    PlannedLegs,
    distance_to,
    fly_leg,
    measured,
    plan_legs,
)
from replay_kit.studies.twins.field import Field, build_field
from replay_kit.studies.twins.reachable import place_at
from replay_kit.studies.twins.vehicle import EPOCH_NS, NS_PER_S, Track, random_places
from replay_kit.workflows.planning import MissionPlanner
from replay_kit.workflows.replay.build import flow_at

#: A replanned mission ends this near to its goal [m].
TOLERANCE = 250.0
# Least and greatest glide angle [degrees] of the missions drawn, and their speed through water [m/s].
_ANGLES, _SPEED = (15.0, 35.0), 0.3
# A mission drawn keeps this far from the edge of the truth's water [m], so that plans may err without leaving it.
_MARGIN = 5_000.0
# Legs of a mission drawn turn from its course by no more than this [degrees].
_TURNS = 60.0
_MAX_DRAWS = 200


@dataclass(frozen=True, slots=True)
class Outcome:
    """The outcome of a mission.

    Attributes:
        miss: Between the goal and the last surfacing [m].
        closest: Between the goal and the surfacing, or the start, nearest to it [m].
        duration: To the last surfacing [s].
        legs: Flown.
        ended: Why no further leg was flown: ``arrived``, ``plan ended``, ``legs used up``, or the reason in words.
    """

    miss: float
    closest: float
    duration: float
    legs: int
    ended: str


@dataclass(frozen=True, slots=True)
class ReplanRow:
    """One twin mission.

    Attributes:
        member: The truth, position from 0.
        seed: Of its start, goal and noise.
        distance: Between start and goal [m].
        truth_duration: Of the mission drawn, which reaches the goal in the truth [s].
        single: With the single plan made at the start.
        replanned: With a new plan at each surfacing.
        prediction_errors: Between each leg's predicted surfacing and the actual one, of the replanned mission [m].
    """

    member: int
    seed: int
    distance: float
    truth_duration: float
    single: Outcome
    replanned: Outcome
    prediction_errors: tuple[float, ...]

    @property
    def ratio(self) -> float:
        """Miss distance of the replanned mission over that with the single plan."""
        return self.replanned.miss / self.single.miss


@dataclass(frozen=True, slots=True, eq=False)
class _Way:
    """A glider on its way to a goal in a truth.

    Attributes:
        field: The truth.
        goal: Where it should surface last.
        start_ns: When the mission began [ns, UTC].
        place: shape (2,) [m], where it is at the surface, local east and north.
        time_ns: Now [ns, UTC].
        misses: Distances from the goal [m], at the start and at each surfacing.
    """

    field: Field
    goal: Place
    start_ns: int
    place: Array
    time_ns: int
    misses: tuple[float, ...]

    def fly(self, leg: Leg) -> tuple[Track, "_Way"]:
        """Return a leg flown from here, and the way after it.

        Raises:
            ForecastError: The current carried the glider out of the truth's water.
        """
        flight = fly_leg(self.field, self.place, self.time_ns, leg)
        place = flight.place[-1]
        misses = (*self.misses, distance_to(self.field, place, self.goal))
        return flight, replace(self, place=place, time_ns=flight.end_ns, misses=misses)

    def outcome(self, ended: str) -> Outcome:
        """Return the outcome of a mission that ends here."""
        return Outcome(
            self.misses[-1],
            min(self.misses),
            (self.time_ns - self.start_ns) / NS_PER_S,
            len(self.misses) - 1,
            ended,
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Twin:
    """What missions in one truth are replanned with: estimator, job, planner, and the random generator of the noise."""

    # Any: each kind of estimator has a state of its own
    estimator: Estimator[Any]
    job: PlanningJob
    planner: MissionPlanner
    rng: np.random.Generator

    def plan(
        self, state: Any, way: _Way, most_legs: int, warm: PlannedLegs | None = None
    ) -> PlannedLegs:
        """Return the plan on an estimate from where a glider is."""
        places = place_at(way.field.grid, way.place), way.goal
        return plan_legs(
            self.planner,
            flow_at(self.estimator, state, way.time_ns),
            places,
            way.time_ns,
            most_legs,
            warm,
        )


def run_replanning(
    series: Sequence[Ensemble],
    config: RunConfig,
    job: PlanningJob,
    members: Sequence[int],
    planner: MissionPlanner,
    advance: Advance,
) -> tuple[ReplanRow, ...]:
    """Return the twin missions.

    Args:
        series: The forecast at its times, in order; one alone may have no time, and the truth then stays as it is.
        config: Settings of the estimator.
        job: How many missions, of how many legs, to which depth.
        members: Positions of the members that are the truth, in turn.
        planner: Plans the missions.
        advance: Counts missions as steps.

    Raises:
        ConfigError: A member does not exist.
        ForecastError: No mission that stays in the truth's water was found.
        PlanError: The planner cannot plan at a mission's start.
    """
    chosen, rows = [members[k % len(members)] for k in range(job.replans)], []
    calls = (
        (series, (config, job, planner), member, job.seed + k) for k, member in enumerate(chosen)
    )
    for k, row in enumerate(each_call(_replanned, calls)):
        rows.append(row)
        advance(f"replanning, mission {k}, member {row.member}")
    return tuple(rows)


def _replanned(
    series: Sequence[Ensemble],
    options: tuple[RunConfig, PlanningJob, MissionPlanner],
    member: int,
    seed: int,
) -> ReplanRow:
    """Return one twin mission."""
    config, job, planner = options
    case = withhold(series, member)
    field, rng = build_field(*case.truths), np.random.default_rng((seed, member))
    twin = _Twin(own_estimator(case, config), job, planner, rng)
    # in a sea that changes it begins in the middle of the forecast, which errs by then, and goes on long enough
    start_ns = (int(field.time_ns[0]) + int(field.time_ns[-1])) // 2 or EPOCH_NS
    start, goal, truth_duration = _drawn(field, job, start_ns, rng)
    way = _Way(field, goal, start_ns, start, start_ns, (distance_to(field, start, goal),))
    first = twin.plan(twin.estimator.initial(), way, job.most_legs)
    replanned, errors = _fly_replanned(twin, way, first)
    return ReplanRow(
        member, seed, way.misses[0], truth_duration, _fly_single(way, first), replanned, errors
    )


def _fly_single(way: _Way, planned: PlannedLegs) -> Outcome:
    """Return the outcome of a plan followed to its end; a glider that leaves the truth's water ends where it surfaced last."""
    for leg in planned.legs:
        try:
            way = way.fly(leg)[1]
        except ForecastError as error:
            return way.outcome(str(error))
    return way.outcome("plan ended")


def _fly_replanned(
    twin: _Twin, way: _Way, planned: PlannedLegs
) -> tuple[Outcome, tuple[float, ...]]:
    """Return the outcome of replanning at each surfacing, and the error of each leg's predicted end [m].

    The mission ends at the goal, or where its legs are used up, or where no plan leads any nearer to the goal.
    """
    state, errors = twin.estimator.initial(), list[float]()
    while len(errors) < twin.job.most_legs:
        if not planned.legs or (errors and planned.miss >= way.misses[-1]):
            return way.outcome("no plan leads nearer"), tuple(errors)
        try:
            flight, way = way.fly(planned.legs[0])
            errors.append(distance_to(way.field, way.place, planned.ends[0]))
            if way.misses[-1] <= TOLERANCE:
                return way.outcome("arrived"), tuple(errors)
            for step in twin.estimator.steps(
                state, measured(way.field, flight, twin.job.noise, twin.rng)
            ):
                state = step[0]
            planned = twin.plan(state, way, max(1, twin.job.most_legs - len(errors)), planned)
        except (ForecastError, PlanError) as error:
            return way.outcome(str(error)), tuple(errors)
    return way.outcome("legs used up"), tuple(errors)


def _drawn(
    field: Field, job: PlanningJob, start_ns: int, rng: np.random.Generator
) -> tuple[Array, Place, float]:
    """Return a start, shape (2,) [m], a goal, and the time [s] from one to the other in the truth, leg by leg at random headings."""
    depth = min(job.depth, float(field.grid.levels[-1]))
    for _ in range(_MAX_DRAWS):
        place, now = random_places(field, 1, rng)[0], start_ns
        start, course = place, rng.uniform(0.0, 360.0)
        try:
            _require_room(field, start)
            for _ in range(job.legs):
                angle = np.deg2rad(rng.uniform(*_ANGLES))
                speeds = _SPEED * float(np.cos(angle)), _SPEED * float(np.sin(angle))
                flight = fly_leg(
                    field,
                    place,
                    now,
                    Leg(course + rng.uniform(-_TURNS, _TURNS), *speeds, (0.0, depth, 0.0)),
                )
                place, now = flight.place[-1], flight.end_ns
                _require_room(field, place)
        except ForecastError:
            continue
        return start, place_at(field.grid, place), (now - start_ns) / NS_PER_S
    raise ForecastError(
        f"{field.grid.projection}: found no mission of {job.legs} legs that stays in the truth's water; use a larger region"
    )


def _require_room(field: Field, place: Array) -> None:
    """Raise ForecastError when there is no water on all sides."""
    around = place + _MARGIN * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    if not np.isfinite(field.velocity(around[:, 0], around[:, 1], 0.0, field.time_ns[0])).all():
        raise ForecastError("too near to the edge of the truth's water")
