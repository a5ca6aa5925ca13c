"""Several vehicles: which goes to which goal, and missions that keep apart.

The separation is the horizontal distance at equal times, regardless of depth. Before departure a vehicle counts as at its start, after
arrival at its goal. If two come too near, that part of one track, widened, becomes a no-go area of the other mission. Of both choices the
one with less total time is taken.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import shapely
from numpy.typing import NDArray

from planners.hazards.areas import NoGo
from planners.odds.mission import currents_of_estimate, latest_arrival, route_of_plan, task_of_plan
from planners.odds.steer import steer
from planners.plan import plan_mission
from planners.request import MissionPlan, MissionRequest
from planners.route.current import Complex
from planners.route.front import sea_of, spread_front
from planners.route.obstacles import obstacles_of
from planners.route.passage import mean_current
from planners.simulation.currents import Flow, Sample, first_of
from planners.task import task_of
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import to_geographic, to_local
from replay_kit.core.grid import Projection
from replay_kit.core.plan import Place

# Widths of what one keeps out of that are tried in turn, in separations, and ways round that are tried in all.
_WIDTHS, _TRIES = (1.1, 1.6, 2.4), 12
# Corners of a quarter of a circle, and how far its middle line may be off the way, in widths.
_CORNERS, _OFF = 4, 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Positions of a vehicle over time in K currents.

    Attributes:
        times: Times, shape (n,) or (K, n), increasing [s], on a common clock.
        places: Positions, shape (K, n) [m], local east + i north, linear between the times.
    """

    times: Array
    places: Complex

    def in_current(self, k: int) -> tuple[Array, Complex]:
        """Return times and positions in one current."""
        return (self.times if self.times.ndim == 1 else self.times[k]), self.places[k]


@dataclass(frozen=True, slots=True)
class Nearness:
    """Closest approach of two vehicles.

    Attributes:
        vehicles: Numbers of the vehicles.
        distance: Smallest distance in the estimate [m].
        time_ns: Time of the closest approach [ns, UTC].
        share: Fraction of samples with less than the required separation; NaN without samples.
    """

    vehicles: tuple[int, int]
    distance: float
    time_ns: int
    share: float


@dataclass(frozen=True, slots=True, eq=False)
class JointMissions:
    """Plans of several vehicles with their separations.

    Attributes:
        plans: Plan of each vehicle.
        requests: Request of each vehicle, with the areas that separate it from others.
        nearness: Closest approach of each pair.
        flown: Simulated flights of each vehicle; empty without samples.
    """

    plans: tuple[MissionPlan, ...]
    requests: tuple[MissionRequest, ...]
    nearness: tuple[Nearness, ...]
    flown: tuple[Motion, ...] = ()


def nearest_approach(first: Motion, second: Motion) -> tuple[Array, Array]:
    """Return the smallest distance of two vehicles in K currents, shape (K,) [m], and its time [s]."""
    found = [_nearest(first.in_current(k), second.in_current(k)) for k in range(len(first.places))]
    distances, times = zip(*found, strict=True)
    return np.array(distances), np.array(times)


def _nearest(first: tuple[Array, Complex], second: tuple[Array, Complex]) -> tuple[float, float]:
    times, apart = _apart(first, second)
    step = np.diff(apart)
    size = np.maximum(np.abs(step) ** 2, 1e-12)
    share = np.clip(-(apart[:-1] * step.conjugate()).real / size, 0.0, 1.0)
    distances = np.append(np.abs(apart[:-1] + share * step), np.abs(apart[-1]))
    k = int(np.argmin(distances))
    when = times[k] + (share[k] * (times[k + 1] - times[k]) if k < share.size else 0.0)
    return float(distances[k]), float(when)


def _apart(first: tuple[Array, Complex], second: tuple[Array, Complex]) -> tuple[Array, Complex]:
    """Return the times of both, shape (n,), and the position of the second relative to the first [m], linear between them."""
    times = np.union1d(first[0], second[0])
    return times, np.interp(times, *second) - np.interp(times, *first)


def motion_of(plan: MissionPlan, projection: Projection) -> Motion:
    """Return the predicted motion of a plan; one without legs stays at its start."""
    begin = plan.start_time_ns / 1e9
    if len(plan.track_time) == 0:
        east, north = to_local(projection, plan.start.longitude, plan.start.latitude)
        return Motion(np.array([begin]), np.array([[complex(east, north)]]))
    return Motion(begin + plan.track_time, (plan.track[:, 0] + 1j * plan.track[:, 1])[None])


def plan_missions(
    flow: Flow,
    samples: Sequence[Sample],
    requests: Sequence[MissionRequest],
    separation: float = 0.0,
    allowed: float = 0.05,
) -> JointMissions:
    """Return plans of several vehicles, separated by detours if any are found.

    Args:
        flow: Estimate, or estimates at increasing times.
        samples: Samples for simulated flights of all vehicles; empty to use the estimate only.
        requests: Requests of the vehicles.
        separation: Required horizontal distance between two vehicles [m]; 0 for none.
        allowed: Accepted fraction of samples with a smaller distance.

    Raises:
        PlanError: A mission cannot be planned, see ``plan_mission``.
    """
    joint = _judged(
        flow, samples, tuple((plan_mission(flow, one), one) for one in requests), separation
    )
    tried: dict[tuple[int, int], int] = {}
    for _ in range(_TRIES if separation > 0.0 else 0):
        near = [
            one
            for one in joint.nearness
            if (one.distance < separation or one.share > allowed)
            and tried.get(one.vehicles, 0) < len(_WIDTHS)
        ]
        if not near or requests[0].settings.is_late:
            break
        worst = min(near, key=lambda one: one.distance)
        width = _WIDTHS[tried.get(worst.vehicles, 0)] * separation
        tried[worst.vehicles] = tried.get(worst.vehicles, 0) + 1
        joint = _gone_round(flow, samples, joint, (worst, width, separation))
    return joint


def _gone_round(
    flow: Flow,
    samples: Sequence[Sample],
    joint: JointMissions,
    asked: tuple[Nearness, float, float],
) -> JointMissions:
    """Return plans with one of two vehicles detouring around the other's track; unchanged if neither can."""
    worst, width, separation = asked
    projection = first_of(flow).grid.projection
    best, options = joint, list[JointMissions]()
    for stays, goes in (worst.vehicles, worst.vehicles[::-1]):
        motions = [motion_of(joint.plans[k], projection) for k in (stays, goes)]
        area = area_between(motions[0], motions[1], width, projection)
        request = replace(joint.requests[goes], no_go=(*joint.requests[goes].no_go, area))
        try:
            plan = plan_mission(flow, request)
        except PlanError:
            # its start or goal lies in the other's way
            continue
        if plan.status == joint.plans[goes].status:
            pairs = list(zip(joint.plans, joint.requests, strict=True))
            pairs[goes] = plan, request
            options.append(_judged(flow, samples, tuple(pairs), separation, joint))
    for option in options:
        if _conflicts(option, separation) < _conflicts(best, separation) or (
            best is not joint
            and _conflicts(option, separation) == _conflicts(best, separation)
            and _hours(option) < _hours(best)
        ):
            best = option
    return best


def _conflicts(joint: JointMissions, separation: float) -> tuple[int, float]:
    """Return the number of conflicting pairs in the estimate, and the summed fraction of samples with conflicts."""
    too_near = sum(one.distance < separation for one in joint.nearness)
    return too_near, round(float(np.nansum([one.share for one in joint.nearness])), 6)


def _hours(joint: JointMissions) -> float:
    return sum(plan.duration for plan in joint.plans) / 3600.0


def area_between(stays: Motion, goes: Motion, width: float, projection: Projection) -> NoGo:
    """Return the no-go area for one vehicle: within a width [m] of the other's track where the two are that near."""
    times, apart = _apart(stays.in_current(0), goes.in_current(0))
    near: NDArray[np.intp] = np.flatnonzero(np.abs(apart) < width)
    _, when = _nearest(stays.in_current(0), goes.in_current(0))
    # with the points before and after, and where they are nearest
    chosen = np.union1d(
        times[max(near.min(initial=times.size) - 1, 0) : near.max(initial=-1) + 2], when
    )
    way = np.interp(chosen, *stays.in_current(0))
    points = np.column_stack([way.real, way.imag])
    line = shapely.LineString(points) if len(points) > 1 else shapely.Point(points[0])
    # a wide buffer of many short pieces may have slivers beside it
    around = shapely.get_parts(line.simplify(_OFF * width).buffer(width, quad_segs=_CORNERS))
    ring = shapely.get_coordinates(around[np.argmax(shapely.area(around))].exterior)
    longitude, latitude = to_geographic(projection, *ring.T)
    corners = tuple(zip(longitude.tolist(), latitude.tolist(), strict=True))
    return NoGo(corners, "the track of another vehicle")


def _judged(
    flow: Flow,
    samples: Sequence[Sample],
    made: tuple[tuple[MissionPlan, MissionRequest], ...],
    separation: float,
    before: JointMissions | None = None,
) -> JointMissions:
    """Return plans with the closest approach of each pair; unchanged plans are not simulated again."""
    projection = first_of(flow).grid.projection
    planned = [motion_of(plan, projection) for plan, _ in made]
    known = {} if before is None else dict(zip(before.plans, before.flown, strict=False))
    flown = tuple(known.get(one[0]) or _flown(flow, samples, *one) for one in made if samples)
    found = list[Nearness]()
    for i, j in combinations(range(len(made)), 2):
        (distance,), (when,) = nearest_approach(planned[i], planned[j])
        near = nearest_approach(flown[i], flown[j])[0] < separation if samples else [np.nan]
        share = float(np.mean(near))
        found.append(Nearness((i, j), float(distance), round(float(when) * 1e9), share))
    plans, requests = zip(*made, strict=True)
    return JointMissions(plans, requests, tuple(found), flown)


def share_of_nearer(
    flow: Flow,
    samples: Sequence[Sample],
    joint: JointMissions,
    vehicles: tuple[int, int],
    separation: float,
) -> float:
    """Return the fraction of samples in which two vehicles come nearer than a separation [m]."""
    one, other = (_flown(flow, samples, joint.plans[k], joint.requests[k]) for k in vehicles)
    return float(np.mean(nearest_approach(one, other)[0] < separation))


def _flown(
    flow: Flow, samples: Sequence[Sample], plan: MissionPlan, request: MissionRequest
) -> Motion:
    """Return the motion of a plan's simulated flights, steered at each surfacing."""
    if len(plan.headings_deg) == 0:
        still = motion_of(plan, first_of(flow).grid.projection)
        return Motion(still.times, np.repeat(still.places, len(samples), axis=0))
    task = task_of_plan(flow, plan, request)
    currents = currents_of_estimate(flow, samples, plan.settings.depth)
    flights = steer(
        task, currents, route_of_plan(task, plan), latest_arrival(plan.settings, plan.duration)
    )
    times = plan.start_time_ns / 1e9 + flights.time
    return Motion(times, flights.place[..., 0] + 1j * flights.place[..., 1])


def times_to_goals(
    flow: Flow, requests: Sequence[MissionRequest], goals: tuple[Place, ...]
) -> Array:
    """Return the earliest arrival of each vehicle at each goal, shape (K, G) [s since its start]; infinite if unreachable.

    A front propagates around obstacles in the mean current of the vehicle's dives and drifts.

    Args:
        flow: Current estimate, or estimates at increasing times.
        requests: Requests of the vehicles; their goals are ignored.
        goals: Goals, at least one.

    Raises:
        PlanError: A start or goal is outside the region, on land or in a forbidden area.
    """
    times = np.empty((len(requests), len(goals)))
    for k, request in enumerate(requests):
        settings = replace(request.settings, legs=None)
        task = task_of(flow, replace(request, goals=goals, settings=settings))
        mean, dives = mean_current(task), task.solid(task.settings.depth)
        sea = sea_of(
            mean.current,
            mean.speed,
            task.places,
            obstacles_of(dives, task.settings.margin, task.places),
        )
        start, nowhere = np.array([mean.current.places.size]), np.zeros(0, dtype=np.intp)
        front = spread_front(sea, start, np.zeros(1), task.longest, nowhere)
        times[k] = front.times[start[0] + 1 : start[0] + 1 + len(goals)]
    return times


def assign(times: Array) -> tuple[int | None, ...]:
    """Return the goal of each vehicle, or None: the most assignments, then the least total time.

    Args:
        times: Travel times, shape (K, G) [s]; infinite for goals out of reach.

    References:
        Crouse (2016), On implementing 2D rectangular assignment algorithms.
    """
    # loads slowly, and one vehicle needs none
    from scipy.optimize import linear_sum_assignment

    finite = np.isfinite(times)
    # dearer than all that can be reached together
    beyond = 1.0 + 2.0 * min(times.shape) * float(np.max(times, initial=0.0, where=finite))
    rows, columns = linear_sum_assignment(np.where(finite, times, beyond))
    found = {int(k): int(goal) for k, goal in zip(rows, columns, strict=True) if finite[k, goal]}
    return tuple(found.get(k) for k in range(len(times)))
