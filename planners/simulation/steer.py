"""A mission corrected at each surfacing: from where the glider came up, the next leg is aimed at the place planned for its end.

The pilot knows the estimate, the place of each surfacing, and dead reckoning: the leg's displacement over ground less its displacement
through water is the mean current of the leg, and the error of its prediction is likely to persist. The pilot does not know the current
that the glider is in.
"""

from dataclasses import dataclass, field

import numpy as np

from planners.simulation.currents import Currents
from planners.simulation.fly import Legs, fly_leg
from planners.vehicle import Glider
from replay_kit.core.arrays import Array
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import true_north_halfway
from replay_kit.core.grid import Projection

# Glide angles among which the aim is sought, and how often the leg is flown in the estimate to aim it.
_ANGLES, _AIMS = 60, 2


@dataclass(frozen=True, slots=True)
class Pilot:
    """Who corrects a mission at its surfacings.

    Attributes:
        persistence: Share of the error of a leg's mean current that is expected in the next leg; 0 for a pilot who only uses the place.
    """

    persistence: float = 1.0

    def __post_init__(self) -> None:
        """Raise PlanError for a share that is not between 0 and 1."""
        if not 0.0 <= self.persistence <= 1.0:
            raise PlanError(f"a pilot's persistence is {self.persistence!r}; expected 0 to 1")


@dataclass(eq=False)
class Correction:
    """What steers K gliders along a plan: mutable, it remembers the leg before.

    Attributes:
        pilot: Who corrects.
        known: One flow: what the pilot knows of the current.
        vehicle: The glider.
        legs: As planned; the first is flown so.
        targets: shape (L, 2) [m], where each leg is planned to end, after its drift.
        start_time: On the clock of the flow's times, of the start [s].
    """

    pilot: Pilot
    known: Currents
    vehicle: Glider
    legs: Legs
    targets: Array
    start_time: float
    before: tuple[Array, Array, Array, Array, Array] | None = field(default=None, init=False)

    def __call__(self, at: Array, now: Array, number: int) -> tuple[Array, Array]:
        """Return headings and glide angles of the gliders' next leg, shape (K,) [rad]."""
        count, projection = len(at), self.known.flow.grid.projection
        heights = np.sum(np.abs(np.diff(self.legs.turns, axis=0)), axis=0)
        error, target = np.zeros((count, 2)), np.broadcast_to(self.targets[number], at.shape)
        if self.before is not None:
            begin, since, *command, expected = self.before
            flown = self.vehicle, (command[0], command[1]), heights[number - 1]
            error = mean_current(projection, flown, (begin, at), now - since) - expected
        heading, angle = (
            np.full(count, of[number]) for of in (self.legs.headings, self.legs.angles)
        )
        turns, drift = self.legs.turns[:, [number]], np.full(count, self.legs.drifts[number])
        for _ in range(_AIMS if number else 1):
            clock = self.start_time + now
            path = fly_leg(self.known, self.vehicle, (at, clock), (heading, angle), turns, drift)
            lasts, ends = path.times[-1] - path.times[0], (at, path.places[-1])
            flown = self.vehicle, (heading, angle), heights[number]
            expected = mean_current(projection, flown, ends, lasts)
            if number:
                current = expected + self.pilot.persistence * error
                height, drifts = float(heights[number]), float(self.legs.drifts[number])
                local, angle = aim(self.vehicle, target - at, current, height, drifts)
                heading = local - true_north_halfway(projection, at, target)
        self.before = at, now, heading, angle, expected
        return heading, angle


def mean_current(
    projection: Projection,
    flown: tuple[Glider, tuple[Array, Array], Array | float],
    ends: tuple[Array, Array],
    lasts: Array,
) -> Array:
    """Return the mean local current of legs by dead reckoning, shape (K, 2) [m/s].

    Args:
        projection: The local frame.
        flown: The glider, headings and glide angles, shape (K,) [rad], and the sum of the heights of its dives and climbs [m].
        ends: Where it began and ended, shape (K, 2) [m].
        lasts: shape (K,) [s], with its drift.
    """
    (vehicle, (heading, angle), height), (begin, end) = flown, ends
    along, down = vehicle.speeds(np, angle)
    local = heading + true_north_halfway(projection, begin, end)
    through = (along * height / down)[:, None] * np.column_stack([np.sin(local), np.cos(local)])
    return np.asarray((end - begin - through) / lasts[:, None])


def aim(
    vehicle: Glider, displacement: Array, current: Array, height: float, drift: float
) -> tuple[Array, Array]:
    """Return the heading from local north and the glide angle [rad], each of shape (K,), that lead to a target in a mean current.

    The steepest angle that leads there is the quickest. When none does, the glider heads there at the angle with the least miss distance.

    Args:
        vehicle: The glider.
        displacement: shape (K, 2), to the target, over ground [m].
        current: shape (K, 2), mean over the leg and its drift [m/s].
        height: Sum of the heights of the leg's dives and climbs [m].
        drift: Drift time after it [s].
    """
    angles = np.linspace(*vehicle.angles, _ANGLES)

    def through_water(angle: Array) -> tuple[Array, Array]:
        along, down = vehicle.speeds(np, angle)
        duration = height / down
        return displacement[:, None] - current[:, None] * (duration + drift)[
            ..., None
        ], along * duration

    needed, reach = through_water(angles)
    short = np.linalg.norm(needed, axis=2) - reach
    rows, reaches = np.arange(len(displacement)), short <= 0.0
    last = _ANGLES - 1 - np.argmax(reaches[:, ::-1], axis=1)
    best = np.where(reaches.any(axis=1), last, np.argmin(short, axis=1))
    steeper = np.minimum(best + 1, _ANGLES - 1)
    here, there = short[rows, best], short[rows, steeper]
    between = reaches.any(axis=1) & (there > 0.0)
    share = np.where(between, -here / np.where(between, there - here, 1.0), 0.0)
    angle = angles[best] + share * (angles[steeper] - angles[best])
    towards = through_water(angle[:, None])[0][:, 0]
    return np.arctan2(towards[:, 0], towards[:, 1]), angle
