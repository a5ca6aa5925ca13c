"""Simulated flights of K gliders along a route, steered at each surfacing until arrival or a deadline.

The pilot knows the estimate, each surfacing's position, and dead reckoning. The displacement over ground minus that through water gives
the DAC of a dive; its deviation from the expected current is expected of the next dive too. The target is one planned leg ahead on the
route, or the next goal if nearer.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planners.simulation.currents import Currents
from planners.simulation.fly import DRIFT_STEPS, Flights, Legs, Path, fly_leg
from planners.task import Task
from planners.vehicle import Glider
from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import true_north_halfway
from replay_kit.core.grid import Projection

# Depths over which the expected current is taken.
_DEPTHS = 33
# Least distance at which a place on the route is aimed at [m].
_LEAST = 500.0
# Share of the way of a leg, or of a dive to a goal below the surface, that is not left to the next goal.
_LEFT = 0.5
# Part of a leg that does not count for the depth of a dive.
_PART = 0.25
# Parts of a depth to which the last dives to waypoints are rounded, and the least of them.
_SHARES, _SHALLOWEST = 0.05, 0.1
# Parts of a dive or climb at least.
_PARTS = 2


@dataclass(frozen=True, slots=True, eq=False)
class Route:
    """Reference route of steered gliders.

    Attributes:
        places: Ends of legs, shape (L + 1, 2) [m].
        angles, depths: Glide angles [rad] and dive depths [m], shape (L,).
        heading: Of the first dive [rad]; None to compute it.
        goals, radius: Goals in order, shape (G, 3), (G,) [m].
        legs: Leg in which each is met, shape (G,); 0 for the start.
        direct: Whether each leg heads for the next goal.
        alone: Whether the glider steers itself by the DAC of its last dive.
        told: Current expected in the first dive, shape (K, 2) [m/s]; NaN or None for the true one.
    """

    places: Array
    angles: Array
    depths: Array
    heading: float | None
    goals: Array
    legs: NDArray[np.intp]
    radius: Array
    direct: bool = False
    alone: bool = False
    told: Array | None = None

    @property
    def along(self) -> Array:
        """Along-route distance from the start, shape (L + 1,) [m]."""
        return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(self.places, axis=0), axis=1)))

    @property
    def passed(self) -> Array:
        """Along-route distance of each goal, shape (G,) [m]: at a leg's end, or its closest point for a goal below the surface."""
        ends = self.along[self.legs]
        first = np.maximum(self.legs - 1, 0)
        way = self.places[self.legs] - self.places[first]
        length = np.maximum(np.linalg.norm(way, axis=1), 1.0)
        share = np.sum((self.goals[:, :2] - self.places[first]) * way, axis=1) / length**2
        inside = self.along[first] + np.clip(share, 0.0, 1.0) * length
        found = np.where((self.goals[:, 2] > 0.0) & (self.legs > 0), np.minimum(inside, ends), ends)
        found[-1] = ends[-1]
        return np.maximum.accumulate(found)


@dataclass(frozen=True, slots=True, eq=False)
class Begin:
    """Initial state of K gliders on a route.

    Attributes:
        place: Position, shape (K, 2) [m].
        time: Time since the start, shape (K,) [s].
        leg: Number of the leg, from 0, shape (K,).
        heading: Heading of the first dive, shape (K,) [rad].
    """

    place: Array
    time: Array
    leg: NDArray[np.intp]
    heading: Array


def steer(
    task: Task, currents: Currents, route: Route, deadline: float, begin: Begin | None = None
) -> Flights:
    """Return the simulated flights of K gliders along a route.

    Args:
        task: Start, vehicle and the current known to the pilot.
        currents: True currents: K flows, or one for any number of gliders.
        route: Route and goals.
        deadline: Latest arrival [s since the start].
        begin: Initial state; None for the start of the task.
    """
    return _Gliders(task, currents, route, deadline, begin).fly()


class _Gliders:
    """State of K gliders under way (mutable)."""

    def __init__(
        self, task: Task, currents: Currents, route: Route, deadline: float, begin: Begin | None
    ) -> None:
        self.task, self.met_in, self.route, self.deadline = task, currents, route, deadline
        self.along, self.passed = route.along, route.passed
        count = len(currents.latent if route.told is None else route.told)
        if begin is not None:
            count = len(begin.place)
        self.clock = currents.clock(task.request.start_time_ns)
        self.radius = np.broadcast_to(route.radius, (count, len(route.goals)))
        self.first = begin
        leg = np.zeros(count, dtype=np.intp)
        self.at, self.now = np.tile(task.start[:2], (count, 1)), np.zeros(count)
        if begin is not None:
            self.at, self.now, leg = begin.place.copy(), begin.time.copy(), begin.leg
        self.ahead = self.along[leg]
        self.goal = np.sum(route.legs <= leg[:, None], axis=1)
        self.met = np.full((count, len(route.goals)), np.inf)
        self.nearest = np.full_like(self.met, np.inf)
        for k, goal in enumerate(self.goal):
            self.met[k, :goal] = self.nearest[k, :goal] = 0.0
        self.error = np.zeros((count, 2))
        first = self.at[None].copy(), self.now[None].copy(), np.full((1, count), task.start[2])
        self.kept = [[values] for values in first]
        if begin is not None:
            self.kept[2] = [np.zeros((1, count))]
        # of what each dive passes
        self.weights = {
            float(deep): task.currents.weights(np.linspace(0.0, deep, _DEPTHS)).mean(axis=0)
            for deep in np.unique(np.append(route.depths, route.goals[route.goals[:, 2] > 0.0, 2]))
        }
        self.surface = task.currents.weights(np.zeros(1))[0]

    def fly(self) -> Flights:
        """Fly dives until all gliders arrive or the deadline passes."""
        goals, ups, numbers, dive = len(self.route.goals), list[int](), [0], 0
        live = np.flatnonzero((self.goal < goals) & (self.now <= self.deadline))
        while live.size:
            path = self._dive(live, dive)
            steps = len(path[0])
            numbers += [dive] * steps
            ups.append(len(numbers) - 1 - DRIFT_STEPS)
            for store, values in zip(self.kept, path, strict=True):
                store.append(values)
            live = live[(self.goal[live] < goals) & (self.now[live] <= self.deadline)]
            dive += 1
        place, time, depth = (np.concatenate(parts) for parts in self.kept)
        return Flights(
            self.met,
            self.nearest,
            place.transpose(1, 0, 2),
            time.T,
            depth.T,
            np.array(numbers),
            np.array(ups, dtype=np.intp),
        )

    def _target(self, live: NDArray[np.intp]) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return the targets of gliders, shape (K, 2) [m], the dive depths [m], and a mask of targets that are goals."""
        route, along = self.route, self.along
        at, goal = self.at[live], self.goal[live]
        if route.direct:
            return (
                route.goals[goal, :2],
                route.depths[np.minimum(goal, len(route.depths) - 1)],
                goal >= 0,
            )
        lengths = np.diff(along)
        way = np.diff(route.places, axis=0) / np.maximum(lengths, 1.0)[:, None]
        since = at[:, None] - route.places[None, :-1]
        part = np.clip(np.sum(since * way, axis=-1), 0.0, lengths)
        until = self.passed[goal]
        # never back, and not past the next goal, where the route may come by again
        part = np.clip(part, self.ahead[live, None] - along[:-1], until[:, None] - along[:-1])
        open_ = (part >= 0.0) & (part <= lengths)
        part = np.clip(part, 0.0, lengths)
        off = np.linalg.norm(since - part[..., None] * way, axis=-1)
        best = np.argmin(np.where(open_, off, np.inf), axis=1)
        rows = np.arange(live.size)
        progress = np.where(open_.any(axis=1), along[best] + part[rows, best], self.ahead[live])
        self.ahead[live] = np.maximum(self.ahead[live], progress)
        numbers = np.arange(along.size)
        flown = np.interp(progress, along, numbers)
        # the dive is of the legs that it follows for more than a part
        leg, then = (
            np.minimum(np.floor(flown + part).astype(int), lengths.size - 1)
            for part in (_PART, 1.0 - _PART)
        )
        deep = np.minimum(route.depths[leg], route.depths[then])
        there = np.interp(flown + 1.0, numbers, along)
        there = np.minimum(np.maximum(there, progress + _LEAST), until)
        place = np.column_stack([np.interp(there, along, route.places[:, c]) for c in (0, 1)])
        # what would be left is too near for another dive
        below, whole = route.goals[goal, 2], 2.0 * self.task.settings.yos * deep
        share = np.where(below > 0.0, below / whole, 1.0)
        last = until - there < _LEFT * share * lengths[leg]
        return np.where(last[:, None], route.goals[goal, :2], place), deep, last

    def _expected(
        self,
        live: NDArray[np.intp],
        to: Array,
        deep: Array,
        drift: Array,
        currents: Currents,
        clock: float,
    ) -> Array:
        """Return the mean current over a dive and its drift halfway to a target, shape (K, 2) [m/s]."""
        at, vehicle = self.at[live], self.task.vehicle
        along, down = (float(value) for value in vehicle.speeds(np, vehicle.angles[0]))
        lasts = 2.0 * self.task.settings.yos * deep / down
        way = to - at
        reach = along * lasts / np.maximum(np.linalg.norm(way, axis=1), 1.0)
        middle = at + 0.5 * np.minimum(reach, 1.0)[:, None] * way
        of_levels = np.array([self.weights[float(z)] for z in deep])
        share = (drift / (lasts + drift))[:, None]
        of_levels = (1.0 - share) * of_levels + share * self.surface
        return currents.velocity(middle, of_levels, clock + self.now[live] + 0.5 * lasts)

    def _dive(self, live: NDArray[np.intp], number: int) -> tuple[Array, Array, Array]:
        """Fly one dive of some gliders; return positions, times and depths of all, shape (S, K, ...)."""
        task, route, vehicle = self.task, self.route, self.task.vehicle
        settings, projection = task.settings, task.region.grid.projection
        to, deep, last = self._target(live)
        goal, at = self.goal[live], self.at[live]
        below = np.where(last, route.goals[goal, 2], 0.0)
        drifts = np.full(live.size, settings.surface_time)
        height = np.where(below > 0.0, below, 2.0 * settings.yos * deep)
        coming = np.where(last, 0.0, drifts)
        passed = np.where(below > 0.0, below, deep)
        u = self._expected(live, to, passed, coming, task.currents, task.start_time)
        if route.alone:
            u = np.zeros_like(u) if number else self._met_at_first(live, to, passed, coming)
            angle = route.angles[goal]
            local, share = home(vehicle, to - at, u + self.error[live], (angle, height), drifts)
            # many are flown together in few kinds of dives
            deep = deep * np.maximum(np.round(share / _SHARES) * _SHARES, _SHALLOWEST)
        else:
            local, angle = aim(vehicle, to - at, u + self.error[live], height, coming)
        heading = local - true_north_halfway(projection, at, to)
        if number == 0 and self.first is not None:
            heading, angle = self.first.heading[live], route.angles[self.first.leg[live]]
        elif number == 0 and route.heading is not None:
            heading, angle = (
                np.full(live.size, value) for value in (route.heading, route.angles[0])
            )
        turns = np.zeros((2 * settings.yos + 1, live.size))
        turns[1::2] = deep
        if number == 0 and self.first is None:
            turns[0] = task.start[2]
            turns[1] = np.maximum(deep, task.start[2])
        path = fly_leg(
            self._current(live, number),
            vehicle,
            (at, self.clock + self.now[live]),
            Legs(heading, angle, turns, drifts),
            _PARTS,
            route.goals[:, 2],
        )
        path = replace(path, times=path.times - self.clock)
        tall = np.sum(np.abs(np.diff(turns, axis=0)), axis=0)
        ends, lasts = (at, path.places[-1]), path.times[-1] - path.times[0]
        found = mean_current(projection, (vehicle, (heading, angle), tall), ends, lasts)
        self.error[live] = found if route.alone else found - u
        arrived = self._arrive(live, path)
        return self._kept(live, path, arrived)

    def _current(self, live: NDArray[np.intp], number: int) -> Currents:
        """Return the true currents of some gliders, with the speeds of their dive."""
        met, vehicle, count = self.met_in, self.task.vehicle, len(self.at)
        errs = bool(vehicle.speed_spread or vehicle.speed_error) and self.first is None
        pace = vehicle.paces(count, number)[live] if errs else None
        numbers = np.zeros(live.size, dtype=np.intp) if len(met.latent) == 1 else live
        return met.some(numbers, pace)

    def _met_at_first(self, live: NDArray[np.intp], to: Array, deep: Array, drift: Array) -> Array:
        """Return the current that self-steering gliders expect in their first dive, shape (K, 2) [m/s]."""
        known, clock = self._current(live, 0), self.clock
        met = self._expected(live, to, deep, drift, known, clock)
        told = self.route.told
        return met if told is None else np.where(np.isnan(told[live]), met, told[live])

    def _arrive(self, live: NDArray[np.intp], path: Path) -> NDArray[np.bool_]:
        """Record the goals met in a dive; return a mask of gliders that arrived."""
        goals, up = self.route.goals, len(path.times) - 1 - DRIFT_STEPS
        goal, rows = self.goal[live], np.arange(live.size)
        away, when = np.linalg.norm(path.places - goals[goal, :2], axis=-1), path.times
        at_depth = np.abs(path.depths - goals[goal, 2]) < 1e-6
        counts = np.where(goals[goal, 2] > 0.0, at_depth, np.arange(len(when))[:, None] == up)
        counts[up + 1 :] = False
        away = np.where(counts, away, np.inf)
        best = np.argmin(away, axis=0)
        off, at = away[best, rows], when[best, rows]
        self.nearest[live, goal] = np.minimum(self.nearest[live, goal], off)
        hit = (off <= self.radius[live, goal]) & (at <= self.deadline)
        self.met[live[hit], goal[hit]] = at[hit]
        self.goal[live[hit]] += 1
        self.ahead[live[hit]] = np.maximum(self.ahead[live[hit]], self.passed[goal[hit]])
        return np.asarray(hit & (goal == len(goals) - 1))

    def _kept(
        self, live: NDArray[np.intp], path: Path, arrived: NDArray[np.bool_]
    ) -> tuple[Array, Array, Array]:
        """Return a dive of some gliders as one of all; arrived ones stay at their last surfacing."""
        up = len(path.times) - 1 - DRIFT_STEPS
        found = list[Array]()
        for values, before in zip((path.places, path.times, path.depths), self.kept, strict=True):
            values = values.copy()
            values[up:, arrived] = values[up, arrived]
            whole = np.repeat(before[-1][-1:], len(values) - 1, axis=0)
            whole[:, live] = values[1:]
            found.append(whole)
        self.at[live], self.now[live] = found[0][-1][live], found[1][-1][live]
        return found[0], found[1], found[2]


# Glide angles among which the aim is sought.
_ANGLES = 32


def mean_current(
    projection: Projection,
    flown: tuple[Glider, tuple[Array, Array], Array | float],
    ends: tuple[Array, Array],
    lasts: Array,
) -> Array:
    """Return the mean local current of legs from dead reckoning, shape (K, 2) [m/s].

    Args:
        projection: Local frame.
        flown: Glider, headings and glide angles, shape (K,) [rad], and summed heights of dives and climbs [m].
        ends: Begin and end positions, shape (K, 2) [m].
        lasts: Duration with the drift, shape (K,) [s].
    """
    (vehicle, (heading, angle), height), (begin, end) = flown, ends
    along, down = vehicle.speeds(np, angle)
    local = heading + true_north_halfway(projection, begin, end)
    through = (along * height / down)[:, None] * np.column_stack([np.sin(local), np.cos(local)])
    return np.asarray((end - begin - through) / lasts[:, None])


def home(
    vehicle: Glider, displacement: Array, current: Array, dive: tuple[Array, Array], drift: Array
) -> tuple[Array, Array]:
    """Return headings of self-steering gliders [rad from local north] and the fractions of a dive that reach the waypoint, shape (K,).

    Args:
        vehicle: Glider.
        displacement: Displacement to the waypoint, shape (K, 2) [m].
        current: Expected mean current over a dive and its drift, shape (K, 2) [m/s].
        dive: Glide angles [rad] and summed heights of dives and climbs [m], shape (K,) each.
        drift: Drift time after the leg, shape (K,) [s].
    """
    angle, height = dive
    along, down = vehicle.speeds(np, angle)
    under, distance = height / down, np.maximum(np.linalg.norm(displacement, axis=1), 1e-3)
    ahead = displacement / distance[:, None]
    off = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    set_across, set_ahead = np.sum(current * off, axis=1), np.sum(current * ahead, axis=1)
    found = list[tuple[Array, Array]]()
    # on the way the drift at the surface counts as well; the last dive is to come up at the waypoint
    for duration in (under + drift, under):
        speed = along * under / duration
        # of the speed through water as much across as the current sets, the rest ahead
        across = np.clip(-set_across, -speed, speed)
        through = np.sqrt(speed**2 - across**2)
        made_good = np.maximum(set_ahead + through, 1e-3 * speed)
        way = across[:, None] * off + through[:, None] * ahead
        found.append((np.arctan2(*way.T), np.minimum(distance / (made_good * duration), 1.0)))
    whole = found[0][1] >= 1.0
    heading, share = (np.where(whole, *both) for both in zip(*found, strict=True))
    return heading, share


def aim(
    vehicle: Glider, displacement: Array, current: Array, height: Array, drift: Array
) -> tuple[Array, Array]:
    """Return the heading from local north and the glide angle towards a target in a mean current, shape (K,) each [rad].

    The steepest angle that reaches the target is the fastest. If none does, the angle with the least miss distance is returned.

    Args:
        vehicle: Glider.
        displacement: Displacement to the target over ground, shape (K, 2) [m].
        current: Mean current over the leg and its drift, shape (K, 2) [m/s].
        height: Summed heights of the leg's dives and climbs, shape (K,) [m].
        drift: Drift time after the leg, shape (K,) [s].
    """
    angles = np.linspace(*vehicle.angles, _ANGLES)

    def lacking(angle: Array) -> tuple[Array, Array]:
        """Return the displacement required through water, shape (K, n, 2) [m], and the part out of reach."""
        along, down = vehicle.speeds(np, angle)
        lasts = height[:, None] / down
        needed = displacement[:, None] - current[:, None] * (lasts + drift[:, None])[..., None]
        return needed, np.linalg.norm(needed, axis=-1) - along * lasts

    short = lacking(angles[None])[1]
    rows, reaches = np.arange(len(displacement)), short <= 0.0
    last = _ANGLES - 1 - np.argmax(reaches[:, ::-1], axis=1)
    best = np.where(reaches.any(axis=1), last, np.argmin(short, axis=1))
    steeper = np.minimum(best + 1, _ANGLES - 1)
    here, there = short[rows, best], short[rows, steeper]
    between = reaches.any(axis=1) & (there > 0.0)
    share = np.where(between, -here / np.where(between, there - here, 1.0), 0.0)
    angle = angles[best] + share * (angles[steeper] - angles[best])
    towards = lacking(angle[:, None])[0][:, 0]
    return np.arctan2(towards[:, 0], towards[:, 1]), angle
