"""A glider that heads for waypoints on its own: at each surfacing it corrects for the mean current of its last dive.

What it expects in its first dive nobody knows: nothing where it was just put to sea, else what its dives before have met. A list of
waypoints is flown with several of these.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray

from planners.clearance import Violation, check, clearances
from planners.request import MissionPlan
from planners.simulation.currents import Currents
from planners.simulation.fly import DRIFT_STEPS, Flight, Legs, Path, fly_leg
from planners.simulation.steer import mean_current
from planners.task import Task
from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_geographic, to_local, true_north_halfway

# Legs flown at most for each one planned, and beside.
_LEGS_EACH, _LEGS_MORE = 2, 3
# Share of a plan's margin that is kept: its own legs come to the margin less the error of the optimiser's current.
_AS_FAR = 0.8
# Share of the full depth that the shallowest dive to a near waypoint goes.
_SHALLOWEST = 0.1
# Parts of a full depth to which dives of many gliders are rounded.
_SHARES = 0.05
# Depths of a dive over which its mean current is taken.
_DEPTHS = 20
# Standard errors to the edge of an ellipse that holds 95 % of a normal distribution in the plane.
_INSIDE = float(np.sqrt(-2.0 * np.log(0.05)))
# Points spread evenly over the unit disc, shape (n, 2), each turned by the golden angle from the one before (Vogel 1979).
_NUMBERS = np.arange(24)
_TURNS = np.pi * (3.0 - np.sqrt(5.0)) * _NUMBERS
_DISC = np.sqrt((_NUMBERS + 0.5) / _NUMBERS.size)[:, None] * np.column_stack(
    [np.sin(_TURNS), np.cos(_TURNS)]
)


@dataclass(frozen=True, slots=True, eq=False)
class WaypointList:
    """What a glider is given: W places, and the dives on the way to each.

    Attributes:
        kept: Numbers of the plan's legs, counted from 1, whose ends are the waypoints.
        radius: Within which a waypoint counts as reached [m].
        places: shape (W, 2) [m].
        angles: shape (W,), glide angle on the way to each [rad].
        depths: shape (W,), depth of the dives on the way to each [m].
    """

    kept: tuple[int, ...]
    radius: float
    places: Array
    angles: Array
    depths: Array

    @classmethod
    def of(
        cls, task: Task, plan: MissionPlan, kept: tuple[int, ...], radius: float
    ) -> "WaypointList":
        """Return the list of some legs' ends, with their mean glide angle and the shallowest of their dives."""
        ends = np.column_stack(to_local(task.region.grid.projection, *plan.surfacings.T))
        angles, turns = (
            np.deg2rad(plan.glide_angles_deg),
            np.array([max(leg[1:]) for leg in plan.yo_depths]),
        )
        spans = list(pairwise([0, *kept]))
        return cls(
            kept,
            radius,
            ends[np.array(kept) - 1],
            np.array([np.mean(angles[begin:end]) for begin, end in spans]),
            np.array([np.min(turns[begin:end]) for begin, end in spans]),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """Waypoints headed for with one current expected in the first dive.

    Attributes:
        few: The waypoints.
        first_current: shape (2,), expected in the first dive [m/s].
        times: shape (W,), when each is reached [s]; NaN for those that are not.
        path: (place [m], time [s]) of the start and of each surfacing.
        violation: What it crosses first, or that it was not checked to the end; None when it keeps clear.
    """

    few: WaypointList
    first_current: Array
    times: Array
    path: list[tuple[Array, float]]
    violation: Violation | None


def first_currents(task: Task, plan: MissionPlan, legs: Legs) -> list[Array]:
    """Return the currents that a glider may expect in its first dive [m/s], each shape (2,), local east and north.

    First that of the plan's first leg; then none, as of a glider that was just put to sea; then, where the estimate knows its errors, what
    it may have met there: currents spread evenly over the ellipse that holds 95 % of the dive's mean currents.
    """
    begin = task.start[None, :2]
    end = np.column_stack(to_local(task.region.grid.projection, *plan.surfacings[:1].T))
    height = float(np.sum(np.abs(np.diff(legs.turns[:, 0]))))
    flown = plan.vehicle, (legs.headings[:1], legs.angles[:1]), height
    lasts, projection = plan.surfacing_times[:1], task.region.grid.projection
    planned = mean_current(projection, flown, (begin, end), lasts)[0]
    if not task.flow.n_modes:
        return [planned, np.zeros(2)]
    depths = np.linspace(0.0, float(np.max(legs.turns[:, 0])), _DEPTHS)
    of_points = task.flow.velocity_covariance(begin[0, 0], begin[0, 1], depths).reshape(
        2, _DEPTHS, 2, _DEPTHS
    )
    variances, axes = np.linalg.eigh(of_points.mean(axis=(1, 3)))
    root = axes * np.sqrt(np.maximum(variances, 0.0)) @ axes.T
    return [planned, np.zeros(2), *(planned + _INSIDE * _DISC @ root)]


def follow(
    task: Task,
    plan: MissionPlan,
    lists: Sequence[WaypointList],
    first_currents: Sequence[Array],
    currents: Currents | None = None,
    corrects: NDArray[np.bool_] | None = None,
) -> list[Followed]:
    """Return the flights of K gliders that head for waypoints, each until the last is reached.

    Args:
        task: The current of the estimate, and what they must keep clear of.
        plan: The mission.
        lists: The waypoints of each: the same places, each within its own radius.
        first_currents: K of shape (2,), that each expects in its first dive [m/s], local east and north.
        currents: K flows, that each meets; None for the estimate.
        corrects: shape (K,), whether it corrects for the current of its last dive, or heads straight at the waypoint; None where all do.
    """
    settings, projection, count = plan.settings, task.region.grid.projection, len(first_currents)
    few, radius = lists[0], np.array([one.radius for one in lists])
    goals = np.column_stack(to_local(projection, *plan.surfacings.T))[np.array(plan.goal_legs) - 1]
    margin = _margin(task, settings.margin, np.vstack([task.start[None, :2], goals]))
    at, now, target = np.tile(task.start[:2], (count, 1)), np.zeros(count), np.zeros(count, int)
    counts = (np.ones(count) if corrects is None else corrects.astype(np.float64))[:, None]
    current = np.array(first_currents) * counts
    times, under_way = np.full((count, len(few.kept)), np.nan), np.arange(count)
    paths = [[(task.start[:2], 0.0)] for _ in range(count)]
    met = task.currents if currents is None else currents
    clock = met.clock(plan.start_time_ns)
    violations: list[Violation | None] = [None] * count
    for number in range(_LEGS_EACH * len(plan.headings_deg) + _LEGS_MORE):
        if under_way.size == 0:
            break
        these, begin = under_way, plan.yo_depths[0][0] if number == 0 else 0.0
        headings, depths = _steered(task, plan, few, at[these], target[these], current[these])
        turns = np.zeros((2 * settings.yos + 1, these.size))
        turns[0], turns[1::2] = begin, np.maximum(depths, begin)
        angles, drift = few.angles[target[these]], np.full(these.size, settings.surface_time)
        meets = met if currents is None else met.some(these)
        whole = at[these], clock + now[these]
        path = fly_leg(meets, plan.vehicle, whole, (headings, angles), turns, drift)
        found = _violations(task, path, turns, margin, currents is None)
        since = path.times - path.times[0]
        surfaced, drifted = ((path.places[k], since[k][:, None]) for k in (-1 - DRIFT_STEPS, -1))
        away = np.linalg.norm(surfaced[0] - few.places[target[these]], axis=1)
        arrived = away <= radius[these]
        last = arrived & (target[these] == len(few.kept) - 1)
        # the last drift does not count
        ends, lasts = (np.where(last[:, None], surfaced[i], drifted[i]) for i in (0, 1))
        heights = np.sum(np.abs(np.diff(turns, axis=0)), axis=0)
        held = plan.vehicle, (headings, angles), heights
        own = mean_current(projection, held, (at[these], ends), lasts[:, 0])
        current[these] = counts[these] * own
        reached = now[these] + surfaced[1][:, 0]
        times[these[arrived], target[these[arrived]]] = reached[arrived]
        for k, one, end, then in zip(these, found, ends, now[these] + lasts[:, 0], strict=True):
            if one is not None and violations[k] is None:
                violations[k] = replace(one, time=one.time + now[k], leg=number + 1)
            paths[k].append((end, float(then)))
        at[these], now[these] = ends, now[these] + lasts[:, 0]
        target[these] += arrived & ~last
        under_way = these[~last]
    if _has_hazards(task, float(few.depths.max())):
        for k in under_way:
            violations[k] = violations[k] or _unchecked(task, int(target[k]), paths[k])
    return [
        Followed(*one) for one in zip(lists, first_currents, times, paths, violations, strict=True)
    ]


def _steered(
    task: Task,
    plan: MissionPlan,
    few: WaypointList,
    at: Array,
    target: NDArray[np.intp],
    current: Array,
) -> tuple[Array, Array]:
    """Return the headings [rad] and the depths [m], shape (K,) each, of gliders at some places on the way to their waypoints."""
    deep = few.depths[target]
    way = few.places[target] - at
    local, share = heading_for(plan, way, few.angles[target], current, deep)
    # many are flown together in few kinds of dives
    share = np.maximum(np.round(share / _SHARES) * _SHARES, _SHALLOWEST)
    heading = local - true_north_halfway(task.region.grid.projection, at, at)
    return heading, share * deep


def _violations(
    task: Task, path: Path, turns: Array, margin: float, exactly: bool
) -> list[Violation | None]:
    """Return what each of K gliders crosses in a leg; of samples, not exactly, without the margin and where it begins."""
    found: list[Violation | None] = [None] * turns.shape[1]
    for profile in np.unique(turns, axis=1).T:
        alike = np.flatnonzero(np.all(turns == profile[:, None], axis=0))
        places, times = path.places[:, alike].transpose(1, 0, 2), path.times[:, alike].T
        depth, count = path.depths[:, alike[0]], times.shape[1]
        numbers, ends = np.zeros(count, dtype=int), np.array([count - 1])
        whole = Flight(times - times[:, :1], depth, places, numbers, ends)
        near = np.flatnonzero(_near_hazards(task, whole, margin))
        if not near.size:
            continue
        part = replace(whole, time=whole.time[near], place=places[near])
        each = _exactly(task, part, margin) if exactly else _roughly(task, part)
        for k, one in zip(alike[near], each, strict=True):
            found[k] = one
    return found


def _exactly(task: Task, flight: Flight, margin: float) -> list[Violation | None]:
    return [
        check(task, replace(flight, time=time[None], place=place[None]), margin)
        for time, place in zip(flight.time, flight.place, strict=True)
    ]


def _roughly(task: Task, flight: Flight) -> list[Violation | None]:
    clear, found = clearances(task, flight), list[Violation | None]()
    where = to_geographic(task.region.grid.projection, *flight.place[:, 0].T)
    for k, (x, y) in enumerate(zip(*where, strict=True)):
        what = next((name for name in clear if clear[name][k] <= 0.0), None)
        found.append(None if what is None else Violation(what, 0.0, 1, float(x), float(y)))
    return found


def _near_hazards(task: Task, flight: Flight, margin: float) -> NDArray[np.bool_]:
    """Return which of K flights may come as near as a margin [m] to a hazard, shape (K,), by the boxes around them."""
    if flight.depth.max() > task.region.deepest:
        return np.ones(len(flight.place), dtype=bool)
    steps, lasts = np.linalg.norm(np.diff(flight.place, axis=1), axis=2), np.diff(flight.time[0])
    # no step bends by more than this at the fastest of all speeds
    wide = margin + 0.5 * float((steps / np.where(lasts > 0.0, lasts, np.inf)).max() * lasts.max())
    low, high = flight.place.min(axis=1) - wide, flight.place.max(axis=1) + wide
    boxes, near = shapely.box(*low.T, *high.T), ~np.isfinite(low + high).all(axis=1)
    for ring in task.solid(float(flight.depth.max())):
        near |= (
            ~shapely.covers(ring.area, boxes)
            if ring.outside
            else shapely.intersects(ring.area, boxes)
        )
    return np.asarray(near)


def _unchecked(task: Task, target: int, path: list[tuple[Array, float]]) -> Violation:
    """Return that the way to a waypoint could not be checked, as it is never reached."""
    place, time = path[-1]
    what = f"water that was not checked, as waypoint {target + 1} is not reached in {len(path) - 1} legs,"
    where = (float(part) for part in to_geographic(task.region.grid.projection, *place))
    return Violation(what, time, len(path) - 1, *where)


def _has_hazards(task: Task, depth: float) -> bool:
    """Return whether there is anything that dives to a depth [m] may cross."""
    return any(not ring.outside for ring in task.solid(depth))


def _margin(task: Task, margin: float, given: Array) -> float:
    """Return the distance that a flight keeps from areas [m]: most of the plan's margin, less where a place it must pass is nearer.

    A glider that heads for waypoints surfaces some tens of metres elsewhere than predicted, so a track just beside an area may cross it.

    Args:
        task: With the areas.
        margin: The plan's [m].
        given: shape (n, 2) [m], start and goals.
    """
    least = min((float(ring.clearance(given).min()) for ring in task.rings), default=np.inf)
    return float(np.clip(0.5 * least, 0.0, _AS_FAR * margin))


def heading_for(
    plan: MissionPlan, displacement: Array, angle: Array, current: Array, depth: Array
) -> tuple[Array, Array]:
    """Return headings from local north [rad] to waypoints and the shares of a full dive's depth needed to reach them, shape (K,) each.

    Args:
        plan: The glider.
        displacement: shape (K, 2), to the waypoints [m].
        angle: shape (K,), glide angles [rad].
        current: shape (K, 2), mean over a leg [m/s].
        depth: shape (K,), of a full dive [m].
    """
    settings, (along, down) = plan.settings, plan.vehicle.speeds(np, angle)
    under, distance = 2.0 * settings.yos * depth / down, np.linalg.norm(displacement, axis=1)
    ahead = displacement / distance[:, None]
    off = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    set_across, set_ahead = np.sum(current * off, axis=1), np.sum(current * ahead, axis=1)
    headings, shares = list[Array](), list[Array]()
    # on the way the drift at the surface counts as well; the last dive is to surface at the waypoint
    for duration in (under + settings.surface_time, under):
        speed = along * under / duration
        # of the speed through water as much across as the current sets, the rest ahead
        across = np.clip(-set_across, -speed, speed)
        through = np.sqrt(speed**2 - across**2)
        made_good = set_ahead + through
        way = across[:, None] * off + through[:, None] * ahead
        headings.append(np.arctan2(*way.T))
        closing = made_good > 0.0
        shares.append(
            np.where(closing, distance / (np.where(closing, made_good, 1.0) * duration), 1.0)
        )
    whole = shares[0] >= 1.0
    heading, share = (np.where(whole, *both) for both in (headings, shares))
    return heading, np.clip(share, _SHALLOWEST, 1.0)
