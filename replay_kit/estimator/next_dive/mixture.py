"""Predictive distribution of the next dive's DAC as a Gaussian mixture, and persistence."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from replay_kit.core.arrays import Array

# Points that stand for each Gaussian, on a spiral whose radii are quantiles.
_POINTS = 48
# Logarithm of the least weight of a Gaussian that moves a radius: thousands of them hold less than a millionth.
_LEAST_LOG_WEIGHT = -25.0
_ANGLES = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(_POINTS)
_SPIRAL = np.sqrt(-2.0 * np.log1p(-(np.arange(_POINTS) + 0.5) / _POINTS)) * np.array(
    [np.cos(_ANGLES), np.sin(_ANGLES)]
)


# Not slotted: the moments are computed once.
@dataclass(frozen=True, eq=False)
class Mixture:
    """Mixture of Gaussians in the plane.

    Attributes:
        log_weights: shape (n,), log weights; the weights sum to one.
        means: shape (n, 2), means.
        covs: shape (n, 2, 2), covariances.
    """

    log_weights: Array
    means: Array
    covs: Array

    @cached_property
    def mean(self) -> Array:
        """Mean of the mixture, shape (2,)."""
        return np.asarray(np.exp(self.log_weights) @ self.means)

    @cached_property
    def cov(self) -> Array:
        """Covariance of the mixture, shape (2, 2)."""
        weights, about = np.exp(self.log_weights), self.means - self.mean
        return np.asarray(np.tensordot(weights, self.covs, 1) + (weights * about.T) @ about)

    def log_density(self, value: Array) -> float:
        """Return the log density at a value, shape (2,)."""
        densities = log_densities(value - self.means, self.covs)
        return float(np.logaddexp.reduce(self.log_weights + densities))

    def radii(self, shares: Sequence[float]) -> Array:
        """Return the radii that contain given probabilities, shape (k,), in standard deviations of ``cov``.

        A mixture has heavier tails than the Gaussian of its moments. Each Gaussian is replaced by points on a spiral (Vogel 1979,
        Mathematical Biosciences 44) at its radial quantiles.

        Args:
            shares: Probabilities between 0 and 1.
        """
        kept = self.log_weights > _LEAST_LOG_WEIGHT
        whiten = np.linalg.inv(np.linalg.cholesky(self.cov))
        points = (self.means[kept] - self.mean)[..., None] + np.linalg.cholesky(
            self.covs[kept]
        ) @ _SPIRAL
        off = np.hypot(*np.moveaxis(whiten @ points, 1, 0)).ravel()
        weights = np.repeat(np.exp(self.log_weights[kept]) / _POINTS, _POINTS)
        order = np.argsort(off)
        return np.asarray(np.interp(shares, np.cumsum(weights[order]), off[order]))


def log_densities(errors: Array, covs: Array) -> Array:
    """Return the log density of errors, shape (..., 2), under Gaussians with covariances, shape (..., 2, 2)."""
    square = np.sum(errors * np.linalg.solve(covs, errors[..., None])[..., 0], axis=-1)
    return np.asarray(-0.5 * square - 0.5 * np.linalg.slogdet(covs)[1] - np.log(2.0 * np.pi))


@dataclass(frozen=True, slots=True, eq=False)
class Persistence:
    """Persistence: the last dive's DAC and the changes between dives so far.

    With a flat prior of the log variance the next change has Student's t distribution with one degree of freedom per component of the
    changes.

    Attributes:
        velocity: shape (2,) [m/s], DAC of the last dive; None before the first.
        squares: Sum of the squared lengths of the changes [m^2/s^2].
        changes: Number of changes.
    """

    velocity: Array | None = None
    squares: float = 0.0
    changes: int = 0

    def after(self, velocity: Array) -> "Persistence":
        """Return the baseline after a dive with a DAC, shape (2,) [m/s]."""
        if self.velocity is None:
            return Persistence(velocity)
        return Persistence(
            velocity,
            self.squares + float(np.sum((velocity - self.velocity) ** 2)),
            self.changes + 1,
        )

    def radius(self, share: float) -> float:
        """Return the radius of the circle that contains the next DAC with a probability [m/s]; NaN before the first change.

        Two components of Student's t with n degrees of freedom and the scale s lie within r with 1 - (1 + r^2 / (n s^2))^(-n / 2).
        """
        if not self.changes:
            return math.nan
        return math.sqrt(self.squares * ((1.0 - share) ** (-1.0 / self.changes) - 1.0))

    def log_density(self, velocity: Array) -> float:
        """Return the log density of the next DAC, shape (2,) [m/s]; NaN before the first change."""
        if self.velocity is None or self.squares == 0.0:
            return math.nan
        square = float(np.sum((velocity - self.velocity) ** 2)) / self.squares
        return math.log(self.changes / (math.pi * self.squares)) - (
            self.changes + 1.0
        ) * math.log1p(square)
