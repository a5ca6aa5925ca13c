"""Measurements from other sources: HF radar vectors averaged to boxes, drifter fixes as mean currents, sensors.

A box is two of the ensemble's cells wide, as vectors of an hour are not independent. The error of a box includes that of its vectors,
correlated over a length; tides and inertial motion, absent from daily fields, are an error common to all boxes of a time. Radials are
averaged along bearings: each sector of a station measures one component.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array, Indices, Mask
from replay_kit.core.geodesy import to_local, unwrap_longitude
from replay_kit.core.grid import Projection
from replay_kit.core.observation import (
    BOTH_COMPONENTS,
    Flag,
    Label,
    LinearMeasurement,
    PathMean,
    Reason,
    usable,
)
from replay_kit.core.observation.table import Table, chosen_rows
from replay_kit.measurements.means import Spot, drift, extended_path, path_from, path_mean
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
#: Where a drifter was, at the depth of the middle of its drogue, and the standard error of each component of its place [m]; NaN where it
#: is not stated.
DrifterFix = tuple[Spot, float]
Linear = list[LinearMeasurement]


#: What radars measured at one time: a row of a table of radars.
Vectors = Mapping[str, Any]


def _part(vectors: Vectors, at: Mask) -> Vectors:
    """Return a subset of the vectors."""
    return {name: values[at] if np.ndim(values) else values for name, values in vectors.items()}


def other_measurements(fixes: dict[str, DrifterFix], tables: Sequence[Table], step: Step) -> Found:
    """Return the measurements of radars, drifters and sensors of other packages.

    Args:
        fixes: Reference fix of each drifter's displacement, by name; updated.
        tables: Tables of their messages.
        step: Block.
    """
    found = Found()
    measured_by = {
        "radar": _radar_measurements,
        "drifter": _drifter_measurement,
        "sensor": _sensor_measurement,
    }
    for message, source in step.messages(tables):
        label = Label(int(step.dived(message.order)["dive"][0]), source)
        made, reason = measured_by[message.kind](
            chosen_rows(message.columns, 0), label, step.config, fixes
        )
        reason = step.left_out(made[0].label.kind, label.dive) if made else reason
        step.note(message, reason)
        found += [(int(message.order[0]), each) for each in made if not reason]
    return found


def _inside(config: MeasurementConfig, longitude: Any, latitude: Any) -> Any:
    """Return whether positions [degrees] are in the box of the settings, west, south, east, north; True without one."""
    if config.surface_box is None:
        return True
    west, south, east, north = config.surface_box
    along = (longitude - west) % 360.0 <= (east - west) % 360.0
    return along & (latitude >= south) & (latitude <= north)


def _tide_of(config: MeasurementConfig) -> float:
    return _USUAL_TIDE if config.surface_tide_std is None else config.surface_tide_std


def _radar_measurements(
    row: Vectors, label: Label, config: MeasurementConfig, _: Any
) -> tuple[Linear, str]:
    """Return the measurements of radar vectors of one time, or the reason for exclusion."""
    inside = _inside(config, row["longitude"], row["latitude"])
    if not np.any(inside):
        return [], "no vector within the ensemble's box"
    good = inside & (np.abs(row["value"]).max(axis=1) <= config.max_speed)
    good &= config.quality.use_suspect | ~row["suspect"]
    if not good.any():
        return [], "no vector slower than measurements.max_speed"
    label, spacing = replace(label, kind=row["kind"]), config.surface_spacing or _SPACING
    return superobservations(_part(row, good), label, spacing, _tide_of(config)), ""


def _sensor_measurement(
    row: Mapping[str, Any], label: Label, _: Any, __: Any
) -> tuple[Linear, str]:
    """Return the measurement of another package's sensor at the time of its message."""
    stated = _with_places(row["measurement"])
    stated_label = replace(stated.label, dive=label.dive, source=label.source)
    stated_label = replace(stated_label, kind=stated_label.kind or "sensors")
    return [replace(stated, time_ns=label.source.time_ns, label=stated_label)], ""


def _drifter_measurement(
    row: Mapping[str, Any], label: Label, config: MeasurementConfig, fixes: dict[str, DrifterFix]
) -> tuple[Linear, str]:
    """Return the mean current since a drifter's fix some hours earlier, if any, or the reason for exclusion."""
    after = Spot(label.source.time_ns, *(row[name].item() for name in Spot._fields[1:]))
    if not _inside(config, after.longitude, after.latitude):
        return [], _OUTSIDE
    now = after, float(row["error"])
    before, error = fixes.setdefault(row["name"], now)
    seconds = (after.time - before.time) * 1e-9
    if seconds > _LONGEST:
        fixes[row["name"]] = now
    if not _SHORTEST <= seconds <= _LONGEST:
        return [], ""
    # a drifter goes with the water: no way through it
    still = before._replace(time=after.time, depth=after.depth)._asdict()
    rows = {name: np.array([value]) for name, value in still.items()}
    path = extended_path(path_from(before), rows, np.empty(0))
    velocity = drift(path, after)
    if max(map(abs, velocity)) > config.max_speed:
        return [], "drifter faster than measurements.max_speed"
    stated = (config.fix_std if math.isnan(each) else each for each in (error, now[1]))
    tide = _tide_of(config) * min(1.0, _PERIOD / (math.pi * seconds))
    std = math.hypot(math.hypot(*stated) / seconds, _SLIP, tide)
    time, longitude, latitude, depth, weight, *_ = path_mean(path, after, velocity, std).values()
    points = time, longitude, latitude, depth, weight
    mean = PathMean(after.time, *points, velocity, std, "drift", label.dive, label.source)
    fixes[row["name"]] = now
    return [replace(mean.linear, label=replace(label, kind="drifters"))], ""


def _with_places(stated: LinearMeasurement) -> LinearMeasurement:
    """Return a measurement with values flagged that have an invalid position or lie above the surface."""
    points = {name: getattr(stated, name) for name in Spot._fields[1:]}
    unknown, above = ~np.isfinite(sum(points.values())), stated.depth < 0.0
    if stated.weights is not None:
        # a point without a place is no point of the sums that do not use it, either
        stated = replace(stated, **{name: np.nan_to_num(each) for name, each in points.items()})
        unknown, above = ((stated.weights != 0.0) @ each for each in (unknown, above))
    flags = np.where(above & usable(stated.flags), Flag.FAIL, stated.flags)
    reasons = Reason.ABOVE_SURFACE * above + Reason.MISSING * unknown
    return replace(
        stated,
        flags=np.where(unknown, Flag.MISSING, flags).astype(np.int8),
        reasons=(stated.reasons | reasons).astype(np.int32),
    )


def superobservations(
    currents: Vectors, label: Label, spacing: float, tide_std: float
) -> list[LinearMeasurement]:
    """Return the measurements of one time: one for total vectors, or one per sector of radials.

    Args:
        currents: At least one vector.
        label: Origin; its source has the time.
        spacing: Width of the boxes [m].
        tide_std: Standard deviation of each component of tides and inertial motion absent from the forecast [m/s].
    """
    common = tide_std * np.sqrt(max(1.0, _TIDE / currents["averaged"]))
    wide = _width(currents, spacing, _MOST_BOXES)
    if currents["direction"] is None:
        narrow = _width(currents, 0.0, _MOST_VECTORS)
        label = replace(label, vectors=_averaged(currents, label, narrow, 0.0))
        return [_averaged(currents, label, wide, common)]
    sector = np.round(currents["direction"] / _SECTOR) % (360.0 / _SECTOR)
    numbers = np.unique(sector)
    # sectors see two components of one tide, however many they are
    common *= np.sqrt(max(1.0, 0.5 * numbers.size))
    return [_averaged(_part(currents, sector == each), label, wide, common) for each in numbers]


def _averaged(currents: Vectors, label: Label, spacing: float, common: float) -> LinearMeasurement:
    """Return vectors averaged to boxes; radials give the component along their mean bearing."""
    x, y = _local(currents)
    # a box is the mean of its quarters, not the current in its middle
    number, quarter = (_boxes(x, y, width) for width in (spacing, 0.5 * spacing))
    size = np.bincount(number)
    weights = np.zeros((size.size, quarter.max() + 1))
    np.add.at(weights, (number, quarter), 1.0 / size[number])

    def mean(values: Array, boxes: Indices = number) -> Array:
        return np.bincount(boxes, values) / np.bincount(boxes)

    def apart(x: Array, y: Array) -> Array:
        return np.hypot(x[:, None] - x, y[:, None] - y)

    length, components = currents["error_length"] or _ERROR_LENGTH, BOTH_COMPONENTS
    std = np.empty(size.size)
    for box, count in enumerate(size):
        at = number == box
        error_std = currents["error_std"][at]
        std[box] = np.sqrt(error_std @ np.exp(-apart(x[at], y[at]) / length) @ error_std) / count
    std = np.maximum(std, _LEAST_ERROR)
    if currents["direction"] is not None:
        angle = np.deg2rad(currents["direction"])
        along = np.arctan2(np.sin(angle).mean(), np.cos(angle).mean())
        components = np.array([[np.sin(along), np.cos(along)]])
        std = np.hypot(std, _CURRENT * np.sqrt(mean(np.sin(angle - along) ** 2)))
    return LinearMeasurement(
        label.source.time_ns,
        None,
        mean(unwrap_longitude(currents["longitude"], currents["longitude"][0]), quarter),
        mean(currents["latitude"], quarter),
        np.full(weights.shape[1], currents["depth"]),
        weights,
        np.column_stack([mean(each) for each in currents["value"].T]),
        std,
        np.full(size.size, Flag.GOOD, np.int8),
        np.zeros(size.size, np.int32),
        label,
        float(common),
        components=components,
        correlation=np.exp(-apart(mean(x), mean(y)) / length),
    )


def _local(currents: Vectors) -> tuple[Array, Array]:
    middle = Projection(float(currents["longitude"][0]), float(currents["latitude"][0]))
    return to_local(middle, currents["longitude"], currents["latitude"])


def _width(currents: Vectors, spacing: float, most: int) -> float:
    """Return the width of boxes [m], at least ``spacing``, for at most ``most`` boxes."""
    x, y = _local(currents)
    spacing = max(spacing, _LEAST_SPACING)
    while _boxes(x, y, spacing).max() >= most:
        spacing *= 1.2
    return spacing


def _boxes(x: Array, y: Array, spacing: float) -> Indices:
    """Return the index of each position's box, shape (n,), from 0 without gaps."""
    east, north = (np.floor((each - each.min()) / spacing).astype(np.int64) for each in (x, y))
    # as one number each: rows are ten times slower to compare
    return np.unique(east * (north.max() + 1) + north, return_inverse=True)[1]
