"""Simulation of legs in K currents at once, by the midpoint method.

A leg holds heading and glide angle through its depths, then drifts at the surface. Steps end at the levels of the current, where its
profile has kinks.
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from threading import RLock

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from planners.simulation.currents import Currents
from planners.vehicle import Glider
from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import rate_in_frame
from replay_kit.core.grid import Projection

#: Held by the thread that makes or calls functions of CasADi: IPOPT's linear solver and a program's own data are one for the process.
TURN = RLock()
#: Steps of a drift; parts of a dive or climb at least.
DRIFT_STEPS, COARSE = 2, 4


@dataclass(frozen=True, slots=True, eq=False)
class Legs:
    """Commands of a mission.

    Attributes:
        headings: Headings, shape (L,), clockwise from true north [rad].
        angles: Glide angles, shape (L,) [rad].
        turns: Depths at which each leg begins, turns and ends, shape (P + 1, L) [m], padded with the last.
        drifts: Drift time after each leg, shape (L,) [s].
    """

    headings: Array
    angles: Array
    turns: Array
    drifts: Array


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """Simulated leg of K gliders.

    Attributes:
        places: Positions, shape (S + 1, K, 2) [m], local east and north.
        times: Times, shape (S + 1, K) [s].
        depths: Depths, shape (S + 1, K) [m]; the last ``DRIFT_STEPS`` steps are the drift.
    """

    places: Array
    times: Array
    depths: Array


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """Simulated flights of commanded legs.

    Attributes:
        time: Time since the start, shape (K, n) [s].
        depth: Depth, shape (n,) [m].
        place: Position in each current, shape (K, n, 2) [m], local east and north.
        leg: Number of the leg at each point, from 0, shape (n,).
        ends: Point at which each leg ends after its drift, shape (L,).
    """

    time: Array
    depth: Array
    place: Array
    leg: NDArray[np.intp]
    ends: NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class Flights:
    """Simulated flights of K gliders, each stationary after its arrival.

    Attributes:
        met: Time at which each goal is met, shape (K, G) [s since the start]; infinite if not by the deadline.
        nearest: Closest approach to each goal, shape (K, G) [m].
        place: Position, shape (K, n, 2) [m].
        time: Time since the start, shape (K, n) [s].
        depth: Depth, shape (K, n) [m].
        dive: Number of the dive, with its drift, at each point, from 0, shape (n,).
        ups: Points at which dives surface, shape (D,).
    """

    met: Array
    nearest: Array
    place: Array
    time: Array
    depth: Array
    dive: NDArray[np.intp]
    ups: NDArray[np.intp]

    @property
    def arrived(self) -> Array:
        """Time at which the last goal is met, shape (K,) [s]; infinite if not."""
        return self.met[:, -1]

    @property
    def surfacings(self) -> Array:
        """End position of each dive and its drift, shape (K, D, 2) [m]; constant after arrival."""
        return self.place[:, self.ups + DRIFT_STEPS]


def fly(
    currents: Currents,
    vehicle: Glider,
    begin: tuple[Array, float],
    legs: Legs,
    parts: int = COARSE,
    stops: Array | None = None,
) -> Flight:
    """Return the simulated flights of consecutive legs in K currents.

    Args:
        currents: K flows.
        vehicle: Glider.
        begin: Position, shape (2,) [m], and time on the clock of the currents [s].
        legs: Commands.
        parts: Minimum number of steps per dive or climb.
        stops: Additional depths at which steps end [m].
    """
    count, (start, start_time) = len(currents.latent), begin
    at, now = np.tile(start, (count, 1)), np.zeros(count)
    places, times, ends = [at[None]], [now[None]], [0]
    depths, number = [legs.turns[:1, 0]], [np.zeros(1, dtype=int)]
    for k in range(len(legs.headings)):
        heading, angle = np.full(count, legs.headings[k]), np.full(count, legs.angles[k])
        one = Legs(heading, angle, legs.turns[:, [k]], np.full(count, legs.drifts[k]))
        path = fly_leg(currents, vehicle, (at, start_time + now), one, parts, stops)
        moving = np.append(True, np.any(np.diff(path.times, axis=0) > 0.0, axis=1))[1:]
        if not moving.any():
            moving[-1] = True
        at, now = path.places[-1], path.times[-1] - start_time
        places.append(path.places[1:][moving])
        times.append(path.times[1:][moving] - start_time)
        depths.append(path.depths[1:, 0][moving])
        number.append(np.full(int(moving.sum()), k))
        ends.append(ends[-1] + int(moving.sum()))
    return Flight(
        np.concatenate(times).T,
        np.concatenate(depths),
        np.concatenate(places).transpose(1, 0, 2),
        np.concatenate(number),
        np.array(ends[1:], dtype=int),
    )


def fly_leg(
    currents: Currents,
    vehicle: Glider,
    begin: tuple[Array, Array],
    legs: Legs,
    parts: int = COARSE,
    stops: Array | None = None,
) -> Path:
    """Return one simulated leg of K gliders.

    Args:
        currents: K flows, or one for any number of gliders.
        vehicle: Glider.
        begin: Positions, shape (K, 2) [m], and times on the clock of the currents, shape (K,) [s].
        legs: Commands, K of them; ``turns`` may be common to all, shape (P + 1, 1).
        parts: Minimum number of steps per dive or climb.
        stops: Additional depths at which steps end [m].
    """
    (at, now), count, drift = begin, len(begin[0]), legs.drifts
    along, down = (np.broadcast_to(speed, count) for speed in vehicle.speeds(np, legs.angles))
    through = along[:, None] * np.stack([np.sin(legs.headings), np.cos(legs.headings)], axis=-1)
    levels = currents.flow.levels
    depths = steps_of(legs.turns, levels if stops is None else np.union1d(levels, stops), parts)
    depths = np.broadcast_to(depths, (len(depths), count))
    heights = np.abs(np.diff(depths, axis=0))
    lasts = np.sum(heights, axis=0) / down
    middles = 0.5 * (depths[1:] + depths[:-1])
    frame = frame_along(currents, at, through, lasts)
    path = _stepped(currents, frame, (at, now), (depths[:-1], middles), heights / down)
    ashore = np.zeros((DRIFT_STEPS, count))
    if np.any(drift > 0.0):
        adrift = frame_along(currents, path[0][-1], np.zeros((count, 2)), drift)
        each = np.broadcast_to(drift / DRIFT_STEPS, ashore.shape)
        more = _stepped(currents, adrift, (path[0][-1], path[1][-1]), (ashore, ashore), each)
    else:
        more = [np.repeat(values[-1:], DRIFT_STEPS, axis=0) for values in path]
        ashore = np.repeat(depths[-1:], DRIFT_STEPS, axis=0)
    return Path(
        np.concatenate([at[None], path[0], more[0]]),
        np.concatenate([now[None], path[1], more[1]]),
        np.concatenate([depths, ashore]),
    )


def steps_of(turns: Array, levels: Array, parts: int) -> Array:
    """Return the depths at which steps end, shape (S + 1, K) [m]: levels, and a minimum number of parts per dive or climb.

    All gliders have the same number of steps; surplus steps have zero length.
    """
    found = [turns[:1]]
    for begin, end in pairwise(turns):
        low, high = np.minimum(begin, end), np.maximum(begin, end)
        met = levels[(levels > low.min()) & (levels < high.max())]
        way = np.abs(np.clip(met[:, None], low, high) - begin)
        knots = np.vstack([np.zeros_like(begin), np.sort(way, axis=0), high - low])
        pieces = np.diff(knots, axis=0)
        share = np.max(pieces / np.maximum(high - low, 1e-9), axis=1)
        counts = np.maximum(np.ceil(share * parts - 1e-9).astype(int), 1)
        inner = [
            knots[i] + (np.arange(1, n + 1) / n)[:, None] * pieces[i] for i, n in enumerate(counts)
        ]
        found.append(begin + np.sign(end - begin) * np.concatenate(inner))
    return np.concatenate(found)


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """Linearised local frame along legs: a glider at x in a current u moves by rate + turn (x - begin) + stretch u.

    Attributes:
        begin: Begin position, shape (K, 2) [m].
        rate: Velocity through water in the frame, shape (K, 2) [m/s].
        turn: Derivative of the velocity with position, shape (K, 2, 2) [1/s].
        stretch: Scale factors of the current, shape (K, 2, 2).
    """

    begin: Array
    rate: Array
    turn: Array
    stretch: Array


def frame_along(currents: Currents, begin: Array, through: Array, lasts: Array) -> Frame:
    """Return the linearised frame along legs.

    Args:
        currents: K flows.
        begin: Begin of each leg, shape (K, 2) [m].
        through: Velocity through water, shape (K, 2) [m/s], true east and north.
        lasts: Duration under water, shape (K,) [s].
    """
    count = len(begin)
    if currents.pace is not None:
        through = currents.pace[:, None] * through
    with TURN:
        function = _frame_function(currents.flow.grid.projection)
        found = function(begin.T, through.T, lasts[None])
    rate, turn, stretch = (np.asarray(value) for value in found)
    squares = (values.reshape(2, count, 2).transpose(1, 0, 2) for values in (turn, stretch))
    return Frame(begin, rate.T, *squares)


def _stepped(
    currents: Currents,
    frame: Frame,
    begin: tuple[Array, Array],
    depths: tuple[Array, Array],
    lasts: Array,
) -> list[Array]:
    """Return positions and times after each step, from begin and middle depths, shape (S, K) each [m], and durations [s]."""
    weights = [currents.weights(depth.ravel()).reshape(*depth.shape, -1) for depth in depths]
    (at, now), places, times = begin, list[Array](), list[Array]()

    def rate(at: Array, of_levels: Array, now: Array) -> Array:
        water = currents.velocity(at, of_levels, now)[..., None]
        turned = frame.turn @ (at - frame.begin)[..., None] + frame.stretch @ water
        return np.asarray(frame.rate + turned[..., 0])

    for first, middle, step in zip(*weights, lasts, strict=True):
        if np.any(step > 0.0):
            half = at + 0.5 * step[:, None] * rate(at, first, now)
            at = at + step[:, None] * rate(half, middle, now + 0.5 * step)
            now = now + step
        places.append(at)
        times.append(now)
    return [np.array(places), np.array(times)]


@lru_cache(maxsize=8)
def _frame_function(projection: Projection) -> ca.Function:
    """Return the linearisation of ``rate_in_frame``: (position, velocity through water, duration) -> (rate, turn, stretch).

    True north turns along the leg and the frame stretches lengths. Derivatives are taken at the middle of the leg: accurate to 1e-6 for a
    leg of 5 km.
    """
    place, through, current = (ca.SX.sym(name, 2) for name in ("place", "through", "current"))
    lasts, at = ca.SX.sym("lasts"), ca.SX.sym("at", 2)
    rates = rate_in_frame(
        projection, at[0], at[1], (through[0], through[1]), (current[0], current[1])
    )
    exact, halfway = ca.vertcat(*rates), 0.5 * lasts * through

    def there(value: ca.SX) -> ca.SX:
        return ca.substitute(ca.substitute(value, current, ca.DM.zeros(2)), at, place + halfway)

    turn, stretch = there(ca.jacobian(exact, at)), there(ca.jacobian(exact, current))
    rate = there(exact) - turn @ halfway
    return ca.Function("frame", [place, through, lasts], [rate, turn, stretch], {"cse": True})
