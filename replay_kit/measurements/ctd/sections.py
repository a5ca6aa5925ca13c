"""Profiles of temperature and salinity along a line, as anomalies of specific volume on common levels (TEOS-10)."""

from collections.abc import Sequence
from dataclasses import dataclass

import gsw
import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.errors import MeasurementError
from replay_kit.core.geodesy import to_local
from replay_kit.core.grid import Projection

#: Reference density [kg/m3] and gravity [m/s2] of the hydrostatic integral.
RHO0, GRAVITY = 1025.0, 9.81
# A level counts where this share of the profiles reaches it, a profile where it has this share of the levels.
_REACHED = 0.6
_LEAST_PROFILES, _LEAST_LEVELS = 4, 3
# Smallest squared buoyancy frequency [1/s2]; a mixed layer has none, and internal waves are scaled by it.
_LEAST_N2 = 1e-6
# An end-to-end distance below this share of the way is no line.
_STRAIGHT = 0.9
# Levels over which the mean stratification is smoothed.
_SMOOTHED = 5
_S_PER_NS = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """Temperature and salinity of one half of a dive, or of a cast.

    Attributes:
        time_ns: shape (n,) [ns, UTC].
        longitude: shape (n,) [degrees].
        latitude: shape (n,) [degrees].
        depth: shape (n,) [m], positive down.
        temperature: shape (n,), in situ [degrees C, ITS-90]; NaN where missing.
        salinity: shape (n,), practical; NaN where missing.
    """

    time_ns: NDArray[np.int64]
    longitude: Array
    latitude: Array
    depth: Array
    temperature: Array
    salinity: Array


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """Anomalies of specific volume along a straight line.

    Attributes:
        levels: shape (Z,) [m], positive down.
        along: shape (n,) [m], of each profile along the line from their mean.
        time: shape (n,) [s], of each profile from their mean.
        anomaly: shape (n, Z) [m3/kg], specific volume minus its mean over the profiles at the level, moved to the profile's place.
        n2: shape (Z,) [1/s2], squared buoyancy frequency of the mean profile.
        latitude: [degrees].
        longitude: [degrees], of the middle.
        time_ns: Of the middle [ns, UTC].
        direction: Of the line, counter-clockwise from east [rad].
    """

    levels: Array
    along: Array
    time: Array
    anomaly: Array
    n2: Array
    latitude: float
    longitude: float
    time_ns: int
    direction: float

    @property
    def is_mixed(self) -> bool:
        """Whether no level is stratified."""
        return bool(self.n2.max() <= _LEAST_N2)

    @property
    def coriolis(self) -> float:
        """Coriolis parameter [1/s]; negative in the south."""
        return float(gsw.f(self.latitude))


def section_of(profiles: Sequence[Profile], spacing: float = 10.0) -> Section:
    """Return profiles as a section: on common levels, without extrapolation, and with the slant of a glider's way taken out.

    Anomalies of samples beside their profile's mean place are moved to it by the slope of their level along the line, in two passes.

    Args:
        profiles: In the order of the way.
        spacing: Between levels [m].

    Raises:
        MeasurementError: There are too few profiles, they do not lie along a line, or they share too few levels.
    """
    if len(profiles) < _LEAST_PROFILES:
        raise MeasurementError(
            f"section: expected at least {_LEAST_PROFILES} profiles, got {len(profiles)}"
        )
    projection = Projection(
        float(np.mean([each.longitude.mean() for each in profiles])),
        float(np.mean([each.latitude.mean() for each in profiles])),
    )
    local = [np.array(to_local(projection, each.longitude, each.latitude)) for each in profiles]
    places = np.array([each.mean(axis=1) for each in local])
    unit = _direction_of(places)
    along = places @ unit
    levels, offset, volume, absolute, conservative = _on_levels(profiles, local, unit, spacing)
    if levels.size < _LEAST_LEVELS:
        raise MeasurementError(
            f"section: expected profiles with temperature and salinity at {_LEAST_LEVELS} levels or more that most of them reach, got "
            f"{levels.size}"
        )
    kept = np.isfinite(volume).mean(axis=1) >= _REACHED
    if kept.sum() < _LEAST_PROFILES:
        raise MeasurementError(
            f"section: expected at least {_LEAST_PROFILES} profiles that reach most levels, got {int(kept.sum())}"
        )
    time_ns = np.array([int(each.time_ns.mean()) for each in profiles])[kept]
    middle_ns = int(time_ns.mean())
    along, latitude = along[kept], projection.latitude
    return Section(
        levels,
        along - along.mean(),
        (time_ns - middle_ns) * _S_PER_NS,
        level_anomalies(volume[kept], offset[kept], along),
        _stratification(absolute[kept], conservative[kept], levels, latitude),
        latitude,
        projection.longitude,
        middle_ns,
        float(np.arctan2(unit[1], unit[0])),
    )


def level_anomalies(volume: Array, offset: Array, along: Array) -> Array:
    """Return anomalies of specific volume at the places of the profiles, shape (n, Z); what is missing is filled along the level.

    A missing value is the level's straight line plus the residual of the nearest level that the profile has.

    Args:
        volume: shape (n, Z) [m3/kg]; NaN where missing.
        offset: shape (n, Z) [m], of the sample along the line from its profile's place.
        along: shape (n,) [m].
    """
    anomaly, offset = volume - np.nanmean(volume, axis=0), np.nan_to_num(offset)
    slope = np.zeros(anomaly.shape[1])
    for _ in range(2):
        slope, mean = _lines(anomaly - offset * slope, along)
    moved, fitted = anomaly - offset * slope, mean + (along - along.mean())[:, None] * slope
    residual = moved - fitted
    for i, row in enumerate(residual):
        known = np.flatnonzero(np.isfinite(row))
        missing = np.flatnonzero(~np.isfinite(row))
        nearest = known[np.abs(known[None, :] - missing[:, None]).argmin(axis=1)]
        moved[i, missing] = fitted[i, missing] + row[nearest]
    return np.asarray(moved - moved.mean(axis=0))


def _lines(values: Array, along: Array) -> tuple[Array, Array]:
    """Return the least-squares slope and the value at the middle of each level, shapes (Z,); NaN are left out."""
    known = np.isfinite(values)
    span = np.where(known, (along - along.mean())[:, None], 0.0)
    filled, count = np.where(known, values, 0.0), known.sum(axis=0)
    mean_span, mean = span.sum(axis=0) / count, filled.sum(axis=0) / count
    centred = np.where(known, span - mean_span, 0.0)
    slope = (centred * filled).sum(axis=0) / (centred**2).sum(axis=0)
    return slope, mean - slope * mean_span


def _direction_of(places: Array) -> Array:
    """Return the unit vector of the line through places, shape (2,), which points from the first to the last.

    Raises:
        MeasurementError: The way is not straight.
    """
    steps = np.hypot(*np.diff(places, axis=0).T).sum()
    net = places[-1] - places[0]
    if not steps > 0.0 or np.hypot(*net) < _STRAIGHT * steps:
        raise MeasurementError(
            f"section: expected a straight line, got one of {np.hypot(*net) / 1e3:.1f} km from end to end over a way of "
            f"{steps / 1e3:.1f} km; split the way where it turns"
        )
    return np.asarray(net / np.hypot(*net))


def _on_levels(
    profiles: Sequence[Profile], local: Sequence[Array], unit: Array, spacing: float
) -> tuple[Array, Array, Array, Array, Array]:
    """Return levels, and by profile and level the offset along the line, specific volume, absolute salinity, conservative temperature."""
    bounds = np.array([[np.nanmin(each.depth), np.nanmax(each.depth)] for each in profiles])
    first = np.ceil(bounds[:, 0].min() / spacing) * spacing
    levels = np.arange(first, bounds[:, 1].max() + 1e-9, spacing)
    rows = []
    for each, place in zip(profiles, local, strict=True):
        pressure = gsw.p_from_z(-each.depth, each.latitude)
        salinity = gsw.SA_from_SP(each.salinity, pressure, each.longitude, each.latitude)
        temperature = gsw.CT_from_t(salinity, each.temperature, pressure)
        good = np.isfinite(salinity) & np.isfinite(temperature) & np.isfinite(each.depth)
        order = np.flatnonzero(good)[np.argsort(each.depth[good], kind="stable")].astype(np.int64)
        way = unit @ (place - place.mean(axis=1, keepdims=True))

        def at(values: Array, order: NDArray[np.int64] = order, depth: Array = each.depth) -> Array:
            if order.size < 2:
                return np.full(levels.size, np.nan)
            return np.asarray(
                np.interp(levels, depth[order], values[order], left=np.nan, right=np.nan)
            )

        sa, ct = at(salinity), at(temperature)
        level_pressure = gsw.p_from_z(-levels, float(np.mean(each.latitude)))
        rows.append((at(way), gsw.specvol(sa, ct, level_pressure), sa, ct))
    offset, volume, absolute, conservative = (np.array(part) for part in zip(*rows, strict=True))
    reached = np.isfinite(volume).mean(axis=0) >= _REACHED
    return (
        levels[reached],
        offset[:, reached],
        volume[:, reached],
        absolute[:, reached],
        conservative[:, reached],
    )


def _stratification(absolute: Array, conservative: Array, levels: Array, latitude: float) -> Array:
    """Return the squared buoyancy frequency of the mean profile, smoothed over five levels, shape (Z,) [1/s2]."""
    pressure = gsw.p_from_z(-levels, latitude)
    n2, middle = gsw.Nsquared(
        np.nanmean(absolute, axis=0), np.nanmean(conservative, axis=0), pressure, latitude
    )
    on_levels = np.interp(pressure, middle, n2)
    padded = np.pad(on_levels, _SMOOTHED // 2, mode="edge")
    smooth = np.convolve(padded, np.full(_SMOOTHED, 1.0 / _SMOOTHED), mode="valid")
    return np.asarray(np.maximum(smooth, _LEAST_N2))
