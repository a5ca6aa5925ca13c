"""A glider's legs flown in a truth, and what its ADCP measures on the way."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import ForecastError
from replay_kit.core.geodesy import grid_bearing_of_true_north, rotate_to_geographic, to_geographic, to_local
from replay_kit.core.observation import Measurement
from replay_kit.core.plan import Place
from replay_kit.measurements import observations
from replay_kit.studies.twins.adcp import AdcpSettings, measure
from replay_kit.studies.twins.faults import Faults
from replay_kit.studies.twins.field import Field
from replay_kit.studies.twins.messages import Record, mission_messages
from replay_kit.studies.twins.vehicle import Dive, Mission, Pings, log_position

# Longest step of a flight, and from one ping to the next [s]; the first ping comes half as long after the surface was left.
_STEP_S = 120.0
_PING_S = 600.0
_NS = 1_000_000_000
_NS_PER_MS = 1_000_000


@dataclass(frozen=True, slots=True)
class Leg:
    """What a glider is told at one surfacing.

    Attributes:
        heading_deg: Through water, clockwise from true north where the leg begins.
        along: Horizontal speed through water [m/s].
        down: Vertical speed in dives and climbs [m/s].
        turns: Depths at which it begins, turns and ends [m].
        drift: Time adrift at the surface after it [s].
    """

    heading_deg: float
    along: float
    down: float
    turns: tuple[float, ...]
    drift: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class LegFlight:
    """A leg flown.

    Attributes:
        start_ns: When it began [ns, UTC].
        seconds: shape (n,) [s], since then.
        place: shape (n, 2) [m], local east and north of the truth.
        depth: shape (n,) [m].
        through_water: shape (2,) [m/s], local east and north, under water.
        surfaced: Number of the point at which the surface was reached; the drift comes after it.
    """

    start_ns: int
    seconds: Array
    place: Array
    depth: Array
    through_water: Array
    surfaced: int

    @property
    def end_ns(self) -> int:
        """When it ended, its drift included [ns, UTC]."""
        return self.start_ns + round(float(self.seconds[-1]) * 1e3) * _NS_PER_MS


def fly_leg(sea: Field, place: Array, start_ns: int, leg: Leg) -> LegFlight:
    """Return a leg flown in a truth, by the midpoint rule with steps of two minutes at most.

    Args:
        sea: The truth.
        place: shape (2,) [m], local east and north.
        start_ns: When it begins [ns, UTC].
        leg: What the glider does.

    Raises:
        ForecastError: The current carried the glider out of the truth's water.
    """
    longitude, latitude = to_geographic(sea.grid.projection, *place)
    heading = np.deg2rad(leg.heading_deg) + float(grid_bearing_of_true_north(sea.grid.projection, longitude, latitude))
    through = leg.along * np.array([np.sin(heading), np.cos(heading)])
    depth, seconds = [leg.turns[0]], [0.0]
    for begin, end in pairwise(leg.turns):
        lasts = abs(end - begin) / leg.down
        shares = np.arange(1, int(np.ceil(lasts / _STEP_S)) + 1) / np.ceil(lasts / _STEP_S)
        depth += (begin + (end - begin) * shares).tolist()
        seconds += (seconds[-1] + lasts * shares).tolist()
    surfaced = len(depth) - 1
    drifts = int(np.ceil(leg.drift / _STEP_S))
    depth += [depth[-1]] * drifts
    seconds += [seconds[-1] + leg.drift * (k + 1) / drifts for k in range(drifts)]
    track = [np.asarray(place, dtype=np.float64)]
    for k, ((before, after), (z0, z1)) in enumerate(zip(pairwise(seconds), pairwise(depth), strict=True)):
        here, step, moved = track[-1], after - before, through if k < surfaced else np.zeros(2)
        now = start_ns + int(before * _NS)
        middle = here + 0.5 * step * (moved + sea.velocity(here[0], here[1], z0, now))
        track.append(here + step * (moved + sea.velocity(middle[0], middle[1], 0.5 * (z0 + z1), now + int(0.5 * step * _NS))))
        if not np.isfinite(track[-1]).all():
            east, north = to_geographic(sea.grid.projection, *here)
            raise ForecastError(f"the current carried the glider out of the truth's water at {east:.3f} E, {north:.3f} N, {z1:.0f} m")
    return LegFlight(start_ns, np.array(seconds), np.array(track), np.array(depth), through, surfaced)


def measured(sea: Field, flight: LegFlight, noise: float, rng: np.random.Generator) -> tuple[Measurement, ...]:
    """Return what an estimator is given of a leg at its end: a profile every ten minutes, and the leg's mean current.

    They go through the messages that a glider logs; between its fixes the positions are dead-reckoned as a shore station does.

    Args:
        sea: The truth.
        flight: The leg, from one surfacing to the next.
        noise: Error of each component of each bin [m/s].
        rng: Of the noise.
    """
    seconds = np.arange(_PING_S / 2.0, float(flight.seconds[flight.surfaced]), _PING_S)
    east, north, depth = (np.interp(seconds, flight.seconds, values) for values in (*flight.place.T, flight.depth))
    sinks = np.interp(seconds, flight.seconds[1:], np.diff(flight.depth)) > 0.0
    heading = np.mod(np.rad2deg(np.arctan2(*flight.through_water)), 360.0)
    times = flight.start_ns + np.round(seconds * 1e3).astype(np.int64) * _NS_PER_MS
    pings = Pings(times, east, north, depth, np.full(seconds.size, heading), np.where(sinks, -20.0, 20.0))
    settings = AdcpSettings(noise=noise)
    record = Record(measure(sea, pings, settings, rng), settings, Faults(), None)
    return tuple(observations(mission_messages(_logged(sea, flight, pings), record), MeasurementConfig()))


def _logged(sea: Field, flight: LegFlight, pings: Pings) -> Mission:
    """Return the mission of one dive: fixes at both ends, dead-reckoned positions at the pings, the mean current."""
    lasts = float(flight.seconds[flight.surfaced])
    end_ns = flight.start_ns + round(lasts * 1e3) * _NS_PER_MS
    begin, end = flight.place[0], flight.place[flight.surfaced]
    start_fix, end_fix = (log_position(sea, time_ns, at, 0.0, False) for time_ns, at in ((flight.start_ns, begin), (end_ns, end)))
    shares = (pings.time_ns - flight.start_ns) / (end_ns - flight.start_ns)
    reckoned = [
        log_position(sea, int(time_ns), begin + share * (end - begin), float(depth), True)
        for time_ns, share, depth in zip(pings.time_ns, shares, pings.depth, strict=True)
    ]
    current = (end - begin) / lasts - flight.through_water
    true = rotate_to_geographic(sea.grid.projection, start_fix.longitude, start_fix.latitude, *current)
    dive = Dive(1, start_fix, end_fix, (float(true[0]), float(true[1])))
    return Mission(pings, (start_fix, *reckoned, end_fix), (dive,))


def place_at(sea: Field, point: Array) -> Place:
    """Return a local point, shape (2,) [m], at the surface."""
    longitude, latitude = to_geographic(sea.grid.projection, *point)
    return Place(float(longitude), float(latitude), 0.0)


def distance_to(sea: Field, point: Array, goal: Place) -> float:
    """Return the distance [m] of a local point, shape (2,) [m], from a place."""
    east, north = to_local(sea.grid.projection, goal.longitude, goal.latitude)
    return float(np.hypot(point[0] - east, point[1] - north))
