"""A glider that heads for waypoints on its own: at each surfacing it corrects for the mean current of its last dive.

What it expects in its first dive nobody knows: nothing where it was just put to sea, else what its dives before have met. A list of
waypoints is flown with several of these.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from planners.mission.flight.legs import Legs, fly_legs, fly_midpoints
from planners.mission.solve.check import Violation, check
from planners.mission.task import MissionTask, leg_depths, steps_needed, turns_of
from planners.mission.values import MissionPlan
from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_geographic, to_local, true_north_halfway

# Legs flown at most for each one planned, and beside.
_LEGS_EACH, _LEGS_MORE = 2, 3
# Share of a plan's margin that is kept: its own legs come to the margin less the error of the optimiser's current.
_AS_FAR = 0.8
# Share of the full depth that the shallowest dive to a near waypoint goes.
_SHALLOWEST = 0.1
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
class Followed:
    """Waypoints headed for with one radius and one current expected in the first dive.

    Attributes:
        radius: Within which a waypoint counts as reached [m].
        kept: Numbers of the plan's legs, counted from 1, whose ends are the waypoints.
        first_current: shape (2,), expected in the first dive [m/s].
        angles: shape (W,), glide angle on the way to each [rad].
        depths: shape (W,), depth of the dives on the way to each [m].
        times: shape (W,), when each is reached [s]; NaN for those that are not.
        path: (place [m], time [s]) of the start and of each surfacing.
        violation: What it crosses first, or that it was not checked to the end; None when it keeps clear.
    """

    radius: float
    kept: tuple[int, ...]
    first_current: Array
    angles: Array
    depths: Array
    times: Array
    path: list[tuple[Array, float]]
    violation: Violation | None


def first_currents(task: MissionTask, plan: MissionPlan, legs: Legs) -> list[Array]:
    """Return the currents that a glider may expect in its first dive [m/s], each shape (2,), local east and north.

    First that of the plan's first leg; then none, as of a glider that was just put to sea; then, where the estimate knows its errors, what
    it may have met there: currents spread evenly over the ellipse that holds 95 % of the dive's mean currents.
    """
    begin, end = (
        task.start[None, :2],
        np.column_stack(to_local(task.region.grid.projection, *plan.surfacings[:1].T)),
    )
    turn = float(true_north_halfway(task.region.grid.projection, begin, end)[0])
    planned = dead_reckoned_current(
        plan,
        end[0] - begin[0],
        float(plan.surfacing_times[0]),
        float(legs.headings[0]) + turn,
        float(legs.angles[0]),
    )
    if not task.flow.n_modes:
        return [planned, np.zeros(2)]
    depths = np.linspace(0.0, float(np.max(legs.depths[0])), _DEPTHS)
    of_points = task.flow.velocity_covariance(begin[0, 0], begin[0, 1], depths).reshape(
        2, _DEPTHS, 2, _DEPTHS
    )
    variances, axes = np.linalg.eigh(of_points.mean(axis=(1, 3)))
    root = axes * np.sqrt(np.maximum(variances, 0.0)) @ axes.T
    return [planned, np.zeros(2), *(planned + _INSIDE * _DISC @ root)]


def follow(
    task: MissionTask,
    plan: MissionPlan,
    legs: Legs,
    kept: tuple[int, ...],
    radius: float,
    first_current: Array,
) -> Followed:
    """Return the flight of a glider that heads for the ends of the legs kept, until the last is reached.

    Args:
        task: The current it is flown in, and what it must keep clear of.
        plan: The mission.
        legs: Its commands.
        kept: Numbers of the legs, counted from 1, whose ends are the waypoints.
        radius: [m], within which a waypoint counts as reached.
        first_current: shape (2,), that it expects in its first dive [m/s], local east and north.
    """
    settings, projection = plan.settings, task.region.grid.projection
    ends = np.column_stack(to_local(projection, *plan.surfacings.T))
    waypoints, drift, levels = (
        ends[np.array(kept) - 1],
        plan.settings.surface_time,
        task.flow.levels,
    )
    margin = _margin(
        task, settings.margin, np.vstack([task.start[None, :2], ends])[[0, *plan.goal_legs]]
    )
    angles = np.array([np.mean(legs.angles[begin:end]) for begin, end in pairwise([0, *kept])])
    turns = np.array(turns_of(plan.yo_depths))
    deep = np.array([np.min(turns[begin:end]) for begin, end in pairwise([0, *kept])])
    times, path, target, violation = (
        np.full(len(waypoints), np.nan),
        [(task.start[:2], 0.0)],
        0,
        None,
    )
    current = first_current
    for number in range(_LEGS_EACH * len(legs.headings) + _LEGS_MORE):
        (at, now), angle, depth = path[-1], float(angles[target]), float(deep[target])
        local, share = heading_for(
            replace(plan, settings=replace(settings, depth=depth)),
            waypoints[target] - at,
            angle,
            current,
        )
        heading = local - float(true_north_halfway(projection, at[None], at[None])[0])
        begin = plan.yo_depths[0][0] if number == 0 else 0.0
        yo_depths = (begin, *(max(share * depth, begin), 0.0) * settings.yos)
        depths = leg_depths(yo_depths, levels, steps_needed(yo_depths, levels, settings.steps))
        leg = Legs(np.array([heading]), np.array([angle]), (depths,), np.array([drift]))
        flown = fly_legs(task.currents, plan.vehicle, at, leg, task.start_time + now, fly_midpoints)
        violation = violation or check(task, flown, margin)
        surfaced = depths.size - 1
        arrived = bool(np.linalg.norm(flown.place[0, surfaced] - waypoints[target]) <= radius)
        last = arrived and target == len(waypoints) - 1
        # the last drift does not count
        point = surfaced if last else -1
        path.append((flown.place[0, point], now + float(flown.time[point])))
        if arrived:
            times[target] = now + float(flown.time[surfaced])
            target += 1
        if last:
            break
        local = heading + float(true_north_halfway(projection, at[None], path[-1][0][None])[0])
        current = dead_reckoned_current(plan, path[-1][0] - at, path[-1][1] - now, local, angle)
    if violation is None and target < len(waypoints) and _has_hazards(task, float(deep.max())):
        place, time = path[-1]
        what = f"water that was not checked, as waypoint {target + 1} is not reached in {len(path) - 1} legs,"
        violation = Violation(
            what, time, len(path) - 1, *(float(part) for part in to_geographic(projection, *place))
        )
    return Followed(radius, kept, first_current, angles, deep, times, path, violation)


def _has_hazards(task: MissionTask, depth: float) -> bool:
    """Return whether there is anything that dives to a depth [m] may cross."""
    return any(not ring.outside for ring in task.rings_at(depth))


def _margin(task: MissionTask, margin: float, given: Array) -> float:
    """Return the distance that a flight keeps from areas [m]: most of the plan's margin, less where a place it must pass is nearer.

    A glider that heads for waypoints surfaces some tens of metres elsewhere than predicted, so a track just beside an area may cross it.

    Args:
        task: With the areas.
        margin: The plan's [m].
        given: shape (n, 2) [m], start and goals.
    """
    least = min((float(ring.clearance(given).min()) for ring in task.rings), default=np.inf)
    return float(np.clip(0.5 * least, 0.0, _AS_FAR * margin))


def dead_reckoned_current(
    plan: MissionPlan, displacement: Array, duration: float, heading: float, angle: float
) -> Array:
    """Return the mean current [m/s] of a leg by dead reckoning: its displacement over ground [m] less that through water, over time [s]."""
    along = float(plan.vehicle.speeds(np, angle)[0]) * max(
        duration - plan.settings.surface_time, 0.0
    )
    return (displacement - along * np.array([np.sin(heading), np.cos(heading)])) / duration


def heading_for(
    plan: MissionPlan, displacement: Array, angle: float, current: Array
) -> tuple[float, float]:
    """Return the heading from local north [rad] to a waypoint and the share of a full dive's depth that is needed to reach it.

    Args:
        plan: The glider, and the depth of its dives.
        displacement: shape (2,), to the waypoint [m].
        angle: Glide angle [rad].
        current: Mean over a leg [m/s].
    """
    settings, (along, down) = plan.settings, plan.vehicle.speeds(np, angle)
    under, distance = (
        2.0 * settings.yos * settings.depth / float(down),
        float(np.linalg.norm(displacement)),
    )
    ahead = displacement / distance
    off = np.array([-ahead[1], ahead[0]])
    heading, share = 0.0, 1.0
    # on the way the drift at the surface counts as well; the last dive is to surface at the waypoint
    for duration in (under + settings.surface_time, under):
        speed = float(along) * under / duration
        # of the speed through water as much across as the current sets, the rest ahead
        across = float(np.clip(-(current @ off), -speed, speed))
        through = float(np.sqrt(speed**2 - across**2))
        made_good = float(current @ ahead) + through
        heading = float(np.arctan2(*(across * off + through * ahead)))
        share = distance / (made_good * duration) if made_good > 0.0 else 1.0
        if share >= 1.0:
            break
    return heading, float(np.clip(share, _SHALLOWEST, 1.0))
