"""A mission as waypoints: fewer places than surfacings, for which a glider heads on its own, and the loss against the plan.

In eight random eddy fields of 0.1, 0.2 and 0.3 m/s RMS at the surface, missions of 24 to 28 h to 390 m become 5.5, 7 and 7 waypoints for
10, 9 and 8.5 surfacings in the median, end 150, 190 and 810 m from the plan's end and last 1.5, 8 and 6 % longer; the worst 6, 31 and 130
%, and one of the 24 misses waypoints: in strong eddies headings for each leg are clearly better.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely

from planners.mission.flight import Currents, Legs, currents_of, fly_legs, refine_steps
from planners.mission.flights import legs_of_plan
from planners.mission.leg import leg_depths, steps_needed
from planners.mission.task import REFINED, time_on_clock
from planners.mission.values import MissionPlan
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import to_geographic, to_local

# Legs flown at most for each one planned, and beside.
_LEGS_EACH, _LEGS_MORE = 2, 3
# Radii of a waypoint that are tried, in tolerances of the plan.
_RADII = np.array([1.0, 2.0, 4.0, 8.0])
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
        depth: Depth of the dives [m].
        yos: Dives between surfacings.
        radius: Within which a waypoint counts as reached [m].
        times: shape (W,) [s] since the start, when each is reached; NaN for those that are not.
        surfacings: shape (L, 2), longitude and latitude [degrees] of each surfacing on the way.
        off_end: Distance of the last surfacing from the end of the plan [m].
        delay: Its delay against the end of the plan [s]; negative when earlier.
        off_track: Largest distance of a surfacing from the plan's legs [m].
        message: The outcome in words.
    """

    longitude: Array
    latitude: Array
    glide_angles_deg: Array
    pitches_deg: Array
    depth: float
    yos: int
    radius: float
    times: Array
    surfacings: Array
    off_end: float
    delay: float
    off_track: float
    message: str


def waypoints_of(flow: FlowEstimate | Sequence[FlowEstimate], plan: MissionPlan, tolerance: float | None = None) -> Waypoints:
    """Return the fewest of a plan's surfacings that describe its track, and the track of a glider that heads for them in a flow.

    It heads for the next waypoint from where it surfaces, corrected for the mean current of its last leg by dead reckoning, at the
    mean glide angle of the planned legs; where less than a leg is left it dives less deep. The radius within which a waypoint counts as
    reached is the plan's tolerance or two, four or eight times that: the one that reaches most waypoints, ends within the tolerance and
    loses least time. A goal below the surface at the end is a waypoint above it.

    Args:
        flow: The current it is flown in: the plan's, or another one.
        plan: The mission.
        tolerance: A surfacing this close to steady progress between two others is left out [m]; None for the plan's tolerance.

    Raises:
        PlanError: The mission has no legs, or it is a mooring, which is a single waypoint.
    """
    if plan.settings.weights.closest == 0.0:
        raise PlanError("a mooring has no waypoints: give the glider the place of the mooring")
    currents = currents_of(flow)
    legs, projection = legs_of_plan(plan, currents.flow), currents.flow.grid.projection
    start = np.array(to_local(projection, plan.start.longitude, plan.start.latitude), dtype=np.float64)
    ends = np.column_stack(to_local(projection, *plan.surfacings.T))
    kept = kept_surfacings(plan, np.vstack([start, ends]), plan.settings.tolerance if tolerance is None else tolerance)
    angles = np.array([np.mean(legs.angles[begin:end]) for begin, end in pairwise([0, *kept])])
    along = float(plan.vehicle.speeds(np, angles[-1])[0])
    tried = []
    for radius in plan.settings.tolerance * _RADII:
        times, path = _follow(currents, plan, legs, (start, ends, ends[np.array(kept) - 1]), angles, radius)
        off_end, delay = float(np.linalg.norm(path[-1][0] - ends[-1])), path[-1][1] - plan.duration
        # the rest of the distance to the plan's end would take time as well
        lost = int(np.isnan(times).sum()), off_end > plan.settings.tolerance, delay + off_end / along
        tried.append((lost, radius, times, path, off_end, delay))
    _, radius, times, path, off_end, delay = min(tried, key=lambda one: one[0])
    surfacings = np.array([at for at, _ in path[1:]])
    off_track = float(np.max(_distance_to_legs(surfacings, np.vstack([start, ends]))))
    n_reached = int(np.isfinite(times).sum())
    message = (
        f"{len(kept)} waypoints for {len(ends)} surfacings; {n_reached} reached within {radius:g} m; "
        f"ends {off_end:.0f} m from the plan's end and {abs(delay) / 60.0:.0f} min {'later' if delay >= 0.0 else 'earlier'}; "
        f"surfaces at most {off_track:.0f} m off the plan's legs"
    )
    longitude, latitude = plan.surfacings[np.array(kept) - 1].T
    pitches = np.rad2deg(plan.vehicle.pitch(angles))
    surfaced = np.column_stack(to_geographic(projection, *surfacings.T))
    dives = plan.settings.depth, plan.settings.yos, float(radius)
    return Waypoints(longitude, latitude, np.rad2deg(angles), pitches, *dives, times, surfaced, off_end, delay, off_track, message)


def kept_surfacings(plan: MissionPlan, places: Array, tolerance: float) -> tuple[int, ...]:
    """Return the numbers of the legs, counted from 1, whose ends are waypoints: those of the goals, and what is needed between them.

    Between two that are kept, the one farthest from steady progress is kept as well, until none is farther than the tolerance
    (Ramer 1972; Douglas and Peucker 1973; here in place and time, so that changes of speed count).

    Args:
        plan: The mission.
        places: shape (L + 1, 2) [m], its start and the ends of its legs.
        tolerance: [m].
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
        away = np.linalg.norm(places[begin] + share[:, None] * (places[end] - places[begin]) - places[begin + 1 : end], axis=1)
        if away.size and away.max() > tolerance:
            middle = begin + 1 + int(np.argmax(away))
            kept.add(middle)
            open_spans += [(begin, middle), (middle, end)]
    return tuple(sorted(kept - {0}))


def _follow(
    currents: Currents, plan: MissionPlan, legs: Legs, places: tuple[Array, Array, Array], angles: Array, radius: float
) -> tuple[Array, list[tuple[Array, float]]]:
    """Return when each waypoint is reached [s], and (place [m], time [s]) of the start and of each surfacing."""
    (start, ends, waypoints), settings = places, plan.settings
    clock, drift = time_on_clock(currents, plan.start_time_ns), settings.surface_time
    current = _dead_reckoned_current(plan, ends[0] - start, float(plan.surfacing_times[0]), float(legs.headings[0]), float(legs.angles[0]))
    times, path, target = np.full(len(waypoints), np.nan), [(start, 0.0)], 0
    for number in range(_LEGS_EACH * len(legs.headings) + _LEGS_MORE):
        (at, now), angle = path[-1], float(angles[target])
        heading, share = heading_for(plan, waypoints[target] - at, angle, current)
        begin = plan.yo_depths[0][0] if number == 0 else 0.0
        yo_depths = (begin, *(max(share * settings.depth, begin), 0.0) * settings.yos)
        levels = currents.flow.levels
        depths = refine_steps(leg_depths(yo_depths, levels, steps_needed(yo_depths, levels, settings.steps)), REFINED)
        leg = Legs(np.array([heading]), np.array([angle]), (depths,), np.array([drift]))
        flown = fly_legs(currents, plan.vehicle, at, leg, clock + now)
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
        current = _dead_reckoned_current(plan, path[-1][0] - at, path[-1][1] - now, heading, angle)
    return times, path


def _dead_reckoned_current(plan: MissionPlan, displacement: Array, duration: float, heading: float, angle: float) -> Array:
    """Return the mean current [m/s] of a leg by dead reckoning: its displacement over ground [m] less that through water, over time [s]."""
    along = float(plan.vehicle.speeds(np, angle)[0]) * max(duration - plan.settings.surface_time, 0.0)
    return np.asarray((displacement - along * np.array([np.sin(heading), np.cos(heading)])) / duration)


def heading_for(plan: MissionPlan, displacement: Array, angle: float, current: Array) -> tuple[float, float]:
    """Return the heading [rad] to a waypoint and the share of a full dive's depth that is needed to reach it.

    Args:
        plan: The glider, and the depth of its dives.
        displacement: shape (2,), to the waypoint [m].
        angle: Glide angle [rad].
        current: Mean over a leg [m/s].
    """
    settings, (along, down) = plan.settings, plan.vehicle.speeds(np, angle)
    under, distance = 2.0 * settings.yos * settings.depth / float(down), float(np.linalg.norm(displacement))
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
