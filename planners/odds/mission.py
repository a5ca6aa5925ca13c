"""Odds of a plan, from simulated flights in samples of the estimate, steered at each surfacing.

The flights yield arrival times, miss distances, violations and the ellipses of surfacings. Flights in the estimate with perturbed
headings yield the heading tolerance of each leg.
"""

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from math import inf

import numpy as np

from planners.clearance import clearances
from planners.odds.steer import Begin, Route, steer
from planners.program.words import arrival_text, odds_text, violations_text
from planners.request import MissionPlan, MissionRequest, MissionSettings, Mooring
from planners.simulation.currents import (
    Currents,
    Flow,
    Sample,
    currents_of,
    currents_of_samples,
    first_of,
    flows_of,
    graph_key,
    with_courses,
)
from planners.simulation.fly import Flights
from planners.task import Task, YoDepths, task_of
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import grid_bearing_of_true_north, to_geographic, to_local
from replay_kit.core.grid import Projection
from replay_kit.core.surfacing import ellipse_of

#: Time after which a glider has not arrived where no latest time is asked for, in the plan's.
LATEST = 1.25
# Share of the surfacings that an ellipse holds.
_SHARE = 0.9
# Headings about the planned one that are tried [degrees].
_ASIDE = np.array([-90.0, -60.0, -30.0, 0.0, 30.0, 60.0, 90.0])


@dataclass(frozen=True, slots=True, eq=False)
class MissionOdds:
    """Odds of a plan, from K simulated flights.

    Attributes:
        flights: Simulated flights.
        radius: Radius within which a goal is met [m].
        deadline: Latest arrival [s since the start].
        reached: Fraction that meets all goals, or stays near a mooring.
        clear: Smallest clearance of each flight, shape (K,) [m]; 0 or less for a violation.
        safe: Fraction without a violation.
        succeeded: Fraction that arrives without a violation.
        arrival_median: Median arrival time [s since the start]; infinite if fewer arrive.
        arrival_90_percent: 90th percentile of the arrival time [s since the start].
        miss_median: Median miss distance of the last goal [m].
        miss_90_percent: 90th percentile of it [m].
        violations: Fraction of violating flights by hazard.
        ellipses: Ellipses of the legs' ends, shape (L, 5), see ``ellipses_of``.
        next_surfacing: Ellipse of the next surfacing, shape (5,).
        forgiving: Heading range of each leg, shape (L, 2), see ``forgiving_headings``.
    """

    flights: Flights
    radius: float
    deadline: float
    reached: float
    clear: Array
    safe: float
    succeeded: float
    arrival_median: float
    arrival_90_percent: float
    miss_median: float
    miss_90_percent: float
    violations: Mapping[str, float]
    ellipses: Array
    next_surfacing: Array
    forgiving: Array

    @property
    def count(self) -> int:
        """Number of simulated flights."""
        return len(self.flights.met)


def mission_odds(
    flow: Flow,
    samples: Sequence[Sample],
    plan: MissionPlan,
    request: MissionRequest,
    route: Route | None = None,
) -> MissionOdds:
    """Return the odds of a plan.

    Args:
        flow: Estimate known to the pilot, or estimates at increasing times.
        samples: Samples on its nodes. The deviation of time-independent ones from the first estimate persists.
        plan: Plan.
        request: Request of the plan.
        route: Route to fly; None for the plan's surfacings.

    Raises:
        PlanError: The plan has no legs, or there are no samples.
    """
    task = task_of_plan(flow, plan, request)
    flown = route_of_plan(task, plan) if route is None else route
    deadline = latest_arrival(plan.settings, plan.duration)
    found = odds_of(task, currents_of_estimate(flow, samples, plan.settings.depth), flown, deadline)
    count = len(plan.headings_deg)
    if count and not plan.is_moored:
        found = replace(found, forgiving=forgiving_headings(task, plan, flown, deadline))
    if len(samples) < 3:
        return found
    ends = found.flights.surfacings
    ends = ends[:, np.minimum(np.arange(count), ends.shape[1] - 1)]
    first = found.flights.place[:, found.flights.ups[:1]]
    ellipses = ellipses_of(task.region.grid.projection, np.concatenate([ends, first], axis=1))
    return replace(found, ellipses=ellipses[:-1], next_surfacing=ellipses[-1])


def next_surfacing(
    flow: Flow, samples: Sequence[Sample], plan: MissionPlan, request: MissionRequest
) -> Array:
    """Return the ellipse of the first surfacing from three samples or more, see ``ellipses_of``."""
    task = task_of_plan(flow, plan, request)
    # over as soon as it has begun
    currents = currents_of_estimate(flow, samples, plan.settings.depth)
    flights = steer(task, currents, route_of_plan(task, plan), 0.0)
    return np.asarray(
        ellipses_of(task.region.grid.projection, flights.place[:, flights.ups[:1]])[0]
    )


def latest_arrival(settings: MissionSettings, duration: float) -> float:
    """Return the latest arrival for a mission duration [s since the start]."""
    return settings.arrive_by if settings.arrive_by < inf else LATEST * duration


def odds_of(task: Task, currents: Currents, route: Route, deadline: float) -> MissionOdds:
    """Return the odds of a route in K currents, without ellipses."""
    mooring = task.shape if isinstance(task.shape, Mooring) else None
    flights = steer(task, currents, route, inf if mooring else deadline)
    by_hazard = clearances(task, flights)
    whole = np.isfinite(flights.place).all(axis=(1, 2))
    clear = np.min([np.where(whole, np.inf, 0.0), *by_hazard.values()], axis=0)
    safe = clear > 0.0
    arrives, when = np.isfinite(flights.arrived), flights.arrived
    off = np.linalg.norm(flights.place[:, -1] - route.goals[-1, :2], axis=1)
    # of who never came to head for the last goal, from where it ends
    miss = np.where(np.isfinite(flights.nearest[:, -1]), flights.nearest[:, -1], off)
    if mooring is not None:
        ends = np.concatenate([flights.ups, flights.ups + 2]) if mooring.surfacings_only else ...
        miss = np.linalg.norm(flights.place - task.goals[0, :2], axis=2)[:, ends].max(axis=1)
        arrives = miss <= mooring.radius
    misses = (float(np.quantile(miss, 0.5)), float(np.quantile(miss, _SHARE)))
    times = [float(np.quantile(when, share, method="higher")) for share in (0.5, _SHARE)]
    nothing = np.full((0, 5), np.nan)
    return MissionOdds(
        flights,
        float(np.max(route.radius[..., -1])) if mooring is None else mooring.radius,
        deadline,
        float(np.mean(arrives)),
        clear,
        float(np.mean(safe)),
        float(np.mean(arrives & safe)),
        times[0],
        times[1],
        misses[0],
        misses[1],
        {name: float(np.mean(one <= 0.0)) for name, one in by_hazard.items() if np.any(one <= 0.0)},
        nothing,
        np.full(5, np.nan),
        np.full((0, 2), np.nan),
    )


def task_of_plan(flow: Flow, plan: MissionPlan, request: MissionRequest) -> Task:
    """Return the task of a plan, in any flow."""
    plan.require_legs()
    asked = replace(
        request,
        start=plan.start,
        goals=plan.goals,
        vehicle=plan.vehicle,
        settings=plan.settings,
        start_time_ns=plan.start_time_ns,
        shape=plan.shape,
    )
    return task_of(flow, asked)


def route_of_plan(task: Task, plan: MissionPlan) -> Route:
    """Return the route along the surfacings of a plan."""
    ends = np.column_stack(to_local(task.region.grid.projection, *plan.surfacings.T))
    first, angles = float(np.deg2rad(plan.headings_deg[0])), np.deg2rad(plan.glide_angles_deg)
    return route_along(task, ends, first, angles, plan.yo_depths, plan.goal_legs)


def route_along(
    task: Task,
    ends: Array,
    heading: float,
    angles: Array,
    legs: Sequence[YoDepths],
    goal_legs: Sequence[int],
) -> Route:
    """Return the route along the ends of legs, shape (L, 2) [m]; for a mooring each is a goal."""
    depths = np.array([max(leg[1:]) for leg in legs])
    if legs[-1][-1] > 0.0:
        # a dive that passes the goal goes on, as those before it
        depths[-1] = max(depths[-1], depths[-2] if len(legs) > 1 else task.settings.depth)
    places = np.vstack([task.start[None, :2], ends])
    if isinstance(task.shape, Mooring):
        goals, numbers = np.column_stack([ends, np.zeros(len(ends))]), np.arange(1, len(ends) + 1)
        radius = np.full(len(ends), inf)
        return Route(places, angles, depths, heading, goals, numbers, radius, direct=True)
    radius = np.full(len(task.goals), task.settings.radius or task.settings.tolerance)
    return Route(places, angles, depths, heading, task.goals, np.array(goal_legs), radius)


def forgiving_headings(task: Task, plan: MissionPlan, route: Route, deadline: float) -> Array:
    """Return the heading range around the planned one with which each leg still arrives, shape (L, 2) [degrees].

    Later legs are steered in the estimate, with one dive more than planned allowed; NaN if the planned heading does not arrive.
    """
    times = np.append(0.0, plan.surfacing_times[:-1])
    count, tried = len(times), len(_ASIDE)
    planned = route_of_plan(task, plan)
    headings = np.deg2rad(plan.headings_deg[:, None] + _ASIDE).ravel()
    begin = Begin(
        np.repeat(planned.places[:-1], tried, axis=0),
        np.repeat(times, tried),
        np.repeat(np.arange(count), tried),
        headings,
    )
    more = float(np.max(np.diff(plan.surfacing_times, prepend=0.0)))
    planned = replace(
        planned, radius=np.full(len(planned.goals), float(np.max(route.radius[..., -1])))
    )
    flights = steer(task, task.currents, planned, min(deadline, plan.duration + more), begin)
    arrives = np.isfinite(flights.arrived).reshape(count, tried)
    middle, found = tried // 2, np.full((count, 2), np.nan)
    for k, arrived in enumerate(arrives):
        if arrived[middle]:
            left = np.argmin(np.append(arrived[middle::-1], False)) - 1
            right = np.argmin(np.append(arrived[middle:], False)) - 1
            found[k] = _ASIDE[[middle - left, middle + right]]
    return found


def ellipses_of(projection: Projection, places: Array) -> Array:
    """Return the 90 % prediction ellipses of positions, assuming a normal distribution.

    Hotelling's factor accounts for the estimation of mean and covariance from few flights.

    Args:
        projection: Local frame.
        places: Positions of three flights or more, shape (K, n, 2) [m].

    Returns:
        Array of shape (n, 5): longitude and latitude of the centre [degrees], semi-axes [m], and bearing of the major axis, clockwise from
        true north, in [0, 180) [degrees].
    """
    # in the local frame: longitudes have no mean across the antimeridian
    centre = np.column_stack(to_geographic(projection, *np.mean(places, axis=0).T))
    turn = grid_bearing_of_true_north(projection, *centre.T)
    radius = ellipse_factor(len(places))
    each = zip(centre, places.swapaxes(0, 1), turn, strict=True)
    ellipses = [ellipse_of(x, y, np.cov(ends.T), radius, by) for (x, y), ends, by in each]
    return np.array([astuple(one) for one in ellipses])


def ellipse_factor(count: int) -> float:
    """Return the semi-axes of a 90 % prediction ellipse in sample standard deviations.

    Args:
        count: Number of points that determine mean and covariance, at least three.

    References:
        Hotelling (1931); Chew (1966), Confidence, prediction, and tolerance regions for the multivariate normal distribution.
    """
    # the quantile of Fisher's distribution of two degrees of freedom and some
    quantile = 0.5 * (count - 2) * ((1.0 - _SHARE) ** (-2.0 / (count - 2)) - 1.0)
    return float(np.sqrt(2.0 * (count - 1) * (count + 1) * quantile / (count * (count - 2))))


def with_odds(
    plan: MissionPlan, odds: MissionOdds, arrive: float, risk: float, to: str = ""
) -> MissionPlan:
    """Return a plan with its odds in status and message.

    Args:
        plan: Plan.
        odds: Odds of the plan.
        arrive: Required fraction of arrivals for ``reached``; below it the status is ``uncertain``.
        risk: Accepted fraction of violations; above it the status is ``unsafe``.
        to: What the flights head for, in words, if not the legs.
    """
    violating, status = 1.0 - odds.safe, plan.status
    text = odds_text(plan, odds.count, odds.reached, odds.radius, odds.deadline, to)
    if not plan.is_moored:
        text += arrival_text(plan, odds.arrival_median, odds.arrival_90_percent)
    text += violations_text(violating, odds.violations)
    # shares of a few samples are rounded by the last bit
    arrives = odds.reached >= arrive - 1e-9
    # the radius within which a flight arrives may be more than the tolerance, and a steered flight may yet meet what the plan misses
    status = "reached" if status == "unreachable" and arrives else status
    if status == "reached" and violating > risk + 1e-9:
        status, text = "unsafe", f"{text}, more than the {100.0 * risk:.0f} % accepted"
    elif status == "reached" and not arrives:
        status, text = "uncertain", f"{text}; {100.0 * arrive:.0f} % are required"
    statistics = {**plan.statistics, "arrive": arrive}
    message = f"{text}. In the mean current: {plan.message}"
    return replace(plan, status=status, message=message, statistics=statistics)


def currents_of_estimate(flow: Flow, samples: Sequence[Sample], depth: float = 0.0) -> Currents:
    """Return the currents of samples on the nodes of the estimate.

    Time-independent samples follow a time-dependent estimate: their deviation from its first time persists.

    Args:
        flow: Estimate, or estimates at increasing times.
        samples: Samples of it.
        depth: Dive depth [m].
    """
    if not samples:
        raise PlanError(
            "no samples of the estimate were given; draw them with flow.sample(100, seed)"
        )
    return with_courses(_below(_flows_around(flow, flows_of(samples)), depth), samples)


def _below(currents: Currents, depth: float) -> Currents:
    """Return samples extrapolated to a depth [m] below their deepest level.

    Each sample adds the shear of its last two levels times a standard normal number.
    """
    flow, levels = currents.flow, currents.flow.levels
    if depth <= levels[-1] or levels.size < 2 or flow.depth_functions.kind != "hat":
        return currents
    count, size, _ = currents.latent.shape
    values = currents.latent.reshape(count, size, -1, levels.size)
    share = (depth - levels[-1]) / (levels[-1] - levels[-2])
    normal = share * np.random.default_rng(count).standard_normal((count, 1, 1))
    more = values[..., -1] + normal * (values[..., -1] - values[..., -2])
    grid = replace(
        flow.grid,
        levels=np.append(levels, depth),
        wet=np.concatenate([flow.grid.wet, flow.grid.wet[-1:]]),
    )
    latent = np.concatenate([values, more[..., None]], axis=-1).reshape(count, size, -1)
    deeper = replace(flow.mean_flow(), grid=grid, latent=latent[0, :, : levels.size + 1])
    return replace(currents, flow=deeper, latent=latent)


def _flows_around(flow: Flow, samples: Sequence[Flow]) -> Currents:
    first = first_of(flow)
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
