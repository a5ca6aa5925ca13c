"""A policy for a vehicle that nobody corrects: the heading by place and time with which it comes to the goal soonest.

A front that spreads from the goal backwards, in the current reversed, says how long the quickest way from each place takes and where it
leads (``front/``). Whatever the current did to the vehicle, it heads along the quickest way from where it surfaces; near the goal it heads
at it. Where the current changes, fronts from several times of arrival are laid together: at each time and place the one whose vehicle is
there then counts.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planners.front.current import Complex, CurrentLattice
from planners.front.front import Front, sea_of, spread
from planners.front.obstacles import obstacles_of
from planners.mission.flight.currents import Flow, Sample
from planners.mission.flights import currents_of_estimate, legs_of_plan, with_paces
from planners.mission.search.passage import Water, longest_time, water_of
from planners.mission.task import MissionTask, task_of_plan
from planners.mission.values import MissionPlan
from planners.mission.waypoint_flight import HeadingTable, WaypointList, first_currents
from planners.mission.waypoints import ListRisk, list_risk
from planners.route.bottom import Bathymetry
from planners.route.hazards import NoGo
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import to_geographic, to_local, true_north_halfway

# Ways of a leg within which a vehicle heads at the goal itself; parts of such a way between places of the table, and places at most.
_NEAR, _PARTS, _MOST = 1.5, 4.0, 1600
# Arrivals that fronts begin at where the current changes, and times of the table; both up to so many times the plan's duration.
_ARRIVALS, _TIMES, _LATEST = 8, 5, 1.5


@dataclass(frozen=True, slots=True, eq=False)
class Policy:
    """A heading for each of some places and times.

    Attributes:
        plan: The mission that it is for: its start, goal, vehicle and dives.
        table: The headings in the local frame.
        longitude: shape (n,), of the places [degrees east].
        latitude: shape (n,) [degrees north].
        headings_deg: shape (T, n), through water, clockwise from true north; NaN from where the goal is not reached.
        hours_left: shape (T, n), that the quickest way takes from there.
        angle_deg: Glide angle of the dives [degrees].
        risk: Its flights in samples of the estimate; None without.
    """

    plan: MissionPlan
    table: HeadingTable
    longitude: Array
    latitude: Array
    headings_deg: Array
    hours_left: Array
    angle_deg: float
    risk: ListRisk | None

    @property
    def message(self) -> str:
        """The policy in words."""
        times, places = self.headings_deg.shape
        text = (
            f"policy: headings at {places} places and {times} time{'s' * (times > 1)}; within {self.table.near / 1e3:.1f} km "
            "the vehicle heads at the goal and dives less deep for less way"
        )
        return text if self.risk is None else f"{text}; {self.risk.text('the goal')}"


def policy_of(
    flow: Flow,
    plan: MissionPlan,
    *,
    no_go: tuple[NoGo, ...] = (),
    bathymetry: Bathymetry | None = None,
    samples: Sequence[Sample] = (),
) -> Policy:
    """Return the policy of a mission to one goal at the surface, flown in samples of the estimate.

    Args:
        flow: The estimate, or estimates for increasing times.
        plan: The mission.
        no_go: Areas that must not be entered.
        bathymetry: Bottom depth.
        samples: As for ``plan_scenarios``.

    Raises:
        PlanError: The mission has no legs, several goals or one below the surface, or its goal is out of reach.
    """
    if len(plan.headings_deg) == 0 or len(plan.goals) != 1 or plan.goals[0].depth > 0.0:
        raise PlanError(
            f"a policy leads to one goal at the surface, by dives; the mission has {len(plan.headings_deg)} legs to {len(plan.goals)} goals"
        )
    task = task_of_plan(flow, plan, no_go, bathymetry)
    water = water_of(task)
    table, left = _table(task, water, plan.duration)
    if not np.isfinite(left).any():
        raise PlanError(
            "the goal is out of reach of the vehicle from everywhere; there is no policy"
        )
    frame, (rows, columns) = task.region.grid.projection, left.shape[1:]
    east, north = (
        table.origin[axis] + table.spacing * np.arange(count)
        for axis, count in enumerate((columns, rows))
    )
    at = np.stack(np.meshgrid(east, north), axis=-1).reshape(-1, 2)
    reached = np.isfinite(left).any(axis=0).ravel()
    longitude, latitude = (np.asarray(one) for one in to_geographic(frame, *at[reached].T))
    degrees = np.mod(np.rad2deg(table.headings), 360.0).reshape(len(left), -1)[:, reached]
    hours = left.reshape(len(left), -1)[:, reached] / 3600.0
    angle = float(np.rad2deg(plan.vehicle.angles[0]))
    made = Policy(plan, table, longitude, latitude, degrees, hours, angle, None)
    if not samples:
        return made
    firsts = first_currents(task, plan, legs_of_plan(plan, task.flow))
    currents = with_paces(currents_of_estimate(flow, samples), plan.vehicle, 1)
    return replace(made, risk=list_risk(task, plan, _list(task, made), firsts, currents))


def _list(task: MissionTask, policy: Policy) -> WaypointList:
    """Return the goal as a list of one waypoint, with the headings on the way to it."""
    plan, goal = policy.plan, policy.plan.goals[0]
    place = np.array([to_local(task.region.grid.projection, goal.longitude, goal.latitude)])
    return WaypointList(
        (len(plan.headings_deg),),
        plan.settings.tolerance,
        place,
        np.array([np.deg2rad(policy.angle_deg)]),
        np.array([plan.settings.depth]),
        policy.table,
    )


def _table(task: MissionTask, water: Water, duration: float) -> tuple[HeadingTable, Array]:
    """Return the table of headings, and the time that the quickest way from its places takes, shape (T, rows, columns) [s]."""
    current, way = water.current, water.speed * task.leg_time(task.vehicle.angles[0])
    changes = current.times.size > 1
    latest = _LATEST * duration
    times = np.linspace(0.0, latest, _TIMES) if changes else np.zeros(1)
    arrivals = latest * np.arange(1, _ARRIVALS + 1) / _ARRIVALS if changes else np.zeros(1)
    fields = [_from_goal(task, water, float(arrival), way) for arrival in arrivals]
    rows, columns = current.shape
    step = max(
        round(way / _PARTS / current.spacing), int(np.ceil((rows * columns / _MOST) ** 0.5)), 1
    )
    left, heading = (
        np.stack([field[k].reshape(rows, columns)[::step, ::step] for field in fields])
        for k in (0, 1)
    )
    # how far from each time of the table the vehicle of each arrival passes a place
    departs = arrivals[:, None, None] - left
    off = np.abs(departs[None] - times[:, None, None, None]) if changes else left[None]
    nearest = np.argmin(np.where(np.isfinite(off), off, np.inf), axis=1)
    chosen = [
        np.take_along_axis(one, nearest.reshape(nearest.shape[0], *one.shape[1:]), axis=0)
        for one in (left, heading)
    ]
    table = HeadingTable(current.origin, step * current.spacing, times, chosen[1], _NEAR * way)
    return table, chosen[0]


def _from_goal(task: MissionTask, water: Water, arrival: float, way: float) -> tuple[Array, Array]:
    """Return the time of the quickest way to the goal [s] and the heading along it [rad] of each point of the lattice, shape (n,)."""
    current = water.current
    back = CurrentLattice(
        current.origin,
        current.spacing,
        arrival - current.times[::-1],
        -current.values[::-1],
        current.divisions,
    )
    goal = task.places[-1:]
    obstacles = obstacles_of(task.rings_at(task.settings.depth), task.settings.margin, task.places)
    sea = sea_of(back, water.speed, goal, obstacles)
    count = current.places.size
    front = spread(
        sea, np.array([count]), np.zeros(1), longest_time(task), np.zeros(0, dtype=np.intp)
    )
    ahead, seconds = _along(front, count, way)
    here = sea.places[:count]
    begins = np.where(np.isfinite(seconds), arrival - front.times[:count], 0.0)
    over_ground = (ahead - here) / np.where(seconds > 0.0, seconds, 1.0)
    through = over_ground - current.at(0.5 * (ahead + here), begins + 0.5 * seconds)
    turn = true_north_halfway(
        task.region.grid.projection, *(np.column_stack([here.real, here.imag]),) * 2
    )
    heading = np.where(seconds > 0.0, np.angle(through.imag + 1j * through.real) - turn, np.nan)
    return front.times[:count], heading


def _along(front: Front, count: int, way: float) -> tuple[Complex, Array]:
    """Return the places up to a way [m] ahead along the quickest way from each of the first points, and the time to there [s]."""
    at, places = np.arange(count), front.sea.places
    reached = np.isfinite(front.times[:count])
    while True:
        onward = front.before[at]
        goes = reached & (onward != at) & (np.abs(places[onward] - places[:count]) <= way)
        # the first point ahead counts however far it is
        goes |= reached & (at == np.arange(count)) & (onward != at)
        if not goes.any():
            break
        at = np.where(goes, onward, at)
    times = np.where(np.isfinite(front.times), front.times, 0.0)
    return places[at], times[:count] - times[at]
