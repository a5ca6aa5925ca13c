"""Profiles of temperature and salinity along a line as specific volume anomalies on common levels (TEOS-10)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import gsw
import numpy as np
from scipy.ndimage import uniform_filter1d

from replay_kit.core.arrays import Array, Times
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
# Levels over which the mean stratification is smoothed, and their spacing [m].
_SMOOTHED, _SPACING = 5, 10.0


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """Temperature and salinity of one cast.

    Attributes:
        time_ns: shape (n,) [ns, UTC].
        longitude: shape (n,) [degrees].
        latitude: shape (n,) [degrees].
        depth: shape (n,) [m], positive down.
        temperature: shape (n,), in situ [degrees C, ITS-90]; NaN where missing.
        salinity: shape (n,), practical; NaN where missing.
    """

    time_ns: Times
    longitude: Array
    latitude: Array
    depth: Array
    temperature: Array
    salinity: Array

    @property
    def water(self) -> Array:
        """Complete samples of depth, temperature and salinity, shape (3, k)."""
        values = np.array([self.depth, self.temperature, self.salinity])
        return values[:, np.isfinite(values).all(axis=0)]


class Section(NamedTuple):
    """Specific volume anomalies along a straight line.

    Attributes:
        levels: shape (Z,) [m], positive down.
        along: shape (n,) [m], position of each profile along the line from their mean.
        time: shape (n,) [s], time of each profile from their mean.
        anomaly: shape (n, Z) [m3/kg], specific volume minus its level mean, at the profile's position.
        n2: shape (Z,) [1/s2], squared buoyancy frequency of the mean profile.
        latitude: Middle of the line [degrees north].
        longitude: Middle of the line [degrees east].
        time_ns: Time of the middle [ns, UTC].
        direction: Direction of the line, counter-clockwise from east [rad].
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
        """Coriolis parameter [1/s]; negative in the southern hemisphere."""
        return float(gsw.f(self.latitude))


def section_of(profiles: Sequence[Profile]) -> Section | None:
    """Return profiles as a section on common levels, without extrapolation, corrected for the slant of casts.

    Anomalies are moved to their profile's mean position by the slope of their level along the line, in two passes. None if profiles are too
    few, not on a line, or share too few levels.

    Args:
        profiles: Profiles in the order of the track.
    """
    if len(profiles) < _LEAST_PROFILES:
        return None
    means = np.array([[profile.longitude.mean(), profile.latitude.mean()] for profile in profiles])
    longitude, latitude = means.mean(axis=0).tolist()
    projection = Projection(longitude, latitude)
    local = [
        np.array(to_local(projection, profile.longitude, profile.latitude)) for profile in profiles
    ]
    places = np.array([each.mean(axis=1) for each in local])
    way, net = np.hypot(*np.diff(places, axis=0).T).sum(), places[-1] - places[0]
    length = np.hypot(*net)
    if not length >= _STRAIGHT * way > 0.0:
        return None
    unit = net / length
    levels, values = _on_levels(profiles, [unit @ each for each in local])
    kept = np.isfinite(values[:, 1]).mean(axis=1) >= _REACHED if levels.size else []
    if levels.size < _LEAST_LEVELS or sum(kept) < _LEAST_PROFILES:
        return None
    offset, volume, absolute, conservative = values[kept].swapaxes(0, 1)
    time_ns = np.array([int(profile.time_ns.mean()) for profile in profiles])[kept]
    middle_ns, along = int(time_ns.mean()), (places @ unit)[kept]
    pressure = gsw.p_from_z(-levels, latitude)
    n2, middle = gsw.Nsquared(
        np.nanmean(absolute, axis=0), np.nanmean(conservative, axis=0), pressure, latitude
    )
    smooth = uniform_filter1d(np.interp(pressure, middle, n2), _SMOOTHED, mode="nearest")
    return Section(
        levels,
        along - along.mean(),
        (time_ns - middle_ns) * 1e-9,
        level_anomalies(volume, offset, along),
        np.maximum(smooth, _LEAST_N2),
        latitude,
        longitude,
        middle_ns,
        float(np.arctan2(unit[1], unit[0])),
    )


def level_anomalies(volume: Array, offset: Array, along: Array) -> Array:
    """Return specific volume anomalies at the profiles' positions, shape (n, Z); gaps are filled along the level.

    A missing value is the level's linear trend plus the residual of the nearest level of the profile.

    Args:
        volume: shape (n, Z) [m3/kg]; NaN where missing.
        offset: shape (n, Z) [m], offset of the sample along the line from its profile's position.
        along: shape (n,) [m], position of each profile.
    """
    anomaly, offset = volume - np.nanmean(volume, axis=0), np.nan_to_num(offset)
    centred, moved = along[:, None] - along.mean(), anomaly
    for _ in range(2):
        # the least-squares line of each level
        span = np.where(np.isfinite(moved), centred, np.nan)
        middle, mean = np.nanmean(span, axis=0), np.nanmean(moved, axis=0)
        apart = span - middle
        slope = np.nansum(apart * moved, axis=0) / np.nansum(apart**2, axis=0)
        fitted = mean + (centred - middle) * slope
        moved = anomaly - offset * slope
    residual = moved - fitted
    for values, line, row in zip(moved, fitted, residual, strict=True):
        known, missing = np.flatnonzero(np.isfinite(row)), np.flatnonzero(np.isnan(row))
        nearest = known[np.abs(known - missing[:, None]).argmin(axis=1)]
        values[missing] = line[missing] + row[nearest]
    return np.asarray(moved - moved.mean(axis=0))


def at_levels(levels: Array, depth: Array, *values: Array) -> Array:
    """Return values at levels from values at depths in any order, shape (v, Z); NaN outside the depths."""
    order = np.argsort(depth, kind="stable")
    return np.array(
        [np.interp(levels, depth[order], each[order], np.nan, np.nan) for each in values]
    )


def _on_levels(profiles: Sequence[Profile], along: Sequence[Array]) -> tuple[Array, Array]:
    """Return levels, and each profile's offset along the line, specific volume, absolute salinity and conservative temperature on them.

    Args:
        profiles: At least one profile.
        along: Positions of each profile's samples along the line [m].
    """
    depths = np.concatenate([profile.depth for profile in profiles])
    first = np.ceil(np.nanmin(depths) / _SPACING) * _SPACING
    levels = np.arange(first, np.nanmax(depths) + 1e-9, _SPACING)
    found = np.full((len(profiles), 4, levels.size), np.nan)
    for profile, way, rows in zip(profiles, along, found, strict=True):
        pressure = gsw.p_from_z(-profile.depth, profile.latitude)
        salinity = gsw.SA_from_SP(profile.salinity, pressure, profile.longitude, profile.latitude)
        temperature = gsw.CT_from_t(salinity, profile.temperature, pressure)
        samples = np.array([profile.depth, way - way.mean(), salinity, temperature])
        depth, *values = samples[:, np.isfinite(samples).all(axis=0)]
        if depth.size >= 2:
            rows[[0, 2, 3]] = at_levels(levels, depth, *values)
            level_pressure = gsw.p_from_z(-levels, float(np.mean(profile.latitude)))
            rows[1] = gsw.specvol(rows[2], rows[3], level_pressure)
    reached = np.isfinite(found[:, 1]).mean(axis=0) >= _REACHED
    return levels[reached], found[..., reached]
