"""Lossless compression of a profile to at most 2 Z independent rows for the Kalman update.

All bins of a profile lie under one point, so its design is a product: H = D (bins x Z) times G (2 x r), one row for each bin and
component. Whitening by the bins' errors, W, and a QR factorisation W D = Q R leave rows R G that hold all the bins say of
the weights; the component orthogonal to Q is pure noise and enters the normalised innovation squared only.
"""

from dataclasses import dataclass

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.estimator.basis.noise import BinNoise


@dataclass(frozen=True, slots=True, eq=False)
class Bins:
    """A profile's bins and the k rows for each component into which they are compressed.

    Attributes:
        q: shape (m, k), orthonormal columns.
        noise: Error of the n bins, of which m combinations are known.
        values: shape (n, 2) [m/s], local axes, measured about the estimator's reference current.
    """

    q: Array
    noise: BinNoise
    values: Array

    @property
    def dof(self) -> int:
        """Number of independent measured values in both components."""
        return 2 * len(self.q)

    def compress(self, values: Array) -> tuple[Array, float]:
        """Return the rows of bin values, shape (2 k,), and the squared norm of the compression residual.

        Args:
            values: shape (n, 2) [m/s].
        """
        whitened = self.noise.whiten @ values
        rows = self.q.T @ whitened
        return rows.T.ravel(), max(float(np.sum(whitened**2) - np.sum(rows**2)), 0.0)

    def whitened_residual(self, rows: Array) -> Array:
        """Return measured minus predicted bins in units of their error, shape (m, 2); ``rows``, shape (2 k,), are the predicted rows."""
        return np.asarray(self.noise.whiten @ self.values - self.q @ rows.reshape(2, -1).T)

    def residual(self, rows: Array) -> Array:
        """Return measured minus predicted bins, shape (n, 2) [m/s]; see ``whitened_residual``."""
        return np.asarray(self.noise.unwhiten @ self.whitened_residual(rows))

    def expand_variance(self, cov: Array) -> Array:
        """Return the variance of the bins, shape (n, 2) [m^2/s^2], that follows from the rows' covariance, shape (2 k, 2 k)."""
        k = self.q.shape[1]
        bins = self.noise.unwhiten @ self.q
        by_component = [
            np.einsum("nk,kl,nl->n", bins, cov[c * k : (c + 1) * k, c * k : (c + 1) * k], bins)
            for c in range(2)
        ]
        return np.column_stack(by_component)


@dataclass(frozen=True, slots=True, eq=False)
class ProfileRows(Bins):
    """A profile compressed: y = H w + noise of unit variance, with k = min(m, Z) rows a component.

    Attributes:
        r: shape (k, Z), the whitened depth factor.
        basis: shape (2, r), the modes' velocity at the point.
    """

    r: Array
    basis: Array

    def design(self) -> Array:
        """Return H, shape (2 k, Z r): all east rows, then all north."""
        rows: Array = np.einsum("kz,cm->ckzm", self.r, self.basis)
        return rows.reshape(2 * self.r.shape[0], -1)

    def matvec(self, weights: Array) -> Array:
        """Return H times weights, shape (..., 2 k); ``weights`` of shape (..., Z, r)."""
        rows: Array = self.r @ (weights @ self.basis.T)  # (..., k, 2)
        return np.swapaxes(rows, -1, -2).reshape(*weights.shape[:-2], -1)


def compress_profile(
    depth_weights: Array, basis: Array, noise: BinNoise, values: Array
) -> ProfileRows:
    """Return a profile's compressed rows.

    Args:
        depth_weights: shape (n, Z), D.
        basis: shape (2, r), G.
        noise: Error of the bins, the same for both components.
        values: shape (n, 2) [m/s], measured about the estimator's reference current.
    """
    q, r = np.linalg.qr(noise.whiten @ depth_weights)
    return ProfileRows(q, noise, values, r, basis)


def dependence_inflation(residual: Array) -> float:
    """Return the factor by which correlated errors inflate the error variance of a profile's bins.

    Bins smoothed by an inversion, or affected by structure that the basis cannot represent, leave residuals that are correlated
    along the profile; treated as independent they would count many times over. For a first-order autoregressive error of
    lag-one correlation rho the mean of n bins has (1 + rho) / (1 - rho) times the variance of n independent ones. The
    residuals' own mean square is applied too when it is above one. Below three standard errors of rho the factor is 1.

    Args:
        residual: shape (n, 2), measured minus estimated over the bins' error, neighbours in depth next to each other.

    Returns:
        A factor of at least 1.
    """
    mean_square = float(np.mean(residual**2))
    rho = float(np.sum(residual[1:] * residual[:-1]) / np.sum(residual**2))
    if rho <= 3.0 / np.sqrt(residual.size):
        return 1.0
    return (1.0 + rho) / (1.0 - rho) * max(1.0, mean_square)
