"""A mission's legs flown densely with NumPy, in one current or in many at once.

A leg leads from one surfacing to the next: heading and glide angle held, through depths that are known beforehand. ``fly_steps`` and
``fly_midpoints`` accept NumPy arrays and CasADi expressions: a yo passes the same depths at any heading and glide angle.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from planners.shooting.layout import frame_function
from planners.shooting.schedule import DRIFT_STEPS
from planners.simulation.currents import Currents
from planners.vehicle import Glider
from replay_kit.core.arrays import Array

#: ``fly_steps`` or ``fly_midpoints``.
Integrator = Callable[
    [Callable[[Any, Any, Any], Any], Any, Any, Any, Any, int], list[tuple[Any, Any]]
]


def fly_steps(
    rate: Callable[[Any, Any, Any], Any],
    place: Any,
    time: Any,
    depths: Any,
    durations: Any,
    count: int,
) -> list[tuple[Any, Any]]:
    """Return (place, time) after each step, by the classical Runge-Kutta method.

    Args:
        rate: (place, depth, time) -> horizontal velocity over ground [m/s].
        place: East and north at the beginning [m].
        time: At the beginning [s].
        depths: Of the steps' ends, one more than there are steps [m].
        durations: Of the steps [s].
        count: Number of steps.
    """
    path = []
    for i in range(count):
        step, middle = durations[i], 0.5 * (depths[i] + depths[i + 1])
        first = rate(place, depths[i], time)
        second = rate(place + step / 2.0 * first, middle, time + step / 2.0)
        third = rate(place + step / 2.0 * second, middle, time + step / 2.0)
        fourth = rate(place + step * third, depths[i + 1], time + step)
        place = place + step / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
        time = time + step
        path.append((place, time))
    return path


def fly_midpoints(
    rate: Callable[[Any, Any, Any], Any],
    place: Any,
    time: Any,
    depths: Any,
    durations: Any,
    count: int,
) -> list[tuple[Any, Any]]:
    """Return (place, time) after each step by the midpoint method: half of the work of ``fly_steps``, whose arguments it takes.

    Between levels the flow is linear in depth, and a step leads over a hundredth of an eddy: ten dives end within a metre or so of where
    ``fly_steps`` ends, which is accurate enough for the optimiser.
    """
    path = []
    for i in range(count):
        step, middle = durations[i], 0.5 * (depths[i] + depths[i + 1])
        halfway = place + step / 2.0 * rate(place, depths[i], time)
        place, time = place + step * rate(halfway, middle, time + step / 2.0), time + step
        path.append((place, time))
    return path


@dataclass(frozen=True, slots=True, eq=False)
class Legs:
    """The commands of a mission, leg after leg.

    Attributes:
        headings: shape (L,), clockwise from true north, as a compass holds them [rad].
        angles: shape (L,), glide angles [rad].
        depths: Of the steps of each leg [m].
        drifts: shape (L,) [s], at the surface after each leg.
    """

    headings: Array
    angles: Array
    depths: tuple[Array, ...]
    drifts: Array


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """The path of some legs.

    Attributes:
        time: shape (n,) [s], since the start; shape (K, n) where each flight is corrected on its own.
        depth: shape (n,) [m].
        place: shape (K, n, 2) [m], local east and north in each current.
        leg: shape (n,), number of the leg that ends there or later; 0 for the first.
        ends: shape (L,), number of the point at which each leg ends, after its drift.
    """

    time: Array
    depth: Array
    place: Array
    leg: Array
    ends: Array


def fly_legs(
    currents: Currents,
    vehicle: Glider,
    start: Array,
    legs: Legs,
    start_time: float = 0.0,
    method: Integrator = fly_steps,
) -> Flight:
    """Return the flight of some legs.

    Args:
        currents: K flows.
        vehicle: The glider.
        start: shape (2,) [m].
        legs: Its commands.
        start_time: On the clock of the currents' times [s].
        method: ``fly_steps``, or ``fly_midpoints`` with half of its work.
    """
    time, place = 0.0, np.tile(start, (len(currents.latent), 1))
    path, depths, number, ends = [(place, time)], [float(legs.depths[0][0])], [0], []
    for k, steps in enumerate(legs.depths):
        along, down = (float(speed) for speed in vehicle.speeds(np, legs.angles[k]))
        through = along * np.array([np.sin(legs.headings[k]), np.cos(legs.headings[k])])
        durations = np.abs(np.diff(steps)) / down
        frame = leg_frame(currents, path[-1][0], through, float(np.sum(durations)))
        profile = LegProfile(steps, durations, float(legs.drifts[k]))
        flown = fly_leg(currents, frame, path[-1], profile, start_time, method)
        path += flown
        depths += [*steps[1:], *[0.0] * (len(flown) - steps.size + 1)]
        number += [k] * len(flown)
        ends.append(len(path) - 1)
    places = np.stack([at for at, _ in path], axis=1)
    return Flight(
        np.array([now for _, now in path]),
        np.array(depths),
        places,
        np.array(number),
        np.array(ends),
    )


class LegProfile(NamedTuple):
    """A leg's steps: depths of their ends, shape (n + 1,) or (n + 1, K) [m]; durations, one or shape (K, 1) each; the drift after them."""

    depths: Array
    durations: Any
    drift: float


def fly_leg(
    currents: Currents,
    frame: "LegFrame",
    begin: tuple[Array, Any],
    profile: LegProfile,
    start_time: float,
    method: Integrator,
) -> list[tuple[Array, Any]]:
    """Return (places (K, 2) [m], time [s]) after each step of a leg and of the drift after it.

    Args:
        currents: K flows.
        frame: Along the leg.
        begin: Places and time where it begins.
        profile: Its steps.
        start_time: On the clock of the currents' times, of time zero [s].
        method: ``fly_steps`` or ``fly_midpoints``.
    """
    steps, durations, drift = profile
    middles = 0.5 * (steps[:-1] + steps[1:])
    # depths that differ from flight to flight are weighed as they come
    known = np.concatenate([steps, middles]) if steps.ndim == 1 else np.zeros(0)
    rate = rate_over_ground(currents, frame, start_time, known)
    flown = method(rate, *begin, steps, durations, len(steps) - 1)
    if drift > 0.0:
        surface = np.zeros(DRIFT_STEPS + 1)
        adrift = leg_frame(currents, flown[-1][0], np.zeros(2), drift)
        rate = rate_over_ground(currents, adrift, start_time, surface)
        each = [drift / DRIFT_STEPS] * DRIFT_STEPS
        flown += method(rate, *flown[-1], surface, each, DRIFT_STEPS)
    return flown


@dataclass(frozen=True, slots=True, eq=False)
class LegFrame:
    """The local frame along a leg of K flights, made linear: a flight at x in a current u moves by rate + turn (x - begin) + stretch u.

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


def leg_frame(
    currents: Currents, begin: Array, through: Array, duration: float | Array
) -> LegFrame:
    """Return the frame along a leg.

    Args:
        currents: K flows.
        begin: shape (K, 2), where it begins [m].
        through: shape (2,) or (K, 2), the velocity through water towards true east and north [m/s].
        duration: Under water, one or shape (K,) [s].
    """
    count = len(begin)
    if currents.pace is not None:
        through = currents.pace[:, None] * through
    given = begin.T, np.broadcast_to(through, (count, 2)).T, np.broadcast_to(duration, (1, count))
    rate, turn, stretch = (
        np.asarray(value) for value in frame_function(currents.flow.grid.projection)(*given)
    )
    return LegFrame(
        begin,
        rate.T,
        *(values.reshape(2, count, 2).transpose(1, 0, 2) for values in (turn, stretch)),
    )


def rate_over_ground(
    currents: Currents, frame: LegFrame, start_time: float, depths: Array
) -> Callable[[Array, Any, float | Array], Array]:
    """Return the rate of local places as a function of places, depth and time, for depths that are known beforehand.

    Args:
        currents: K flows.
        frame: Along the leg.
        start_time: On the clock of the currents' times [s].
        depths: At which it will be asked for [m]; at others of each flight, shape (K,), it may be asked for too.
    """
    weights = dict(zip(depths.tolist(), currents.weights(depths), strict=True))

    def over_ground(at: Array, depth: float | Array, now: float | Array) -> Array:
        own = isinstance(depth, np.ndarray) and depth.ndim > 0
        of_levels = currents.weights(np.asarray(depth)) if own else weights[float(depth)]
        # flights that are corrected each on its own differ by less than the current changes over
        water = currents.velocity(at, of_levels, start_time + float(np.mean(now)))
        turned = frame.turn @ (at - frame.begin)[..., None] + frame.stretch @ water[..., None]
        return frame.rate + turned[..., 0]

    return over_ground
