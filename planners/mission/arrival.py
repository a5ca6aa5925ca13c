"""The earliest arrival of a mission: the route past its goals, a lower bound of the time that any vehicle of its speed takes, and a guess.

The front knows the mean current of the dives and drifts, and the greatest horizontal speed in the mean of both. The bound gives the vehicle
every doubt: no margin, half-open water counts as open, it may wait, the goals' discs are enough, its speed is raised by the second-order
terms of shear within a dive, and the time is lowered by the lattice's own error.
"""

from dataclasses import dataclass
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
# Kernel lengths around start and goals within which shear counts, and points that it is looked up at in each.
_AROUND, _SAMPLES = 1.5, 2.0
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
    times, latent = np.zeros(1), task.currents.latent[0]
    if task.currents.times is not None:
        times = task.currents.times - task.start_time
        last = longest_time(task)
        # what lies before the start or after the end counts through the nearest time alone
        keep = np.flatnonzero(
            (np.append(times[1:], inf) > 0.0) & (np.append(-inf, times[:-1]) < last)
        )
        columns = (keep[:, None] * flow.levels.size + np.arange(flow.levels.size)).ravel()
        times, latent = times[keep], latent[:, columns]
    shares = shares_of_levels(flow, task.settings.depth, drift_share)
    along = float(task.vehicle.speeds(np, angle)[0])
    return Water(
        current_lattice(flow, latent, times, spacing_over(flow, finer), shares),
        (1.0 - drift_share) * along,
    )


def longest_time(task: MissionTask) -> float:
    """Return the time of the longest mission considered [s]."""
    settings = task.settings
    legs = (settings.legs or settings.max_legs) * task.leg_time(task.vehicle.angles[0])
    return min(legs, settings.max_duration)


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
    places = _places(task)
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
    bound = _bound_in(task, water, _LATTICE_ERROR, _STRONG * water.speed)
    if bound is not None:
        return water, bound
    finer = water_of(task, _FINER)
    bound = _bound_in(task, finer, _STRONG_ERROR, inf)
    assert bound is not None, "no current is faster than infinity"
    # to come near a goal that is out of reach needs no finer lattice
    return (finer if bound.goal < 0 else water), bound


def _bound_in(task: MissionTask, water: Water, error: float, strong: float) -> Bound | None:
    """Return the bound on one lattice; None where that is not to be trusted.

    Args:
        task: The problem.
        water: Of the lattice.
        error: What its times are multiplied by where the current on the way is not calm.
        strong: A current on the way [m/s], or a goal out of reach, for which it is not to be trusted; infinite to trust it always.
    """
    places, most, radius = _places(task), longest_time(task), task.settings.tolerance
    discs = [
        np.append(directions_around(complex(place), radius, _ON_DISC), place)
        for place in places[1:]
    ]
    obstacles = obstacles_of((*task.rings, *task.bottom.rings(LEAST_DIVE)), 0.0, places)
    sea = sea_of(
        water.current,
        water.speed + _second_order(task),
        np.concatenate([places[:1], *discs]),
        obstacles,
        waits=True,
    )
    first, now, fastest = water.current.places.size, 0.0, 0.0
    seeds = np.array([first])
    for k, place in enumerate(places[1:]):
        goals = first + 1 + k * (_ON_DISC + 1) + np.arange(_ON_DISC + 1)
        if np.any(np.abs(sea.places[seeds] - place) <= radius):
            seeds = goals
            continue
        front = spread(sea, seeds, np.full(seeds.size, now), most / error, goals)
        best = int(goals[np.argmin(front.times[goals])])
        if not front.times[best] <= most / error:
            return (
                None
                if np.isfinite(strong)
                else Bound(inf, most, k, *front.approach(complex(place), most / error))
            )
        route = front.route_to(best, now, True)
        fastest = max(
            fastest,
            float(np.max(np.abs(water.current.at(as_complex(route.points), now + route.times)))),
        )
        if fastest > strong:
            return None
        now, seeds = now + float(relax(sea, route, now).times[-1]), goals
    # the mean speed has a drift after each leg, but the last one arrives without
    error = _CALM_ERROR if fastest <= _CALM * water.speed else error
    return Bound(max(error * now - task.settings.surface_time, 0.0), most)


def _second_order(task: MissionTask) -> float:
    """Return what a vehicle gains at most from the shear of the current within a dive and its drift [m/s].

    The deviation w of the current from its mean over a dive of time t carries the vehicle off its mean track by t / (2 pi) times w in the
    root mean square at most (Wirtinger's inequality), to where w differs by some w / l, l the kernel length: w^2 t / (2 pi l) in the mean.
    The largest w around start and goals, in the forecast's region, counts.
    """
    flow, angle, drift = task.flow, task.vehicle.angles[0], task.settings.surface_time
    dive = (task.leg_time(angle) - drift) / task.settings.yos + drift
    shares = shares_of_levels(flow, task.settings.depth, drift / task.leg_time(angle))
    kernel, places = flow.horizontal.kernel, np.vstack([task.start, task.goals])[:, :2]
    lengths = np.array([kernel.length_east, kernel.length_north])
    # beyond its region the flow is no estimate of a current
    corners = np.array(
        [[pick(axis) for axis in (flow.grid.east, flow.grid.north)] for pick in (np.min, np.max)]
    )
    low, high = np.clip(
        [places.min(axis=0) - _AROUND * lengths, places.max(axis=0) + _AROUND * lengths], *corners
    )
    counts = np.ceil((high - low) / lengths * _SAMPLES).astype(int) + 1
    points = np.stack(
        np.meshgrid(*(np.linspace(low[i], high[i], counts[i]) for i in (0, 1))), axis=-1
    ).reshape(-1, 2)
    by_level = flow.horizontal.velocity(points, task.currents.latent[0][:, : flow.levels.size])
    deviation = by_level - (by_level @ shares)[..., None]
    largest = float(np.max(np.sum(deviation**2, axis=0) @ np.maximum(shares, 0.0)))
    return dive * largest / (2.0 * np.pi * float(np.min(lengths)))


def _places(task: MissionTask) -> Complex:
    """Return start and goals [m], east + i north."""
    return as_complex(np.vstack([task.start, task.goals])[:, :2])


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
