"""Simulated vehicles: pings, logged positions, advection by a truth, dead reckoning, and a vessel's survey of random places."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.errors import ForecastError
from replay_kit.core.geodesy import heading_deg, rotate_to_geographic, to_geographic
from replay_kit.studies.twins.field import Field

EPOCH = "2018-11-16T00:00:00Z"  # when the truth has no time of its own
EPOCH_NS = 1_542_326_400_000_000_000
_NS = 1_000_000_000
_NS_PER_MS = 1_000_000
_MAX_DRAWS = 1000


@dataclass(frozen=True, slots=True, eq=False)
class Pings:
    """Where and when the instrument pings, exactly.

    Attributes:
        time_ns: shape (n,) [ns, UTC], whole milliseconds.
        east: shape (n,) [m], local frame of the truth.
        north: shape (n,) [m], local frame of the truth.
        depth: shape (n,) [m], of the transducer.
        heading_deg: shape (n,), clockwise from true north.
        pitch_deg: shape (n,), nose up.
        velocity: shape (n, 2) [m/s], of the platform over the ground, local east and north; None where nobody asks for it.
    """

    time_ns: NDArray[np.int64]
    east: Array
    north: Array
    depth: Array
    heading_deg: Array
    pitch_deg: Array
    velocity: Array | None = None


@dataclass(frozen=True, slots=True)
class Position:
    """A position as the vehicle logs it.

    Attributes:
        time_ns: [ns, UTC].
        longitude: [degrees east].
        latitude: [degrees north].
        depth: [m].
        dead_reckoned: True when computed, not measured.
    """

    time_ns: int
    longitude: float
    latitude: float
    depth: float
    dead_reckoned: bool


@dataclass(frozen=True, slots=True)
class Dive:
    """One dive, surfacing to surfacing.

    Attributes:
        number: Counted from 1.
        start: Last fix before.
        end: First fix after.
        current: Depth-averaged current along true east and true north [m/s].
    """

    number: int
    start: Position
    end: Position
    current: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Mission:
    """What a vehicle did.

    Attributes:
        pings: Where it pinged.
        positions: What it logged of its position, in order of time; one at each ping.
        dives: The glider's dives; none for a vessel.
    """

    pings: Pings
    positions: tuple[Position, ...]
    dives: tuple[Dive, ...]


def log_position(field: Field, time_ns: int, place: Array, depth: float, dead_reckoned: bool) -> Position:
    """Return a position as it is logged: to 1e-7 degree and millimetres of depth, the resolution that MAVLink carries.

    Args:
        field: The truth, whose local frame ``place`` is in.
        time_ns: [ns, UTC].
        place: shape (2,) [m], local east and north.
        depth: [m].
        dead_reckoned: True when computed, not measured.
    """
    longitude, latitude = to_geographic(field.grid.projection, place[0], place[1])
    return Position(int(time_ns), round(float(longitude), 7), round(float(latitude), 7), round(float(depth), 3), dead_reckoned)


def advected(field: Field, place: Array, start_ns: int, seconds: Array, depth: Array, through_water: Array) -> Array:
    """Return the track of a vehicle in a truth, shape (n, 2) [m], by the midpoint rule.

    Args:
        field: The truth.
        place: shape (2,) [m], local east and north at the start.
        start_ns: [ns, UTC].
        seconds: shape (n,) [s], since the start.
        depth: shape (n,) [m].
        through_water: shape (2,) for the whole way, or (n - 1, 2) for each step [m/s], local east and north.

    Raises:
        ForecastError: The current carried the vehicle out of the truth's water.
    """
    track = [np.asarray(place, dtype=np.float64)]
    each = np.broadcast_to(through_water, (len(seconds) - 1, 2))
    for (before, after), (upper, lower), own in zip(pairwise(seconds.tolist()), pairwise(depth.tolist()), each, strict=True):
        here, step, now = track[-1], after - before, start_ns + int(before * _NS)
        middle = here + 0.5 * step * (own + field.velocity(here[0], here[1], upper, now))
        at_middle = field.velocity(middle[0], middle[1], 0.5 * (upper + lower), now + int(0.5 * step * _NS))
        track.append(here + step * (own + at_middle))
        if not np.isfinite(track[-1]).all():
            longitude, latitude = to_geographic(field.grid.projection, here[0], here[1])
            raise ForecastError(
                f"the current carried the glider out of the truth's water at {longitude:.3f} E, {latitude:.3f} N, {lower:.0f} m; "
                "use another seed, a shorter mission or a larger region"
            )
    return np.array(track)


def dead_reckoned(
    field: Field, number: int, ends: tuple[Position, Position], track: Array, current: Array, pings: tuple[NDArray[np.int64], Array]
) -> tuple[Dive, list[Position]]:
    """Return a dive with its depth-averaged current, and positions as a shore station reckons them after the dive.

    Through-water motion plus the depth-averaged current ends at the fix after the dive, so that positions lie evenly between the fixes.

    Args:
        field: The truth.
        number: Of the dive.
        ends: The fixes before and after it.
        track: shape (2, 2) [m], places of the fixes.
        current: shape (2,) [m/s], depth-averaged, local east and north.
        pings: Times [ns, UTC] and depths [m] of the positions, shape (k,) each.
    """
    start_ns, end_ns = (fix.time_ns for fix in ends)
    true = rotate_to_geographic(field.grid.projection, ends[0].longitude, ends[0].latitude, current[0], current[1])
    positions = [
        log_position(field, time_ns, track[0] + (time_ns - start_ns) / (end_ns - start_ns) * (track[1] - track[0]), depth, True)
        for time_ns, depth in zip(pings[0].tolist(), pings[1].tolist(), strict=True)
    ]
    return Dive(number, *ends, (float(true[0]), float(true[1]))), positions


def survey(field: Field, pings: int, start_ns: int, rng: np.random.Generator, speed: float = 5.0) -> Mission:
    """Return a vessel's survey: places uniformly random over the wet surface, visited nearest first, one ping at each.

    Args:
        field: The truth; only places where it has a surface current are visited.
        pings: Number of places.
        start_ns: Time of the first ping [ns, UTC].
        rng: Source of the places.
        speed: [m/s], over ground.

    Raises:
        ForecastError: Hardly any of the region's surface is wet.
    """
    places = _nearest_first(random_places(field, pings, rng))
    d_east, d_north = np.diff(places, axis=0).T
    elapsed_ms = np.round(np.append(0.0, np.cumsum(np.hypot(d_east, d_north))) / speed * 1000.0)
    time_ns = start_ns + elapsed_ms.astype(np.int64) * _NS_PER_MS
    # the last ping keeps the heading of the leg that led to it
    course = heading_deg(d_east, d_north)
    heading = np.append(course, course[-1:]) if pings > 1 else np.zeros(1)
    surface = np.zeros(pings)
    over_ground = speed * np.column_stack([np.sin(np.deg2rad(heading)), np.cos(np.deg2rad(heading))])
    track = Pings(time_ns, places[:, 0], places[:, 1], surface, heading, surface, over_ground)
    positions = tuple(log_position(field, t, place, 0.0, False) for t, place in zip(time_ns.tolist(), places, strict=True))
    return Mission(track, positions, ())


def random_places(field: Field, count: int, rng: np.random.Generator) -> Array:
    """Return places, shape (count, 2) [m], uniform over the region's wet surface, by rejection from the box around the grid."""
    grid = field.grid
    low, high = (np.array([f(grid.east), f(grid.north)]) for f in (np.min, np.max))
    kept = np.empty((0, 2))
    for _ in range(_MAX_DRAWS):
        drawn = rng.uniform(low, high, size=(count, 2))
        wet = np.isfinite(field.velocity(drawn[:, 0], drawn[:, 1], 0.0, field.time_ns[0])).all(axis=1)
        kept = np.concatenate([kept, drawn[wet]])[:count]
        if len(kept) == count:
            return kept
    raise ForecastError(f"found {len(kept)} of {count} places on the truth's wet surface; use a truth with more water")


def _nearest_first(places: Array) -> Array:
    """Return places, shape (n, 2), each followed by the nearest one not yet visited."""
    order, left = [0], np.arange(1, len(places))
    while left.size:
        nearest = int(np.argmin(((places[left] - places[order[-1]]) ** 2).sum(axis=1)))
        order.append(int(left[nearest]))
        left = np.delete(left, nearest)
    return places[order]
