"""The instrument's heading against the course between the vehicle's positions: a clock that is late.

A vehicle that moves heads along its course but for a constant turn, of a declination or a mounting. With headings h at the times t of
pings and courses c(t), the mean of exp(i (h - c(t - lag))) has a length of 1 where the lag is right. What it lacks counts as the mean
square of what a lag leaves, and the likelihood ratio of a lag is that of ``depths.py``. A vehicle that holds its course, or drifts,
says nothing.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.errors import Finding
from replay_kit.core.observation import VehicleState
from replay_kit.measurements.consistency.depths import (
    LEAST_GAIN,
    LEAST_PINGS,
    LONGEST,
    MOST_COUNTED,
    SPACING,
    DepthRecord,
    late_clock,
)
from replay_kit.measurements.consistency.sources import metres_per_degree

# m/s of a vehicle whose heading is its course; mean square error of the two, of 10 degrees; share by which courses must differ
_MOVES, _ERROR, _TURNS = 0.5, 0.03, 0.1
# s; lags that are tried, and those of which it is asked whether they would show; positions that are remembered
_LAGS = np.arange(-46_800.0, 46_801.0, SPACING)
_ASKED = SPACING * 2.0 ** np.arange(10)
_MOST = 1500
#: Latest positions, oldest first.
Positions = tuple[VehicleState, ...]


def with_position(positions: Positions, vehicle: VehicleState) -> Positions:
    """Return the positions with one more, where it comes late enough after the last one."""
    if positions and vehicle.time_ns - positions[-1].time_ns < SPACING * 1e9:
        return positions
    return (*positions[1 - _MOST :], vehicle)


def found_of_headings(own: DepthRecord, positions: Positions, topic: str) -> Finding | None:
    """Return that the instrument's clock is late, if that explains its headings much better than none.

    Args:
        own: Of the instrument, headings [degrees] in place of depths.
        positions: Of the vehicle.
        topic: Of the pings.
    """
    if len(positions) < LEAST_PINGS or len(own.depths) < LEAST_PINGS:
        return None
    t, degrees, _ = own.arrays
    heading, courses = np.exp(1j * np.radians(degrees)), _courses(positions)
    none = _misfit(t, heading, courses)
    if none is None or none[0] < 4.0 * _ERROR:
        return None
    each = [(lag, _misfit(t - lag, heading, courses)) for lag in _LAGS.tolist()]
    known = [
        (lag, misfit) for lag, misfit in each if misfit is not None and misfit[1] >= 0.5 * t.size
    ]
    if not known:
        return None
    # of lags that explain as much the least
    most = min(misfit[0] for _, misfit in known) + 0.1 * _ERROR
    lag, late = min((one for one in known if one[1][0] <= most), key=lambda one: abs(one[0]))
    gain = _gain(none, late)
    if lag == 0.0 or gain < LEAST_GAIN or none[0] < 4.0 * late[0]:
        return None
    return late_clock(f"{topic}: the headings of the pings", int(t[-1] * 1e9), lag, late[1], gain)


def least_lag(own: DepthRecord, positions: Positions) -> float:
    """Return the least lag of an instrument's clock that its headings would show [s]; inf where they show none."""
    if len(positions) < LEAST_PINGS or len(own.depths) < LEAST_PINGS:
        return math.inf
    t, courses = own.arrays[0], _courses(positions)
    heading = _at(t, courses)
    for lag in _ASKED.tolist():
        none = _misfit(t - lag, heading, courses)
        if none is not None and _gain(none, (0.0, none[1])) >= LEAST_GAIN:
            return float(lag)
    return math.inf


def _courses(positions: Sequence[VehicleState]) -> tuple[Array, NDArray[np.complex128]]:
    """Return the times of positions [s], and the direction from each to the next; 0 where the vehicle hardly moves or it is not known."""
    times = np.array([one.time_ns for one in positions]) * 1e-9
    longitude, latitude = (
        np.array([getattr(one, name) for one in positions]) for name in ("longitude", "latitude")
    )
    east, north = metres_per_degree(float(latitude[0]))
    way = north * np.diff(latitude) + 1j * east * ((np.diff(longitude) + 180.0) % 360.0 - 180.0)
    seconds = np.maximum(np.diff(times), 1e-3)
    moves = (np.abs(way) >= _MOVES * seconds) & (seconds <= 2.0 * LONGEST)
    return times, np.where(moves, way / np.maximum(np.abs(way), 1e-9), 0.0)


def _at(t: Array, courses: tuple[Array, NDArray[np.complex128]]) -> NDArray[np.complex128]:
    times, course = courses
    at = np.searchsorted(times, t, side="right") - 1
    inside = (at >= 0) & (at < course.size)
    return np.where(inside, course[np.clip(at, 0, course.size - 1)], 0.0)


def _misfit(
    t: Array, heading: NDArray[np.complex128], courses: tuple[Array, NDArray[np.complex128]]
) -> tuple[float, float] | None:
    """Return the mean square of what headings and courses differ in, less a constant turn, and their number; None where few turn."""
    course = _at(t, courses)
    known = (course != 0.0) & (heading != 0.0)
    number = int(known.sum())
    if number < LEAST_PINGS or abs(course[known].mean()) > 1.0 - _TURNS:
        return None
    return 2.0 - 2.0 * abs(complex(np.mean(heading[known] * course[known].conj()))), float(number)


def _gain(none: tuple[float, float], late: tuple[float, float]) -> float:
    number = min(none[1], late[1], 2.0 * MOST_COUNTED)
    return 0.25 * number * math.log((none[0] + _ERROR) / (late[0] + _ERROR))
