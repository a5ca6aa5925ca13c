"""Simulated missions in a truth: a vessel's survey of random positions, and a glider's dives along a course."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from replay_kit.core.arrays import Array, Indices, Mask, Times
from replay_kit.core.errors import ForecastError
from replay_kit.core.geodesy import (
    grid_bearing_of_true_north,
    heading_deg,
    rotate_to_geographic,
    to_geographic,
)
from replay_kit.studies.twins.field import Field, grid_indices

VESSEL_SPEED = 5.0  # m/s, over ground
# A glider's speed through water [m/s], angle to the horizontal [degrees], and greatest depth [m].
GLIDER_SPEED, GLIDE_ANGLE_DEG, _MAX_DEPTH = 0.3, 20.0, 500.0
# Step of a glider's flight [s]; steps from ping to ping, and of a stay at the surface.
_STEP_S, _PING_STEPS, _SURFACE_STEPS = 120, 5, 2
# Corners of a glider's course in fractions of the grid's rows and columns; it starts at any of them and goes round.
_COURSE = np.array([(0.2, 0.2), (0.8, 0.8), (0.8, 0.2), (0.2, 0.8)])
_REACHED = 5_000.0  # m; a corner this near counts as reached: one dive goes half as far
_EDGE = 0.1  # of the grid; a surfacing nearer to the edge than this turns the glider to the centre
_MAX_DRAWS = 1000


@dataclass(frozen=True, slots=True, eq=False)
class Mission:
    """Simulated mission; a row for each logged position, in order of time.

    Attributes:
        time_ns: shape (n,) [ns, UTC], whole milliseconds.
        place: shape (n, 3) [m], exact position in the truth's local frame: east, north, depth.
        heading_deg: shape (n,), heading clockwise from true north; 0 of a glider at the surface.
        pitch_deg: shape (n,), pitch, nose up.
        pinged: shape (n,), whether the ADCP pings.
        logged: shape (n, 3), position as logged: longitude, latitude [degrees], depth [m].
        dead_reckoned: shape (n,), whether the logged position is dead-reckoned.
        dives: shape (d, 2), rows of the fixes before and after each dive of a glider.
        current: shape (d, 2) [m/s], depth-averaged current of each dive, true east and north.
    """

    time_ns: Times
    place: Array
    heading_deg: Array
    pitch_deg: Array
    pinged: Mask
    logged: Array
    dead_reckoned: Mask
    dives: Indices
    current: Array

    @property
    def hours(self) -> float:
        """Time from the first ping to the last [h]."""
        return float(np.ptp(self.time_ns[self.pinged])) / 3.6e12


def as_logged(field: Field, place: Array) -> Array:
    """Return local positions, shape (n, 3), as logged: to 1e-7 degree and 1 mm of depth, the resolution of MAVLink."""
    longitude, latitude = to_geographic(field.grid.projection, place[:, 0], place[:, 1])
    return np.column_stack([longitude.round(7), latitude.round(7), place[:, 2].round(3)])


def survey(field: Field, pings: int, rng: np.random.Generator) -> Mission:
    """Return a vessel's survey: positions uniformly random over the wet surface, visited nearest first, one ping at each.

    Args:
        field: Truth; only positions with a surface current are visited.
        pings: Number of positions.
        rng: Generator of the positions.

    Raises:
        ForecastError: The region's surface is almost all dry.
    """
    drawn = random_places(field, pings, rng)
    order, left = [0], np.arange(1, pings)
    while left.size:
        nearest = int(np.argmin(((drawn[left] - drawn[order[-1]]) ** 2).sum(axis=1)))
        order.append(int(left[nearest]))
        left = np.delete(left, nearest)
    legs = np.diff(drawn[order], axis=0)
    elapsed_s = np.append(0.0, np.cumsum(np.hypot(*legs.T))) / VESSEL_SPEED
    # the last ping keeps the heading of the leg that led to it
    course = np.append(heading_deg(*legs.T), 0.0)
    course[-1] = course[-2:][0]
    level, every = np.zeros(pings), np.ones(pings, dtype=np.bool_)
    place = np.column_stack([drawn[order], level])
    return Mission(
        field.time_ns + np.round(elapsed_s * 1e3).astype(np.int64) * 10**6,
        place,
        course,
        level,
        every,
        as_logged(field, place),
        ~every,
        np.empty((0, 2), dtype=np.intp),
        np.empty((0, 2)),
    )


def dives(field: Field, pings: int, rng: np.random.Generator) -> Mission:
    """Return a glider's mission: dives along a course, a ping every ten minutes, a fix at each surfacing.

    Positions between fixes are dead-reckoned as by a shore station after the dive: motion through water plus the depth-averaged current, so
    that the track ends at the next fix. The last dive is flown to its end.

    Args:
        field: Truth.
        pings: Number of pings.
        rng: Generator of the starting corner.

    Raises:
        ForecastError: The glider drifted out of the truth's water.
    """
    bottom = min(_MAX_DEPTH, float(field.grid.levels[-1]))
    sinking = GLIDER_SPEED * float(np.sin(np.deg2rad(GLIDE_ANGLE_DEG)))
    half = max(1, round(bottom / (sinking * _STEP_S)))
    pinged, period = _PING_STEPS * np.arange(pings), 2 * half + _SURFACE_STEPS
    # a stay at the surface begins and ends the mission, so that each dive lies between two fixes
    begins = _SURFACE_STEPS + period * np.arange((pinged[-1] - _SURFACE_STEPS) // period + 1)
    ends = begins + 2 * half
    down, adrift = np.linspace(0.0, bottom, half + 1), np.zeros(_SURFACE_STEPS)
    dive_and_drift = [down, down[-2:0:-1], adrift]
    depth = np.concatenate([adrift, *dive_and_drift * begins.size, [0.0]])
    flown, through_water = _flown(field, depth, begins, int(rng.integers(len(_COURSE))))
    fixes = np.concatenate([[0, _SURFACE_STEPS], begins, ends, ends + _SURFACE_STEPS])
    rows = np.union1d(fixes, pinged)
    place = np.column_stack([flown, depth])[rows]
    submerged, stated = place[:, 2] > 0.0, place.copy()
    for axis in (0, 1):
        stated[:, axis] = np.interp(rows, rows[~submerged], place[~submerged, axis])
    logged = as_logged(field, stated)
    between = np.searchsorted(rows, np.column_stack([begins, ends]))
    current = (flown[ends] - flown[begins]) / (2 * half * _STEP_S) - through_water[begins]
    where = logged[between[:, 0], :2].T
    true = rotate_to_geographic(field.grid.projection, *where, *current.T)
    moving, sinks = through_water[rows].any(axis=1), np.diff(depth, prepend=0.0)[rows] >= 0.0
    exact = to_geographic(field.grid.projection, *flown[rows].T)
    bearing = np.arctan2(*through_water[rows].T) - grid_bearing_of_true_north(
        field.grid.projection, *exact
    )
    return Mission(
        field.time_ns + rows * (_STEP_S * 10**9),
        place,
        np.where(moving, np.mod(np.rad2deg(bearing), 360.0), 0.0),
        np.where(moving, np.where(sinks, -GLIDE_ANGLE_DEG, GLIDE_ANGLE_DEG), 0.0),
        np.isin(rows, pinged),
        logged,
        submerged,
        between,
        np.column_stack(true),
    )


def _flown(field: Field, depth: Array, begins: Indices, corner: int) -> tuple[Array, Array]:
    """Return position [m] and velocity through water [m/s] at each step, shapes (n, 2), by the midpoint rule.

    Args:
        field: Truth.
        depth: shape (n,) [m].
        begins: Steps at which dives begin.
        corner: Number of the corner at which the course begins.
    """
    along = GLIDER_SPEED * np.cos(np.deg2rad(GLIDE_ANGLE_DEG))
    flown, through_water = np.zeros((2, depth.size, 2))
    flown[0], target, ahead = _corner(field, corner), corner + 1, np.zeros(2)
    for k, (upper, lower) in enumerate(pairwise(depth.tolist())):
        here = flown[k]
        if k in begins:
            aim, target = _aim(field, here, target)
            ahead = along * ((aim - here) / np.hypot(*(aim - here)))
        through_water[k] = ahead if upper or lower else 0.0
        middle = here + 0.5 * _STEP_S * (through_water[k] + field.velocity(here[0], here[1], upper))
        halfway = field.velocity(middle[0], middle[1], 0.5 * (upper + lower))
        flown[k + 1] = here + _STEP_S * (through_water[k] + halfway)
        if not np.isfinite(halfway).all():
            longitude, latitude = to_geographic(field.grid.projection, *here)
            raise ForecastError(
                f"the current carried the glider out of the truth's water at {longitude:.3f} E, {latitude:.3f} N, {lower:.0f} m; "
                "use another seed, a shorter mission or a larger region"
            )
    return flown, through_water


def _corner(field: Field, number: int) -> Array:
    """Return the local position [m] of a corner of the course."""
    fraction = _COURSE[number % len(_COURSE)]
    return np.asarray(field.place_spline(fraction * (np.array(field.grid.east.shape) - 1.0)))


def _aim(field: Field, place: Array, target: int) -> tuple[Array, int]:
    """Return the position to fly to, and the number of the corner that is flown to next."""
    j, i, _ = grid_indices(field, place[:1], place[1:])
    fraction = np.append(j, i) / (np.array(field.grid.east.shape) - 1.0)
    if (np.abs(fraction - 0.5) > 0.5 - _EDGE).any():
        return np.asarray(field.place_spline(0.5 * (np.array(field.grid.east.shape) - 1.0))), target
    if np.hypot(*(_corner(field, target) - place)) < _REACHED:
        target += 1
    return _corner(field, target), target


def random_places(field: Field, count: int, rng: np.random.Generator) -> Array:
    """Return positions, shape (count, 2) [m], uniform over the region's wet surface, by rejection sampling."""
    axes = field.grid.east, field.grid.north
    low, high = ([end(axis) for axis in axes] for end in (np.min, np.max))
    kept = np.empty((0, 2))
    for _ in range(_MAX_DRAWS):
        drawn = rng.uniform(low, high, size=(count, 2))
        wet = np.isfinite(field.velocity(drawn[:, 0], drawn[:, 1], 0.0)).all(axis=1)
        kept = np.concatenate([kept, drawn[wet]])[:count]
        if len(kept) == count:
            return kept
    raise ForecastError(
        f"found {len(kept)} of {count} places on the truth's wet surface; use a truth with more water"
    )
