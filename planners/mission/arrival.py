"""The earliest arrival of a mission: the route past its goals, a lower bound of the time that any vehicle of its speed takes, and a guess.

The front knows the mean current of the dives and drifts, and the greatest horizontal speed in the mean of both. The bound gives the vehicle
every doubt: no margin, half-open water counts as open, it may wait, the goals' discs are enough, its speed is raised by the second-order
terms of shear within a dive, and the time is lowered by the lattice's own error.
"""

from dataclasses import dataclass, replace
from math import inf

import numpy as np
import shapely

from planners.front.bound import Bound
from planners.front.current import (
    Complex,
    CurrentLattice,
    current_lattice,
    shares_of_levels,
    spacing_over,
)
from planners.front.front import sea_of, spread
from planners.front.obstacles import as_complex, directions_around, obstacles_of
from planners.front.relax import relax
from planners.front.route import Route
from planners.mission.beyond import bound_beyond, limit_of
from planners.mission.lead import Lead, currents_around, lead_of
from planners.mission.program import MissionGuess
from planners.mission.task import LEAST_DIVE, MissionTask
from planners.route.hazards import Ring
from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import true_north_halfway

# What a bound is multiplied by, for the error of the lattice against Zermelo's rays: in currents up to a share of the vehicle's speed on
# the way, where the rays were 0.12 % before the front at most, in faster ones, 0.7 %, and in strong ones.
_CALM_ERROR, _LATTICE_ERROR, _STRONG_ERROR = 0.998, 0.993, 0.985
# These shares of the vehicle's speed: of calm and of strong currents. In strong ones the lattice has so many times more lines.
_CALM, _STRONG, _FINER = 0.45, 0.75, 1.6
# Where a current within reach is faster than this share, a lattice may miss the quickest way by far.
_TRUSTED = 0.9
# Points on the edge of a goal's disc.
_ON_DISC = 12
# Margins of wider routes [m], the widest first, and the share of time that they may cost.
_WIDER, _MAY_COST = (600.0, 300.0, 150.0), 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Passage:
    """A route past all goals.

    Attributes:
        route: Past all of them, or as far as can be reached.
        passed: shape (G,), when it passes each [s].
    """

    route: Route
    passed: Array


@dataclass(frozen=True, slots=True, eq=False)
class Water:
    """What a mission's vehicle meets in the mean over a leg.

    Attributes:
        current: Since the start of the mission.
        speed: Horizontal, through water, in the mean of dives and drifts [m/s].
    """

    current: CurrentLattice
    speed: float


def water_of(task: MissionTask, finer: float = 1.0) -> Water:
    """Return the mean current of a mission's dives and drifts, over the times that it may last, and its speed in it.

    Args:
        task: The problem.
        finer: How many times more lines than usual the lattice has.
    """
    flow, angle = task.flow, task.vehicle.angles[0]
    drift_share = task.settings.surface_time / task.leg_time(angle)
    times, latent = _through(task)
    shares = shares_of_levels(flow, task.settings.depth, drift_share)
    along = float(task.vehicle.speeds(np, angle)[0])
    return Water(
        current_lattice(flow, latent, times, spacing_over(flow, finer), shares),
        (1.0 - drift_share) * along,
    )


def _through(task: MissionTask) -> tuple[Array, Array]:
    """Return the times that a mission may meet, shape (T,) [s] since its start, and the latent values then, shape (M, Z T)."""
    if task.currents.times is None:
        return np.zeros(1), task.currents.latent[0]
    times, levels = task.currents.times - task.start_time, np.arange(task.flow.levels.size)
    # what lies before the start or after the end counts through the nearest time alone
    keep = np.flatnonzero(
        (np.append(times[1:], inf) > 0.0)
        & (np.append(-inf, times[:-1]) < task.settings.max_duration)
    )
    return times[keep], task.currents.latent[0][:, (keep[:, None] * levels.size + levels).ravel()]


def longest_time(task: MissionTask) -> float:
    """Return the time of the longest mission considered [s]."""
    settings = task.settings
    return min(
        (settings.legs or settings.most_legs) * task.leg_time(task.vehicle.angles[0]),
        settings.max_duration,
    )


def passage_past_goals(
    task: MissionTask,
    water: Water,
    rings: tuple[Ring, ...],
    *,
    margin: float | None = None,
    depth: float | None = None,
    quick: bool = False,
) -> Passage:
    """Return the quickest route past all goals, or as near as it comes to the first that is out of reach.

    Args:
        task: The problem.
        water: What the vehicle meets.
        rings: What the route keeps clear of at any depth.
        margin: Distance kept from it [m]; None for that of the settings.
        depth: Of the water that it needs [m]; None for that of the settings.
        quick: Whether to stay on the lattice: a route that is somewhat longer.
    """
    shallows = task.bottom.rings(task.settings.depth if depth is None else depth)
    places = task.places
    obstacles = obstacles_of(
        (*rings, *shallows), task.settings.margin if margin is None else margin, places
    )
    sea = sea_of(water.current, water.speed, places, obstacles)
    first, now, last = water.current.places.size, 0.0, longest_time(task)
    points, times, passed = [task.start[None, :2]], [np.zeros(1)], list[float]()
    for k in range(1, places.size):
        front = spread(sea, np.array([first + k - 1]), np.array([now]), last, np.array([first + k]))
        arrives = bool(np.isfinite(front.times[first + k]))
        number = first + k if arrives else front.nearest_to(complex(places[k]))
        on_lattice = front.route_to(number, now, arrives)
        route = on_lattice if quick else relax(sea, on_lattice, now)
        points.append(route.points[1:])
        times.append(now + route.times[1:])
        now += float(route.times[-1])
        passed.append(now)
        if not arrives:
            passed += [now] * (places.size - 1 - k)
            break
    return Passage(Route(np.concatenate(points), np.concatenate(times), arrives), np.array(passed))


def is_beside(task: MissionTask, rings: tuple[Ring, ...], passage: Passage) -> bool:
    """Return whether a passage leads beside an area or land, so that a wider way may differ from it."""
    line = shapely.linestrings(passage.route.points)
    solid = [
        ring
        for ring in (*rings, *task.bottom.rings(task.settings.depth))
        if not ring.outside and not ring.surface_only
    ]
    return any(bool(shapely.dwithin(ring.area, line, _WIDER[0])) for ring in solid)


def widest_passage(
    task: MissionTask, water: Water, rings: tuple[Ring, ...], passage: Passage
) -> Passage:
    """Return the passage farthest from what it must keep clear of that takes little longer than the quickest."""
    for margin in _WIDER:
        if margin > task.settings.margin:
            wider = passage_past_goals(task, water, rings, margin=margin)
            if wider.route.arrives and wider.passed[-1] <= (1.0 + _MAY_COST) * passage.passed[-1]:
                return wider
    return passage


def bound_of(task: MissionTask) -> tuple[Water, Bound]:
    """Return the lower bound of a mission's time, or how near one can come to the first goal out of reach; and the water of its lattice.

    Where the current is about as fast as the vehicle, few edges lead where it can go, and a finer lattice is needed.
    """
    water = water_of(task)
    lead = _lead(task, water)
    bound = _bound_in(task, water, lead, _LATTICE_ERROR, _STRONG * water.speed)
    if bound is not None:
        return water, bound
    finer = water_of(task, _FINER)
    bound = _bound_in(task, finer, lead, _STRONG_ERROR, inf)
    assert bound is not None, "no current is faster than infinity"
    if bound.goal >= 0 and not bound.limit:
        bound = replace(bound, limit=limit_of(task, water.current, water.speed, bound.goal))
    # to come near a goal that is out of reach needs no finer lattice
    return (finer if bound.goal < 0 else water), bound


def _bound_in(
    task: MissionTask, water: Water, lead: Lead, error: float, strong: float
) -> Bound | None:
    """Return the bound on one lattice; None where that is not to be trusted.

    Args:
        task: The problem.
        water: Of the lattice.
        lead: Of the vehicle.
        error: What its times are multiplied by where the current on the way is not calm.
        strong: A current on the way [m/s], or a goal out of reach, for which it is not to be trusted; infinite to trust it always.
    """
    places, most = task.places, longest_time(task)
    radii = np.append(lead.start, task.settings.tolerance + lead.goals)
    discs = [
        _disc(complex(place), float(radius)) for place, radius in zip(places, radii, strict=True)
    ]
    obstacles = obstacles_of((*task.rings, *task.bottom.rings(LEAST_DIVE)), 0.0, places)
    sea = sea_of(water.current, lead.speed, np.concatenate(discs), obstacles, waits=True)
    ends = water.current.places.size + np.cumsum([0, *(disc.size for disc in discs)])
    until = (most if np.isfinite(strong) else task.settings.max_duration) / error
    now, fastest, trusted, limit, seeds = (
        0.0,
        0.0,
        True,
        _TRUSTED * water.speed,
        np.arange(ends[0], ends[1]),
    )
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


def _lead(task: MissionTask, water: Water) -> Lead:
    """Return what the vehicle of the bound is given so that no mission leads ahead of it."""
    lead, drift = lead_of(task, _by_level(task)), task.settings.surface_time
    # a drift after the last leg is taken off the bound's time; in it the current may carry the vehicle away from the goal
    at = np.repeat(task.places[-1:], water.current.times.size)
    away = float(np.max(np.abs(water.current.at(at, water.current.times)))) - lead.speed
    goals = np.append(lead.goals[:-1], max(lead.goals[-1] + drift * away, 0.0))
    return replace(lead, speed=lead.speed + _second_order(task), goals=goals)


def _second_order(task: MissionTask) -> float:
    """Return what a vehicle gains at most from the shear of the current within a dive and its drift [m/s].

    The deviation w of the current from its mean over a dive of time t carries the vehicle off its mean track by t / (2 pi) times w in the
    root mean square at most (Wirtinger's inequality), to where w differs by some w / l, l the kernel length: w^2 t / (2 pi l) in the mean.
    The largest w around start and goals, in the forecast's region, counts, at any time of the mission.
    """
    flow, angle, drift, by_level = (
        task.flow,
        task.vehicle.angles[0],
        task.settings.surface_time,
        _by_level(task),
    )
    dive = (task.leg_time(angle) - drift) / task.settings.yos + drift
    shares = shares_of_levels(flow, task.settings.depth, drift / task.leg_time(angle))
    deviation = by_level - (by_level @ shares)[..., None]
    largest = float(np.max(np.sum(deviation**2, axis=0) @ np.maximum(shares, 0.0)))
    kernel = flow.horizontal.kernel
    return dive * largest / (2.0 * np.pi * min(kernel.length_east, kernel.length_north))


def _by_level(task: MissionTask) -> Array:
    """Return the current of each level that a mission may meet [m/s], shape (2, n, Z)."""
    return currents_around(task, _through(task)[1])


def initial_guess(task: MissionTask, route: Route, water: Water, ends: Array) -> MissionGuess:
    """Return a route cut into legs at some times, shape (L + 1,) [s], with the headings that follow it in the mean current."""
    places, durations = route.at(ends), np.diff(ends)
    current = water.current.at(
        as_complex(0.5 * (places[1:] + places[:-1])), 0.5 * (ends[1:] + ends[:-1])
    )
    through = np.diff(places, axis=0) / np.maximum(durations, 1.0)[:, None] - np.column_stack(
        [current.real, current.imag]
    )
    turns = (None,) * durations.size if task.turns is None else task.turns
    angles = [
        task.angle_of(float(duration), turn)
        for duration, turn in zip(durations, turns, strict=True)
    ]
    turn = true_north_halfway(task.region.grid.projection, places[:-1], places[1:])
    return MissionGuess(
        places[1:], np.arctan2(through[:, 0], through[:, 1]) - turn, np.array(angles)
    )
