"""One profile as the Kalman update meets it, compressed exactly to at most 2 Z rows.

All bins of a profile lie under one point, so its design is a product: H = D (bins x Z) times G (2 x r), one row for each bin and
component. Whitening by the bins' errors, W, and a QR factorisation W D = Q R leave rows R G that hold all the bins say of
the weights; what Q discards is pure noise and enters the normalised innovation squared only.
"""

from dataclasses import dataclass

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.estimator.basis.noise import BinNoise


@dataclass(frozen=True, slots=True, eq=False)
class Bins:
    """A profile's bins and the k rows a component into which they are compressed.

    Attributes:
        q: shape (m, k), orthonormal columns.
        noise: Of the n bins, of which m combinations are known.
    """

    q: Array
    noise: BinNoise

    @property
    def dof(self) -> int:
        """Number of independent values in both components."""
        return 2 * len(self.q)

    def compress(self, values: Array) -> tuple[Array, float]:
        """Return the rows of bin values, shape (2 k,), and the squared norm of what they leave out.

        Args:
            values: shape (n, 2) [m/s].
        """
        whitened = self.noise.whiten @ values
        rows = self.q.T @ whitened
        return rows.T.ravel(), max(float(np.sum(whitened**2) - np.sum(rows**2)), 0.0)

    def deviation(self, values: Array, rows: Array) -> Array:
        """Return what bin values, shape (n, 2) [m/s], have beyond rows, shape (2 k,), in units of their error: shape (m, 2)."""
        return np.asarray(self.noise.whiten @ values - self.q @ rows.reshape(2, -1).T)

    def misfit(self, values: Array, rows: Array) -> Array:
        """Return what bin values have beyond rows, shape (n, 2) [m/s]; see ``deviation``."""
        return np.asarray(self.noise.unwhiten @ self.deviation(values, rows))

    def expand_variance(self, cov: Array) -> Array:
        """Return the variance of bin values, shape (n, 2) [m^2/s^2], of rows with covariance ``cov``, shape (2 k, 2 k)."""
        k = self.q.shape[1]
        bins = self.noise.unwhiten @ self.q
        by_component = [np.einsum("nk,kl,nl->n", bins, cov[c * k : (c + 1) * k, c * k : (c + 1) * k], bins) for c in range(2)]
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

    def times(self, weights: Array) -> Array:
        """Return weights seen through H, shape (..., 2 k); ``weights`` of shape (..., Z, r)."""
        seen: Array = self.r @ (weights @ self.basis.T)  # (..., k, 2)
        return np.swapaxes(seen, -1, -2).reshape(*weights.shape[:-2], -1)


def compress_profile(depth_weights: Array, basis: Array, noise: BinNoise) -> ProfileRows:
    """Return a profile's compressed rows.

    Args:
        depth_weights: shape (n, Z), D.
        basis: shape (2, r), G.
        noise: Of the bins, the same for both components.
    """
    q, r = np.linalg.qr(noise.whiten @ depth_weights)
    return ProfileRows(q, noise, r, basis)


def dependence_inflation(residual: Array) -> float:
    """Return by how much the error variance of a profile's bins must grow because their errors are not independent.

    Bins that an inversion smoothed, or that all see a structure the basis cannot show, leave residuals that are correlated
    along the profile; taken for independent they would count many times over. For a first-order autoregressive error of
    lag-one correlation rho the mean of n bins has (1 + rho) / (1 - rho) times the variance of n independent ones. The
    residuals' own mean square enters too when it is above one. Below three standard errors of rho nothing is done.

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
