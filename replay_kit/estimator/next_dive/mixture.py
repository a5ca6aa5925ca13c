"""Mixtures of Gaussians in the plane: moments, density, and the scale of the ellipse that holds a share."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from replay_kit.core.arrays import Array

# Points that stand for each Gaussian, on a spiral whose radii are quantiles.
_POINTS = 48
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
        return np.asarray(np.einsum("n,nij->ij", weights, self.covs) + (weights[:, None] * about).T @ about)

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
        whitened = np.linalg.solve(np.linalg.cholesky(self.cov), points.transpose(1, 0, 2).reshape(2, -1))
        radius = np.hypot(*whitened)
        order = np.argsort(radius)
        held = np.cumsum(np.repeat(np.exp(self.log_weights) / _POINTS, _POINTS)[order])
        return np.asarray(np.interp(shares, held, radius[order]))


def log_densities(errors: Array, covs: Array) -> Array:
    """Return the logarithm of the density of errors, shape (n, 2), under Gaussians of some covariances, shape (n, 2, 2)."""
    determinant = covs[:, 0, 0] * covs[:, 1, 1] - covs[:, 0, 1] ** 2
    first, second = errors.T
    square = (covs[:, 1, 1] * first**2 - 2.0 * covs[:, 0, 1] * first * second + covs[:, 0, 0] * second**2) / determinant
    return np.asarray(-0.5 * square - 0.5 * np.log(determinant) - np.log(2.0 * np.pi))
