"""Measurements of other sources: vectors of HF radars averaged to boxes, fixes of drifters to means of the current between them, sensors.

A box is two of the ensemble's cells wide: 500 vectors an hour are not 500 measurements. The error of a box has that of its vectors,
correlated over a length; tides and inertial motion, which daily fields do not hold, are an error that all boxes of a time share. Radials
are averaged along bearings: each sector of a station measures one component.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array, Indices, Mask
from replay_kit.core.geodesy import to_local, unwrap_longitude
from replay_kit.core.grid import Projection
from replay_kit.core.observation import (
    BOTH_COMPONENTS,
    Flag,
    Kind,
    Label,
    LinearMeasurement,
    PathMean,
    Reason,
    Source,
    usable,
)
from replay_kit.core.table import Table
from replay_kit.measurements.means import Spot, begun, drift, extended, path_mean
from replay_kit.measurements.step import Found, Step

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
# s; shortest and longest time between two fixes of a mean: tides are averaged, and the way between is known
_SHORTEST, _LONGEST = 3 * 3600, 26 * 3600
# m/s; a drogued drifter's slip through the water (Niiler and Paduan 1995, J. Phys. Oceanogr. 25), and the semidiurnal tide's period [s]
_SLIP, _PERIOD = 0.01, 12.42 * 3600.0
# m, and m/s
_SPACING, _USUAL_TIDE = 10e3, 0.08
_OUTSIDE = "drifter outside the ensemble's box"
_TOO_FAST = "drifter faster than measurements.max_speed"
_NO_VECTOR = "no vector slower than measurements.max_speed within the ensemble's box"
#: Where a drifter was, at the depth of the middle of its drogue, and the standard error of each component of its place [m]; NaN where it
#: is not stated.
DrifterFix = tuple[Spot, float]


def _tide_of(config: MeasurementConfig) -> float:
    return _USUAL_TIDE if config.surface_tide_std is None else config.surface_tide_std


class Vectors(NamedTuple):
    """What radars measured at one time.

    Attributes:
        longitude: shape (n,) [degrees].
        latitude: shape (n,) [degrees].
        value: shape (n, c) [m/s]: eastward and northward, or along ``direction``.
        error_std: shape (n,) [m/s], of each component.
        direction: shape (n,), of a positive radial, clockwise from true north [degrees]; None for total vectors.
        suspect: shape (n,), which their quality flags call suspect.
        depth: That the radars see [m].
        averaged: Over which time [s].
        error_length: Over which errors are correlated [m]; 0 where that is not stated.
        kind: As in ``Label``.
    """

    longitude: Array
    latitude: Array
    value: Array
    error_std: Array
    direction: Array | None
    suspect: Mask
    depth: float
    averaged: float
    error_length: float
    kind: Kind = "radar"

    def part(self, at: Mask) -> "Vectors":
        """Return some of the vectors."""
        rows = (None if values is None else values[at] for values in self[:6])
        return Vectors._make((*rows, *self[6:]))


def _inside(config: MeasurementConfig, longitude: Any, latitude: Any) -> Any:
    """Return whether places [degrees] are in the box of the settings, west, south, east, north; everywhere without one."""
    if config.surface_box is None:
        return np.isfinite(latitude) | True
    west, south, east, north = config.surface_box
    along = (longitude - west) % 360.0 <= (east - west) % 360.0
    return along & (latitude >= south) & (latitude <= north)


def _messages(table: Table, step: Step) -> Iterator[tuple[int, int, Source, int]]:
    """Yield place in the stream, row, message and dive of each row of a table."""
    columns = table.order, table.position, table.time, step.dived(table.order)["dive"]
    for k, (order, *message, dive) in enumerate(np.column_stack(columns).tolist()):
        yield order, k, Source(table.input, table.topic, *message), dive


def of_radar(table: Table, step: Step) -> Found:
    """Return the measurements of the radars' vectors of each time."""
    found, reasons, config = Found(), np.full(len(table), "", object), step.config
    spacing = config.surface_spacing or _SPACING
    for order, k, source, dive in _messages(table, step):
        stated = Vectors(*(table[name][k] for name in Vectors._fields))
        good = np.abs(stated.value).max(axis=1) <= config.max_speed
        good &= config.quality.use_suspect | ~stated.suspect
        good &= _inside(config, stated.longitude, stated.latitude)
        if good.any():
            label = Label(dive, source, kind=stated.kind)
            made = superobservations(stated.part(good), label, spacing, _tide_of(config))
            found += [(order, one) for one in made]
        else:
            reasons[k] = _NO_VECTOR
    step.note(table, reasons)
    return found


def of_sensor(table: Table, step: Step) -> Found:
    """Return what sensors of other packages measured, at the time of their messages."""
    found = Found()
    step.note(table)
    for order, k, source, dive in _messages(table, step):
        stated = _with_places(table["measurement"][k])
        kind = stated.label.kind or "sensors"
        label = replace(stated.label, dive=dive, source=source, kind=kind)
        found.append((order, replace(stated, time_ns=source.time_ns, label=label)))
    return found


def _with_places(stated: LinearMeasurement) -> LinearMeasurement:
    """Return a measurement with those values flagged that have no place, or one above the surface."""
    points = stated.longitude + stated.latitude + stated.depth
    unknown, above, weights = ~np.isfinite(points), stated.depth < 0.0, stated.weights
    if weights is not None:
        # a point without a place is no point of the sums that do not use it, either
        stated = replace(
            stated, **{name: np.nan_to_num(getattr(stated, name)) for name in Spot._fields[1:]}
        )
        unknown, above = ((weights != 0.0) @ each for each in (unknown, above))
    flags = np.where(above & usable(stated.flags), Flag.FAIL, stated.flags)
    reasons = Reason.ABOVE_SURFACE * above + Reason.MISSING * unknown
    return replace(
        stated,
        flags=np.where(unknown, Flag.MISSING, flags).astype(np.int8),
        reasons=(stated.reasons | reasons).astype(np.int32),
    )


def of_drifters(fixes: dict[str, DrifterFix], tables: Sequence[Table], step: Step) -> Found:
    """Return the mean currents since the fixes from which drifters' displacements are counted, by name, and bring these up to date."""
    found, config = Found(), step.config
    rows = [(row, table) for table in tables for row in _messages(table, step)]
    for (order, k, source, dive), table in sorted(rows, key=lambda one: one[0][0]):
        spot = Spot(source.time_ns, *(table[name][k].item() for name in Spot._fields[1:]))
        now, name, made = (spot, float(table["error"][k])), table["name"][k], Found()
        reason = "" if _inside(config, spot.longitude, spot.latitude) else _OUTSIDE
        before = now if reason else fixes.setdefault(name, now)
        seconds = (spot.time - before[0].time) * 1e-9
        if _SHORTEST <= seconds <= _LONGEST:
            label = Label(dive, source, kind="drifters")
            made = [(order, _displacement(before, now, config, label))]
        if any(np.abs(one.value).max() > config.max_speed for _, one in made):
            reason, made = _TOO_FAST, Found()
        elif made or seconds > _LONGEST:
            fixes[name] = now
        step.note(table.rows(slice(k, k + 1)), reason)
        found += made
    return found


def _displacement(
    first: DrifterFix, last: DrifterFix, config: MeasurementConfig, label: Label
) -> LinearMeasurement:
    """Return the mean current between two fixes of one drifter."""
    (before, _), (after, _) = first, last
    seconds = (after.time - before.time) * 1e-9
    # a drifter goes with the water: no way through it
    still = before._replace(time=after.time, depth=after.depth)._asdict()
    rows = {name: np.array([value]) for name, value in still.items()}
    stated = (config.fix_std if math.isnan(error) else error for _, error in (first, last))
    tide = _tide_of(config) * min(1.0, _PERIOD / (math.pi * seconds))
    error = math.hypot(math.hypot(*stated) / seconds, _SLIP, tide)
    path = extended(begun(before), rows, np.empty(0))
    velocity = drift(begun(before), after)
    time, longitude, latitude, depth, weight, *_ = path_mean(path, after, velocity, error).values()
    mean = PathMean(
        after.time,
        time,
        longitude,
        latitude,
        depth,
        weight,
        velocity,
        error,
        "drift",
        label.dive,
        label.source,
    )
    return replace(mean.linear, label=label)


def superobservations(
    currents: Vectors, label: Label, spacing: float, tide_std: float
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
        label = replace(label, vectors=_averaged(currents, label, narrow, 0.0))
        return [_averaged(currents, label, wide, common)]
    sector = np.round(currents.direction / _SECTOR) % (360.0 / _SECTOR)
    numbers = np.unique(sector)
    # sectors see two components of one tide, however many they are
    common *= np.sqrt(max(1.0, 0.5 * numbers.size))
    return [_averaged(currents.part(sector == each), label, wide, common) for each in numbers]


def _averaged(currents: Vectors, label: Label, spacing: float, common: float) -> LinearMeasurement:
    """Return vectors averaged to boxes; radials are measurements of the component along the mean of their bearings."""
    x, y = _local(currents)
    # a box is the mean of its quarters, not the current in its middle
    number, quarter = (_boxes(x, y, width) for width in (spacing, 0.5 * spacing))
    size = np.bincount(number)
    weights = np.zeros((size.size, quarter.max() + 1))
    np.add.at(weights, (number, quarter), 1.0 / size[number])

    def mean(values: Array, of: Indices = number) -> Array:
        return np.bincount(of, values) / np.bincount(of)

    def apart(x: Array, y: Array) -> Array:
        return np.hypot(x[:, None] - x, y[:, None] - y)

    length, components = currents.error_length or _ERROR_LENGTH, BOTH_COMPONENTS
    std = np.empty(size.size)
    for box, count in enumerate(size):
        at = number == box
        own = currents.error_std[at]
        std[box] = np.sqrt(own @ np.exp(-apart(x[at], y[at]) / length) @ own) / count
    std = np.maximum(std, _LEAST_ERROR)
    if currents.direction is not None:
        angle = np.deg2rad(currents.direction)
        along = np.arctan2(np.sin(angle).mean(), np.cos(angle).mean())
        components = np.array([[np.sin(along), np.cos(along)]])
        std = np.hypot(std, _CURRENT * np.sqrt(mean(np.sin(angle - along) ** 2)))
    return LinearMeasurement(
        label.source.time_ns,
        None,
        mean(unwrap_longitude(currents.longitude, currents.longitude[0]), quarter),
        mean(currents.latitude, quarter),
        np.full(weights.shape[1], currents.depth),
        weights,
        np.column_stack([mean(each) for each in currents.value.T]),
        std,
        np.full(size.size, Flag.GOOD, np.int8),
        np.zeros(size.size, np.int32),
        label,
        float(common),
        components=components,
        correlation=np.exp(-apart(mean(x), mean(y)) / length),
    )


def _local(currents: Vectors) -> tuple[Array, Array]:
    middle = Projection(float(currents.longitude[0]), float(currents.latitude[0]))
    return to_local(middle, currents.longitude, currents.latitude)


def _width(currents: Vectors, spacing: float, most: int) -> float:
    """Return the width of boxes [m], ``spacing`` or so much more that there are no more than ``most``."""
    x, y = _local(currents)
    spacing = max(spacing, _LEAST_SPACING)
    while _boxes(x, y, spacing).max() >= most:
        spacing *= 1.2
    return spacing


def _boxes(x: Array, y: Array, spacing: float) -> Indices:
    """Return the number of each place's box, shape (n,), from 0 without gaps."""
    east, north = (np.floor((each - each.min()) / spacing).astype(np.int64) for each in (x, y))
    # as one number each: rows are ten times slower to compare
    return np.unique(east * (north.max() + 1) + north, return_inverse=True)[1]
