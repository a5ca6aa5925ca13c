"""The earliest arrival of a mission: the route past its goals, a lower bound of the time that any vehicle of its speed takes, and a guess.

The front knows the mean current of the dives and drifts, and the greatest horizontal speed in the mean of both. The bound gives the vehicle
every doubt: no margin, half-open water counts as open, it may wait, the goals' discs are enough, its speed is raised by the second-order
terms of shear within a dive, and the time is lowered by the lattice's own error.
"""

from dataclasses import dataclass, replace
from math import inf

import numpy as np

from planners.front.bound import Bound
from planners.front.current import Complex, CurrentLattice, current_lattice, shares_of_levels, spacing_over
from planners.front.front import Front, Numbers, sea_of, spread
from planners.front.obstacles import as_complex, directions_around, obstacles_of
from planners.front.relax import relax
from planners.front.route import Route
from planners.mission.program import MissionGuess
from planners.mission.task import LEAST_DIVE, MissionTask
from planners.route.hazards import Ring
from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import true_north_halfway

# What a bound is multiplied by: the error of the lattice against Zermelo's rays.
_LATTICE_ERROR = 0.993
# Points on the edge of a goal's disc.
_ON_DISC = 12
# Margins of wider routes [m], the widest first, and the share of time that they may cost.
_WIDER, _MAY_COST = (600.0, 300.0, 150.0), 0.02
# A route this much slower than without obstacles is bent by them.
_BENT = 1.005


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


def water_of(task: MissionTask) -> Water:
    """Return the mean current of a mission's dives and drifts, over the times that the mission may last, and its speed in it."""
    flow, angle = task.flow, task.vehicle.angles[0]
    drift_share = task.settings.surface_time / task.leg_time(angle)
    times, latent = np.zeros(1), task.currents.latent[0]
    if task.currents.times is not None:
        times = task.currents.times - task.start_time
        last = longest_time(task)
        # what lies before the start or after the end counts through the nearest time alone
        keep = np.flatnonzero((np.append(times[1:], inf) > 0.0) & (np.append(-inf, times[:-1]) < last))
        columns = (keep[:, None] * flow.levels.size + np.arange(flow.levels.size)).ravel()
        times, latent = times[keep], latent[:, columns]
    low, high = (np.array([pick(flow.grid.east), pick(flow.grid.north)]) for pick in (np.min, np.max))
    kernel = flow.horizontal.kernel
    spacing = spacing_over(low, high, min(kernel.length_east, kernel.length_north))
    shares = shares_of_levels(flow, task.settings.depth, drift_share)
    along = float(task.vehicle.speeds(np, angle)[0])
    return Water(current_lattice(flow, latent, times, spacing, shares), (1.0 - drift_share) * along)


def longest_time(task: MissionTask) -> float:
    """Return the time of the longest mission considered [s]."""
    settings = task.settings
    legs = (settings.legs or settings.max_legs) * task.leg_time(task.vehicle.angles[0])
    return min(legs, settings.max_duration)


def passage_past_goals(
    task: MissionTask, water: Water, rings: tuple[Ring, ...], *, margin: float | None = None, depth: float | None = None
) -> Passage:
    """Return the quickest route past all goals, or as near as it comes to the first that is out of reach.

    Args:
        task: The problem.
        water: What the vehicle meets.
        rings: What the route keeps clear of at any depth.
        margin: Distance kept from it [m]; None for that of the settings.
        depth: Of the water that it needs [m]; None for that of the settings.
    """
    shallows = task.bottom.rings(task.settings.depth if depth is None else depth)
    places = _places(task)
    obstacles = obstacles_of((*rings, *shallows), task.settings.margin if margin is None else margin, places)
    sea = sea_of(water.current, water.speed, places, obstacles)
    first, now, last = sea.free.size - places.size - obstacles.corners.size, 0.0, longest_time(task)
    points, times, passed = [task.start[None, :2]], [np.zeros(1)], list[float]()
    for k in range(1, places.size):
        front = spread(sea, np.array([first + k - 1]), np.array([now]), last, np.array([first + k]))
        arrives = bool(np.isfinite(front.times[first + k]))
        number = first + k if arrives else front.nearest_to(complex(places[k]))[0]
        route = relax(sea, front.route_to(number, now, arrives), now)
        points.append(route.points[1:])
        times.append(now + route.times[1:])
        now += float(route.times[-1])
        passed.append(now)
        if not arrives:
            passed += [now] * (places.size - 1 - k)
            break
    return Passage(Route(np.concatenate(points), np.concatenate(times), arrives), np.array(passed))


def is_bent(task: MissionTask, water: Water, passage: Passage) -> bool:
    """Return whether obstacles make a passage slower, so that without them the path would cross one."""
    edges = tuple(ring for ring in task.rings if ring.outside)
    sea = sea_of(water.current, water.speed, _places(task), obstacles_of(edges, 0.0, _places(task)))
    first, now = sea.free.size - 1 - len(task.goals) - (0 if sea.obstacles is None else sea.obstacles.corners.size), 0.0
    for k in range(1, len(task.goals) + 1):
        front = spread(sea, np.array([first + k - 1]), np.array([now]), inf, np.array([first + k]))
        now = float(front.times[first + k])
    return bool(passage.route.times[-1] > _BENT * now)


def widest_passage(task: MissionTask, water: Water, rings: tuple[Ring, ...], passage: Passage) -> Passage:
    """Return the passage farthest from what it must keep clear of that takes little longer than the quickest."""
    for margin in _WIDER:
        if margin > task.settings.margin:
            wider = passage_past_goals(task, water, rings, margin=margin)
            if wider.route.arrives and wider.passed[-1] <= (1.0 + _MAY_COST) * passage.passed[-1]:
                return wider
    return passage


def bound_of(task: MissionTask, water: Water) -> Bound:
    """Return the lower bound of a mission's time, or how near one can come to the first goal that is out of reach."""
    places, most, radius = _places(task), longest_time(task), task.settings.tolerance
    discs = [np.append(directions_around(complex(place), radius, _ON_DISC), place) for place in places[1:]]
    obstacles = obstacles_of((*task.rings, *task.bottom.rings(LEAST_DIVE)), 0.0, places)
    sea = sea_of(water.current, water.speed + _second_order(task, water), np.concatenate([places[:1], *discs]), obstacles, waits=True)
    # a disc may lie on land in part
    first = water.current.places.size
    seeds, now = np.array([first]), 0.0
    for k in range(len(discs)):
        goals = first + 1 + k * (_ON_DISC + 1) + np.arange(_ON_DISC + 1)
        inside = np.abs(sea.places[seeds] - places[k + 1]) <= radius
        front = spread(sea, seeds, np.full(seeds.size, now), most / _LATTICE_ERROR, np.zeros(0, dtype=int) if inside.any() else goals)
        if not inside.any():
            now = float(np.min(front.times[goals]))
        if not np.isfinite(now) or _LATTICE_ERROR * now > most:
            number, nearest = front.nearest_to(complex(places[k + 1]))
            return Bound(inf, most, k, nearest, float(front.times[number]))
        now = _relaxed_time(front, goals, now, inside.any())
        seeds = goals
    return Bound(_LATTICE_ERROR * now, most)


def _relaxed_time(front: Front, goals: Numbers, now: float, inside: bool) -> float:
    """Return the time of the earliest arrival [s] after its route is relaxed off the lattice."""
    if inside:
        return now
    best = int(goals[np.argmin(front.times[goals])])
    route = front.route_to(best, 0.0, True)
    begins = float(route.times[0])
    return begins + float(relax(front.sea, replace(route, times=route.times - begins), begins).times[-1])


def _second_order(task: MissionTask, water: Water) -> float:
    """Return what a vehicle gains at most from the shear of the current within a dive and its drift [m/s].

    It is carried off its mean track by the shear times a quarter of the dive's time at most, to where the current differs from that of the
    track by as much over a kernel length: both are the current's deviation from its mean over depth.
    """
    flow, angle = task.flow, task.vehicle.angles[0]
    drift = task.settings.surface_time
    dive = (task.leg_time(angle) - drift) / task.settings.yos + drift
    shares = shares_of_levels(flow, task.settings.depth, drift / task.leg_time(angle))
    places = water.current.places
    points = np.column_stack([places.real, places.imag])[:: max(places.size // 600, 1)]
    by_level = flow.horizontal.velocity(points, task.currents.latent[0][:, : flow.levels.size])
    deviation = by_level - (by_level @ shares)[..., None]
    variance = float(np.max(np.sum(deviation**2, axis=0) @ np.maximum(shares, 0.0)))
    kernel = flow.horizontal.kernel
    return 0.25 * dive * variance / min(kernel.length_east, kernel.length_north)


def _places(task: MissionTask) -> Complex:
    """Return start and goals [m], east + i north."""
    return as_complex(np.vstack([task.start, task.goals])[:, :2])


def initial_guess(task: MissionTask, route: Route, water: Water, ends: Array) -> MissionGuess:
    """Return a route cut into legs at some times, shape (L + 1,) [s], with the headings that follow it in the mean current."""
    places, durations = route.at(ends), np.diff(ends)
    current = water.current.at(as_complex(0.5 * (places[1:] + places[:-1])), 0.5 * (ends[1:] + ends[:-1]))
    through = np.diff(places, axis=0) / np.maximum(durations, 1.0)[:, None] - np.column_stack([current.real, current.imag])
    turns = (None,) * durations.size if task.turns is None else task.turns
    angles = [task.angle_of(float(duration), turn) for duration, turn in zip(durations, turns, strict=True)]
    turn = true_north_halfway(task.region.grid.projection, places[:-1], places[1:])
    return MissionGuess(places[1:], np.arctan2(through[:, 0], through[:, 1]) - turn, np.array(angles))
