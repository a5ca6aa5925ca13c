"""The geostrophic current across a line of profiles relative to its depth mean, with what it can be wrong by (thermal wind).

The slope of the geopotential along the line, by generalised least squares, gives the current across it. The error has internal waves and
tides, curvature and change of the signal within the line, what is not geostrophic, and what is not resolved; a short line states a large
error.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.errors import MeasurementError
from replay_kit.measurements.ctd.noise import (
    Regime,
    Statistics,
    fit,
    garrett_munk,
    rossby_radius,
)
from replay_kit.measurements.ctd.sections import GRAVITY, RHO0, Section

#: Degrees from the equator, within which there is no geostrophic balance to use.
EQUATOR = 5.0
_LEAST_PROFILES = 4
# Depth of the water, which is not known [m].
_BOTTOM = 4000.0
# Least share of the shear that is not geostrophic, and the error that always stays [m/s].
_AGEOSTROPHIC, _FLOOR = 0.05, 0.003
# Drift of a conductivity cell over a window, as salinity; and haline contraction of sea water.
_SALINITY_DRIFT, _HALINE_CONTRACTION = 0.002, 7.6e-4
# Speed of the signal in units of the region's, which counts as one further line; and lengths of a line that count as one.
_REGIONAL, _LINE = 0.25, 2.5


@dataclass(frozen=True, slots=True, eq=False)
class GeostrophicShear:
    """The current across a line relative to its mean over the levels, at one place and time.

    Attributes:
        levels: shape (Z,) [m], positive down.
        velocity: shape (Z,) [m/s], to the left of the line, minus its mean over the levels.
        covariance: shape (Z, Z) [m2/s2], of its error.
        along: Place of the current on the line [m].
        direction: In which it flows where it is positive, counter-clockwise from east [rad].
    """

    levels: Array
    velocity: Array
    covariance: Array
    along: float
    direction: float

    @property
    def standard_error(self) -> Array:
        """Shape (Z,) [m/s]."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


@dataclass(frozen=True, slots=True, eq=False)
class FittedLine:
    """A line with its statistics, of which windows give the shear.

    Attributes:
        section: The line.
        geopotential: shape (n, Z) [m2/s2], of each profile, without its depth mean.
        statistics: Of waves and signal.
        regime: Of the region.
    """

    section: Section
    geopotential: Array
    statistics: Statistics
    regime: Regime


def regime_of(section: Section, speed: float) -> Regime:
    """Return the scales of a line's region.

    Args:
        section: The line.
        speed: Rms speed of the region's currents over the levels [m/s], such as of an ensemble.

    Raises:
        MeasurementError: The line is too near the equator.
    """
    if abs(section.latitude) < EQUATOR:
        raise MeasurementError(
            f"geostrophic shear: expected a latitude of at least {EQUATOR:g} degrees, got {section.latitude:.2f}"
        )
    radius = rossby_radius(section.levels, section.n2, section.coriolis, _BOTTOM)
    return Regime(section.coriolis, radius, speed)


def fitted_line(section: Section, speed: float) -> FittedLine:
    """Return a line with its statistics; the arguments are those of ``regime_of``.

    Raises:
        MeasurementError: The line is too near the equator, or has too few profiles.
    """
    regime, n = regime_of(section, speed), section.along.size
    if n < _LEAST_PROFILES:
        raise MeasurementError(
            f"geostrophic shear: expected at least {_LEAST_PROFILES} profiles, got {n}"
        )
    to_geopotential = geopotential_matrix(section.levels)
    values = section.anomaly @ to_geopotential.T
    waves = garrett_munk(section.levels, section.n2, to_geopotential)
    fitted = fit(values, section.along, section.time, waves, regime)
    return FittedLine(section, values, fitted, regime)


def geopotential_matrix(levels: Array) -> Array:
    """Return what takes anomalies of specific volume to geopotential without its depth mean, shape (Z, Z) [m2/s2 per m3/kg].

    Row z integrates from level z down to the last one by the trapezoidal rule; the mean over the levels is that of the same rule.
    """
    size = levels.size
    half = 0.5 * RHO0 * GRAVITY * np.diff(levels)
    integral = np.zeros((size, size))
    for k in range(size - 1):
        integral[: k + 1, k] += half[k]
        integral[: k + 1, k + 1] += half[k]
    return np.asarray(integral - depth_weights(levels) @ integral)


def depth_weights(levels: Array) -> Array:
    """Return the weights of the mean over levels by the trapezoidal rule, shape (Z,), which sum to 1."""
    spaces = np.diff(levels)
    weights = np.zeros(levels.size)
    weights[:-1] += 0.5 * spaces
    weights[1:] += 0.5 * spaces
    return np.asarray(weights / weights.sum())


def slope_weights(along: Array, covariance: Array) -> Array:
    """Return the weights, shape (n,) [1/m], that give the slope of values with errors of a covariance, shape (n, n)."""
    trend = np.stack([np.ones(along.size), along - along.mean()], axis=1)
    solved = np.linalg.solve(covariance, trend)
    return np.asarray(np.linalg.solve(trend.T @ solved, solved.T)[1])


def place_of(along: Array, weights: Array) -> float:
    """Return the place at which slope weights see the slope: the middle of their kernel along the line [m]."""
    order = np.argsort(along, kind="stable")
    lengths, middles = np.diff(along[order]), 0.5 * (along[order][1:] + along[order][:-1])
    kernel = -np.cumsum(weights[order])[:-1] * lengths
    return float((kernel * middles).sum() / kernel.sum())


def window_shear(line: FittedLine, part: NDArray[np.int64]) -> GeostrophicShear:
    """Return the shear of some profiles of a line at the time of the last of them.

    Args:
        line: With its statistics.
        part: Numbers of the profiles.
    """
    section, regime, fitted = line.section, line.regime, line.statistics
    along, f = section.along[part], regime.coriolis
    of_modes = fitted.noise[:, part[:, None], part]
    weights = slope_weights(along, of_modes.sum(axis=0))
    at = place_of(along, weights)
    velocity = weights @ line.geopotential[part] / f
    variance = np.einsum("i,kij,j->k", weights, of_modes, weights)
    variance = variance + _curvature(line, part, weights, at, _rms(velocity))
    modes = fitted.modes / f
    rossby = float(np.hypot(_rms(velocity), regime.speed)) / (abs(f) * 1.6 * regime.rossby_radius)
    beside = max(_AGEOSTROPHIC, rossby) * velocity
    drifted = _salinity_drift(section.levels) / (float(np.ptp(along)) * f)
    unresolved = fitted.outside * float(weights @ weights) / f**2 + _FLOOR**2
    covariance = (
        modes * variance @ modes.T
        + np.outer(beside, beside)
        + np.outer(drifted, drifted)
        + unresolved * np.eye(section.levels.size)
    )
    direction = section.direction + 0.5 * np.pi
    return GeostrophicShear(section.levels, velocity, covariance, at, direction)


def _salinity_drift(levels: Array) -> Array:
    """Return what a drift of the salinity by its standard error changes of the geopotential, shape (Z,) [m2/s2]."""
    volume = _HALINE_CONTRACTION * _SALINITY_DRIFT / RHO0
    return np.asarray(geopotential_matrix(levels) @ np.full(levels.size, volume))


def _curvature(
    line: FittedLine, part: NDArray[np.int64], weights: Array, at: float, found: float
) -> Array:
    """Return by mode the variance of the slope seen by profiles minus that at a place at the last one's time, shape (k,) [1/s4].

    One line knows its own slope alone: the size of the signal is blended from the shear ``found`` on it [m/s] and the region's speed.
    """
    section, fitted, regime = line.section, line.statistics, line.regime
    along, time = section.along[part], section.time[part] - section.time[part].max()
    amplitudes = np.array([kernel.amplitude for kernel in fitted.kernels])
    lengths = np.array([kernel.length for kernel in fitted.kernels])
    # modes are orthonormal over the levels: of a level it is the mean
    slopes = float((amplitudes / lengths[:, None] ** 2).sum())
    fitted_size = slopes / regime.coriolis**2 / section.levels.size
    length = float(section.along.max() - section.along.min())
    known = max(0.5, length / (_LINE * float(lengths.mean())))
    blended = (known * found**2 + (_REGIONAL * regime.speed) ** 2) / (known + 1.0)
    total = np.zeros(amplitudes.shape[1])
    for kernel, amplitude in zip(fitted.kernels, amplitudes, strict=True):
        seen = weights @ kernel.covariance(along, time) @ weights
        both = weights @ kernel.with_slope(along, time, at)
        total += amplitude * (seen - 2.0 * both + 1.0 / kernel.length**2)
    return total * (blended / fitted_size)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
