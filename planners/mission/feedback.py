"""A mission corrected at each surfacing: from where it came up, the next leg is aimed anew at the place planned for its end.

The pilot knows the estimate, the place of each surfacing, and what dead reckoning tells: the leg's way over ground less its way through
water is the mean current of the leg, and its difference from what was expected is likely to go on. The pilot does not know the current
that the glider is in.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from planners.mission.flight import Currents, Flight, Legs, rate_over_ground
from planners.mission.leg import DRIFT_STEPS, fly_midpoints, fly_steps
from planners.vehicle import Glider
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError

# Glide angles among which the aim is sought, and how often the leg is flown in the estimate to aim it.
_ANGLES, _AIMS = 60, 2


@dataclass(frozen=True, slots=True)
class Pilot:
    """Who corrects a mission at its surfacings.

    Attributes:
        learned: Share of the error of a leg's mean current that is expected of the next leg; 0 for a pilot who only knows the place.
    """

    learned: float = 1.0

    def __post_init__(self) -> None:
        """Refuse a share that is none."""
        if not 0.0 <= self.learned <= 1.0:
            raise PlanError(f"a pilot's learned share is {self.learned!r}; expected 0 to 1")


@dataclass(frozen=True, slots=True, eq=False)
class Corrected:
    """A mission flown with corrections in K currents.

    Attributes:
        flight: Where it leads; its times are shape (K, n).
        headings: shape (K, L), clockwise from local north, as flown [rad].
        angles: shape (K, L), glide angles as flown [rad].
    """

    flight: Flight
    headings: Array
    angles: Array


@dataclass(frozen=True, slots=True, eq=False)
class _Leg:
    depths: Array
    drift: float

    @property
    def way(self) -> float:
        """Through all its dives and climbs [m]."""
        return float(np.sum(np.abs(np.diff(self.depths))))


def fly_corrected(
    believed: Currents, currents: Currents, vehicle: Glider, start: Array, legs: Legs, targets: Array, pilot: Pilot
) -> Corrected:
    """Return a mission flown in some currents, each of its legs after the first aimed anew where the one before has ended.

    Args:
        believed: One flow that does not change: what the pilot knows of the current.
        currents: K flows that do not change: what the glider is in.
        vehicle: What glides.
        start: shape (2,) [m].
        legs: As planned; the depths and drifts are flown, heading and angle of the first leg too.
        targets: shape (L, 2) [m], where each leg is planned to end, after its drift.
        pilot: Who corrects.
    """
    count = len(currents.latent)
    path, depths = [(np.tile(start, (count, 1)), np.zeros((count, 1)))], [float(legs.depths[0][0])]
    numbers, ends, off = [0], [], np.zeros((count, 2))
    headings, angles = (np.tile(planned, (count, 1)) for planned in (legs.headings, legs.angles))
    for k, steps in enumerate(legs.depths):
        leg, (begin, began) = _Leg(steps, float(legs.drifts[k])), path[-1]
        expected = np.zeros((count, 2))
        for _ in range(_AIMS if k > 0 else 1):
            end, time = _fly(believed, vehicle, begin, leg, headings[:, k], angles[:, k], fly_midpoints)[-1]
            expected = _carried(vehicle, leg, end - begin, time, headings[:, k], angles[:, k])
            if k > 0:
                headings[:, k], angles[:, k] = aim(vehicle, targets[k] - begin, expected + pilot.learned * off, leg.way, leg.drift)
        flown = _fly(currents, vehicle, begin, leg, headings[:, k], angles[:, k], fly_steps)
        off = _carried(vehicle, leg, flown[-1][0] - begin, flown[-1][1], headings[:, k], angles[:, k]) - expected
        path += [(at, began + time) for at, time in flown]
        depths += [*steps[1:], *[0.0] * (len(flown) - steps.size + 1)]
        numbers += [k] * len(flown)
        ends.append(len(path) - 1)
    places, times = (np.stack([step[i] for step in path], axis=1) for i in (0, 1))
    return Corrected(Flight(times[..., 0], np.array(depths), places, np.array(numbers), np.array(ends)), headings, angles)


def aim(vehicle: Glider, way: Array, current: Array, depths: float, drift: float) -> tuple[Array, Array]:
    """Return the heading and the glide angle [rad], each of shape (K,), that lead over a way in a mean current.

    The steepest angle that leads there is the quickest. When none does, the glider heads there at the angle that misses it by least.

    Args:
        vehicle: What glides.
        way: shape (K, 2), over ground [m].
        current: shape (K, 2), mean over the leg and its drift [m/s].
        depths: Sum of the heights of its dives and climbs [m].
        drift: At the surface after it [s].
    """
    angles = np.linspace(*vehicle.angles, _ANGLES)

    def through_water(angle: Array) -> tuple[Array, Array]:
        along, down = vehicle.speeds(np, angle)
        lasts = depths / down
        return way[:, None] - current[:, None] * (lasts + drift)[..., None], along * lasts

    needed, reach = through_water(angles)
    short = np.linalg.norm(needed, axis=2) - reach
    rows, leads = np.arange(len(way)), short <= 0.0
    last = _ANGLES - 1 - np.argmax(leads[:, ::-1], axis=1)
    best = np.where(leads.any(axis=1), last, np.argmin(short, axis=1))
    steeper = np.minimum(best + 1, _ANGLES - 1)
    here, there = short[rows, best], short[rows, steeper]
    between = leads.any(axis=1) & (there > 0.0)
    share = np.where(between, -here / np.where(between, there - here, 1.0), 0.0)
    angle = angles[best] + share * (angles[steeper] - angles[best])
    towards = through_water(angle[:, None])[0][:, 0]
    return np.arctan2(towards[:, 0], towards[:, 1]), angle


def _through(vehicle: Glider, heading: Array, angle: Array) -> tuple[Array, Array]:
    """Return the horizontal velocity through water (K, 2) and the vertical speed (K,) [m/s]."""
    along, down = vehicle.speeds(np, angle)
    return along[:, None] * np.column_stack([np.sin(heading), np.cos(heading)]), down


def _carried(vehicle: Glider, leg: _Leg, way: Array, time: Array, heading: Array, angle: Array) -> Array:
    """Return the mean current (K, 2) [m/s] of a leg that led over a way (K, 2) [m] in a time (K, 1) [s], by dead reckoning."""
    through, down = _through(vehicle, heading, angle)
    return np.asarray((way - through * (leg.way / down)[:, None]) / time)


def _fly(
    currents: Currents,
    vehicle: Glider,
    begin: Array,
    leg: _Leg,
    heading: Array,
    angle: Array,
    method: Callable[..., list[tuple[Array, Array]]],
) -> list[tuple[Array, Array]]:
    """Return (places, times since its beginning) after each step of a leg, each of K gliders with its own heading and angle."""
    through, down = _through(vehicle, heading, angle)
    heights = np.abs(np.diff(leg.depths))
    rate = rate_over_ground(currents, through, 0.0, np.concatenate([leg.depths, 0.5 * (leg.depths[:-1] + leg.depths[1:])]))
    flown = method(rate, begin, np.zeros((len(begin), 1)), leg.depths, [(height / down)[:, None] for height in heights], heights.size)
    if leg.drift > 0.0:
        surface = np.zeros(DRIFT_STEPS + 1)
        adrift = rate_over_ground(currents, np.zeros(2), 0.0, surface)
        flown += method(adrift, *flown[-1], surface, [leg.drift / DRIFT_STEPS] * DRIFT_STEPS, DRIFT_STEPS)
    return flown
