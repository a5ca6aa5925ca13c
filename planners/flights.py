"""A mission flown in other currents than it was planned on: in a truth, or in samples of the estimate, with a pilot or without."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planners.clearance import clearances
from planners.hazards.areas import NoGo
from planners.hazards.bottom import Bathymetry
from planners.request import MissionPlan, MissionRequest
from planners.simulation.currents import (
    Currents,
    Flow,
    Sample,
    currents_of,
    currents_of_samples,
    flows_of,
    graph_key,
    with_courses,
)
from planners.simulation.fly import COARSE, Flight, Legs, fly
from planners.simulation.steer import Correction, Pilot
from planners.task import Task, task_of, turns_of
from planners.vehicle import Glider
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import grid_bearing_of_true_north, to_geographic, to_local
from replay_kit.core.grid import Projection


@dataclass(frozen=True, slots=True)
class MonteCarloSummary:
    """A mission flown in samples of the current.

    Attributes:
        reached: Share of the samples in which every goal is met within the tolerance, by the latest time of the settings.
        safe: Share without a constraint violation.
        miss_median: Median miss distance of the last goal [m].
        miss_90_percent: 90th percentile of the miss distance of the last goal [m].
        violations: Share that violates a constraint, by the name of the hazard; hazards without violations are left out.
        succeeded: Share in which every goal is met so and no constraint violated.
        arrival_90_percent: Time since the start by which 90 % have met the last goal within the tolerance [s]; infinite where fewer do.
    """

    reached: float
    safe: float
    miss_median: float
    miss_90_percent: float
    violations: Mapping[str, float]
    succeeded: float = float("nan")
    arrival_90_percent: float = float("nan")


# Share of a glide by which it goes on.
_MORE = 0.5
# Share of the surfacings that an ellipse holds.
_SHARE = 0.9


@dataclass(frozen=True, slots=True, eq=False)
class MissionFlights:
    """A mission in K currents.

    Attributes:
        time: shape (n,) [s] since the start; the same in all, as the currents change the places and not the durations.
        depth: shape (n,) [m].
        place: shape (K, n, 2) [m], east and north in the flows' local frame.
        surfacings: shape (K, L, 2), longitude and latitude [degrees] at each leg's end.
        miss: shape (K, G), miss distance of each goal at the time when it should be met [m].
        projection: The flows' local frame.
    """

    time: Array
    depth: Array
    place: Array
    surfacings: Array
    miss: Array
    projection: Projection


def fly_mission(flows: FlowEstimate | Sequence[Sample], plan: MissionPlan) -> MissionFlights:
    """Return the tracks of a mission's headings, glide angles and depths in other currents, without corrections on the way.

    Args:
        flows: Flows on the same nodes, of each that changes its flows at the same increasing times; their projection may differ from
            that of the plan's flow.
        plan: The mission.

    Raises:
        PlanError: The mission has no legs, or the flows are not on the same nodes.
    """
    currents = currents_of_samples([flows] if isinstance(flows, FlowEstimate) else flows)
    if len(currents.latent) > 1:
        currents = with_paces(currents, plan.vehicle, len(plan.headings_deg))
    legs, projection = legs_of_plan(plan), currents.flow.grid.projection
    start = np.array(
        to_local(projection, plan.start.longitude, plan.start.latitude), dtype=np.float64
    )
    clock, parts = currents.clock(plan.start_time_ns), parts_for(plan)
    deep = np.array([goal.depth for goal in plan.goals])
    flight = fly(currents, plan.vehicle, start, legs, clock, parts=parts, stops=deep)
    ends = flight.place[:, flight.ends]
    met = flight.place[:, np.searchsorted(flight.time[0], plan.goal_times - 1e-3)]
    goals = np.column_stack(
        to_local(projection, *np.array([[goal.longitude, goal.latitude] for goal in plan.goals]).T)
    )
    miss = np.linalg.norm(met - goals, axis=2)
    surfacings = np.stack(to_geographic(projection, ends[..., 0], ends[..., 1]), axis=-1)
    return MissionFlights(flight.time[0], flight.depth, flight.place, surfacings, miss, projection)


def closest_approach(flow: Flow, plan: MissionPlan) -> float:
    """Return how near a plan's track comes to its last goal when it is flown in a flow, three-dimensionally [m].

    Its last leg goes on for half as long again.
    """
    longer = _longer(plan)
    flights = fly_mission([flow], longer)
    goal, projection = plan.goals[-1], flights.projection
    at = np.array([*to_local(projection, goal.longitude, goal.latitude), goal.depth])
    track = np.column_stack([flights.place[0], flights.depth])
    begin, way = track[:-1], np.diff(track, axis=0)
    share = np.sum((at - begin) * way, axis=1) / np.maximum(np.sum(way**2, axis=1), 1e-9)
    nearest = begin + np.clip(share, 0.0, 1.0)[:, None] * way
    return float(np.min(np.linalg.norm(nearest - at, axis=1)))


def _longer(plan: MissionPlan) -> MissionPlan:
    """Return a glide that goes on, as far as its depth allows; other plans as they are."""
    if plan.settings.yos > 0:
        return plan
    first, last = plan.yo_depths[0][0], plan.yo_depths[0][-1]
    return replace(plan, yo_depths=((first, max(last + _MORE * (last - first), 0.0)),))


def legs_of_plan(plan: MissionPlan) -> Legs:
    """Return the commands of a mission.

    Raises:
        PlanError: It has no legs.
    """
    if len(plan.headings_deg) == 0:
        raise PlanError(f"a mission without legs cannot be flown: {plan.message}")
    drifts = np.append(np.full(len(plan.yo_depths) - 1, plan.settings.surface_time), 0.0)
    return Legs(
        np.deg2rad(plan.headings_deg),
        np.deg2rad(plan.glide_angles_deg),
        turns_of(plan.yo_depths),
        drifts,
    )


def parts_for(plan: MissionPlan) -> int:
    """Return the parts of a dive or climb that a plan's track has."""
    return int(plan.statistics.get("steps", COARSE))


def task_for(
    flow: Flow, plan: MissionPlan, no_go: tuple[NoGo, ...], bathymetry: Bathymetry | None
) -> Task:
    """Return the task of a mission that is planned, in a flow that may be another and with what it must keep clear of."""
    places = plan.start, plan.goals, plan.vehicle, plan.settings
    begin = plan.start_time_ns
    return task_of(flow, MissionRequest(*places, no_go, bathymetry, begin, plan.shape))


def surfacing_ellipses(flights: MissionFlights, plan: MissionPlan) -> Array:
    """Return the ellipse that holds another surfacing of each leg with a probability of 90 %, assuming a normal distribution.

    Mean and covariance are themselves estimated from few flights, which Hotelling's factor allows for.

    Returns:
        Array of shape (L, 5): longitude and latitude of its centre [degrees], semi-axes [m], and the bearing of the major one, clockwise
        from true north, in [0, 180) [degrees].

    Raises:
        PlanError: There are fewer than three flights.
    """
    if len(flights.place) < 3:
        raise PlanError(
            f"an ellipse needs three flights or more, but there are {len(flights.place)}"
        )
    numbers = np.searchsorted(flights.time, plan.surfacing_times - 1e-3)
    # in the local frame: longitudes have no mean across the antimeridian
    centre = np.column_stack(
        to_geographic(flights.projection, *np.mean(flights.place[:, numbers], axis=0).T)
    )
    turn = grid_bearing_of_true_north(flights.projection, *centre.T)
    ellipses = []
    for k, number in enumerate(numbers):
        values, vectors = np.linalg.eigh(np.cov(flights.place[:, number].T))
        minor, major = ellipse_factor(len(flights.place)) * np.sqrt(np.maximum(values, 0.0))
        bearing = np.rad2deg(np.arctan2(*vectors[:, 1]) - turn[k]) % 180.0
        ellipses.append([*centre[k], major, minor, bearing])
    return np.array(ellipses)


def ellipse_factor(count: int) -> float:
    """Return the semi-axes, in sample standard deviations, of the ellipse that holds the next of some points with a probability of 90 %.

    Args:
        count: Number of points, three or more, from whose mean and covariance the ellipse is made.

    References:
        Hotelling (1931); Chew (1966), Confidence, prediction, and tolerance regions for the multivariate normal distribution.
    """
    # the quantile of Fisher's distribution of two degrees of freedom and some
    quantile = 0.5 * (count - 2) * ((1.0 - _SHARE) ** (-2.0 / (count - 2)) - 1.0)
    return float(np.sqrt(2.0 * (count - 1) * (count + 1) * quantile / (count * (count - 2))))


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
    legs = legs_of_plan(plan)
    task = task_for(flow, plan, no_go, bathymetry)
    predicted = predict(task, legs)
    flight = fly_samples(task, currents_of_estimate(flow, samples), legs, predicted, pilot)
    return summarise_flights(task, flight, points_at(predicted, plan.goal_times))[0]


def points_at(predicted: Flight, times: Array) -> NDArray[np.intp]:
    """Return the numbers of a flight's points at some times, shape (G,) [s]; all flights of the same legs have the same points."""
    return np.asarray(np.argmin(np.abs(predicted.time[0] - times[:, None]), axis=1))


def summarise_flights(
    task: Task, flight: Flight, points: NDArray[np.intp]
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
    when = flight.time[:, points[-1]]
    arrives = np.all(miss <= task.settings.tolerance, axis=1)
    arrives &= when <= task.settings.arrive_by
    last = np.quantile(np.where(arrives, when, np.inf), 0.9, method="higher")
    return MonteCarloSummary(
        float(np.mean(arrives)),
        float(np.mean(clear > 0.0)),
        median,
        ninety,
        violations,
        float(np.mean(arrives & (clear > 0.0))),
        float(last),
    ), clear


def predict(task: Task, legs: Legs) -> Flight:
    """Return the flight of legs in the estimate."""
    begin, deep = task.start[:2], task.goals[:, 2]
    return fly(task.currents, task.vehicle, begin, legs, task.start_time, stops=deep)


def fly_samples(
    task: Task, currents: Currents, legs: Legs, predicted: Flight, pilot: Pilot | None
) -> Flight:
    """Return the flights of legs in K currents; a pilot leads them where the prediction goes."""
    currents = with_paces(currents, task.vehicle, len(legs.headings))
    begin, deep = task.start[:2], task.goals[:, 2]
    clock = currents.clock(task.request.start_time_ns)
    steer = None
    if pilot is not None:
        targets, known = predicted.place[0, predicted.ends], task.currents
        steer = Correction(pilot, known, task.vehicle, legs, targets, task.start_time)
    return fly(currents, task.vehicle, begin, legs, clock, steer, stops=deep)


def with_paces(currents: Currents, vehicle: Glider, n_legs: int) -> Currents:
    """Return samples of the current in which the vehicle's speed errs as well, by what its log's dives show."""
    if not (vehicle.speed_spread or vehicle.speed_error):
        return currents
    return replace(currents, pace=vehicle.paces(len(currents.latent), n_legs))


def currents_of_estimate(flow: Flow, samples: Sequence[Sample]) -> Currents:
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
