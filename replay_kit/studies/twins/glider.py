"""A sawtooth glider flown through a truth: carried by the current, logging fixes at the surface and dead-reckoned positions under water."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import grid_bearing_of_true_north, to_geographic
from replay_kit.studies.twins.field import Field, grid_indices
from replay_kit.studies.twins.vehicle import Dive, Mission, Pings, Position, advected, dead_reckoned, log_position

STEP_S = 120
_STEP_NS = STEP_S * 1_000_000_000
PING_STEPS = 5  # a ping every ten minutes
SURFACE_STEPS = 2
_REACHED = 5_000.0  # m; a waypoint this near counts as reached: one dive goes half as far
_EDGE = 0.1  # of the grid; a surfacing nearer to the edge than this turns the glider to the centre

# Corners of a course over the grid, in fractions of its rows and columns; it starts at any of them and goes round.
_COURSE = np.array([(0.2, 0.2), (0.8, 0.8), (0.8, 0.2), (0.2, 0.8)])
_CENTRE = np.array([0.5, 0.5])


@dataclass(frozen=True, slots=True)
class GliderLimits:
    """How a glider flies.

    Attributes:
        speed: Through water [m/s].
        glide_angle_deg: Below and above the horizontal.
        max_depth: Of a dive [m]; the truth's last level when that is shallower.
    """

    speed: float = 0.3
    glide_angle_deg: float = 20.0
    max_depth: float = 500.0


@dataclass(frozen=True, slots=True)
class Schedule:
    """When a glider pings and logs.

    Attributes:
        ping_steps: From one ping to the next [steps of 120 s].
        to_the_end: Whether positions are logged to the end of the last dive, and not to the last ping only.
    """

    ping_steps: int = PING_STEPS
    to_the_end: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class _Flight:
    """One dive, or one stay at the surface, step by step.

    Attributes:
        place: shape (steps + 1, 2) [m], local east and north.
        depth: shape (steps + 1,) [m].
        through_water: shape (2,) [m/s], local; zero at the surface.
        pitch_deg: shape (steps + 1,).
    """

    place: Array
    depth: Array
    through_water: Array
    pitch_deg: Array

    @property
    def steps(self) -> int:
        return len(self.depth) - 1


def mission(
    field: Field,
    pings: int,
    start_ns: int,
    rng: np.random.Generator,
    limits: GliderLimits = GliderLimits(),
    schedule: Schedule = Schedule(),
) -> Mission:
    """Return a glider's mission: dives along a course over the region, a ping every ten minutes, a fix at each surfacing.

    Between fixes the logged positions are dead-reckoned as a shore station does after the dive: through-water motion plus the
    depth-averaged current that makes the track end at the next fix. The last dive is flown to its end.

    Args:
        field: The truth.
        pings: Number of pings.
        start_ns: Time of the first ping [ns, UTC].
        rng: Chooses the corner at which the course starts.
        limits: How it flies.
        schedule: When it pings, and until when it logs.

    Raises:
        ForecastError: The current carried the glider out of the truth's water.
    """
    flights: list[_Flight] = []
    corner = int(rng.integers(len(_COURSE)))
    place, target = _place_of(field, _COURSE[corner]), corner + 1
    # a stay at the surface begins and ends the mission, so that each dive lies between two fixes
    flights.append(_surface(field, place, start_ns))
    flown = flights[-1].steps
    while flown <= (pings - 1) * schedule.ping_steps:
        place = flights[-1].place[-1]
        aim, target = _aim(field, place, target)
        dive = _dive(field, place, start_ns + flown * _STEP_NS, aim, limits)
        surface = _surface(field, dive.place[-1], start_ns + (flown + dive.steps) * _STEP_NS)
        flights += [dive, surface]
        flown += dive.steps + surface.steps
    return _logged(field, flights, np.arange(pings) * schedule.ping_steps, start_ns, schedule.to_the_end)


def _place_of(field: Field, fraction: Array) -> Array:
    rows, columns = field.grid.east.shape
    return np.asarray(field.place_spline(fraction * [rows - 1.0, columns - 1.0]), dtype=np.float64).reshape(2)


def _aim(field: Field, place: Array, target: int) -> tuple[Array, int]:
    """Return the place to head for, and the corner of the course that is next."""
    rows, columns = field.grid.east.shape
    j, i, _ = grid_indices(field, place[:1], place[1:])
    fraction = np.array([j[0] / (rows - 1), i[0] / (columns - 1)])
    if (fraction < _EDGE).any() or (fraction > 1.0 - _EDGE).any():
        return _place_of(field, _CENTRE), target
    corner = _place_of(field, _COURSE[target % len(_COURSE)])
    if np.hypot(*(corner - place)) < _REACHED:
        target += 1
        corner = _place_of(field, _COURSE[target % len(_COURSE)])
    return corner, target


def _dive(field: Field, place: Array, start_ns: int, aim: Array, limits: GliderLimits) -> _Flight:
    angle = np.deg2rad(limits.glide_angle_deg)
    bottom = min(limits.max_depth, float(field.grid.levels[-1]))
    leg = max(1, round(bottom / (limits.speed * np.sin(angle) * STEP_S)))
    down = np.linspace(0.0, bottom, leg + 1)
    depth = np.concatenate([down, down[-2::-1]])
    pitch = np.concatenate([np.full(leg + 1, -limits.glide_angle_deg), np.full(leg, limits.glide_angle_deg)])
    towards = (aim - place) / np.hypot(*(aim - place))
    through_water = limits.speed * np.cos(angle) * towards
    return _flight(field, place, start_ns, depth, through_water, pitch)


def _surface(field: Field, place: Array, start_ns: int) -> _Flight:
    depth = np.zeros(SURFACE_STEPS + 1)
    return _flight(field, place, start_ns, depth, np.zeros(2), depth)


def _flight(field: Field, place: Array, start_ns: int, depth: Array, through_water: Array, pitch_deg: Array) -> _Flight:
    seconds = STEP_S * np.arange(depth.size, dtype=np.float64)
    return _Flight(advected(field, place, start_ns, seconds, depth, through_water), depth, through_water, pitch_deg)


def _logged(field: Field, flights: list[_Flight], ping_steps: NDArray[np.int64], start_ns: int, to_the_end: bool) -> Mission:
    """Return what is logged of the flights."""
    end = sum(flight.steps for flight in flights) if to_the_end else int(ping_steps[-1])
    logged_steps = np.union1d(np.arange(0, end + 1, PING_STEPS), ping_steps)
    positions: dict[int, Position] = {}
    dives: list[Dive] = []
    parts: list[tuple[Array, ...]] = []
    step = 0
    for flight in flights:
        last = step + flight.steps
        inside, logged = (steps[(steps >= step) & (steps < last)] - step for steps in (ping_steps, logged_steps))
        times = start_ns + (step + np.arange(flight.steps + 1)) * _STEP_NS
        if flight.depth.any():
            ends = tuple(log_position(field, int(times[k]), flight.place[k], 0.0, False) for k in (0, -1))
            under = logged[logged > 0]
            pinged = times[under], flight.depth[under]
            way = flight.place[[0, -1]]
            current = (way[1] - way[0]) / (flight.steps * float(STEP_S)) - flight.through_water
            dive, reckoned = dead_reckoned(field, len(dives) + 1, (ends[0], ends[1]), way, current, pinged)
            dives.append(dive)
        else:
            # the first and the last moment at the surface are fixes, and so is each ping there
            steps = sorted({0, flight.steps, *logged.tolist()})
            reckoned = [log_position(field, int(times[k]), flight.place[k], 0.0, False) for k in steps]
        positions.update((position.time_ns, position) for position in reckoned)
        heading = _heading(field, flight)
        through_water = np.tile(flight.through_water, (inside.size, 1))
        parts.append((flight.place[inside], flight.depth[inside], heading[inside], flight.pitch_deg[inside], through_water))
        step = last
    place, depth, heading, pitch, through_water = (np.concatenate(column) for column in zip(*parts, strict=True))
    times = start_ns + ping_steps * _STEP_NS
    over_ground = through_water + field.velocity(place[:, 0], place[:, 1], depth, times)
    track = Pings(times, place[:, 0], place[:, 1], depth, heading, pitch, over_ground)
    return Mission(track, tuple(positions[t] for t in sorted(positions)), tuple(dives))


def _heading(field: Field, flight: _Flight) -> Array:
    """Return the heading at each step, clockwise from true north; adrift at the surface, north by convention."""
    if not flight.through_water.any():
        return np.zeros(flight.steps + 1)
    longitude, latitude = to_geographic(field.grid.projection, flight.place[:, 0], flight.place[:, 1])
    bearing = np.arctan2(flight.through_water[0], flight.through_water[1])
    true = bearing - grid_bearing_of_true_north(field.grid.projection, longitude, latitude)
    return np.asarray(np.mod(np.rad2deg(true), 360.0), dtype=np.float64)
