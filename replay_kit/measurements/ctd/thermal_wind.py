"""Geostrophic current across a line of profiles relative to its depth mean, with its error (thermal wind).

The slope of the geopotential along the line, by generalised least squares, gives the current across it. The error includes internal waves
and tides, curvature and change of the signal, ageostrophic and unresolved currents; it is large for a short line.
"""

from typing import NamedTuple

import numpy as np
from scipy.integrate import cumulative_trapezoid

from replay_kit.core.arrays import Array, Indices
from replay_kit.measurements.ctd.noise import (
    Statistics,
    fit,
    garrett_munk,
    near,
    rossby_radius,
    trend_of,
)
from replay_kit.measurements.ctd.sections import GRAVITY, RHO0, Section

#: Degrees from the equator, within which there is no geostrophic balance to use.
EQUATOR = 5.0
# Least share of the shear that is not geostrophic, and the error that always stays [m/s].
_AGEOSTROPHIC, _FLOOR = 0.05, 0.003
# Drift of a conductivity cell over a window, as salinity; and haline contraction of sea water.
_SALINITY_DRIFT, _HALINE_CONTRACTION = 0.002, 7.6e-4
# Speed of the signal in units of the region's, which counts as one further line; and lengths of a line that count as one.
_REGIONAL, _LINE = 0.25, 2.5


class GeostrophicShear(NamedTuple):
    """Current across a line relative to its mean over the levels, at one position and time.

    Attributes:
        levels: shape (Z,) [m], positive down.
        velocity: shape (Z,) [m/s], to the left of the line, minus its mean over the levels.
        covariance: shape (Z, Z) [m2/s2], error covariance.
        along: Position of the current on the line [m].
        direction: Direction of positive velocity, counter-clockwise from east [rad].
    """

    levels: Array
    velocity: Array
    covariance: Array
    along: float
    direction: float

    @property
    def standard_error(self) -> Array:
        """Standard error of the velocity, shape (Z,) [m/s]."""
        return np.sqrt(np.diag(self.covariance))


def radius_of(section: Section) -> float:
    """Return the first baroclinic Rossby radius of a line's region [m]."""
    return rossby_radius(section.levels, section.n2, section.coriolis)


def geopotential_matrix(levels: Array) -> Array:
    """Return the matrix from specific volume anomalies to geopotential without its depth mean, shape (Z, Z) [m2/s2 per m3/kg].

    Row z integrates from level z to the last one by the trapezoidal rule, which also gives the depth mean.
    """
    above = RHO0 * GRAVITY * cumulative_trapezoid(np.eye(levels.size), levels, initial=0.0).T
    integral = above[-1] - above
    return np.asarray(integral - depth_weights(levels) @ integral)


def depth_weights(levels: Array) -> Array:
    """Return the weights of the mean over levels by the trapezoidal rule, shape (Z,), which sum to 1."""
    return np.asarray(np.trapezoid(np.eye(levels.size), levels) / np.ptp(levels))


def slope_weights(along: Array, covariance: Array) -> Array:
    """Return the weights of the generalised least-squares slope, shape (n,) [1/m], for an error covariance, shape (n, n)."""
    trend = trend_of(along)
    solved = np.linalg.solve(covariance, trend)
    return np.asarray(np.linalg.solve(trend.T @ solved, solved.T)[1])


def place_of(along: Array, weights: Array) -> float:
    """Return the effective position of a slope on the line: the centre of the kernel of its weights [m]."""
    order = np.argsort(along, kind="stable")
    lengths, middles = np.diff(along[order]), 0.5 * (along[order][1:] + along[order][:-1])
    kernel = -np.cumsum(weights[order])[:-1] * lengths
    return float((kernel * middles).sum() / kernel.sum())


def shear_of(section: Section, speed: float, part: Indices) -> GeostrophicShear:
    """Return the shear of some profiles of a line at the time of the last one.

    Args:
        section: Line that provides the statistics.
        speed: RMS speed of the region's currents over the levels [m/s], for example of an ensemble.
        part: Indices of the profiles.
    """
    levels, f, radius = section.levels, section.coriolis, radius_of(section)
    to_geopotential = geopotential_matrix(levels)
    geopotential = section.anomaly @ to_geopotential.T
    waves = garrett_munk(levels, section.n2, to_geopotential)
    fitted, along = fit(section, geopotential, waves, radius, speed), section.along[part]
    noise = fitted.noise[:, part[:, None], part]
    weights = slope_weights(along, noise.sum(axis=0))
    at, velocity = place_of(along, weights), weights @ geopotential[part] / f
    found = float(np.sqrt(np.mean(velocity**2)))
    # one line knows its own slope alone: the size of the signal is blended from the shear found on it and the region's speed
    lines = max(0.5, np.ptp(section.along) / (_LINE * fitted.lengths.mean()))
    size = (lines * found**2 + (_REGIONAL * speed) ** 2) / (lines + 1.0)
    variance = noise @ weights @ weights + size * _curvature(section, fitted, part, weights, at)
    modes = fitted.modes / f
    beside = max(_AGEOSTROPHIC, float(np.hypot(found, speed)) / (abs(f) * 1.6 * radius)) * velocity
    # what a drift of the salinity by its standard error changes of the geopotential
    drift = _HALINE_CONTRACTION * _SALINITY_DRIFT / (RHO0 * float(np.ptp(along)) * f)
    drifted = to_geopotential.sum(axis=1) * drift
    unresolved = fitted.outside * float(weights @ weights) / f**2 + _FLOOR**2
    covariance = (
        modes * variance @ modes.T
        + np.outer(beside, beside)
        + np.outer(drifted, drifted)
        + unresolved * np.eye(levels.size)
    )
    return GeostrophicShear(levels, velocity, covariance, at, section.direction + 0.5 * np.pi)


def _curvature(
    section: Section, fitted: Statistics, part: Indices, weights: Array, at: float
) -> Array:
    """Return the variance by mode of the profiles' slope minus that at a position and the last time, shape (k,) [1/s4].

    In units of the mean square of the signal's shear [m2/s2].
    """
    away, later = section.along[part] - at, section.time[part] - section.time[part].max()
    seen = []
    for length, lasting in zip(fitted.lengths, fitted.lasting, strict=True):
        pairs = near(away[:, None] - away, later[:, None] - later, length, lasting)
        both = weights @ (away / length**2 * near(away, later, length, lasting))
        seen.append(weights @ pairs @ weights - 2.0 * both + 1.0 / length**2)
    # modes are orthonormal over the levels: of a level it is the mean
    mean_square = fitted.signal.sum(axis=1) @ fitted.lengths**-2.0 / section.levels.size
    return np.asarray(seen @ fitted.signal * section.coriolis**2 / mean_square)
