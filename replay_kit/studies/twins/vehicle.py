"""Simulated vehicles: pings, positions, advection by a truth, dead reckoning, and a vessel's survey of random positions."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.errors import ForecastError
from replay_kit.core.geodesy import heading_deg, rotate_to_geographic, to_geographic
from replay_kit.core.observation import Source, VehicleState
from replay_kit.studies.twins.field import Field

EPOCH = "2018-11-16T00:00:00Z"  # when the truth has no time of its own
EPOCH_NS = 1_542_326_400_000_000_000
NS_PER_S, NS_PER_MS = 1_000_000_000, 1_000_000
_MAX_DRAWS = 1000


@dataclass(frozen=True, slots=True, eq=False)
class Pings:
    """Exact positions and times of pings.

    Attributes:
        time_ns: shape (n,) [ns, UTC], whole milliseconds.
        east: shape (n,) [m], local frame of the truth.
        north: shape (n,) [m], local frame of the truth.
        depth: shape (n,) [m], depth of the transducer.
        heading_deg: shape (n,), heading clockwise from true north.
        pitch_deg: shape (n,), pitch, nose up.
        velocity: shape (n, 2) [m/s], platform over ground, local east and north; None if not needed.
    """

    time_ns: NDArray[np.int64]
    east: Array
    north: Array
    depth: Array
    heading_deg: Array
    pitch_deg: Array
    velocity: Array | None = None


@dataclass(frozen=True, slots=True)
class Dive:
    """Dive from surfacing to surfacing.

    Attributes:
        number: Number, from 1.
        start: Last fix before it.
        end: First fix after it.
        current: Depth-averaged current along true east and true north [m/s].
    """

    number: int
    start: VehicleState
    end: VehicleState
    current: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Mission:
    """Simulated mission of a vehicle.

    Attributes:
        pings: Pings.
        positions: Logged positions in order of time, one at each ping.
        dives: Dives of a glider; empty for a vessel.
    """

    pings: Pings
    positions: tuple[VehicleState, ...]
    dives: tuple[Dive, ...]

    @property
    def hours(self) -> float:
        """Time from the first ping to the last [h]."""
        return float(np.ptp(self.pings.time_ns)) / 3.6e12


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Track through a truth: consecutive dives, a surface drift, or a dive and the drift after it.

    Attributes:
        start_ns: Start [ns, UTC].
        seconds: shape (n,) [s], time since the start.
        place: shape (n, 2) [m], local east and north of the truth.
        depth: shape (n,) [m].
        through_water: shape (2,) [m/s], local east and north, under water.
    """

    start_ns: int
    seconds: Array
    place: Array
    depth: Array
    through_water: Array

    @property
    def surfaced(self) -> int:
        """Index of the point at which the surface was reached, 0 for a drift."""
        return int(np.flatnonzero(np.diff(self.depth, prepend=self.depth[0])).max(initial=0))

    @property
    def end_ns(self) -> int:
        """End, including its drift [ns, UTC]."""
        return self.time_ns(-1)

    def time_ns(self, point: int) -> int:
        """Return the time of a point, to the millisecond [ns, UTC]."""
        return self.start_ns + round(float(self.seconds[point]) * 1e3) * NS_PER_MS


def log_position(
    field: Field, time_ns: int, place: Array, depth: float = 0.0, dead_reckoned: bool = False
) -> VehicleState:
    """Return a position as logged, rounded to 1e-7 degree and 1 mm of depth, the resolution of MAVLink.

    Args:
        field: Truth, with the local frame of ``place``.
        time_ns: [ns, UTC].
        place: shape (2,) [m], local east and north.
        depth: [m].
        dead_reckoned: Whether it is dead-reckoned.
    """
    longitude, latitude = (
        round(float(degrees), 7)
        for degrees in to_geographic(field.grid.projection, place[0], place[1])
    )
    source = Source(0, "/vehicle/position" if dead_reckoned else "/vehicle/fix", 0, int(time_ns))
    return VehicleState(
        source.time_ns,
        round(float(longitude), 7),
        round(float(latitude), 7),
        round(float(depth), 3),
        dead_reckoned,
        source,
    )


def advected(
    field: Field,
    places: Array,
    starts_ns: NDArray[np.int64],
    seconds: Array,
    depth: Array,
    through_water: Array,
) -> list[Track]:
    """Return the tracks of g vehicles in a truth by the midpoint rule, vectorised over vehicles.

    Args:
        field: Truth.
        places: shape (g, 2) [m], local east and north at the start.
        starts_ns: shape (g,) [ns, UTC].
        seconds: shape (n,) [s], time since the start.
        depth: shape (n,) [m]; the vehicle is adrift once it no longer changes.
        through_water: shape (g, 2) [m/s], local east and north, until then.

    Raises:
        ForecastError: A vehicle drifted out of the truth's water.
    """
    flown = np.empty((len(seconds), *places.shape))
    flown[0] = places
    tracks = [
        Track(int(start_ns), seconds, flown[:, g], depth, through_water[g])
        for g, start_ns in enumerate(starts_ns)
    ]
    for k, ((before, after), (upper, lower)) in enumerate(
        zip(pairwise(seconds.tolist()), pairwise(depth.tolist()), strict=True)
    ):
        own = through_water if k < tracks[0].surfaced else np.zeros_like(places)
        here, step, now = flown[k], after - before, starts_ns + int(before * NS_PER_S)
        middle = here + 0.5 * step * (own + field.velocity(here[:, 0], here[:, 1], upper, now))
        at_middle = field.velocity(
            middle[:, 0], middle[:, 1], 0.5 * (upper + lower), now + int(0.5 * step * NS_PER_S)
        )
        flown[k + 1] = here + step * (own + at_middle)
        if not np.isfinite(flown[k + 1]).all():
            lost = int(np.argmin(np.isfinite(flown[k + 1]).all(axis=1)))
            longitude, latitude = to_geographic(field.grid.projection, *here[lost])
            raise ForecastError(
                f"the current carried the glider out of the truth's water at {longitude:.3f} E, {latitude:.3f} N, {lower:.0f} m; "
                "use another seed, a shorter mission or a larger region"
            )
    return tracks


def dead_reckoned(
    field: Field, number: int, track: Track, time_ns: NDArray[np.int64], depth: Array
) -> tuple[Dive, list[VehicleState]]:
    """Return a dive with its depth-averaged current, and positions dead-reckoned as by a shore station after the dive.

    Motion through water plus the depth-averaged current ends at the fix after the dive.

    Args:
        field: Truth.
        number: Number of the dive.
        track: Track of the dive, between fixes at its start and surfacing.
        time_ns: shape (k,) [ns, UTC], times of the positions.
        depth: shape (k,) [m], depths of the positions.
    """
    points = (0, track.surfaced)
    begin, end = (log_position(field, track.time_ns(k), track.place[k]) for k in points)
    way = track.place[points[1]] - track.place[0]
    current = way / float(track.seconds[points[1]]) - track.through_water
    true = rotate_to_geographic(
        field.grid.projection, begin.longitude, begin.latitude, current[0], current[1]
    )
    shares = (time_ns - begin.time_ns) / (end.time_ns - begin.time_ns)
    positions = [
        log_position(field, at_ns, track.place[0] + share * way, down, True)
        for at_ns, share, down in zip(time_ns.tolist(), shares, depth.tolist(), strict=True)
    ]
    return Dive(number, begin, end, (float(true[0]), float(true[1]))), positions


def survey(
    field: Field, pings: int, start_ns: int, rng: np.random.Generator, speed: float = 5.0
) -> Mission:
    """Return a vessel's survey: positions uniformly random over the wet surface, visited nearest first, one ping at each.

    Args:
        field: Truth; only positions with a surface current are visited.
        pings: Number of positions.
        start_ns: Time of the first ping [ns, UTC].
        rng: Generator of the positions.
        speed: Speed over ground [m/s].

    Raises:
        ForecastError: The region's surface is almost all dry.
    """
    places = _nearest_first(random_places(field, pings, rng))
    d_east, d_north = np.diff(places, axis=0).T
    elapsed_ms = np.round(np.append(0.0, np.cumsum(np.hypot(d_east, d_north))) / speed * 1000.0)
    time_ns = start_ns + elapsed_ms.astype(np.int64) * NS_PER_MS
    # the last ping keeps the heading of the leg that led to it
    course = heading_deg(d_east, d_north)
    heading = np.append(course, course[-1:]) if pings > 1 else np.zeros(1)
    surface = np.zeros(pings)
    over_ground = speed * np.column_stack(
        [np.sin(np.deg2rad(heading)), np.cos(np.deg2rad(heading))]
    )
    track = Pings(time_ns, places[:, 0], places[:, 1], surface, heading, surface, over_ground)
    positions = tuple(
        log_position(field, t, place) for t, place in zip(time_ns.tolist(), places, strict=True)
    )
    return Mission(track, positions, ())


def random_places(field: Field, count: int, rng: np.random.Generator) -> Array:
    """Return positions, shape (count, 2) [m], uniform over the region's wet surface, by rejection sampling."""
    grid = field.grid
    low, high = (np.array([f(grid.east), f(grid.north)]) for f in (np.min, np.max))
    kept = np.empty((0, 2))
    for _ in range(_MAX_DRAWS):
        drawn = rng.uniform(low, high, size=(count, 2))
        wet = np.isfinite(field.velocity(drawn[:, 0], drawn[:, 1], 0.0, field.time_ns[0])).all(
            axis=1
        )
        kept = np.concatenate([kept, drawn[wet]])[:count]
        if len(kept) == count:
            return kept
    raise ForecastError(
        f"found {len(kept)} of {count} places on the truth's wet surface; use a truth with more water"
    )


def _nearest_first(places: Array) -> Array:
    """Return positions, shape (n, 2), each followed by the nearest unvisited one."""
    order, left = [0], np.arange(1, len(places))
    while left.size:
        nearest = int(np.argmin(((places[left] - places[order[-1]]) ** 2).sum(axis=1)))
        order.append(int(left[nearest]))
        left = np.delete(left, nearest)
    return places[order]
