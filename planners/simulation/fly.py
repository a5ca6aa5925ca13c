"""Legs flown in K currents at once, each glider at its own place, time, heading, glide angle and depths, by the midpoint method.

A leg leads from one surfacing to the next: heading and glide angle held through its depths, then a drift. Steps end where the levels of the
current are passed, as it bends there in depth.
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
    """The commands of a mission.

    Attributes:
        headings: shape (L,), clockwise from true north, as a compass holds them [rad].
        angles: shape (L,), glide angles [rad].
        turns: shape (P + 1, L) [m], depths at which each leg begins, turns and ends, the last repeated.
        drifts: shape (L,) [s], at the surface after each leg.
    """

    headings: Array
    angles: Array
    turns: Array
    drifts: Array


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """A leg of K gliders.

    Attributes:
        places: shape (S + 1, K, 2) [m], local east and north.
        times: shape (S + 1, K) [s].
        depths: shape (S + 1, K) [m]; the last ``DRIFT_STEPS`` steps are the drift.
    """

    places: Array
    times: Array
    depths: Array


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """The flights of some legs.

    Attributes:
        time: shape (K, n) [s], since the start.
        depth: shape (n,) [m].
        place: shape (K, n, 2) [m], local east and north in each current.
        leg: shape (n,), number of the leg that ends there or later; 0 for the first.
        ends: shape (L,), number of the point at which each leg ends, after its drift.
    """

    time: Array
    depth: Array
    place: Array
    leg: NDArray[np.intp]
    ends: NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class Flights:
    """K gliders, each until it arrived; from then on it stays.

    Attributes:
        met: shape (K, G) [s], since the start, when each goal is met; infinite where it is not by the deadline.
        nearest: shape (K, G), least distance at which each was passed [m].
        place: shape (K, n, 2) [m].
        time: shape (K, n) [s], since the start.
        depth: shape (K, n) [m].
        dive: shape (n,), number of the dive that leads there, from 0; the drift after it belongs to it.
        ups: shape (D,), numbers of the points at which dives come up.
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
        """When the last goal is met, shape (K,) [s]; infinite where it is not."""
        return self.met[:, -1]

    @property
    def surfacings(self) -> Array:
        """Where each dive and the drift after it ends, shape (K, D, 2) [m]; of a glider that arrived, where it stays."""
        return self.place[:, self.ups + DRIFT_STEPS]


def fly(
    currents: Currents,
    vehicle: Glider,
    start: Array,
    legs: Legs,
    start_time: float = 0.0,
    parts: int = COARSE,
    stops: Array | None = None,
) -> Flight:
    """Return the flights of legs, one after the other, in K currents.

    Args:
        currents: K flows.
        vehicle: The glider.
        start: shape (2,) [m].
        legs: Its commands.
        start_time: On the clock of the currents' times [s].
        parts: Of a dive or climb at least.
        stops: Depths at which steps end too [m].
    """
    count = len(currents.latent)
    at, now = np.tile(start, (count, 1)), np.zeros(count)
    places, times, ends = [at[None]], [now[None]], [0]
    depths, number = [legs.turns[:1, 0]], [np.zeros(1, dtype=int)]
    for k in range(len(legs.headings)):
        heading, angle = np.full(count, legs.headings[k]), np.full(count, legs.angles[k])
        turns, drift = legs.turns[:, [k]], np.full(count, legs.drifts[k])
        path = fly_leg(
            currents, vehicle, (at, start_time + now), (heading, angle), turns, drift, parts, stops
        )
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
    command: tuple[Array, Array],
    turns: Array,
    drift: Array,
    parts: int = COARSE,
    stops: Array | None = None,
) -> Path:
    """Return one leg of K gliders.

    Args:
        currents: K flows, or one for any number of gliders.
        vehicle: The glider.
        begin: Places, shape (K, 2) [m], and times, shape (K,), on the clock of the currents [s].
        command: Headings from true north and glide angles, shape (K,) [rad].
        turns: shape (P + 1, K) or (P + 1, 1) [m], where it begins, turns and ends.
        drift: shape (K,) [s].
        parts: Of a dive or climb at least.
        stops: Depths at which steps end too [m].
    """
    (at, now), (heading, angle), count = begin, command, len(begin[0])
    along, down = (np.broadcast_to(speed, count) for speed in vehicle.speeds(np, angle))
    through = along[:, None] * np.stack([np.sin(heading), np.cos(heading)], axis=-1)
    levels = currents.flow.levels
    depths = steps_of(turns, levels if stops is None else np.union1d(levels, stops), parts)
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
    """Return the depths at which steps end, shape (S + 1, K) [m]: levels, and so many parts of a dive or climb at least.

    Gliders have the same number of steps; those of one that passes fewer levels have no length.
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
    """The local frame along legs, made linear: a glider at x in a current u moves by rate + turn (x - begin) + stretch u.

    Attributes:
        begin: shape (K, 2) [m].
        rate: shape (K, 2) [m/s].
        turn: shape (K, 2, 2) [1/s].
        stretch: shape (K, 2, 2).
    """

    begin: Array
    rate: Array
    turn: Array
    stretch: Array


def frame_along(currents: Currents, begin: Array, through: Array, lasts: Array) -> Frame:
    """Return the frame along legs.

    Args:
        currents: K flows.
        begin: shape (K, 2), where they begin [m].
        through: shape (K, 2), the velocity through water towards true east and north [m/s].
        lasts: shape (K,), under water [s].
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
    """Return places and times after each step, from its depths at the beginning and the middle, shape (S, K) [m], and duration [s]."""
    weights = [currents.weights(of.ravel()).reshape(*of.shape, -1) for of in depths]
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
    """Return the function of a leg that makes ``rate_in_frame`` linear: (place, velocity through water, duration) -> (rate, turn, stretch).

    A compass holds a heading of true north, which turns along the leg, and the frame stretches lengths. The slopes are those halfway
    along the leg: to a part in a million for a leg of 5 km.
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
