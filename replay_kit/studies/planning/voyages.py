"""Missions of days in a sea that changes: one plan followed, a new plan at each surfacing, and the habit of heading at the goal.

All are flown in a truth on the planner's functions, linear between its times. A goal counts as passed where the track comes within
``PASSED`` of it, at whatever depth: a pilot does not wait for the next surfacing to be there.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf

import numpy as np

from planners import Glider, MissionPlan, MissionRequest, MissionSettings, plan_mission
from planners.mission.flights import fly_mission
from planners.mission.timing import first_legs
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import grid_bearing_of_true_north, inside_grid, to_geographic, to_local
from replay_kit.core.grid import Ensemble
from replay_kit.core.plan import Place
from replay_kit.estimator import embed_member
from replay_kit.studies.twins.vehicle import NS_PER_S
from replay_kit.workflows.planning.currents import uniform_currents

#: A goal is passed at this distance [m].
PASSED = 1_500.0
# A mission is given up after so many times the truth's earliest arrival.
_LONGEST = 1.6
# Time within which the error of a leg's mean current fades [s]: a glider is then in other water.
_FADES = 86_400.0
# Steps into which a leg's track is divided where the first passage is sought.
_FINE = 8

Sea = tuple[FlowEstimate, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Voyage:
    """How a mission went.

    Attributes:
        arrival: When the goal was passed [s]; inf where it was not.
        legs: Flown.
        closest: Least distance from the goal [m].
        plans: Made on the way.
    """

    arrival: float
    legs: int
    closest: float
    plans: int


@dataclass(frozen=True, slots=True, eq=False)
class Crossing:
    """A mission to be flown.

    Attributes:
        start: Where it begins.
        goal: Where it should go.
        start_ns: When it begins [ns, UTC].
        vehicle: The glider.
        settings: How its dives are flown.
    """

    start: Place
    goal: Place
    start_ns: int
    vehicle: Glider
    settings: MissionSettings

    def request(self, place: Place, time_ns: int) -> MissionRequest:
        """Return what is asked of the planner from a place and time on."""
        return MissionRequest(
            place, (self.goal,), self.vehicle, self.settings, start_time_ns=time_ns
        )


def sea_of(series: Sequence[Ensemble], config: EstimatorConfig) -> Sea:
    """Return the mean of an ensemble's members at each of its times as flows; of a truth, an ensemble of one, the truth."""
    # one amplitude of the kernel for all, so that truths and means share their functions
    common = config.model_copy(update={"speed": 1.0})
    means = (
        replace(one, velocity=one.velocity.mean(axis=0, keepdims=True), members=())
        for one in series
    )
    return tuple(embed_member(mean, 0, common) for mean in means)


def frozen(sea: Sea, time_ns: int) -> FlowEstimate:
    """Return the current of a time [ns, UTC], as one that does not change."""
    times = np.array([float((flow.time_ns or 0) - (sea[0].time_ns or 0)) for flow in sea])
    weights = [
        np.interp(float(time_ns - (sea[0].time_ns or 0)), times, one) for one in np.eye(len(sea))
    ]
    return replace(
        sea[0],
        latent=np.asarray(
            sum(weight * flow.latent for weight, flow in zip(weights, sea, strict=True))
        ),
        time_ns=time_ns,
    )


def follow_plan(truth: Sea, crossing: Crossing, plan: MissionPlan) -> Voyage:
    """Return how a mission goes that follows one plan to its end."""
    passed, closest, _, _ = _fly(truth, crossing, plan, 0.0)
    return Voyage(passed, len(plan.headings_deg), closest, 1)


def with_error(known: Sea, uniform: Array, error: Array, now_ns: int) -> Sea:
    """Return what is known of a current from now on, with the error of the last leg's mean current: it fades within a day.

    Args:
        known: The current at its times.
        uniform: shape (M, 2), of ``uniform_currents``.
        error: shape (2,), mean current of the leg less that predicted [m/s].
        now_ns: [ns, UTC].
    """
    fades = now_ns + round(_FADES * NS_PER_S)
    begins, later = frozen(known, now_ns), frozen(known, fades)
    begins = replace(begins, latent=begins.latent + (uniform @ error)[:, None])
    between = [flow for flow in known if now_ns < (flow.time_ns or 0) < fades]
    shares = [1.0 - ((flow.time_ns or 0) - now_ns) / (_FADES * NS_PER_S) for flow in between]
    moved = [
        replace(flow, latent=flow.latent + s * (uniform @ error)[:, None])
        for flow, s in zip(between, shares, strict=True)
    ]
    return (begins, *moved, later, *(flow for flow in known if (flow.time_ns or 0) > fades))


def replan(truth: Sea, known: Sea, crossing: Crossing, first: MissionPlan, limit: float) -> Voyage:
    """Return how a mission goes that is planned anew at each surfacing, on what is known of the current.

    The leg's end, less where it was predicted, tells by how much its mean current was wrong; the next day is planned with that error.

    Args:
        truth: What it is flown in.
        known: What is planned on.
        crossing: The mission.
        first: The plan that it begins with.
        limit: When it is given up [s].
    """
    plan, now, closest, legs, plans = first, 0.0, inf, 0, 1
    projection, uniform, error = truth[0].grid.projection, uniform_currents(known[0]), np.zeros(2)
    while len(plan.headings_deg) and now < limit:
        leg = first_legs(plan, 1, projection)
        passed, nearest, ends, place = _fly(truth, crossing, leg, now)
        closest, legs = min(closest, nearest), legs + 1
        if np.isfinite(passed):
            return Voyage(passed, legs, closest, plans)
        # the prediction had the last leg's error in it
        off = np.array(to_local(projection, place.longitude, place.latitude)) - leg.track[-1, :2]
        error, now = error + off / (ends - now), ends
        now_ns = crossing.start_ns + round(now * NS_PER_S)
        try:
            plan = plan_mission(
                with_error(known, uniform, error, now_ns),
                crossing.request(place, now_ns),
                warm=plan,
            )
        except PlanError:
            # the current has carried it to where no mission may begin
            break
        plans += 1
    return Voyage(inf, legs, closest, plans)


def head_at_goal(truth: Sea, crossing: Crossing, like: MissionPlan, limit: float) -> Voyage:
    """Return how a mission goes that heads at the goal at each surfacing, at the shallowest glide angle.

    Args:
        truth: What it is flown in.
        crossing: The mission.
        like: A mission of the same dives.
        limit: When it is given up [s].
    """
    projection, leg = truth[0].grid.projection, first_legs(like, 1, truth[0].grid.projection)
    place, now, closest, legs = crossing.start, 0.0, inf, 0
    settings, down = (
        crossing.settings,
        float(crossing.vehicle.speeds(np, crossing.vehicle.angles[0])[1]),
    )
    turns = (0.0, *(settings.depth, 0.0) * settings.yos)
    duration = 2.0 * settings.yos * settings.depth / down
    while now < limit and bool(
        inside_grid(truth[0].grid, *to_local(projection, place.longitude, place.latitude))
    ):
        here, there = (
            np.array(to_local(projection, one.longitude, one.latitude))
            for one in (place, crossing.goal)
        )
        turn = float(grid_bearing_of_true_north(projection, place.longitude, place.latitude))
        heading = np.mod(np.rad2deg(np.arctan2(*(there - here)) - turn), 360.0)
        leg = replace(
            leg,
            start=place,
            start_time_ns=crossing.start_ns + round(now * NS_PER_S),
            headings_deg=np.array([heading]),
            glide_angles_deg=np.array([crossing.vehicle.min_angle]),
            yo_depths=(turns,),
            surfacing_times=np.array([duration]),
            goal_times=np.array([duration]),
        )
        passed, nearest, now, place = _fly(truth, crossing, leg, now)
        closest, legs = min(closest, nearest), legs + 1
        if np.isfinite(passed):
            return Voyage(passed, legs, closest, 0)
    return Voyage(inf, legs, closest, 0)


def _fly(
    truth: Sea, crossing: Crossing, plan: MissionPlan, began: float
) -> tuple[float, float, float, Place]:
    """Return when legs first pass the goal (inf: never), how near they come [m], when they end and where; times since the start [s]."""
    flown = fly_mission([truth], plan)
    goal = np.array(to_local(flown.projection, crossing.goal.longitude, crossing.goal.latitude))
    time, track = _finer(flown.time), _finer(flown.place[0])
    off = np.linalg.norm(track - goal, axis=1)
    within = np.flatnonzero(off <= PASSED)
    longitude, latitude = to_geographic(flown.projection, *flown.place[0, -1])
    passed = began + float(time[within[0]]) if within.size else inf
    return (
        passed,
        float(off.min()),
        began + float(flown.time[-1]),
        Place(float(longitude), float(latitude), 0.0),
    )


def _finer(values: Array) -> Array:
    """Return values with points between them, linear."""
    at = np.linspace(0.0, len(values) - 1.0, _FINE * (len(values) - 1) + 1)
    flat = values.reshape(len(values), -1)
    return np.column_stack(
        [np.interp(at, np.arange(len(values)), column) for column in flat.T]
    ).reshape(len(at), *values.shape[1:])


def given_up(earliest: float) -> float:
    """Return when a mission is given up [s] whose earliest arrival in the truth is known [s]."""
    return _LONGEST * earliest
