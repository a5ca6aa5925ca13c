"""Distributions of a dive's mean current: mixtures of Gaussians in the plane, and the baseline that the last one persists."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln, logsumexp

from replay_kit.core.arrays import Array

# Points that stand for each Gaussian, on a spiral whose radii are quantiles.
_POINTS = 48
# Bins of the radii: each has some hundreds of the points of all combinations of settings.
_BINS = 1024
_GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))


@dataclass(frozen=True, slots=True, eq=False)
class Mixture:
    """Gaussians in the plane with weights.

    Attributes:
        log_weights: shape (n,); the weights sum to one.
        means: shape (n, 2).
        covs: shape (n, 2, 2).
    """

    log_weights: Array
    means: Array
    covs: Array

    @property
    def mean(self) -> Array:
        """Mean of the mixture, shape (2,)."""
        return np.asarray(np.exp(self.log_weights) @ self.means)

    @property
    def cov(self) -> Array:
        """Covariance of the mixture, shape (2, 2)."""
        weights, about = np.exp(self.log_weights), self.means - self.mean
        return np.asarray(
            np.einsum("n,nij->ij", weights, self.covs) + (weights[:, None] * about).T @ about
        )

    def log_density(self, value: Array) -> float:
        """Return the logarithm of the density at a value, shape (2,)."""
        return float(logsumexp(self.log_weights + log_densities(value - self.means, self.covs)))

    def radii(self, shares: Sequence[float]) -> Array:
        """Return the radii, in standard deviations of ``cov``, within which the mixture has some shares of its weight, shape (k,).

        A mixture has heavier tails than the Gaussian of its moments, whose ellipses would hold other shares. Each Gaussian is replaced by
        points on a spiral (Vogel 1979, Mathematical Biosciences 44) whose radii are the quantiles of its own.

        Args:
            shares: Between 0 and 1.
        """
        rank = (np.arange(_POINTS) + 0.5) / _POINTS
        angle = _GOLDEN_ANGLE * np.arange(_POINTS)
        unit = np.sqrt(-2.0 * np.log1p(-rank)) * np.array([np.cos(angle), np.sin(angle)])
        points = self.means[:, :, None] - self.mean[:, None] + np.linalg.cholesky(self.covs) @ unit
        whitened = np.linalg.inv(np.linalg.cholesky(self.cov)) @ points.transpose(1, 0, 2).reshape(
            2, -1
        )
        return weighted_quantiles(
            np.hypot(*whitened), np.repeat(np.exp(self.log_weights) / _POINTS, _POINTS), shares
        )


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
    """Return the logarithm of the density of errors, shape (..., 2), under Gaussians of some covariances, shape (..., 2, 2)."""
    (east, both), (_, north) = np.moveaxis(covs, (-2, -1), (0, 1))
    first, second = np.moveaxis(errors, -1, 0)
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
