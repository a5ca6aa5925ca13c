"""Settings of the small models of dives, all averaged by the evidence of the dives before, and the mixtures that they answer."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from replay_kit.core.arrays import Array

_HOUR = 3600.0
# Factors of 2 and of 4 apart: a few dives do not resolve smaller steps. A velocity over ground holds the way through the water: a dive's
# course is like that of the last, or turned.
_TIME_SCALES = (6.0 * _HOUR, 24.0 * _HOUR, 96.0 * _HOUR)
_WHITES = (0.005, 0.01, 0.02, 0.04)
_FLIGHT_BIASES = (0.05, 0.5)
_CONSTANTS = (0.05, 0.15)
_GROUND_AMPLITUDES = (0.02, 0.04, 0.08, 0.16, 0.32)
_GROUND_CONSTANTS = (0.1, 0.3)
# The same for the flight model's bias alone: fewer, as they are passed through once for each dive that is left out.
_FLIGHT_AMPLITUDES, _FLIGHT_TIME_SCALES, FLIGHT_WHITES = (
    (0.01, 0.04, 0.16),
    (6.0 * _HOUR, 96.0 * _HOUR),
    (0.005, 0.015, 0.04),
)
_FLIGHT_SURFACE_SHARES = (0.0, 2.0)
# m/s; of a current beside the estimate, where there is one
_LOCAL_AMPLITUDES = (0.02, 0.04, 0.08, 0.16)
# s; the wind that drives the surface part changes as fast
_SURFACE_SCALE = 12.0 * _HOUR
#: Number of unknowns: a constant, a part that decorrelates, one trapped at the surface, each east and north; and the flight model's bias.
UNKNOWNS = 8
#: Positions of the flight model's bias among them: along the way through the water and across it.
FLIGHT_BIAS = slice(6, 8)


@dataclass(frozen=True, slots=True, eq=False)
class Settings:
    """Combinations of settings, each a model of its own.

    Attributes:
        white_std: shape (h,) [m/s], part of a mean current that no other one shares.
        variance: shape (h, 8), prior variances of the unknowns [m^2/s^2, and 1 of the flight bias].
        scales: shape (h, 8), their decorrelation times [s]; inf for constants.
        background: shape (h,), which background the current is measured about; 0 for none.
        log_prior: shape (h,), logarithm of the probability of each before the first dive.
    """

    white_std: Array
    variance: Array
    scales: Array
    background: NDArray[np.intp]
    log_prior: Array

    @property
    def size(self) -> int:
        """Number of combinations h."""
        return self.white_std.size

    @property
    def has_flight_bias(self) -> NDArray[np.bool_]:
        """Which combinations have an error of the flight model, shape (h,)."""
        return np.asarray(self.variance[:, FLIGHT_BIAS.start] > 0.0)


def ground_combinations(n_backgrounds: int = 0) -> Settings:
    """Return all combinations of settings of a mean velocity over ground, without a flight model and a part trapped at the surface.

    Args:
        n_backgrounds: Number of currents beside zero that a dive's velocity may be measured about; what is left is the way through the
            water.
    """
    return _of_axes(
        _GROUND_AMPLITUDES,
        _TIME_SCALES,
        _WHITES,
        (0.0,),
        (0.0,),
        _GROUND_CONSTANTS,
        range(n_backgrounds + 1),
    )


def flight_combinations() -> Settings:
    """Return combinations of settings of a mean current that tell whether the flight model errs; half of the probability has no error."""
    biases = (0.0, *_FLIGHT_BIASES)
    axes = (
        _FLIGHT_AMPLITUDES,
        _FLIGHT_TIME_SCALES,
        FLIGHT_WHITES,
        biases,
        _FLIGHT_SURFACE_SHARES,
        _CONSTANTS,
        (0,),
    )
    settings = _of_axes(*axes)
    return _half_without(settings, settings.has_flight_bias)


def local_combinations() -> Settings:
    """Return all combinations of settings of a current beside the estimate; half of the probability has none.

    Errors that no other dive shares are those that the estimate and the measurement state: whatever else changes from dive to dive is a
    current that decorrelates, as ellipses that leave it out would be too small.
    """
    settings = _of_axes(
        (0.0, *_LOCAL_AMPLITUDES), _TIME_SCALES, _WHITES[:1], (0.0,), (0.0,), (0.0,), (0,)
    )
    return _half_without(settings, settings.variance[:, 2] > 0.0)


def _half_without(settings: Settings, has: NDArray[np.bool_]) -> Settings:
    """Return settings of which those that have something, shape (h,), have half of the probability, evenly, and the others the rest."""
    return replace(settings, log_prior=np.log(np.where(has, 0.5 / np.sum(has), 0.5 / np.sum(~has))))


def _of_axes(*axes: Iterable[float]) -> Settings:
    amplitude, scale, white, bias, share, constant, background = np.array(
        list(product(*axes)), dtype=np.float64
    ).T
    surface = share * amplitude
    # the part across the way errs half as much
    std = np.column_stack(
        [constant, constant, amplitude, amplitude, surface, surface, bias, 0.5 * bias]
    )
    scales = np.full((scale.size, UNKNOWNS), np.inf)
    scales[:, 2:4] = scale[:, None]
    scales[:, 4:6] = _SURFACE_SCALE
    return Settings(
        white, std**2, scales, background.astype(np.intp), np.full(white.size, -np.log(white.size))
    )


# Points that stand for each Gaussian, on a spiral whose radii are quantiles.
_POINTS = 48
# Bins of the radii: each has some hundreds of the points of all combinations of settings.
_BINS = 1024
# Logarithm of the least weight of a Gaussian that moves a radius: thousands of them hold less than a millionth.
_LEAST_LOG_WEIGHT = -25.0
_ANGLES = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(_POINTS)
_SPIRAL = np.sqrt(-2.0 * np.log1p(-(np.arange(_POINTS) + 0.5) / _POINTS)) * np.array(
    [np.cos(_ANGLES), np.sin(_ANGLES)]
)


# Not slotted: the moments are computed once.
@dataclass(frozen=True, eq=False)
class Mixture:
    """Gaussians in the plane with weights.

    Attributes:
        log_weights: shape (n,); the weights sum to one.
        means: shape (2, n).
        covs: shape (2, 2, n).
    """

    log_weights: Array
    means: Array
    covs: Array

    @cached_property
    def mean(self) -> Array:
        """Mean of the mixture, shape (2,)."""
        return np.asarray(self.means @ np.exp(self.log_weights))

    @cached_property
    def cov(self) -> Array:
        """Covariance of the mixture, shape (2, 2)."""
        weights, about = np.exp(self.log_weights), self.means - self.mean[:, None]
        return np.asarray(self.covs @ weights + (weights * about) @ about.T)

    def log_density(self, value: Array) -> float:
        """Return the logarithm of the density at a value, shape (2,)."""
        densities = log_densities(value[:, None] - self.means, self.covs)
        return float(np.logaddexp.reduce(self.log_weights + densities))

    def holds(self, value: Array, shares: Sequence[float]) -> tuple[bool, ...]:
        """Return whether the ellipses that hold some shares of the weight, of ``mean`` and ``cov``, hold a value, shape (2,)."""
        off = np.hypot(*np.linalg.solve(np.linalg.cholesky(self.cov), value - self.mean))
        return tuple((off <= self.radii(shares)).tolist())

    def radii(self, shares: Sequence[float]) -> Array:
        """Return the radii, in standard deviations of ``cov``, within which the mixture has some shares of its weight, shape (k,).

        A mixture has heavier tails than the Gaussian of its moments, whose ellipses would hold other shares. Each Gaussian is replaced by
        points on a spiral (Vogel 1979, Mathematical Biosciences 44) whose radii are the quantiles of its own.

        Args:
            shares: Between 0 and 1.
        """
        kept = self.log_weights > _LEAST_LOG_WEIGHT
        whiten = np.linalg.inv(np.linalg.cholesky(self.cov))
        roots = whiten @ np.linalg.cholesky(np.moveaxis(self.covs[..., kept], -1, 0))
        (of_east, _), (both, of_north) = np.moveaxis(roots, 0, -1)[..., None]
        east, north = (whiten @ (self.means[:, kept] - self.mean[:, None]))[..., None]
        square = (east + of_east * _SPIRAL[0]) ** 2
        square += (north + both * _SPIRAL[0] + of_north * _SPIRAL[1]) ** 2
        weights = np.exp(self.log_weights[kept]) / _POINTS
        return weighted_quantiles(np.sqrt(square).ravel(), np.repeat(weights, _POINTS), shares)


def weighted_quantiles(values: Array, weights: Array, shares: Sequence[float]) -> Array:
    """Return the values up to which the sorted ones have some shares of the weight, interpolated between two of them, shape (k,).

    Only those of the bin in which a share is reached are sorted, with the last before it.

    Args:
        values: shape (n,), at least 0, not all 0.
        weights: shape (n,); their sum is one.
        shares: Between 0 and 1.
    """
    at = np.minimum((values * (_BINS / values.max())).astype(np.intp), _BINS - 1)
    weight = np.bincount(at, weights, _BINS)
    held, filled = np.cumsum(weight), np.flatnonzero(weight)
    found = []
    for share in shares:
        reached = min(int(np.searchsorted(held[filled], share)), filled.size - 1)
        first, last = filled[max(reached - 1, 0)], filled[reached]
        chosen = np.flatnonzero((at >= first) & (at <= last))
        chosen = chosen[np.argsort(values[chosen])]
        found.append(
            np.interp(
                share, held[first] - weight[first] + np.cumsum(weights[chosen]), values[chosen]
            )
        )
    return np.array(found)


def log_densities(errors: Array, covs: Array) -> Array:
    """Return the logarithm of the density of errors, shape (2, ...), under Gaussians of some covariances, shape (2, 2, ...)."""
    (east, both), (_, north) = covs
    first, second = errors
    determinant = east * north - both**2
    square = (north * first**2 - 2.0 * both * first * second + east * second**2) / determinant
    return np.asarray(-0.5 * square - 0.5 * np.log(determinant) - np.log(2.0 * np.pi))


@dataclass(frozen=True, slots=True, eq=False)
class Persistence:
    """The last dive's mean current and the changes from dive to dive so far.

    With a flat prior of the logarithm of their variance the next change has Student's t distribution, with as many degrees of freedom as
    changes have components.

    Attributes:
        velocity: shape (2,) [m/s], of the last dive; None before the first.
        squares: Sum of the squared lengths of the changes [m^2/s^2].
        changes: Their number.
    """

    velocity: Array | None = None
    squares: float = 0.0
    changes: int = 0

    def after(self, velocity: Array) -> "Persistence":
        """Return the baseline after a dive of some mean current, shape (2,) [m/s]."""
        if self.velocity is None:
            return Persistence(velocity)
        return Persistence(
            velocity,
            self.squares + float(np.sum((velocity - self.velocity) ** 2)),
            self.changes + 1,
        )

    def radius(self, share: float) -> float:
        """Return the radius of the circle that should hold a share of the next mean currents [m/s]; NaN before the first change.

        Two components of Student's t with n degrees of freedom and the scale s lie within r with 1 - (1 + r^2 / (n s^2))^(-n / 2).
        """
        if not self.changes:
            return math.nan
        return math.sqrt(self.squares * ((1.0 - share) ** (-1.0 / self.changes) - 1.0))

    def holds(self, velocity: Array, shares: Sequence[float]) -> tuple[bool, ...]:
        """Return whether the circles that should hold some shares hold a velocity, shape (2,) [m/s]; none does before the first change."""
        off = math.inf if self.velocity is None else float(np.hypot(*(velocity - self.velocity)))
        return tuple(off <= self.radius(share) for share in shares)

    def log_density(self, velocity: Array) -> float:
        """Return the logarithm of the density of the next mean current, shape (2,) [m/s]; NaN before the first change."""
        if self.velocity is None or not self.changes or self.squares == 0.0:
            return math.nan
        half = float(self.changes)
        square = float(np.sum((velocity - self.velocity) ** 2)) / self.squares
        return float(
            gammaln(half + 1.0)
            - gammaln(half)
            - math.log(math.pi * self.squares)
            - (half + 1.0) * math.log1p(square)
        )
