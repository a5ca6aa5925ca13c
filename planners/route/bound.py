"""Lower bound of a mission's time, and the closest approach to a goal out of reach.

A front propagates at the greatest mean horizontal speed in the mean current of dives and drifts. All approximations favour the vehicle:
no margin, partly open water is open, waiting is allowed, goals are discs, second-order terms of shear within a dive increase the speed,
and the discretisation error reduces the time.

A leg of duration T at glide angle g, and a drift d after it, lead over ground by V(g) T through water and by the currents at the leg's
depths and at the surface. In the same time the vehicle of the bound moves S (T + d) plus the mean current m (T + d). Steep dives are
short, so that drifts take a larger fraction of the time. The last leg has no drift; the first may begin, and the last end, below the
surface. In a sheared current each of these may gain on the mean by at most the lead (``Lead``).
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from math import inf
from typing import Literal

import numpy as np

from planners.route.current import Complex, CurrentLattice, shares_of_levels
from planners.route.front import Front, sea_of, spread_front
from planners.route.obstacles import as_complex, directions_around, obstacles_of
from planners.route.passage import MeanCurrent, mean_current, relax
from planners.task import LEAST_DIVE, Task, YoDepths, yo_depths
from replay_kit.core.arrays import Array, points_over

# What a bound is multiplied by, for the error of the lattice against Zermelo's rays: in currents up to a share of the vehicle's speed on
# the way, where the rays were 0.12 % before the front at most, in faster ones, 0.7 %, and in strong ones.
_CALM_ERROR, _LATTICE_ERROR, _STRONG_ERROR = 0.998, 0.993, 0.985
# These shares of the vehicle's speed: of calm and of strong currents.
_CALM, _STRONG = 0.45, 0.75
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
    """Lower bound of a mission for any vehicle of its speed.

    Attributes:
        time: Earliest arrival within the tolerance of the last goal, after all others [s]; infinite if out of reach.
        most: Largest mission duration [s].
        goal: Number of the first goal out of reach, from 0; -1 without one.
        nearest: Closest approach to that goal [m].
        when: Time of the closest approach [s].
        is_tight: Whether the bound is tight. In a current about as fast as the vehicle it is the straight distance in the fastest current,
            and goals out of reach of the lattice may be reachable.
        limit: Limit that keeps it out of reach: ``legs``, too few for the route; ``duration``, too short even in still water; ``ways``, no
            open route; or ``current``. Empty without one.
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
    """Allowances for the vehicle of a bound, so that no real mission overtakes it.

    Attributes:
        speed: Horizontal speed through water [m/s].
        start: Largest offset from the start [m].
        goals: Passing distance of each goal in addition to the tolerance, shape (G,) [m].
    """

    speed: float
    start: float
    goals: Array


def bound_of(task: Task) -> tuple[MeanCurrent, Bound]:
    """Return the mean current on a lattice and the lower bound of a mission's time or closest approach."""
    water, places, most = mean_current(task), task.places, task.longest
    lead = _lead(task, water)
    radii = np.append(lead.start, task.settings.tolerance + lead.goals)
    discs = [
        _disc(complex(place), float(radius)) for place, radius in zip(places, radii, strict=True)
    ]
    obstacles = obstacles_of(task.solid(LEAST_DIVE), 0.0, places)
    sea = sea_of(water.current, lead.speed, np.concatenate(discs), obstacles, waits=True)
    ends = water.current.places.size + np.cumsum([0, *(disc.size for disc in discs)])
    until = task.settings.max_duration / _STRONG_ERROR
    now, fastest, trusted = 0.0, 0.0, True
    seeds = np.arange(ends[0], ends[1])
    for k, place in enumerate(places[1:]):
        goals = np.arange(ends[k + 1], ends[k + 2])
        if np.any(np.abs(sea.places[seeds] - place) <= radii[k + 1]):
            seeds = goals
            continue
        front = spread_front(sea, seeds, np.full(seeds.size, now), until, goals)
        best, slowest = int(goals[np.argmin(front.times[goals])]), _TRUSTED * water.speed
        if not front.times[best] <= most / _STRONG_ERROR:
            # with more legs than it may have it might be reached
            needs_legs = bool(front.times[best] <= until)
            last = most if needs_legs else task.settings.max_duration
            beyond = bound_beyond(front, k, complex(place), last)
            limit = "legs" if needs_legs else limit_of(task, water.current, water.speed, k)
            tight = trusted and front.fastest_met(now, until) <= slowest
            return water, replace(beyond, is_tight=tight, limit=limit)
        route = front.route_to(best, now, True)
        met = water.current.at(as_complex(route.points), now + route.times)
        fastest = max(fastest, float(np.max(np.abs(met))))
        disc = complex(place), float(radii[k + 1])
        trusted = trusted and front.fastest_met(now, float(front.times[best]), disc) <= slowest
        now, seeds = now + float(relax(sea, route, now).times[-1]), goals
    # the mean speed has a drift after each leg, but the last one arrives without
    error = _LATTICE_ERROR if fastest <= _STRONG * water.speed else _STRONG_ERROR
    error = _CALM_ERROR if fastest <= _CALM * water.speed else error
    # straight there with the fastest current of all
    apart = np.abs(np.diff(places)) - radii[1:] - radii[:-1]
    straight = float(np.sum(np.maximum(apart, 0.0))) / sea.fastest
    time = max((error * now if trusted else straight) - task.settings.surface_time, 0.0)
    return water, Bound(time, most, is_tight=trusted)


def _disc(place: complex, radius: float) -> Complex:
    """Return the centre and points on the edge of a disc [m]; only the centre for a zero radius."""
    return (
        np.append(directions_around(place, radius, _ON_DISC), place)
        if radius > 0.0
        else np.array([place])
    )


def _lead(task: Task, water: MeanCurrent) -> Lead:
    """Return the allowances for the vehicle of the bound."""
    lead, drift = lead_of(task, _by_level(task)), task.settings.surface_time
    # a drift after the last leg is taken off the bound's time; in it the current may carry the vehicle away from the goal
    at = np.repeat(task.places[-1:], water.current.times.size)
    away = float(np.max(np.abs(water.current.at(at, water.current.times)))) - lead.speed
    goals = np.append(lead.goals[:-1], max(lead.goals[-1] + drift * away, 0.0))
    return replace(lead, speed=lead.speed + _second_order(task), goals=goals)


def _second_order(task: Task) -> float:
    """Return the largest gain from the shear of the current within a dive and its drift [m/s].

    The deviation w of the current from its mean over a dive of time t carries the vehicle off its mean track by t / (2 pi) times w in the
    root mean square at most (Wirtinger's inequality), to where w differs by some w / l, l the kernel length: w^2 t / (2 pi l) in the mean.
    The largest w around start and goals, in the forecast's region, counts, at any time of the mission.
    """
    drift, by_level = task.settings.surface_time, _by_level(task)
    dive = (task.leg_time() - drift) / task.settings.yos + drift
    shares = shares_of_levels(task.currents, task.settings.depth, drift / task.leg_time())
    deviation = by_level - (by_level @ shares)[..., None]
    largest = float(np.max(np.sum(deviation**2, axis=0) @ np.maximum(shares, 0.0)))
    return dive * largest / (2.0 * np.pi * float(task.flow.horizontal.kernel.lengths.min()))


def _by_level(task: Task) -> Array:
    """Return the currents by level that a mission may meet, shape (2, n, Z) [m/s]."""
    return currents_around(task, task.currents_through()[1])


def lead_of(task: Task, by_level: Array) -> Lead:
    """Return the allowances of a mission's bound.

    Args:
        task: Mission.
        by_level: Current of each level at all reachable positions and times, shape (2, n, Z) [m/s].
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
        speed, ahead(first, drift), np.array([*goals, max(ahead(last), ahead(_legs(task, 1)[0]))])
    )


def _legs(task: Task, count: int) -> tuple[YoDepths, ...]:
    return yo_depths(task.turns(np.full(count, task.settings.depth)))


def currents_around(task: Task, latent: Array) -> Array:
    """Return the current of each level around start and goals at all times, shape (2, n, Z) [m/s].

    Args:
        task: Mission.
        latent: Latent values, shape (M, Z T), all levels of the first time first.
    """
    flow, ends = task.flow, np.vstack([task.start, task.goals])[:, :2]
    lengths = flow.horizontal.kernel.lengths
    # beyond its region the flow is no estimate of a current
    low, high = np.clip(
        [ends.min(axis=0) - _AROUND * lengths, ends.max(axis=0) + _AROUND * lengths],
        *flow.grid.ends,
    )
    counts = np.ceil((high - low) / lengths * _SAMPLES).astype(int) + 1
    points = points_over(*(np.linspace(*span) for span in zip(low, high, counts, strict=True)))
    return np.asarray(flow.horizontal.velocity(points, latent)).reshape(2, -1, flow.levels.size)


def _ways(task: Task, by_level: Array, leg: YoDepths, drift: float) -> tuple[Array, Array]:
    """Return the largest displacements relative to the mean current [m] of a leg and a drift [s], and durations [s], by glide angle."""
    currents, whole = task.currents, task.settings.surface_time
    along, down = task.vehicle.speeds(np, np.linspace(*task.vehicle.angles, _ANGLES))
    ends = list(pairwise(leg))
    heights = [abs(end - begin) for begin, end in ends]
    dives = [currents.weights(np.linspace(*both, _DEPTHS)).mean(axis=0) for both in ends]
    lasts = sum(heights) / np.asarray(down)
    in_dives = np.average(dives, axis=0, weights=heights)
    surface = currents.weights(np.zeros(1))[0]
    mean = shares_of_levels(currents, task.settings.depth, whole / task.leg_time())
    weights = lasts[:, None] * in_dives + drift * surface - (lasts + drift)[:, None] * mean
    beside = np.linalg.norm(by_level @ weights.T, axis=0).max(axis=0)
    return np.asarray(along * lasts + beside), lasts + drift


def _down_to(leg: YoDepths, depth: float) -> list[YoDepths]:
    """Return the parts of a leg up to each passage of a depth [m]."""
    passes = [
        k
        for k, (begin, end) in enumerate(pairwise(leg))
        if min(begin, end) < depth <= max(begin, end)
    ]
    return [(*leg[: k + 1], depth) for k in passes]


def bound_beyond(front: Front, goal: int, place: complex, until: float) -> Bound:
    """Return the bound for a goal that a front does not reach in time.

    Args:
        front: Front from the previous goal.
        goal: Number of the goal, from 0.
        place: Position of the goal [m], east + i north.
        until: Latest end of the mission [s].
    """
    reached = replace(front, times=np.where(front.times <= until, front.times, inf))
    return Bound(inf, until, goal, *reached.approach(place, until))


def limit_of(task: Task, current: CurrentLattice, speed: float, goal: int) -> Limit:
    """Return the limit that keeps a goal out of reach, from the travel time in still water.

    Args:
        task: Mission.
        current: Current on a lattice.
        speed: Speed through water [m/s].
        goal: Number of the goal, from 0.
    """
    still = replace(current, times=np.zeros(1), values=np.zeros_like(current.values[:1]))
    obstacles = obstacles_of(task.solid(LEAST_DIVE), 0.0, task.places)
    sea, now = sea_of(still, speed, task.places[: goal + 2], obstacles), np.zeros(1)
    for number in current.places.size + np.arange(goal + 1):
        now = spread_front(sea, np.array([number]), now, inf, np.array([number + 1])).times[
            [number + 1]
        ]
    if np.isinf(now[0]):
        return "ways"
    return "duration" if now[0] > task.settings.max_duration else "current"
