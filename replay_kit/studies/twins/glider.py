"""Simulated sawtooth glider in a truth: advected, with fixes at the surface and dead-reckoned positions under water."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import grid_bearing_of_true_north, to_geographic
from replay_kit.core.observation import VehicleState
from replay_kit.studies.twins.field import Field, grid_indices
from replay_kit.studies.twins.vehicle import (
    NS_PER_S,
    Dive,
    Mission,
    Pings,
    Track,
    advected,
    dead_reckoned,
    log_position,
)

STEP_S = 120
_STEP_NS = STEP_S * NS_PER_S
PING_STEPS = 5  # a ping every ten minutes
SURFACE_STEPS = 2
# Through water [m/s], below and above the horizontal [degrees], and of a dive where the truth is deeper [m].
_SPEED, _GLIDE_ANGLE_DEG, _MAX_DEPTH = 0.3, 20.0, 500.0
_REACHED = 5_000.0  # m; a waypoint this near counts as reached: one dive goes half as far
_EDGE = 0.1  # of the grid; a surfacing nearer to the edge than this turns the glider to the centre

# Corners of a course over the grid, in fractions of its rows and columns; it starts at any of them and goes round.
_COURSE = np.array([(0.2, 0.2), (0.8, 0.8), (0.8, 0.2), (0.2, 0.8)])
_CENTRE = np.array([0.5, 0.5])


@dataclass(frozen=True, slots=True)
class Schedule:
    """Schedule of a glider's pings and positions.

    Attributes:
        ping_steps: Ping interval [steps of 120 s].
        to_the_end: Whether positions are logged to the end of the last dive instead of the last ping.
        course: Corners of its course in fractions of the grid's rows and columns, from the first; empty for the default course from a
            random corner.
    """

    ping_steps: int = PING_STEPS
    to_the_end: bool = False
    course: tuple[tuple[float, float], ...] = ()


def mission(
    field: Field,
    pings: int,
    start_ns: int,
    rng: np.random.Generator,
    schedule: Schedule = Schedule(),
) -> Mission:
    """Return a glider's mission: dives along a course, a ping every ten minutes, a fix at each surfacing.

    Positions between fixes are dead-reckoned as by a shore station after the dive: motion through water plus the depth-averaged current, so
    that the track ends at the next fix. The last dive is flown to its end.

    Args:
        field: Truth.
        pings: Number of pings.
        start_ns: Time of the first ping [ns, UTC].
        rng: Generator of the starting corner.
        schedule: Times of pings and positions.

    Raises:
        ForecastError: The glider drifted out of the truth's water.
    """
    return missions(field, pings, (start_ns,), (rng,), (schedule,))[0]


def missions(
    field: Field,
    pings: int,
    starts_ns: Sequence[int],
    rngs: Sequence[np.random.Generator],
    schedules: Sequence[Schedule],
) -> list[Mission]:
    """Return the missions of several gliders with equal numbers of pings; arguments as in ``mission``, one for each."""
    every = schedules[0].ping_steps * _STEP_NS
    courses = [np.array(one.course or _COURSE) for one in schedules]
    corners = [int(rng.integers(len(_COURSE))) for rng in rngs]
    targets = [0 if one.course else at for one, at in zip(schedules, corners, strict=True)]
    places = np.stack(
        [_place_of(field, course[at]) for course, at in zip(courses, targets, strict=True)]
    )
    targets = [corner + 1 for corner in targets]
    # a stay at the surface begins and ends the mission, so that each dive lies between two fixes
    flown = [_surface(field, places, np.array(starts_ns, np.int64))]
    while flown[-1][0].end_ns <= starts_ns[0] + (pings - 1) * every:
        places, now_ns = _end(flown[-1])
        aimed = [_aim(field, *each) for each in zip(places, targets, courses, strict=True)]
        targets = [target for _, target in aimed]
        flown.append(_dive(field, places, now_ns, np.stack([aim for aim, _ in aimed])))
        flown.append(_surface(field, *_end(flown[-1])))
    return [
        _logged(field, list(tracks), start_ns + np.arange(pings) * every, one.to_the_end)
        for tracks, start_ns, one in zip(
            zip(*flown, strict=True), starts_ns, schedules, strict=True
        )
    ]


def _end(tracks: Sequence[Track]) -> tuple[Array, NDArray[np.int64]]:
    """Return the ends of tracks, shape (g, 2), and their times, shape (g,) [ns, UTC]."""
    return (
        np.stack([track.place[-1] for track in tracks]),
        np.array([track.end_ns for track in tracks], np.int64),
    )


def _place_of(field: Field, fraction: Array) -> Array:
    rows, columns = field.grid.east.shape
    return np.asarray(
        field.place_spline(fraction * [rows - 1.0, columns - 1.0]), dtype=np.float64
    ).reshape(2)


def _aim(field: Field, place: Array, target: int, course: Array) -> tuple[Array, int]:
    """Return the target position, and the next corner of the course."""
    rows, columns = field.grid.east.shape
    j, i, _ = grid_indices(field, place[:1], place[1:])
    fraction = np.array([j[0] / (rows - 1), i[0] / (columns - 1)])
    if (fraction < _EDGE).any() or (fraction > 1.0 - _EDGE).any():
        return _place_of(field, _CENTRE), target
    corner = _place_of(field, course[target % len(course)])
    if np.hypot(*(corner - place)) < _REACHED:
        target += 1
        corner = _place_of(field, course[target % len(course)])
    return corner, target


def _dive(field: Field, places: Array, starts_ns: NDArray[np.int64], aims: Array) -> list[Track]:
    angle, way = np.deg2rad(_GLIDE_ANGLE_DEG), aims - places
    bottom = min(_MAX_DEPTH, float(field.grid.levels[-1]))
    down = np.linspace(0.0, bottom, dive_steps(field) // 2 + 1)
    towards = way / np.hypot(*way.T)[:, None]
    depth = np.concatenate([down, down[-2::-1]])
    return _carried(field, places, starts_ns, depth, _SPEED * np.cos(angle) * towards)


def dive_steps(field: Field) -> int:
    """Return the duration of a dive [steps of 120 s], half down and half up."""
    bottom = min(_MAX_DEPTH, float(field.grid.levels[-1]))
    return 2 * max(
        1,
        round(bottom / (_SPEED * float(np.sin(np.deg2rad(_GLIDE_ANGLE_DEG))) * STEP_S)),
    )


def _surface(field: Field, places: Array, starts_ns: NDArray[np.int64]) -> list[Track]:
    return _carried(field, places, starts_ns, np.zeros(SURFACE_STEPS + 1), np.zeros_like(places))


def _carried(
    field: Field,
    places: Array,
    starts_ns: NDArray[np.int64],
    depth: Array,
    through_water: Array,
) -> list[Track]:
    seconds = STEP_S * np.arange(depth.size, dtype=np.float64)
    return advected(field, places, starts_ns, seconds, depth, through_water)


def _logged(
    field: Field,
    tracks: list[Track],
    pings_ns: NDArray[np.int64],
    to_the_end: bool,
) -> Mission:
    """Return the logged mission from dives and surface drifts."""
    start_ns = tracks[0].start_ns
    end_ns = tracks[-1].end_ns if to_the_end else int(pings_ns[-1])
    logged_ns = np.union1d(np.arange(start_ns, end_ns + 1, PING_STEPS * _STEP_NS), pings_ns)
    positions: dict[int, VehicleState] = {}
    dives: list[Dive] = []
    parts: list[tuple[Array, ...]] = []
    for track in tracks:
        steps = [
            times_ns[(times_ns >= track.start_ns) & (times_ns < track.end_ns)]
            for times_ns in (pings_ns, logged_ns)
        ]
        pinged, logged = ((times_ns - track.start_ns) // _STEP_NS for times_ns in steps)
        deepest = int(np.argmax(track.depth))
        if deepest:
            under = logged[logged > 0]
            dive, reckoned = dead_reckoned(
                field, len(dives) + 1, track, track.start_ns + under * _STEP_NS, track.depth[under]
            )
            dives.append(dive)
        else:
            # the first and the last moment at the surface are fixes, and so is each ping there
            moments = sorted({0, SURFACE_STEPS, *logged.tolist()})
            reckoned = [log_position(field, track.time_ns(k), track.place[k]) for k in moments]
        positions.update((position.time_ns, position) for position in reckoned)
        pitch = (
            np.where(pinged <= deepest, -_GLIDE_ANGLE_DEG, _GLIDE_ANGLE_DEG)
            if deepest
            else np.zeros(pinged.size)
        )
        through_water = np.tile(track.through_water, (pinged.size, 1))
        parts.append(
            (
                track.place[pinged],
                track.depth[pinged],
                _heading(field, track)[pinged],
                pitch,
                through_water,
            )
        )
    place, depth, heading, pitch, through_water = (
        np.concatenate(column) for column in zip(*parts, strict=True)
    )
    over_ground = through_water + field.velocity(place[:, 0], place[:, 1], depth, pings_ns)
    pings = Pings(pings_ns, place[:, 0], place[:, 1], depth, heading, pitch, over_ground)
    return Mission(pings, tuple(positions[t] for t in sorted(positions)), tuple(dives))


def _heading(field: Field, track: Track) -> Array:
    """Return the heading at each step, clockwise from true north; north at the surface by convention."""
    if not track.through_water.any():
        return np.zeros(track.depth.size)
    longitude, latitude = to_geographic(field.grid.projection, track.place[:, 0], track.place[:, 1])
    bearing = np.arctan2(track.through_water[0], track.through_water[1])
    true = bearing - grid_bearing_of_true_north(field.grid.projection, longitude, latitude)
    return np.asarray(np.mod(np.rad2deg(true), 360.0), dtype=np.float64)
