"""A mission as waypoints: fewer places than surfacings, for which a glider heads on its own, and the loss against the plan.

In eight random eddy fields of 0.1, 0.2 and 0.3 m/s RMS at the surface, missions of 27 km in dives to 390 m become 3.5, 6 and 6 waypoints
for 8, 7 and 6 surfacings in the median. With the worst of the currents that the glider may expect in its first dive they end 160, 130 and
1010 m from the plan's end and last 1, 13 and 22 % longer; 8, 5 and 2 of the lists end within the tolerance whatever it expects: in strong
eddies headings for each leg are clearly better.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import shapely

from planners.clearance import Violation
from planners.departures import first_legs
from planners.flights import (
    currents_of_estimate,
    fly_mission,
    legs_of_plan,
    surfacing_ellipses,
    task_for,
    with_paces,
)
from planners.hazards.areas import NoGo, Ring, first_crossing
from planners.hazards.bottom import Bathymetry
from planners.request import MissionPlan
from planners.simulation.currents import Currents, Flow, Sample
from planners.task import Task
from planners.waypoint_flight import Followed, WaypointList, first_currents, follow
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import heading_deg, rotate_to_geographic, to_geographic, to_local
from replay_kit.core.grid import Projection
from replay_kit.core.plan import Area

# Radii of a waypoint that are tried, in tolerances of the plan.
_RADII = np.array([1.0, 2.0, 4.0, 8.0])
# Where fewer samples reach the last waypoint another radius is tried.
_MOST = 0.9


@dataclass(frozen=True, slots=True)
class ListRisk:
    """A list headed for in samples of the estimate, in each with another current expected in the first dive.

    Attributes:
        count: Number of samples.
        reached: Share in which a glider that corrects for the current of its last dive reaches the last waypoint.
        violating: Share in which it violates a constraint, or could not be checked to the end.
        reached_straight: As ``reached``, of one that heads straight at each waypoint.
        violating_straight: As ``violating``, of that.
    """

    count: int
    reached: float
    violating: float
    reached_straight: float
    violating_straight: float

    def text(self, to: str = "the last") -> str:
        """Return it in words, with what is reached."""
        shares = self.reached, self.violating, self.reached_straight, self.violating_straight
        reached, violating, straight, unsafe = (f"{100.0 * share:.0f} %" for share in shares)
        return (
            f"in {self.count} samples of the estimate {reached} reach {to} and {violating} are not safe, without the glider's own "
            f"correction for the current {straight} and {unsafe}"
        )


@dataclass(frozen=True, slots=True, eq=False)
class Waypoints:
    """Places that a glider heads for one after the other, and its predicted track with the worst current that it may expect at first.

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
        off_end: Largest distance of the last surfacing from the end of the plan [m], of all currents that it may expect at first.
        delay: Its largest delay against the end of the plan [s]; negative when earlier.
        off_track: Largest distance of a surfacing from the plan's legs [m].
        violation: What a glider that heads for them crosses first; None when it keeps clear.
        arrives: Whether it reaches all of them and ends within the plan's tolerance of the plan's end.
        message: The outcome in words.
        risk: In samples of the estimate; None without.
        areas: That it keeps out of, and fences.
        clearance: Least height of the dives above the bottom [m].
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
    arrives: bool
    message: str
    risk: ListRisk | None = None
    areas: tuple[Area, ...] = ()
    clearance: float = 20.0


def waypoints_of(
    flow: Flow,
    plan: MissionPlan,
    tolerance: float | None = None,
    *,
    no_go: tuple[NoGo, ...] = (),
    bathymetry: Bathymetry | None = None,
    samples: Sequence[Sample] = (),
) -> Waypoints:
    """Return the fewest of a plan's surfacings that describe its track, and the track of a glider that heads for them in a flow.

    It heads for the next waypoint from where it surfaces, corrected for the mean current of its last leg by dead reckoning, at the
    mean glide angle of the planned legs; where less than a leg is left it dives less deep. What it expects in its first dive is not known:
    it is flown with each of ``first_currents``. The radius within which a waypoint counts as reached is the plan's tolerance or two, four
    or eight times that: the one that, expecting the worst, reaches most waypoints, ends within the tolerance and loses least time. A
    goal below the surface at the end is a waypoint above it.

    No straight line between two waypoints crosses an area. The flights are checked as a plan is: where one violates a constraint or does
    not end within the tolerance, all surfacings become waypoints; ``violation`` is what one crosses all the same, or that the last
    waypoints are not reached, so that the way there could not be checked. Dives to a waypoint are as deep as the shallowest planned.

    Args:
        flow: The current it is flown in: the plan's, or another one.
        plan: The mission.
        tolerance: A surfacing this close to steady progress between two others is left out [m]; None for the plan's tolerance.
        no_go: Areas that must not be entered.
        bathymetry: Bottom depth.
        samples: As for ``plan_scenarios``, in which the list is judged. The semi-axis of the ellipse of a first surfacing is tried as its
            radius too: within less a glider turns back for a waypoint that it has passed.

    Raises:
        PlanError: The mission has no legs, or it is a mooring, which is a single waypoint.
    """
    if plan.is_moored:
        raise PlanError("a mooring has no waypoints: give the glider the place of the mooring")
    task = task_for(flow, plan, no_go, bathymetry)
    ends = np.column_stack(to_local(task.region.grid.projection, *plan.surfacings.T))
    places, wanted = np.vstack([task.start[None, :2], ends]), plan.settings.tolerance
    firsts = first_currents(task, plan, legs_of_plan(plan))
    fewest = kept_surfacings(plan, places, wanted if tolerance is None else tolerance, task.rings)
    best, whole = _best_radius(task, plan, firsts, fewest), tuple(range(1, len(ends) + 1))
    if not _serves(plan, best):
        best = min(
            best,
            _best_radius(task, plan, firsts, whole),
            key=lambda flown: _lost(plan, flown[0]),
        )
    if not samples:
        return _waypoints(task, plan, best, places, no_go)
    currents = with_paces(currents_of_estimate(flow, samples), plan.vehicle, 1)
    risk = list_risk(task, plan, best[0].few, firsts, currents)
    first = first_legs(plan, 1, task.region.grid.projection)
    wide = float(np.ceil(surfacing_ellipses(fly_mission(samples, first), first)[0, 2]))
    if _serves(plan, best) and risk.reached < _MOST and wide > best[0].few.radius:
        wider = _worst_first(plan, _flown(task, plan, [replace(best[0].few, radius=wide)], firsts))
        then = list_risk(task, plan, wider[0].few, firsts, currents)
        if _serves(plan, wider) and (-then.violating, then.reached) > (
            -risk.violating,
            risk.reached,
        ):
            best, risk = wider, then
    found = _waypoints(task, plan, best, places, no_go)
    return replace(found, risk=risk, message=f"{found.message}; {risk.text()}")


def _lost(plan: MissionPlan, one: Followed) -> tuple[bool, int, bool, float]:
    """Return what a flight loses, the worst first: a constraint, waypoints, the end of the plan, time [s]."""
    off_end = float(np.linalg.norm(one.path[-1][0] - one.few.places[-1]))
    # the rest of the distance to the plan's end would take time as well
    late = one.path[-1][1] + off_end / float(plan.vehicle.speeds(np, one.few.angles[-1])[0])
    missed = int(np.isnan(one.times).sum())
    return one.violation is not None, missed, off_end > plan.settings.tolerance, late


def _serves(plan: MissionPlan, flown: Sequence[Followed]) -> bool:
    """Return whether the worst flight of a list loses nothing but time."""
    return not any(_lost(plan, flown[0])[:3])


def _worst_first(plan: MissionPlan, flown: Sequence[Followed]) -> list[Followed]:
    """Return flights, the one that loses most first."""
    return sorted(flown, key=lambda one: _lost(plan, one), reverse=True)


def _flown(
    task: Task, plan: MissionPlan, lists: Sequence[WaypointList], firsts: Sequence[Array]
) -> list[Followed]:
    """Return the flights of each list with each first current in the estimate, list by list."""
    each = [few for few in lists for _ in firsts]
    return follow(task, plan, each, [*firsts] * len(lists))


def _best_radius(
    task: Task, plan: MissionPlan, firsts: Sequence[Array], kept: tuple[int, ...]
) -> list[Followed]:
    """Return the flights with all first currents, the worst first, of the list of some legs' ends within the radius that serves best.

    All radii are flown with the first currents that lose most as a rule, the plan's and none; what a list loses with these bounds what it
    loses at worst, so that only those are flown with the others that may still be the best.
    """
    lists = [
        WaypointList.of(task, plan, kept, float(plan.settings.tolerance * of)) for of in _RADII
    ]
    first, rest = firsts[:2], firsts[2:]
    flown = _flown(task, plan, lists, first)
    open_ = [
        _worst_first(plan, flown[k * len(first) : (k + 1) * len(first)]) for k in range(len(lists))
    ]
    while True:
        best = min(open_, key=lambda one: _lost(plan, one[0]))
        if len(best) == len(firsts):
            return best
        more = _flown(task, plan, [best[0].few], rest)
        open_[open_.index(best)] = _worst_first(plan, [*best, *more])


def list_risk(
    task: Task,
    plan: MissionPlan,
    few: WaypointList,
    firsts: Sequence[Array],
    currents: Currents,
) -> ListRisk:
    """Return how a list fares in K currents, in each with a current expected in the first dive, with and without correction."""
    count = len(currents.latent)
    expected = [firsts[k % len(firsts)] for k in range(count)]
    twice = currents.some(np.tile(np.arange(count), 2))
    corrects = np.repeat([True, False], count)
    flown = follow(task, plan, [few] * 2 * count, expected * 2, twice, corrects)
    figures = list[float]()
    for half in (flown[:count], flown[count:]):
        figures += [
            float(np.mean([np.isfinite(one.times[-1]) for one in half])),
            float(np.mean([one.violation is not None for one in half])),
        ]
    return ListRisk(count, *figures)


def _waypoints(
    task: Task,
    plan: MissionPlan,
    flown: Sequence[Followed],
    places: Array,
    no_go: tuple[NoGo, ...],
) -> Waypoints:
    """Return waypoints and what they lose at most against the plan, whose legs lie between places [m], in flights with the worst first."""
    worst, projection = flown[0], task.region.grid.projection
    off_end = max(float(np.linalg.norm(one.path[-1][0] - places[-1])) for one in flown)
    delay = max(one.path[-1][1] for one in flown) - plan.duration
    surfacings = [np.array([place for place, _ in one.path[1:]]) for one in flown]
    off_track = float(np.max(_distance_to_legs(np.vstack(surfacings), places)))
    n_reached = int(np.isfinite(worst.times).sum())
    message = (
        f"{len(worst.few.kept)} waypoints for {len(places) - 1} surfacings; {n_reached} reached within {worst.few.radius:g} m; "
        f"ends {off_end:.0f} m from the plan's end and {abs(delay) / 60.0:.0f} min {'later' if delay >= 0.0 else 'earlier'}; "
        f"surfaces at most {off_track:.0f} m off the plan's legs"
    )
    at = worst.violation
    arrives = n_reached == len(worst.few.kept) and off_end <= plan.settings.tolerance
    expecting = f"if the glider expects {_expected(plan, projection, worst)} in its first dive"
    if at is not None:
        message = f"not safe: heading for the waypoints crosses {at.what} at {at.longitude:.4f}, {at.latitude:.4f} {expecting}; {message}"
    elif not arrives:
        message = f"not reliable: ends farther than {plan.settings.tolerance:g} m from the plan's end {expecting}; {message}"
    else:
        message += ", whatever current it expects in its first dive"
    longitude, latitude = plan.surfacings[np.array(worst.few.kept) - 1].T
    pitches = np.rad2deg(plan.vehicle.pitch(worst.few.angles))
    surfaced = np.column_stack(to_geographic(projection, *surfacings[0].T))
    dives = worst.few.depths, plan.settings.yos, worst.few.radius
    angles = np.rad2deg(worst.few.angles)
    lost = off_end, delay, off_track
    return Waypoints(
        longitude,
        latitude,
        angles,
        pitches,
        *dives,
        worst.times,
        surfaced,
        *lost,
        at,
        arrives,
        message,
        areas=tuple(area.area for area in no_go),
        clearance=plan.settings.clearance,
    )


def _expected(plan: MissionPlan, projection: Projection, followed: Followed) -> str:
    """Return the current that a glider expects in its first dive, in words."""
    east, north = rotate_to_geographic(
        projection, plan.start.longitude, plan.start.latitude, *followed.first_current
    )
    speed = float(np.hypot(east, north))
    return (
        f"a current of {100.0 * speed:.0f} cm/s toward {float(heading_deg(east, north)):.0f} degrees"
        if speed > 0.0
        else "no current"
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
        kept |= {leg} if goal.depth == 0.0 else {max(leg - 1, 0), leg}
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


def _distance_to_legs(points: Array, corners: Array) -> Array:
    """Return the distance [m] of points, shape (n, 2), from the nearest of the straight lines between corners, shape (m, 2) [m]."""
    return np.asarray(shapely.distance(shapely.LineString(corners), shapely.points(points)))
