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
from replay_kit.measurements.section import noise
from replay_kit.measurements.section.hydrography import GRAVITY, RHO0, Section
from replay_kit.measurements.section.noise import Statistics

# Degrees from the equator, within which there is no geostrophic balance to use.
_EQUATOR = 5.0
_LEAST_PROFILES, _MOST_WINDOWS = 4, 8
# Depth of the water where it is not known [m].
_BOTTOM = 4000.0
# Least share of the shear that is not geostrophic, and the error that always stays [m/s].
_AGEOSTROPHIC, _FLOOR = 0.05, 0.003
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
        time_ns: [ns, UTC].
        profiles: How many it comes from.
        baseline: From the first of them to the last [m].
        rossby_radius: First baroclinic [m].
    """

    levels: Array
    velocity: Array
    covariance: Array
    along: float
    direction: float
    time_ns: int
    profiles: int
    baseline: float
    rossby_radius: float

    @property
    def standard_error(self) -> Array:
        """Shape (Z,) [m/s]."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


def geostrophic_shear(
    section: Section, speed: float, bottom: float | None = None
) -> tuple[GeostrophicShear, ...]:
    """Return the geostrophic shear of a line, in as many windows of it as leave the least expected error.

    Args:
        section: The line.
        speed: Rms speed of the region's currents over the levels [m/s], such as of an ensemble.
        bottom: Depth of the water [m]; None for 4000 m.

    Raises:
        MeasurementError: The line is too near the equator, or has too few profiles.
    """
    if abs(section.latitude) < _EQUATOR:
        raise MeasurementError(
            f"geostrophic shear: expected a latitude of at least {_EQUATOR:g} degrees, got {section.latitude:.2f}"
        )
    n = section.along.size
    if n < _LEAST_PROFILES:
        raise MeasurementError(
            f"geostrophic shear: expected at least {_LEAST_PROFILES} profiles, got {n}"
        )
    to_geopotential = geopotential_matrix(section.levels)
    values = section.anomaly @ to_geopotential.T
    radius = noise.rossby_radius(
        section.levels, section.n2, section.coriolis, _BOTTOM if bottom is None else bottom
    )
    fitted = noise.fit(
        values,
        section.along,
        section.time,
        noise.garrett_munk(section.levels, section.n2, to_geopotential),
        section.coriolis,
        radius,
        speed,
    )
    candidates = [
        _windows(section, values, fitted, radius, speed, count)
        for count in range(1, min(_MOST_WINDOWS, n // _LEAST_PROFILES) + 1)
    ]
    best = min(candidates, key=lambda found: float(np.mean([error for _, error in found])))
    return tuple(shear for shear, _ in best)


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


def _windows(
    section: Section,
    values: Array,
    fitted: Statistics,
    radius: float,
    speed: float,
    count: int,
) -> list[tuple[GeostrophicShear, float]]:
    """Return the shear of each of some windows of equal numbers of profiles, with its expected variance."""
    parts = np.array_split(np.argsort(section.along, kind="stable"), count)
    return [_shear(section, values, fitted, radius, speed, part) for part in parts]


def _shear(
    section: Section,
    values: Array,
    fitted: Statistics,
    radius: float,
    speed: float,
    part: NDArray[np.int64],
) -> tuple[GeostrophicShear, float]:
    along, time, f = section.along[part], section.time[part], section.coriolis
    of_modes = fitted.noise[:, part[:, None], part]
    weights = slope_weights(along, of_modes.sum(axis=0))
    at, now = place_of(along, weights), float(time.mean())
    velocity = weights @ values[part] / f
    variance = np.einsum("i,kij,j->k", weights, of_modes, weights)
    velocities = _rms(velocity), speed
    variance = variance + _curvature(fitted, section, along, time - now, weights, at, velocities)
    modes = fitted.modes / f
    beside = (
        max(_AGEOSTROPHIC, float(np.hypot(_rms(velocity), speed)) / (abs(f) * 1.6 * radius))
        * velocity
    )
    unresolved = fitted.outside * float(weights @ weights) / f**2 + _FLOOR**2
    covariance = (
        modes * variance @ modes.T
        + np.outer(beside, beside)
        + unresolved * np.eye(section.levels.size)
    )
    return (
        GeostrophicShear(
            section.levels,
            velocity,
            covariance,
            at,
            section.direction + 0.5 * np.pi,
            section.time_ns + int(now * 1e9),
            part.size,
            float(along.max() - along.min()),
            radius,
        ),
        float(variance.sum()) / f**2,
    )


def _curvature(
    fitted: Statistics,
    section: Section,
    along: Array,
    time: Array,
    weights: Array,
    at: float,
    velocities: tuple[float, float],
) -> Array:
    """Return by mode the variance of the slope seen by the weights minus the slope at their place and time, shape (k,) [1/s4].

    One line knows its own slope alone: the size of the signal is blended from the shear found on it and the speed of the region, both in
    ``velocities`` [m/s].
    """
    f, amplitudes = section.coriolis, np.array([kernel.amplitude for kernel in fitted.kernels])
    lengths = np.array([kernel.length for kernel in fitted.kernels])
    # modes are orthonormal over the levels: of a level it is the mean
    fitted_size = float((amplitudes / lengths[:, None] ** 2).sum()) / f**2 / section.levels.size
    line = float(section.along.max() - section.along.min())
    known = max(0.5, line / (_LINE * float(lengths.mean())))
    found, speed = velocities
    blended = (known * found**2 + (_REGIONAL * speed) ** 2) / (known + 1.0)
    total = np.zeros(amplitudes.shape[1])
    for kernel, amplitude in zip(fitted.kernels, amplitudes, strict=True):
        seen = weights @ kernel.covariance(along, time) @ weights
        both = weights @ kernel.with_slope(along, time, at)
        total += amplitude * (seen - 2.0 * both + 1.0 / kernel.length**2)
    return total * (blended / fitted_size)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
