"""Reduction of a plan to few waypoints, and their loss against the plan.

At each surfacing the glider heads for the next waypoint, corrected for its last DAC, at the mean glide angle of the planned legs. In the
first dive it expects the current of its last one, which the estimate tells no better than to its error: a list is judged for several.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import shapely

from planners.clearance import Violation, first_violation
from planners.hazards.areas import Ring, first_crossing
from planners.odds.mission import (
    MissionOdds,
    currents_of_estimate,
    latest_arrival,
    mission_odds,
    odds_of,
    task_of_plan,
)
from planners.odds.steer import Route, steer
from planners.request import MissionPlan, MissionRequest
from planners.simulation.currents import Currents, Flow, Sample, first_of
from planners.simulation.fly import DRIFT_STEPS, Flight, Flights
from planners.task import Task
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import to_geographic, to_local
from replay_kit.core.plan import Area

# Radii of a waypoint that are tried, in those of the goal, and the number of samples in which they are.
_RADII, _TRIED = (1.0, 2.0, 4.0, 8.0), 25
# Share of a plan's margin that is kept: its own legs come to the margin less the error of the optimiser's current.
_AS_FAR = 0.8
# Standard errors by which the current that a glider remembers may differ from the estimate; depths of its mean.
_ERRORS, _DEPTHS = (1.0, 2.0), 9


@dataclass(frozen=True, slots=True, eq=False)
class Waypoints:
    """Waypoints of a glider, and its simulated track.

    Attributes:
        depths: Dive depths on the way [m].
        radius: Acceptance radius [m]; a goal's the plan's.
        times: When each is reached [s since the start]; NaN for never.
        surfacings: Shape (D, 2), longitude and latitude [degrees].
        off_end: Least distance of one from the plan's end [m].
        delay: Time after the plan's [s].
        off_track: Largest distance from the plan's legs [m].
        violation: First violation, or None.
        arrives: Whether all flights reach all waypoints.
    """

    longitude: Array
    latitude: Array
    glide_angles_deg: Array
    pitches_deg: Array
    depths: Array
    yos: int
    radius: Array
    times: Array
    surfacings: Array
    off_end: float
    delay: float
    off_track: float
    violation: Violation | None
    arrives: bool
    message: str
    areas: tuple[Area, ...] = ()
    clearance: float = 20.0


@dataclass(frozen=True, slots=True, eq=False)
class _List:
    """Candidate waypoints, with simulated flights in the estimate.

    Attributes:
        kept: Numbers of the legs that end at them.
        route: Route along them, with their acceptance radii.
        flights: Flights of gliders that expect each of ``_remembered`` in the first dive.
        violation: First violation of a flight, or an unchecked part; None if all keep clear.
    """

    kept: tuple[int, ...]
    route: Route
    flights: Flights
    violation: Violation | None

    @property
    def serves(self) -> bool:
        """Whether the glider arrives without a violation."""
        return self.violation is None and bool(np.isfinite(self.flights.arrived).all())


def waypoints_of(
    flow: Flow,
    plan: MissionPlan,
    request: MissionRequest,
    tolerance: float | None = None,
    samples: Sequence[Sample] = (),
) -> tuple[Waypoints, MissionOdds | None]:
    """Return the fewest surfacings of a plan that describe its track, and the odds of flying them; None without samples.

    No line between two crosses an area. If the simulated flight violates a constraint or does not arrive, all surfacings are waypoints.

    Args:
        flow: Current.
        plan: Plan.
        request: Request of the plan.
        tolerance: Largest deviation from steady progress of an omitted surfacing [m].
        samples: Samples, see ``mission_odds``.

    Raises:
        PlanError: The plan has no legs, or is a mooring.
    """
    if plan.is_moored:
        raise PlanError("a mooring has no waypoints: give the glider the position of the mooring")
    task = task_of_plan(flow, plan, request)
    ends = np.column_stack(to_local(task.region.grid.projection, *plan.surfacings.T))
    places = np.vstack([task.start[None, :2], ends])
    near = plan.settings.tolerance if tolerance is None else tolerance
    currents = (
        currents_of_estimate(flow, samples[:_TRIED], task.settings.depth)
        if samples
        else task.currents
    )
    told = _remembered(flow, task, max(plan.yo_depths[0]))
    fewest = kept_surfacings(plan, places, near, task.rings)
    best = _best_radius(task, plan, places, fewest, currents, told)
    if not best.serves:
        whole = _best_radius(task, plan, places, tuple(range(1, len(ends) + 1)), currents, told)
        best = whole if whole.serves or not best.violation else best
    odds = mission_odds(flow, samples, plan, request, best.route) if samples else None
    return _waypoints(task, plan, best, places, request), odds


def _remembered(flow: Flow, task: Task, depth: float) -> Array:
    """Return currents that a glider may expect in its first dive, shape (K, 2) [m/s].

    The true one (NaN), none, as after deployment, and those about the estimate's that its standard error leaves likely.

    Args:
        flow: Estimate, or estimates at increasing times.
        task: Mission, with its start.
        depth: Depth of the first dive [m].
    """
    first = first_of(flow)
    found = np.array([[np.nan, np.nan], [0.0, 0.0]])
    if not first.n_modes:
        return found
    depths = np.linspace(0.0, min(depth, float(first.levels[-1])), _DEPTHS)
    at, weights = task.start[None, :2], task.currents.weights(depths).mean(axis=0)[None]
    mean = task.currents.velocity(at, weights, np.array([task.start_time]))
    covariance = first.velocity_covariance(at[:, 0], at[:, 1], depths).reshape(
        2, _DEPTHS, 2, _DEPTHS
    )
    values, axes = np.linalg.eigh(covariance.mean(axis=(1, 3)))
    turns = 0.25 * np.pi * np.arange(8)
    ring = np.column_stack([np.cos(turns), np.sin(turns)]) * np.sqrt(np.maximum(values, 0.0))
    return np.vstack([found, *(mean + errors * ring @ axes.T for errors in _ERRORS)])


def _best_radius(
    task: Task,
    plan: MissionPlan,
    places: Array,
    kept: tuple[int, ...],
    currents: Currents,
    told: Array,
) -> _List:
    """Return the waypoints with the acceptance radius of the best odds, the smallest among equals."""
    goal, found = plan.settings.radius or plan.settings.tolerance, list[tuple[float, _List]]()
    # most of the plan's margin is kept from areas, less near a start or an end within it
    near = (float(ring.clearance(places[[0, -1]]).min()) for ring in task.rings)
    margin = np.clip(0.5 * min(near, default=np.inf), 0.0, _AS_FAR * plan.settings.margin)
    for times in _RADII:
        route = _route(plan, places, kept, times * goal)
        flown = steer(
            task,
            task.currents,
            replace(route, told=told),
            latest_arrival(plan.settings, plan.duration),
        )
        crossed = (_violation(task, flown, k, margin) for k in range(len(told)))
        waypoints = _List(kept, route, flown, next(filter(None, crossed), None))
        odds = odds_of(task, currents, route, latest_arrival(plan.settings, plan.duration))
        found.append((odds.succeeded + waypoints.serves, waypoints))
        if odds.succeeded == 1.0 and waypoints.serves:
            break
    return max(found, key=lambda pair: pair[0])[1]


def _violation(task: Task, flown: Flights, number: int, margin: float) -> Violation | None:
    """Return the first violation of a flight, or its unchecked part if constraints exist; otherwise None."""
    leg, ends = np.s_[number : number + 1], flown.ups + DRIFT_STEPS
    place, depth, time = flown.place[leg], flown.depth[number], flown.time[leg]
    found = first_violation(task, Flight(time, depth, place, flown.dive, ends), margin)
    deepest = float(depth.max())
    if found is not None or np.isfinite(flown.arrived[number]):
        return found
    if all(ring.outside for ring in task.solid(deepest)):
        return None
    what = f"unchecked water, as waypoint {int(np.isfinite(flown.met[number]).sum()) + 1} is not reached in {ends.size} legs,"
    where = (float(part) for part in to_geographic(task.region.grid.projection, *place[0, -1]))
    return Violation(what, float(time[0, -1]), ends.size, *where)


def _route(plan: MissionPlan, places: Array, kept: tuple[int, ...], radius: float) -> Route:
    """Return the route along legs' ends, at their mean glide angle and shallowest dive depth."""
    angles = np.deg2rad(plan.glide_angles_deg)
    depths = np.array([max(leg[1:]) for leg in plan.yo_depths])
    spans, numbers = list(pairwise([0, *kept])), np.array(kept)
    radii = np.where(
        np.isin(numbers, plan.goal_legs), plan.settings.radius or plan.settings.tolerance, radius
    )
    return Route(
        places[np.append(0, numbers)],
        np.array([np.mean(angles[begin:end]) for begin, end in spans]),
        np.array([np.min(depths[begin:end]) for begin, end in spans]),
        None,
        np.column_stack([places[numbers], np.zeros(numbers.size)]),
        np.arange(1, numbers.size + 1),
        radii,
        direct=True,
        alone=True,
    )


def _waypoints(
    task: Task, plan: MissionPlan, few: _List, places: Array, request: MissionRequest
) -> Waypoints:
    """Return the waypoints and their loss against the plan, whose legs end at ``places`` [m]."""
    projection, flights, numbers = task.region.grid.projection, few.flights, np.array(few.kept)
    # having arrived it stays, while others go on
    ups = flights.ups[np.diff(flights.time[0, flights.ups], prepend=-1.0) > 0.0]
    surfaced = flights.place[0, ups]
    off_legs = shapely.distance(shapely.LineString(places), shapely.points(surfaced))
    off_track = float(np.max(off_legs))
    times = np.where(np.isfinite(flights.met[0]), flights.met[0], np.nan)
    off_end = float(np.min(np.linalg.norm(surfaced - places[-1], axis=1)))
    ended = flights.arrived[0] if few.serves else flights.time[0, ups[-1]]
    delay, n_reached = float(ended) - plan.duration, int(np.isfinite(times).sum())
    lost = np.isinf(flights.arrived).sum()
    within = " or ".join(f"{radius:g}" for radius in np.unique(few.route.radius))
    message = (
        f"{len(times)} waypoints for {len(places) - 1} surfacings; {n_reached} reached within {within} m; "
        f"ends {off_end:.0f} m from the plan's end and {abs(delay) / 60.0:.0f} min {'later' if delay >= 0.0 else 'earlier'}; "
        f"surfaces at most {off_track:.0f} m off the plan's legs"
    )
    at = few.violation
    if at is not None:
        message = f"not safe: heading for the waypoints crosses {at.what} at {at.longitude:.4f}, {at.latitude:.4f}; {message}"
    elif lost:
        message = f"not reliable: not all waypoints are reached in {lost} of {len(flights.arrived)} flights; {message}"
    longitude, latitude = plan.surfacings[numbers - 1].T
    return Waypoints(
        longitude,
        latitude,
        np.rad2deg(few.route.angles),
        np.rad2deg(plan.vehicle.pitch(few.route.angles)),
        few.route.depths,
        plan.settings.yos,
        few.route.radius,
        times,
        np.column_stack(to_geographic(projection, *surfaced.T)),
        off_end,
        delay,
        off_track,
        at,
        not lost,
        message,
        areas=tuple(area.area for area in request.no_go),
        clearance=plan.settings.clearance,
    )


def kept_surfacings(
    plan: MissionPlan, places: Array, tolerance: float, rings: Sequence[Ring] = ()
) -> tuple[int, ...]:
    """Return the numbers, from 1, of the legs that end at waypoints: at goals, and as needed between them.

    Surfacings farthest from steady progress in space and time are kept, down to the tolerance (Ramer 1972; Douglas and Peucker 1973), and
    until no line between two comes nearer to an area than the plan's margin.

    Args:
        plan: Plan.
        places: Start and legs' ends, shape (L + 1, 2) [m].
        tolerance: Tolerance [m].
        rings: Forbidden areas.
    """
    times = np.concatenate([[0.0], plan.surfacing_times])
    kept = {0, len(times) - 1}
    for leg, goal in zip(plan.goal_legs, plan.goals, strict=True):
        # a goal below the surface is passed on a straight leg: both of its ends are kept
        kept |= {leg} if goal.depth == 0.0 else {max(leg - 1, 0), leg}
    open_spans = list(pairwise(sorted(kept)))
    while open_spans:
        begin, end = open_spans.pop()
        share = (times[begin + 1 : end] - times[begin]) / (times[end] - times[begin])
        away = np.linalg.norm(
            places[begin]
            + share[:, None] * (places[end] - places[begin])
            - places[begin + 1 : end],
            axis=1,
        )
        line, skin = places[[begin, end]][None], np.array([plan.settings.margin])
        if away.size and (away.max() > tolerance or first_crossing(rings, line, skin) is not None):
            middle = begin + 1 + int(np.argmax(away))
            kept.add(middle)
            open_spans += [(begin, middle), (middle, end)]
    return tuple(sorted(kept - {0}))
