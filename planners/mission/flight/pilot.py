"""A mission corrected at each surfacing: from where the glider came up, the next leg is aimed at the place planned for its end.

The pilot knows the estimate, the place of each surfacing, and dead reckoning: the leg's displacement over ground less its displacement
through water is the mean current of the leg, and the error of its prediction is likely to persist. The pilot does not know the current
that the glider is in.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from planners.mission.flight.legs import Flight, LegProfile, Legs, fly_leg, fly_midpoints, leg_frame
from planners.simulation.currents import Currents
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


@dataclass(frozen=True, slots=True, eq=False)
class CorrectedFlight:
    """A mission flown with corrections in K currents.

    Attributes:
        flight: Where it leads; its times are shape (K, n).
        headings: shape (K, L), clockwise from true north, as flown [rad].
        angles: shape (K, L), glide angles as flown [rad].
    """

    flight: Flight
    headings: Array
    angles: Array


@dataclass(frozen=True, slots=True, eq=False)
class HeldLeg:
    """A leg of K gliders, each with its own heading and glide angle, shape (K,) [rad], and depths of all or, shape (n + 1, K), its own."""

    vehicle: Glider
    depths: Array
    drift: float
    headings: Array
    angles: Array

    @property
    def height(self) -> Any:
        """Sum of the heights of its dives and climbs [m], one or shape (K,)."""
        return np.sum(np.abs(np.diff(self.depths, axis=0)), axis=0)

    @property
    def velocity_through_water(self) -> tuple[Array, Array]:
        """Horizontal velocity towards true east and north (K, 2) and vertical speed (K,) [m/s]."""
        along, down = self.vehicle.speeds(np, self.angles)
        return along[:, None] * np.column_stack(
            [np.sin(self.headings), np.cos(self.headings)]
        ), down

    def mean_current(self, projection: Projection, begin: Array, end: Array, time: Array) -> Array:
        """Return the mean local current (K, 2) [m/s] by dead reckoning between two places (K, 2) [m] in a time (K, 1) [s]."""
        along, down = self.vehicle.speeds(np, self.angles)
        local = self.headings + true_north_halfway(projection, begin, end)
        through = along[:, None] * np.column_stack([np.sin(local), np.cos(local)])
        return np.asarray((end - begin - through * (self.height / down)[:, None]) / time)

    def fly(self, currents: Currents, begin: tuple[Array, Array]) -> list[tuple[Array, Array]]:
        """Return (places (K, 2) [m], times since its beginning (K, 1) [s]) after each step from a place and time."""
        at, began = begin[0], float(np.mean(begin[1]))
        through, down = self.velocity_through_water
        heights = np.abs(np.diff(self.depths, axis=0))
        frame = leg_frame(currents, at, through, self.height / down)
        durations = [(height / down)[:, None] for height in heights]
        zero = np.zeros((len(at), 1))
        profile = LegProfile(self.depths, durations, self.drift)
        return fly_leg(currents, frame, (at, zero), profile, began, fly_midpoints)


def fly_corrected(
    estimate: Currents,
    currents: Currents,
    vehicle: Glider,
    predicted: Flight,
    legs: Legs,
    pilot: Pilot,
) -> CorrectedFlight:
    """Return a mission flown in some currents, each leg after the first aimed again from where the one before has ended.

    Args:
        estimate: One flow: what the pilot knows of the current. Its times, if it has any, are since the start of the mission.
        currents: K flows: what the glider is in.
        vehicle: The glider.
        predicted: The flight of the plan: its start, and the place at which each leg is planned to end, after its drift.
        legs: As planned; the depths and drifts are flown, heading and angle of the first leg too.
        pilot: Who corrects.
    """
    count = len(currents.latent)
    targets = predicted.place[0, predicted.ends]
    projection = currents.flow.grid.projection
    path = [(np.tile(predicted.place[0, 0], (count, 1)), np.zeros((count, 1)))]
    depths = [float(legs.depths[0][0])]
    numbers, ends, current_error = [0], [], np.zeros((count, 2))
    headings, angles = (np.tile(planned, (count, 1)) for planned in (legs.headings, legs.angles))
    for k, steps in enumerate(legs.depths):
        leg = HeldLeg(vehicle, steps, float(legs.drifts[k]), headings[:, k], angles[:, k])
        begin, began = path[-1]
        expected = np.zeros((count, 2))
        for _ in range(_AIMS if k > 0 else 1):
            end, time = leg.fly(estimate, (begin, began))[-1]
            expected = leg.mean_current(projection, begin, end, time)
            if k > 0:
                current = expected + pilot.persistence * current_error
                heading, angle = aim(vehicle, targets[k] - begin, current, leg.height, leg.drift)
                turn = true_north_halfway(
                    projection, begin, np.broadcast_to(targets[k], begin.shape)
                )
                leg = replace(leg, headings=heading - turn, angles=angle)
        headings[:, k], angles[:, k] = leg.headings, leg.angles
        flown = leg.fly(currents, (begin, began))
        current_error = leg.mean_current(projection, begin, *flown[-1]) - expected
        path += [(at, began + time) for at, time in flown]
        depths += [*steps[1:], *[0.0] * (len(flown) - steps.size + 1)]
        numbers += [k] * len(flown)
        ends.append(len(path) - 1)
    places, times = (np.stack([step[i] for step in path], axis=1) for i in (0, 1))
    return CorrectedFlight(
        Flight(times[..., 0], np.array(depths), places, np.array(numbers), np.array(ends)),
        headings,
        angles,
    )


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
