"""A mission as waypoints: fewer places than surfacings, for which a glider heads on its own, and the loss against the plan.

In eight random eddy fields of 0.1, 0.2 and 0.3 m/s RMS at the surface, missions of 24 to 28 h to 390 m become 5.5, 7 and 7 waypoints for
10, 9 and 8.5 surfacings in the median, end 150, 190 and 810 m from the plan's end and last 1.5, 8 and 6 % longer; the worst 6, 31 and 130
%, and one of the 24 misses waypoints: in strong eddies headings for each leg are clearly better.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import shapely

from planners.mission.check import Violation, check
from planners.mission.flight import Legs, fly_legs, refine_steps
from planners.mission.flights import legs_of_plan
from planners.mission.leg import leg_depths, steps_needed
from planners.mission.task import REFINED, MissionTask, mission_task, turns_of
from planners.mission.values import MissionPlan, MissionRequest
from planners.route.bottom import Bathymetry
from planners.route.hazards import NoGo, Ring, first_crossing
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import to_geographic, to_local, true_north_halfway

# Legs flown at most for each one planned, and beside.
_LEGS_EACH, _LEGS_MORE = 2, 3
# Radii of a waypoint that are tried, in tolerances of the plan.
_RADII = np.array([1.0, 2.0, 4.0, 8.0])
# Share of a plan's margin that is kept: its own legs come to the margin less the error of the optimiser's current.
_AS_FAR = 0.8
# Share of the full depth that the shallowest dive to a near waypoint goes.
_SHALLOWEST = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Waypoints:
    """Places that a glider heads for one after the other, and its predicted track.

    Attributes:
        longitude: shape (W,) [degrees east].
        latitude: shape (W,) [degrees north].
        glide_angles_deg: shape (W,), on the way to each.
        pitches_deg: shape (W,).
        depths: shape (W,), depth of the dives on the way to each [m].
        yos: Dives between surfacings.
        radius: Within which a waypoint counts as reached [m].
        times: shape (W,) [s] since the start, when each is reached; NaN for those that are not.
        surfacings: shape (L, 2), longitude and latitude [degrees] of each surfacing on the way.
        off_end: Distance of the last surfacing from the end of the plan [m].
        delay: Its delay against the end of the plan [s]; negative when earlier.
        off_track: Largest distance of a surfacing from the plan's legs [m].
        violation: What a glider that heads for them crosses first; None when it keeps clear.
        message: The outcome in words.
    """

    longitude: Array
    latitude: Array
    glide_angles_deg: Array
    pitches_deg: Array
    depths: Array
    yos: int
    radius: float
    times: Array
    surfacings: Array
    off_end: float
    delay: float
    off_track: float
    violation: Violation | None
    message: str


@dataclass(frozen=True, slots=True, eq=False)
class _Followed:
    """Waypoints headed for with one radius: when each is reached [s], (place [m], time [s]) of each surfacing, the first violation."""

    radius: float
    kept: tuple[int, ...]
    angles: Array
    depths: Array
    times: Array
    path: list[tuple[Array, float]]
    violation: Violation | None


def waypoints_of(
    flow: FlowEstimate | Sequence[FlowEstimate],
    plan: MissionPlan,
    tolerance: float | None = None,
    *,
    no_go: tuple[NoGo, ...] = (),
    bathymetry: Bathymetry | None = None,
) -> Waypoints:
    """Return the fewest of a plan's surfacings that describe its track, and the track of a glider that heads for them in a flow.

    It heads for the next waypoint from where it surfaces, corrected for the mean current of its last leg by dead reckoning, at the
    mean glide angle of the planned legs; where less than a leg is left it dives less deep. The radius within which a waypoint counts as
    reached is the plan's tolerance or two, four or eight times that: the one that reaches most waypoints, ends within the tolerance and
    loses least time. A goal below the surface at the end is a waypoint above it.

    No straight line between two waypoints crosses an area. The flight is checked as a plan is: where it violates a constraint, all
    surfacings become waypoints; ``violation`` is what it crosses all the same, or that the last waypoints are not reached, so that the way
    there could not be checked. Dives to a waypoint are as deep as the shallowest planned.

    Args:
        flow: The current it is flown in: the plan's, or another one.
        plan: The mission.
        tolerance: A surfacing this close to steady progress between two others is left out [m]; None for the plan's tolerance.
        no_go: Areas that must not be entered.
        bathymetry: Bottom depth.

    Raises:
        PlanError: The mission has no legs, or it is a mooring, which is a single waypoint.
    """
    if plan.settings.weights.closest == 0.0:
        raise PlanError("a mooring has no waypoints: give the glider the place of the mooring")
    task = mission_task(
        flow,
        MissionRequest(
            plan.start,
            plan.goals,
            plan.vehicle,
            plan.settings,
            no_go,
            bathymetry,
            plan.start_time_ns,
        ),
    )
    legs, projection, settings = (
        legs_of_plan(plan, task.flow),
        task.region.grid.projection,
        plan.settings,
    )
    ends = np.column_stack(to_local(projection, *plan.surfacings.T))
    places, tried = np.vstack([task.start[None, :2], ends]), list[_Followed]()
    fewest = kept_surfacings(
        plan, places, settings.tolerance if tolerance is None else tolerance, task.rings
    )
    for kept in (fewest, tuple(range(1, len(ends) + 1))):
        tried += [
            _follow(task, plan, legs, kept, float(radius)) for radius in settings.tolerance * _RADII
        ]
        if any(one.violation is None for one in tried):
            break

    def lost(one: _Followed) -> tuple[bool, int, bool, float]:
        off_end = float(np.linalg.norm(one.path[-1][0] - ends[-1]))
        # the rest of the distance to the plan's end would take time as well
        late = one.path[-1][1] + off_end / float(plan.vehicle.speeds(np, one.angles[-1])[0])
        return (
            one.violation is not None,
            int(np.isnan(one.times).sum()),
            off_end > settings.tolerance,
            late,
        )

    return _waypoints(task, plan, min(tried, key=lost), places)


def _waypoints(task: MissionTask, plan: MissionPlan, best: _Followed, places: Array) -> Waypoints:
    """Return the waypoints that are followed best, and what they lose against the plan, whose legs lie between places [m]."""
    off_end, delay = (
        float(np.linalg.norm(best.path[-1][0] - places[-1])),
        best.path[-1][1] - plan.duration,
    )
    surfacings, at = np.array([place for place, _ in best.path[1:]]), best.violation
    off_track = float(np.max(_distance_to_legs(surfacings, places)))
    n_reached = int(np.isfinite(best.times).sum())
    message = (
        f"{len(best.kept)} waypoints for {len(places) - 1} surfacings; {n_reached} reached within {best.radius:g} m; "
        f"ends {off_end:.0f} m from the plan's end and {abs(delay) / 60.0:.0f} min {'later' if delay >= 0.0 else 'earlier'}; "
        f"surfaces at most {off_track:.0f} m off the plan's legs"
    )
    if at is not None:
        message = f"not safe: heading for the waypoints crosses {at.what} at {at.longitude:.4f}, {at.latitude:.4f}; {message}"
    longitude, latitude = plan.surfacings[np.array(best.kept) - 1].T
    pitches = np.rad2deg(plan.vehicle.pitch(best.angles))
    surfaced = np.column_stack(to_geographic(task.region.grid.projection, *surfacings.T))
    dives = best.depths, plan.settings.yos, best.radius
    angles = np.rad2deg(best.angles)
    return Waypoints(
        longitude,
        latitude,
        angles,
        pitches,
        *dives,
        best.times,
        surfaced,
        off_end,
        delay,
        off_track,
        at,
        message,
    )


def kept_surfacings(
    plan: MissionPlan, places: Array, tolerance: float, rings: Sequence[Ring] = ()
) -> tuple[int, ...]:
    """Return the numbers of the legs, counted from 1, whose ends are waypoints: those of the goals, and what is needed between them.

    Between two that are kept, the one farthest from steady progress is kept as well, until none is farther than the tolerance
    (Ramer 1972; Douglas and Peucker 1973; here in place and time, so that changes of speed count) and no straight line between two crosses
    an area or comes nearer to it than the plan's margin.

    Args:
        plan: The mission.
        places: shape (L + 1, 2) [m], its start and the ends of its legs.
        tolerance: [m].
        rings: What must not be crossed.
    """
    times = np.concatenate([[0.0], plan.surfacing_times])
    kept = {0, len(times) - 1}
    for leg, goal in zip(plan.goal_legs, plan.goals, strict=True):
        # a goal below the surface is passed on a straight leg: both of its ends are kept
        kept |= {leg} if goal.depth == 0.0 else {leg - 1, leg}
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


def _follow(
    task: MissionTask, plan: MissionPlan, legs: Legs, kept: tuple[int, ...], radius: float
) -> _Followed:
    """Return the flight of a glider that heads for the ends of the legs kept, until the last is reached within a radius [m]."""
    settings, projection = plan.settings, task.region.grid.projection
    ends = np.column_stack(to_local(projection, *plan.surfacings.T))
    waypoints, drift, levels = (
        ends[np.array(kept) - 1],
        plan.settings.surface_time,
        task.flow.levels,
    )
    margin = _margin(
        task, settings.margin, np.vstack([task.start[None, :2], ends[np.array(plan.goal_legs) - 1]])
    )
    angles = np.array([np.mean(legs.angles[begin:end]) for begin, end in pairwise([0, *kept])])
    turns = np.array(turns_of(plan.yo_depths))
    deep = np.array([np.min(turns[begin:end]) for begin, end in pairwise([0, *kept])])
    turn = true_north_halfway(projection, task.start[None, :2], ends[:1])[0]
    first = (
        ends[0] - task.start[:2],
        float(plan.surfacing_times[0]),
        float(legs.headings[0] + turn),
        float(legs.angles[0]),
    )
    current = _dead_reckoned_current(plan, *first)
    times, path, target, violation = (
        np.full(len(waypoints), np.nan),
        [(task.start[:2], 0.0)],
        0,
        None,
    )
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
        depths = refine_steps(
            leg_depths(yo_depths, levels, steps_needed(yo_depths, levels, settings.steps)), REFINED
        )
        leg = Legs(np.array([heading]), np.array([angle]), (depths,), np.array([drift]))
        flown = fly_legs(task.currents, plan.vehicle, at, leg, task.start_time + now)
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
        current = _dead_reckoned_current(plan, path[-1][0] - at, path[-1][1] - now, local, angle)
    if violation is None and target < len(waypoints) and _has_hazards(task, float(deep.max())):
        place, time = path[-1]
        what = f"water that was not checked, as waypoint {target + 1} is not reached in {len(path) - 1} legs,"
        violation = Violation(
            what, time, len(path) - 1, *(float(part) for part in to_geographic(projection, *place))
        )
    return _Followed(radius, kept, angles, deep, times, path, violation)


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


def _dead_reckoned_current(
    plan: MissionPlan, displacement: Array, duration: float, heading: float, angle: float
) -> Array:
    """Return the mean current [m/s] of a leg by dead reckoning: its displacement over ground [m] less that through water, over time [s]."""
    along = float(plan.vehicle.speeds(np, angle)[0]) * max(
        duration - plan.settings.surface_time, 0.0
    )
    return np.asarray(
        (displacement - along * np.array([np.sin(heading), np.cos(heading)])) / duration
    )


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


def _distance_to_legs(points: Array, corners: Array) -> Array:
    """Return the distance [m] of points, shape (n, 2), from the nearest of the straight lines between corners, shape (m, 2) [m]."""
    return np.asarray(shapely.distance(shapely.LineString(corners), shapely.points(points)))
