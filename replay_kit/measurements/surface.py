"""Measurements of other sources: vectors of HF radars averaged to boxes, fixes of drifters to means of the current between them, sensors.

A box is two of the ensemble's cells wide: 500 vectors an hour are not 500 measurements. The error of a box has that of its vectors,
correlated over a length; tides and inertial motion, which daily fields do not hold, are an error that all boxes of a time share. Radials
are averaged along bearings: each sector of a station measures one component.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_local
from replay_kit.core.grid import Projection
from replay_kit.core.observation import (
    BOTH_COMPONENTS,
    Flag,
    Kind,
    Label,
    LinearMeasurement,
    Reason,
    Source,
    usable,
)
from replay_kit.core.table import Table
from replay_kit.measurements.dives import Depths
from replay_kit.measurements.ledger import Ledger
from replay_kit.measurements.means import Spot, begun, drift, extended, path_mean

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
_OUTSIDE, _TOO_FAST = (
    "drifter outside the ensemble's box",
    "drifter faster than measurements.max_speed",
)
_NO_VECTOR = "no vector slower than measurements.max_speed within the ensemble's box"
_PLACE = ("longitude", "latitude", "depth")
#: Place in the stream, and the measurement that its message completes.
Found = list[tuple[int, LinearMeasurement]]


def _tide_of(config: MeasurementConfig) -> float:
    return _USUAL_TIDE if config.surface_tide_std is None else config.surface_tide_std


@dataclass(frozen=True, slots=True, eq=False)
class Vectors:
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
    suspect: NDArray[np.bool_]
    depth: float
    averaged: float
    error_length: float
    kind: Kind = "radar"

    def part(self, at: NDArray[np.bool_]) -> "Vectors":
        """Return some of the vectors."""
        return replace(
            self,
            longitude=self.longitude[at],
            latitude=self.latitude[at],
            value=self.value[at],
            error_std=self.error_std[at],
            suspect=self.suspect[at],
            direction=None if self.direction is None else self.direction[at],
        )

    def within(self, box: tuple[float, float, float, float]) -> "Vectors":
        """Return those in a box of west, south, east, north [degrees]."""
        west, south, east, north = box
        along = (self.longitude - west) % 360.0 <= (east - west) % 360.0
        return self.part(along & (self.latitude >= south) & (self.latitude <= north))


def sources_of(table: Table) -> list[Source]:
    """Return the messages of a table's rows."""
    rows = zip(table.position.tolist(), table.time.tolist(), strict=True)
    return [Source(table.input, table.topic, ordinal, time) for ordinal, time in rows]


def of_radar(table: Table, depths: Depths, config: MeasurementConfig, ledger: Ledger) -> Found:
    """Return the measurements of the radars' vectors of each time."""
    found: Found = []
    reasons = np.full(len(table), "", object)
    names = ("longitude", "latitude", "value", "error_std", "direction", "suspect")
    _, _, dives = depths.at(table.order)
    for k, source in enumerate(sources_of(table)):
        extent = (table[name][k] for name in ("depth", "averaged", "error_length", "kind"))
        stated = Vectors(*(table[name][k] for name in names), *extent)
        slow = np.abs(stated.value).max(axis=1) <= config.max_speed
        stated = stated.part(slow & (config.quality.use_suspect | ~stated.suspect))
        stated = stated if config.surface_box is None else stated.within(config.surface_box)
        if not stated.error_std.size:
            reasons[k] = _NO_VECTOR
            continue
        label = Label(int(dives[k]), source, kind=stated.kind)
        spacing = config.surface_spacing or _SPACING
        made = superobservations(stated, label, spacing, _tide_of(config))
        found += [(int(table.order[k]), one) for one in made]
    ledger.add(table.order, table.topic, reasons)
    return found


def of_sensor(table: Table, depths: Depths, ledger: Ledger) -> Found:
    """Return what sensors of other packages measured, at the time of their messages."""
    found: Found = []
    _, _, dives = depths.at(table.order)
    ledger.add(table.order, table.topic)
    for k, source in enumerate(sources_of(table)):
        stated = table["measurement"][k]
        label = replace(
            stated.label, dive=int(dives[k]), source=source, kind=stated.label.kind or "sensors"
        )
        placed = replace(_with_places(stated), time_ns=source.time_ns, label=label)
        found.append((int(table.order[k]), placed))
    return found


def _with_places(stated: LinearMeasurement) -> LinearMeasurement:
    """Return a measurement with those values flagged that have no place, or one above the surface."""
    points = stated.longitude + stated.latitude + stated.depth
    unknown, above, weights = ~np.isfinite(points), stated.depth < 0.0, stated.weights
    if weights is not None:
        # a point without a place is no point of the sums that do not use it, either
        stated = replace(stated, **{name: np.nan_to_num(getattr(stated, name)) for name in _PLACE})
        unknown, above = ((weights != 0.0) @ each for each in (unknown, above))
    flags = np.where(above & usable(stated.flags), Flag.FAIL, stated.flags)
    reasons = Reason.ABOVE_SURFACE * above + Reason.MISSING * unknown
    return replace(
        stated,
        flags=np.where(unknown, Flag.MISSING, flags).astype(np.int8),
        reasons=(stated.reasons | reasons).astype(np.int32),
    )


@dataclass(frozen=True, slots=True)
class DrifterFix:
    """Where a drifter was: the fix, with the depth of the middle of its drogue, and the error of each component of its place [m].

    Attributes:
        spot: The fix.
        error: Standard error [m]; NaN where it is not stated.
    """

    spot: Spot
    error: float


def of_drifters(
    known: Mapping[str, DrifterFix],
    tables: Sequence[Table],
    depths: Depths,
    config: MeasurementConfig,
    ledger: Ledger,
) -> tuple[dict[str, DrifterFix], Found]:
    """Return the fixes from which drifters' displacements are counted, by name, and the mean currents since them."""
    fixes, found = dict(known), Found()
    rows = sorted(
        (int(order), t, k) for t, one in enumerate(tables) for k, order in enumerate(one.order)
    )
    for order, t, k in rows:
        table = tables[t]
        source = sources_of(table)[k]
        spot = Spot(source.time_ns, *(float(table[name][k]) for name in _PLACE))
        now, name = DrifterFix(spot, float(table["error"][k])), table["name"][k]
        reason, made = "", None
        if config.surface_box is not None and not _inside(spot, config.surface_box):
            reason = _OUTSIDE
        elif (before := fixes.get(name)) is not None:
            dive = int(depths.at(np.array([order]))[2][0])
            made = _displacement(before, now, config, Label(dive, source, kind="drifters"))
            if made is not None and np.abs(made.value).max() > config.max_speed:
                reason = _TOO_FAST
            elif made is not None or (spot.time - before.spot.time) * 1e-9 > _LONGEST:
                fixes[name] = now
        else:
            fixes[name] = now
        ledger.add(np.array([order]), table.topic, reason)
        found += [(order, made)] if made is not None and not reason else []
    return fixes, found


def _inside(spot: Spot, box: tuple[float, float, float, float]) -> bool:
    west, south, east, north = box
    along = (spot.longitude - west) % 360.0 <= (east - west) % 360.0
    return along and south <= spot.latitude <= north


def _displacement(
    first: DrifterFix, last: DrifterFix, config: MeasurementConfig, label: Label
) -> LinearMeasurement | None:
    """Return the mean current between two fixes of one drifter; None where they are too near in time, or too far."""
    before, after = first.spot, last.spot
    seconds = (after.time - before.time) * 1e-9
    if not _SHORTEST <= seconds <= _LONGEST:
        return None
    velocity = drift(begun(before), after)
    # a drifter goes with the water: no way through it
    still = {
        "time": np.array([after.time]),
        "longitude": np.array([before.longitude]),
        "latitude": np.array([before.latitude]),
        "depth": np.array([after.depth]),
    }
    stated = (config.fix_std if math.isnan(fix.error) else fix.error for fix in (first, last))
    turns = math.pi * seconds / _PERIOD
    tide = _tide_of(config) * min(1.0, 1.0 / turns)
    error = math.hypot(math.hypot(*stated) / seconds, _SLIP, tide)
    mean = path_mean(extended(begun(before), still, np.empty(0)), after, velocity, error)
    return linear_mean(mean, label, after.time)


def linear_mean(mean: Mapping[str, Any], label: Label, time: int) -> LinearMeasurement:
    """Return a mean along a path as a measurement of one value."""
    return LinearMeasurement(
        time,
        mean["path_time"],
        mean["path_longitude"],
        mean["path_latitude"],
        mean["path_depth"],
        mean["weight"][None],
        np.array([mean["velocity"]]),
        np.array([mean["error_std"]]),
        np.array([Flag.GOOD], np.int8),
        np.zeros(1, np.int32),
        label,
    )


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
    currents: Vectors,
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


def _local(currents: Vectors) -> tuple[Array, Array]:
    middle = Projection(float(currents.longitude[0]), float(currents.latitude[0]))
    return to_local(middle, currents.longitude, currents.latitude)


def _width(currents: Vectors, spacing: float, most: int) -> float:
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
