"""Currents at the surface: vectors of HF radars averaged to boxes, and fixes of drifters to means of the current between them.

A box is two of the ensemble's cells wide: 500 vectors an hour are not 500 measurements.

The error of a box has that of its vectors, correlated over a length; tides and inertial motion, which daily fields do not hold, are an
error that all boxes of a time share. Radials are averaged along bearings: each sector of a station measures one component.

An estimate has no divergence and changes over days; a sea surface has divergence, fronts and tides. What total vectors show beside an
estimate is taken as a field whose components are independent with the covariance s^2 exp(-d / L) between places d apart, and errors of f
times those stated. Times before say which s, L and f (maximum likelihood): stated errors may be those of the method, which hours share.
For that a measurement keeps its vectors, of very many averaged to smaller boxes.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_local
from replay_kit.core.grid import Projection
from replay_kit.core.observation import (
    BOTH_COMPONENTS,
    Flag,
    Label,
    LinearMeasurement,
    Source,
    VehicleState,
)
from replay_kit.measurements.messages.water import DrifterFix, RadarCurrents
from replay_kit.measurements.vehicle.dead_reckoning import begin, drift_velocity, extend, path_mean

# m; boxes at least so wide, and over which errors are correlated where the file does not say
_LEAST_SPACING, _ERROR_LENGTH = 2e3, 10e3
# boxes, and vectors of the field, of a time at most: they become wider
_MOST_BOXES, _MOST_VECTORS = 300, 600
# m/s; error of a box at least, and a current of which an oblique bearing sees a part
_LEAST_ERROR, _CURRENT = 0.02, 0.2
# s; over which tides and inertial motion keep their direction: a quarter of the semidiurnal period
_TIDE = 0.25 * 12.42 * 3600.0
# degrees of a sector
_SECTOR = 10.0
# m, lengths of the field that are tried, errors as shares of its size, and the share of its variance that keeps equal places apart
_LENGTHS, _ERRORS, _NUGGET = np.geomspace(5e3, 80e3, 9), np.geomspace(0.05, 3.0, 7), 1e-6
# s; shortest and longest time between two fixes of a mean: tides are averaged, and the way between is known
_SHORTEST, _LONGEST = 3 * 3600, 26 * 3600
# m/s; a drogued drifter's slip through the water (Niiler and Paduan 1995, J. Phys. Oceanogr. 25), and the semidiurnal tide's period [s]
_SLIP, _PERIOD = 0.01, 12.42 * 3600.0


def superobservations(
    currents: RadarCurrents, label: Label, spacing: float, tide_std: float
) -> list[LinearMeasurement]:
    """Return the measurements of a time: one of total vectors, or one of each sector of radials.

    Args:
        currents: At least one vector.
        label: For statistics; its source has the time.
        spacing: Width of the boxes [m].
        tide_std: Speed of tides and inertial motion that the forecast does not hold, of each component [m/s].
    """
    common = tide_std * np.sqrt(max(1.0, _TIDE / currents.averaged))
    wide = _width(currents, spacing, _MOST_BOXES)
    if currents.direction is None:
        narrow = _width(currents, 0.0, _MOST_VECTORS)
        vectors = _averaged(currents, label, narrow, 0.0, BOTH_COMPONENTS)
        return [_averaged(currents, replace(label, vectors=vectors), wide, common, BOTH_COMPONENTS)]
    sector = np.round(currents.direction / _SECTOR) % (360.0 / _SECTOR)
    numbers = np.unique(sector)
    # sectors see two components of one tide, however many they are
    common *= np.sqrt(max(1.0, 0.5 * numbers.size))
    made = []
    for number in numbers:
        part = currents.part(sector == number)
        assert part.direction is not None
        angle = np.deg2rad(part.direction)
        mean = np.arctan2(np.sin(angle).mean(), np.cos(angle).mean())
        component = np.array([[np.sin(mean), np.cos(mean)]])
        made.append(_averaged(part, label, wide, common, component, angle - mean))
    return made


def _averaged(
    currents: RadarCurrents,
    label: Label,
    spacing: float,
    common: float,
    components: Array,
    oblique: Array | None = None,
) -> LinearMeasurement:
    """Return vectors averaged to boxes; ``oblique``, shape (n,), are the angles of radials from the component [rad]."""
    x, y = _local(currents)
    number, count = _boxes(x, y, spacing)
    size = np.bincount(number, minlength=count)
    # a box is the mean of its quarters, not the current in its middle
    quarter, points = _boxes(x, y, 0.5 * spacing)
    weights = np.zeros((count, points))
    np.add.at(weights, (number, quarter), 1.0 / size[number])

    def mean(values: Array, of: NDArray[np.intp] = number, n: int = count) -> Array:
        return np.asarray(np.bincount(of, values, minlength=n) / np.bincount(of, minlength=n))

    length = currents.error_length or _ERROR_LENGTH
    std = np.empty(count)
    of_boxes = np.split(np.argsort(number, kind="stable"), np.cumsum(size)[:-1])
    for box, at in enumerate(of_boxes):
        apart = np.hypot(x[at, None] - x[at], y[at, None] - y[at])
        own = currents.error_std[at]
        std[box] = np.sqrt(own @ np.exp(-apart / length) @ own) / at.size
    std = np.maximum(std, _LEAST_ERROR)
    if oblique is not None:
        std = np.hypot(std, _CURRENT * np.sqrt(mean(np.sin(oblique) ** 2)))
    east, north = mean(x), mean(y)
    between = np.hypot(east[:, None] - east, north[:, None] - north)
    west = currents.longitude[0] + (currents.longitude - currents.longitude[0] + 180.0) % 360.0
    return LinearMeasurement(
        label.source.time_ns,
        None,
        mean(west - 180.0, quarter, points),
        mean(currents.latitude, quarter, points),
        np.full(points, currents.depth),
        weights,
        np.column_stack([mean(each) for each in currents.value.T]),
        std,
        np.full(count, Flag.GOOD, np.int8),
        np.zeros(count, np.int32),
        label,
        float(common),
        components=components,
        correlation=np.exp(-between / length),
    )


def _local(currents: RadarCurrents) -> tuple[Array, Array]:
    middle = Projection(float(currents.longitude[0]), float(currents.latitude[0]))
    return to_local(middle, currents.longitude, currents.latitude)


def _width(currents: RadarCurrents, spacing: float, most: int) -> float:
    """Return the width of boxes [m], ``spacing`` or so much more that there are no more than ``most``."""
    x, y = _local(currents)
    spacing = max(spacing, _LEAST_SPACING)
    while _boxes(x, y, spacing)[1] > most:
        spacing *= 1.2
    return spacing


def _boxes(x: Array, y: Array, spacing: float) -> tuple[NDArray[np.intp], int]:
    """Return the number of each place's box, shape (n,), and how many there are."""
    east, north = (np.floor((each - each.min()) / spacing).astype(np.int64) for each in (x, y))
    # as one number each: rows are ten times slower to compare
    found, number = np.unique(east * (north.max() + 1) + north, return_inverse=True)
    return number.astype(np.intp), found.size


@dataclass(frozen=True, slots=True)
class ResidualField:
    """The field's covariance.

    Attributes:
        std: s [m/s], of a component.
        length: L [m].
        error_factor: f, on the stated errors of vectors.
    """

    std: float
    length: float
    error_factor: float

    @classmethod
    def likeliest(cls, times: Sequence[tuple[LinearMeasurement, Array]]) -> "ResidualField":
        """Return the field under which residuals are likeliest.

        Args:
            times: Total vectors of each time, and what they are beside an estimate, shape (n, 2) [m/s]; NaN where there is none.
        """
        seen = [
            (_apart(places, places), errors, residual)
            for places, errors, residual in (_known(*each) for each in times)
        ]
        number = sum(residual.size for *_, residual in seen)
        usual = float(np.median(np.concatenate([vectors.error_std for vectors, _ in times])))
        best, found = -np.inf, cls(0.0, 0.0, 0.0)
        for length, error in product(_LENGTHS.tolist(), _ERRORS.tolist()):
            unit, square, log_det = cls(1.0, length, error / usual), 0.0, 0.0
            for apart, errors, residual in seen:
                lower = np.linalg.cholesky(unit._covariance(apart, errors))
                white = solve_triangular(lower, residual, lower=True)
                square += float(np.sum(white**2))
                log_det += 4.0 * float(np.log(np.diag(lower)).sum())
            # the field's size is that under which all of it is likeliest
            likelihood = -number * np.log(square / number) - log_det
            if likelihood > best:
                std = float(np.sqrt(square / number))
                best, found = likelihood, cls(std, length, std * unit.error_factor)
        return found

    def between(
        self, seen: LinearMeasurement, residual: Array, longitude: Array, latitude: Array
    ) -> tuple[Array, Array]:
        """Return the field at places, shape (m, 2) [m/s], and the standard error of a component of it, shape (m,) [m/s].

        Work grows with the third power of the vectors: 500 take some 0.02 s.

        Args:
            seen: Total vectors of one time.
            residual: What they are beside an estimate, shape (n, 2) [m/s]; NaN where there is none.
            longitude: shape (m,) [degrees].
            latitude: shape (m,) [degrees].
        """
        places, errors, known = _known(seen, residual)
        cross = self.std**2 * np.exp(-_apart((longitude, latitude), places) / self.length)
        lower = np.linalg.cholesky(self._covariance(_apart(places, places), errors))
        white, crossed = (
            solve_triangular(lower, each, lower=True, check_finite=False)
            for each in (known, cross.T)
        )
        variance = self.std**2 - np.einsum("nm,nm->m", crossed, crossed)
        return crossed.T @ white, np.sqrt(np.maximum(variance, 0.0))

    def _covariance(self, apart: Array, errors: Array) -> Array:
        """Return the covariance of residuals so far apart [m], shape (n, n) [m2/s2], by that of the vectors' stated errors."""
        field = np.exp(-apart / self.length) + _NUGGET * np.eye(len(errors))
        return np.asarray(self.std**2 * field + self.error_factor**2 * errors)


def _known(seen: LinearMeasurement, residual: Array) -> tuple[tuple[Array, Array], Array, Array]:
    """Return the places of the vectors with a residual, the covariance of their errors [m2/s2], and the residuals."""
    known = np.flatnonzero(np.isfinite(residual).all(axis=1))
    longitude, latitude = seen.value_places
    return (longitude[known], latitude[known]), seen.covariance(known), residual[known]


def _apart(places: tuple[Array, Array], others: tuple[Array, Array]) -> Array:
    """Return the distances between places, longitudes and latitudes, shape (m, n) [m]."""
    middle = Projection(float(others[0][0]), float(others[1][0]))
    (x, y), (to_x, to_y) = (to_local(middle, *each) for each in (places, others))
    return np.asarray(np.hypot(x[:, None] - to_x, y[:, None] - to_y))


@dataclass(frozen=True, slots=True)
class Errors:
    """What errs.

    Attributes:
        fix_std: Of each component of a fix that states no error [m].
        tide_std: Speed of tides and inertial motion that the forecast does not hold [m/s].
    """

    fix_std: float
    tide_std: float


def displacement(
    first: tuple[Source, DrifterFix], last: tuple[Source, DrifterFix], errors: Errors, dive: int
) -> LinearMeasurement | None:
    """Return the mean current between two fixes of one drifter; None where they are too near in time, or too far.

    Args:
        first: Message and fix.
        last: The later one.
        errors: What errs.
        dive: Number of the vehicle's dive, for statistics.
    """
    seconds = (last[0].time_ns - first[0].time_ns) * 1e-9
    if not _SHORTEST <= seconds <= _LONGEST:
        return None
    before, after = (
        VehicleState(source.time_ns, fix.longitude, fix.latitude, fix.depth, False, source)
        for source, fix in (first, last)
    )
    velocity = drift_velocity(begin(before), after)
    # a drifter goes with the water: no way through it
    still = replace(after, longitude=before.longitude, latitude=before.latitude)
    places = math.hypot(
        *(errors.fix_std if math.isnan(fix.error) else fix.error for _, fix in (first, last))
    )
    turns = math.pi * seconds / _PERIOD
    tide = errors.tide_std * min(1.0, 1.0 / turns)
    error = math.hypot(places / seconds, _SLIP, tide)
    mean = path_mean(extend(begin(before), still), after, velocity, error, "drift", dive)
    return replace(mean.linear, label=Label(dive, last[0], kind="drifters"))


def is_over(first: Source, now: Source) -> bool:
    """Return whether a fix is too old to begin a mean that ends now."""
    return (now.time_ns - first.time_ns) * 1e-9 > _LONGEST
