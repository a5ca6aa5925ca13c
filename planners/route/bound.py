"""The earliest arrival of any vehicle of a mission's speed: a lower bound of its time, or what keeps a goal out of reach.

The front knows the mean current of the dives and drifts, and the greatest horizontal speed in the mean of both. The bound gives the vehicle
every doubt: no margin, half-open water counts as open, it may wait, the goals' discs are enough, its speed is raised by the second-order
terms of shear within a dive, and the time is lowered by the lattice's own error.

A leg of duration T at glide angle g, and a drift d after it, lead over ground by V(g) T through water and by what the current gives: over
the leg's own depths and at the surface. In the same time the vehicle of the bound goes S (T + d), beside the mean current m (T + d). Steep
dives are short, so that the drifts between them are a larger part of the time; the last leg has no drift, may end at a depth, and the first
may begin at one. Where the current differs between the surface and below, each of these may gain on the mean: the vehicle is given that
lead (``Lead``).
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from math import inf
from typing import Literal

import numpy as np

from planners.route.current import Complex, CurrentLattice, shares_of_levels
from planners.route.front import Front, sea_of, spread
from planners.route.obstacles import as_complex, directions_around, obstacles_of
from planners.route.passage import MeanCurrent, mean_current
from planners.route.relax import relax
from planners.task import LEAST_DIVE, Task, YoDepths, yo_depths
from replay_kit.core.arrays import Array
from replay_kit.core.flow.functions import depth_weights

# What a bound is multiplied by, for the error of the lattice against Zermelo's rays: in currents up to a share of the vehicle's speed on
# the way, where the rays were 0.12 % before the front at most, in faster ones, 0.7 %, and in strong ones.
_CALM_ERROR, _LATTICE_ERROR, _STRONG_ERROR = 0.998, 0.993, 0.985
# These shares of the vehicle's speed: of calm and of strong currents. In strong ones the lattice has so many times more lines.
_CALM, _STRONG, _FINER = 0.45, 0.75, 1.6
# Where a current within reach is faster than this share, a lattice may miss the quickest way by far.
_TRUSTED = 0.9
# Points on the edge of a goal's disc.
_ON_DISC = 12
# Kernel lengths around start and goals within which shear counts, and points that it is looked up at in each.
_AROUND, _SAMPLES = 1.5, 2.0
# Glide angles, and depths of a dive, among which the largest lead is sought.
_ANGLES, _DEPTHS = 16, 101


#: What keeps a goal out of reach; empty when none is.
Limit = Literal["", "legs", "duration", "ways", "current"]


@dataclass(frozen=True, slots=True)
class Bound:
    """What no vehicle of a mission's speed can do better.

    Attributes:
        time: Earliest arrival within the tolerance of the last goal, all others passed [s]; infinite when it is out of reach.
        most: The longest time considered [s].
        goal: Number of the first goal out of reach, from 0; -1 when there is none.
        nearest: How near one can come to that goal [m].
        when: At which time [s].
        is_tight: Whether it is near to what such a vehicle can do. Where a current within reach is about as fast as the vehicle, nothing
            better is known than the straight way in the fastest current of all, and what is out of reach of the lattice may be reached.
        limit: What keeps it out of reach: fewer ``legs`` than the way takes; the longest ``duration``, which the way takes longer than in
            still water; the ``ways``, none of which is open; or the ``current``. Empty when none is out of reach.
    """

    time: float
    most: float
    goal: int = -1
    nearest: float = 0.0
    when: float = 0.0
    is_tight: bool = True
    limit: Limit = ""


@dataclass(frozen=True, slots=True, eq=False)
class Lead:
    """What the vehicle of a bound is given so that no mission leads ahead of it.

    Attributes:
        speed: Through water, horizontal [m/s].
        start: How far from the start it may begin [m].
        goals: shape (G,) [m], how far from each goal it may pass, beside the tolerance.
    """

    speed: float
    start: float
    goals: Array


def bound_of(task: Task) -> tuple[MeanCurrent, Bound]:
    """Return the lower bound of a mission's time, or how near one can come to the first goal out of reach; and the water of its lattice.

    Where the current is about as fast as the vehicle, few edges lead where it can go, and a finer lattice is needed.
    """
    water = mean_current(task)
    lead = _lead(task, water)
    bound = _bound_in(task, water, lead, _LATTICE_ERROR, _STRONG * water.speed)
    if bound is not None:
        return water, bound
    finer = mean_current(task, _FINER)
    bound = _bound_in(task, finer, lead, _STRONG_ERROR, inf)
    assert bound is not None, "no current is faster than infinity"
    if bound.goal >= 0 and not bound.limit:
        bound = replace(bound, limit=limit_of(task, water.current, water.speed, bound.goal))
    # to come near a goal that is out of reach needs no finer lattice
    return (finer if bound.goal < 0 else water), bound


def _bound_in(
    task: Task, water: MeanCurrent, lead: Lead, error: float, strong: float
) -> Bound | None:
    """Return the bound on one lattice; None where that is not to be trusted.

    Args:
        task: The problem.
        water: Of the lattice.
        lead: Of the vehicle.
        error: What its times are multiplied by where the current on the way is not calm.
        strong: A current on the way [m/s], or a goal out of reach, for which it is not to be trusted; infinite to trust it always.
    """
    places, most = task.places, task.longest
    radii = np.append(lead.start, task.settings.tolerance + lead.goals)
    discs = [
        _disc(complex(place), float(radius)) for place, radius in zip(places, radii, strict=True)
    ]
    obstacles = obstacles_of((*task.rings, *task.bottom.rings(LEAST_DIVE)), 0.0, places)
    sea = sea_of(water.current, lead.speed, np.concatenate(discs), obstacles, waits=True)
    ends = water.current.places.size + np.cumsum([0, *(disc.size for disc in discs)])
    until = (most if np.isfinite(strong) else task.settings.max_duration) / error
    now = 0.0
    fastest = 0.0
    trusted = True
    limit = _TRUSTED * water.speed
    seeds = np.arange(ends[0], ends[1])
    for k, place in enumerate(places[1:]):
        goals = np.arange(ends[k + 1], ends[k + 2])
        if np.any(np.abs(sea.places[seeds] - place) <= radii[k + 1]):
            seeds = goals
            continue
        front = spread(sea, seeds, np.full(seeds.size, now), until, goals)
        best = int(goals[np.argmin(front.times[goals])])
        if not front.times[best] <= most / error:
            if np.isfinite(strong):
                return None
            # with more legs than it may have it might be reached
            needs_legs = bool(front.times[best] <= until)
            beyond = bound_beyond(
                front, k, complex(place), most if needs_legs else task.settings.max_duration
            )
            return replace(
                beyond,
                is_tight=trusted and front.fastest_met(now, until) <= limit,
                limit="legs" if needs_legs else "",
            )
        route = front.route_to(best, now, True)
        fastest = max(
            fastest,
            float(np.max(np.abs(water.current.at(as_complex(route.points), now + route.times)))),
        )
        if fastest > strong:
            return None
        trusted = (
            trusted
            and front.fastest_met(
                now, float(front.times[best]), (complex(place), float(radii[k + 1]))
            )
            <= limit
        )
        now, seeds = now + float(relax(sea, route, now).times[-1]), goals
    # the mean speed has a drift after each leg, but the last one arrives without
    error = _CALM_ERROR if fastest <= _CALM * water.speed else error
    # straight there with the fastest current of all
    straight = (
        float(np.sum(np.maximum(np.abs(np.diff(places)) - radii[1:] - radii[:-1], 0.0)))
        / sea.fastest
    )
    return Bound(
        max((error * now if trusted else straight) - task.settings.surface_time, 0.0),
        most,
        is_tight=trusted,
    )


def _disc(place: complex, radius: float) -> Complex:
    """Return places on the edge of a disc and its middle [m]; the middle alone of one without a radius."""
    return (
        np.append(directions_around(place, radius, _ON_DISC), place)
        if radius > 0.0
        else np.array([place])
    )


def _lead(task: Task, water: MeanCurrent) -> Lead:
    """Return what the vehicle of the bound is given so that no mission leads ahead of it."""
    lead, drift = lead_of(task, _by_level(task)), task.settings.surface_time
    # a drift after the last leg is taken off the bound's time; in it the current may carry the vehicle away from the goal
    at = np.repeat(task.places[-1:], water.current.times.size)
    away = float(np.max(np.abs(water.current.at(at, water.current.times)))) - lead.speed
    goals = np.append(lead.goals[:-1], max(lead.goals[-1] + drift * away, 0.0))
    return replace(lead, speed=lead.speed + _second_order(task), goals=goals)


def _second_order(task: Task) -> float:
    """Return what a vehicle gains at most from the shear of the current within a dive and its drift [m/s].

    The deviation w of the current from its mean over a dive of time t carries the vehicle off its mean track by t / (2 pi) times w in the
    root mean square at most (Wirtinger's inequality), to where w differs by some w / l, l the kernel length: w^2 t / (2 pi l) in the mean.
    The largest w around start and goals, in the forecast's region, counts, at any time of the mission.
    """
    flow = task.flow
    drift = task.settings.surface_time
    by_level = _by_level(task)
    dive = (task.leg_time() - drift) / task.settings.yos + drift
    shares = shares_of_levels(flow, task.settings.depth, drift / task.leg_time())
    deviation = by_level - (by_level @ shares)[..., None]
    largest = float(np.max(np.sum(deviation**2, axis=0) @ np.maximum(shares, 0.0)))
    kernel = flow.horizontal.kernel
    return dive * largest / (2.0 * np.pi * min(kernel.length_east, kernel.length_north))


def _by_level(task: Task) -> Array:
    """Return the current of each level that a mission may meet [m/s], shape (2, n, Z)."""
    return currents_around(task, task.currents_through()[1])


def lead_of(task: Task, by_level: Array) -> Lead:
    """Return the lead of a mission.

    Args:
        task: The mission.
        by_level: shape (2, n, Z) [m/s], the current of each level wherever and whenever it may be met.
    """
    drift = task.settings.surface_time
    first, full, last = _legs(task, 3)
    speed = float(np.max(np.divide(*_ways(task, by_level, full, drift))))

    def ahead(leg: YoDepths, then: float = 0.0) -> float:
        way, lasts = _ways(task, by_level, leg, then)
        # whole legs are not ahead but for rounding
        return max(round(float(np.max(way - speed * lasts)), 3), 0.0)

    goals = [
        # a goal on the way is passed within a dive, or after a whole leg and its drift
        max((ahead(part) for part in _down_to(full, float(depth))), default=0.0)
        for depth in task.goals[:-1, 2]
    ]
    return Lead(
        speed,
        ahead(first, drift),
        np.array([*goals, max(ahead(last), ahead(_legs(task, 1)[0]))]),
    )


def _legs(task: Task, count: int) -> tuple[YoDepths, ...]:
    return yo_depths(task.turns(np.full(count, task.settings.depth)))


def currents_around(task: Task, latent: Array) -> Array:
    """Return the current of each level [m/s], shape (2, n, Z), at places around start and goals, in all of T times.

    Args:
        task: The mission.
        latent: shape (M, Z T), all levels of the first time first.
    """
    flow = task.flow
    kernel, ends = flow.horizontal.kernel, np.vstack([task.start, task.goals])[:, :2]
    lengths = np.array([kernel.length_east, kernel.length_north])
    # beyond its region the flow is no estimate of a current
    corners = np.array(
        [[pick(axis) for axis in (flow.grid.east, flow.grid.north)] for pick in (np.min, np.max)]
    )
    low, high = np.clip(
        [ends.min(axis=0) - _AROUND * lengths, ends.max(axis=0) + _AROUND * lengths], *corners
    )
    counts = np.ceil((high - low) / lengths * _SAMPLES).astype(int) + 1
    points = np.stack(
        np.meshgrid(*(np.linspace(low[i], high[i], counts[i]) for i in (0, 1))), axis=-1
    ).reshape(-1, 2)
    return np.asarray(flow.horizontal.velocity(points, latent)).reshape(2, -1, flow.levels.size)


def _ways(task: Task, by_level: Array, leg: YoDepths, drift: float) -> tuple[Array, Array]:
    """Return how far a leg and a drift [s] lead at some glide angles at most, beside the mean current [m], and how long they last [s]."""
    flow, whole = task.flow, task.settings.surface_time
    along, down = task.vehicle.speeds(np, np.linspace(*task.vehicle.angles, _ANGLES))
    dives, heights = zip(
        *((_mean_weights(task, begin, end), abs(end - begin)) for begin, end in pairwise(leg)),
        strict=True,
    )
    lasts = sum(heights) / np.asarray(down)
    own = np.average(dives, axis=0, weights=heights)
    surface = depth_weights(flow.depth_functions, np.zeros(1), flow.levels)[0]
    mean = shares_of_levels(flow, task.settings.depth, whole / task.leg_time())
    weights = lasts[:, None] * own + drift * surface - (lasts + drift)[:, None] * mean
    beside = np.linalg.norm(by_level @ weights.T, axis=0).max(axis=0)
    return np.asarray(along * lasts + beside), lasts + drift


def _mean_weights(task: Task, begin: float, end: float) -> Array:
    """Return the weights of the levels, shape (Z,), in the mean between two depths [m]."""
    return np.asarray(
        depth_weights(
            task.flow.depth_functions, np.linspace(begin, end, _DEPTHS), task.flow.levels
        ).mean(axis=0)
    )


def _down_to(leg: YoDepths, depth: float) -> list[YoDepths]:
    """Return the parts of a leg up to where it passes a depth [m] below the surface."""
    passes = [
        k
        for k, (begin, end) in enumerate(pairwise(leg))
        if min(begin, end) < depth <= max(begin, end)
    ]
    return [(*leg[: k + 1], depth) for k in passes]


def bound_beyond(front: Front, goal: int, place: complex, until: float) -> Bound:
    """Return how near one can come to a goal that a front does not reach in time.

    Args:
        front: From the place before it.
        goal: Its number, from 0.
        place: Where it is [m], east + i north.
        until: When the mission ends at the latest [s].
    """
    reached = replace(front, times=np.where(front.times <= until, front.times, inf))
    return Bound(inf, until, goal, *reached.approach(place, until))


def limit_of(task: Task, current: CurrentLattice, speed: float, goal: int) -> Limit:
    """Return what keeps a goal out of reach of any number of legs, by the time that the way there takes in still water.

    Args:
        task: The mission.
        current: On its lattice.
        speed: Of the vehicle through water [m/s].
        goal: Number of the goal, from 0.
    """
    still = replace(current, times=np.zeros(1), values=np.zeros_like(current.values[:1]))
    obstacles = obstacles_of((*task.rings, *task.bottom.rings(LEAST_DIVE)), 0.0, task.places)
    sea, now = sea_of(still, speed, task.places[: goal + 2], obstacles), np.zeros(1)
    for number in current.places.size + np.arange(goal + 1):
        now = spread(sea, np.array([number]), now, inf, np.array([number + 1])).times[[number + 1]]
    if np.isinf(now[0]):
        return "ways"
    return "duration" if now[0] > task.settings.max_duration else "current"
