"""The geostrophic current across a line of profiles relative to its depth mean, with what it can be wrong by (thermal wind).

The slope of the geopotential along the line, by generalised least squares, gives the current across it. The error has internal waves and
tides, curvature and change of the signal within the line, what is not geostrophic, and what is not resolved; a short line states a large
error.
"""

from dataclasses import dataclass

import numpy as np

from replay_kit.core.arrays import Array, Indices
from replay_kit.core.errors import MeasurementError
from replay_kit.measurements.ctd.noise import Statistics, fit, garrett_munk, near, rossby_radius
from replay_kit.measurements.ctd.sections import GRAVITY, RHO0, Section

#: Degrees from the equator, within which there is no geostrophic balance to use.
EQUATOR = 5.0
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
        return np.sqrt(np.diag(self.covariance))


@dataclass(frozen=True, slots=True, eq=False)
class FittedLine:
    """A line with its statistics, of which windows give the shear.

    Attributes:
        section: The line.
        geopotential: shape (n, Z) [m2/s2], of each profile, without its depth mean.
        statistics: Of waves and signal.
        radius: First baroclinic Rossby radius [m].
        speed: Rms speed of the region's currents over the levels [m/s].
    """

    section: Section
    geopotential: Array
    statistics: Statistics
    radius: float
    speed: float


def radius_of(section: Section) -> float:
    """Return the first baroclinic Rossby radius of a line's region [m].

    Raises:
        MeasurementError: The line is too near the equator.
    """
    if abs(section.latitude) < EQUATOR:
        raise MeasurementError(
            f"geostrophic shear: expected a latitude of at least {EQUATOR:g} degrees, got {section.latitude:.2f}"
        )
    return rossby_radius(section.levels, section.n2, section.coriolis, _BOTTOM)


def fitted_line(section: Section, speed: float) -> FittedLine:
    """Return a line with its statistics.

    Args:
        section: The line.
        speed: Rms speed of the region's currents over the levels [m/s], such as of an ensemble.

    Raises:
        MeasurementError: The line is too near the equator.
    """
    radius, to_geopotential = radius_of(section), geopotential_matrix(section.levels)
    values = section.anomaly @ to_geopotential.T
    waves = garrett_munk(section.levels, section.n2, to_geopotential)
    fitted = fit(section, values, waves, radius, speed)
    return FittedLine(section, values, fitted, radius, speed)


def geopotential_matrix(levels: Array) -> Array:
    """Return what takes anomalies of specific volume to geopotential without its depth mean, shape (Z, Z) [m2/s2 per m3/kg].

    Row z integrates from level z down to the last one by the trapezoidal rule; the mean over the levels is that of the same rule.
    """
    half = 0.5 * RHO0 * GRAVITY * np.diff(levels)
    integral = np.triu(np.append(half, 0.0) + np.append(0.0, half))
    np.fill_diagonal(integral, np.append(half, 0.0))
    return np.asarray(integral - depth_weights(levels) @ integral)


def depth_weights(levels: Array) -> Array:
    """Return the weights of the mean over levels by the trapezoidal rule, shape (Z,), which sum to 1."""
    spaces = np.diff(levels)
    weights = np.append(spaces, 0.0) + np.append(0.0, spaces)
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


def window_shear(line: FittedLine, part: Indices) -> GeostrophicShear:
    """Return the shear of some profiles of a line at the time of the last of them.

    Args:
        line: With its statistics.
        part: Numbers of the profiles.
    """
    section, fitted = line.section, line.statistics
    along, f = section.along[part], section.coriolis
    of_modes = fitted.noise[:, part[:, None], part]
    weights = slope_weights(along, of_modes.sum(axis=0))
    at = place_of(along, weights)
    velocity = weights @ line.geopotential[part] / f
    variance = np.einsum("i,kij,j->k", weights, of_modes, weights)
    variance = variance + _curvature(line, part, weights, at, _rms(velocity))
    modes = fitted.modes / f
    rossby = float(np.hypot(_rms(velocity), line.speed)) / (abs(f) * 1.6 * line.radius)
    beside = max(_AGEOSTROPHIC, rossby) * velocity
    # what a drift of the salinity by its standard error changes of the geopotential
    volume = np.full(section.levels.size, _HALINE_CONTRACTION * _SALINITY_DRIFT / RHO0)
    drifted = geopotential_matrix(section.levels) @ volume / (float(np.ptp(along)) * f)
    unresolved = fitted.outside * float(weights @ weights) / f**2 + _FLOOR**2
    covariance = (
        modes * variance @ modes.T
        + np.outer(beside, beside)
        + np.outer(drifted, drifted)
        + unresolved * np.eye(section.levels.size)
    )
    direction = section.direction + 0.5 * np.pi
    return GeostrophicShear(section.levels, velocity, covariance, at, direction)


def _curvature(line: FittedLine, part: Indices, weights: Array, at: float, found: float) -> Array:
    """Return by mode the variance of the slope seen by profiles minus that at a place at the last one's time, shape (k,) [1/s4].

    One line knows its own slope alone: the size of the signal is blended from the shear ``found`` on it [m/s] and the region's speed.
    """
    section, signal = line.section, line.statistics.signal
    along, time = section.along[part], section.time[part] - section.time[part].max()
    # modes are orthonormal over the levels: of a level it is the mean
    slopes = sum(float(amplitude.sum()) / length**2 for length, _, amplitude in signal)
    fitted_size = slopes / section.coriolis**2 / section.levels.size
    lines = np.ptp(section.along) / (_LINE * np.mean([length for length, _, _ in signal]))
    known = max(0.5, lines)
    blended = (known * found**2 + (_REGIONAL * line.speed) ** 2) / (known + 1.0)
    total = np.zeros(signal[0][2].size)
    for length, lasting, amplitude in signal:
        seen = near(along[:, None] - along, time[:, None] - time, length, lasting)
        both = weights @ ((along - at) / length**2 * near(along - at, time, length, lasting))
        total += amplitude * (weights @ seen @ weights - 2.0 * both + 1.0 / length**2)
    return total * (blended / fitted_size)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
