"""Measurements as rows of unit noise: the bins' errors, lossless compression of a profile, means along a path.

**Errors.** Each component of a profile errs with covariance N, the same for both:

    N_ij = s_i s_j exp(-|z_i - z_j| / L) + e_i^2 [i = j] + c^2,

with s the instrument's own errors, correlated along the profile over L, e the representation error of the basis, and c the error of the
platform's velocity, which all bins share. A platform of unknown velocity is the limit c -> inf: the profile is then known up to a
constant, and each component loses one degree of freedom. That is the same as estimating the platform's velocity with a flat prior beside
the weights and then taking the marginal of the weights.

**Compression** of a profile to at most 2 Z independent rows. All bins of a profile lie under one point, so its design is a product: H = D
(bins x Z) times G (2 x r), one row for each bin and component. Whitening by the bins' errors, W, and a QR factorisation W D = Q R leave
rows R G that hold all the bins' information on the weights; the component orthogonal to Q is pure noise and enters the normalised
innovation squared only.

**A mean along a path** is the exact weighted sum of the basis flows at the path's points.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import takewhile

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.flow.depth import DepthFunctions, depth_weights
from replay_kit.core.geodesy import to_local
from replay_kit.core.observation import Observation, PathMean
from replay_kit.estimator.basis.modes import Basis
from replay_kit.estimator.update.grouping import ProfileGroup
from replay_kit.estimator.update.screening import local_mean


@dataclass(frozen=True, slots=True, eq=False)
class BinNoise:
    """The whitening of a profile's bins, and its inverse.

    Attributes:
        whiten: shape (m, n) [s/m]; m = n, or n - 1 where the platform's velocity is not known.
        unwhiten: shape (n, m) [m/s]; after ``whiten`` it restores a profile, without its constant part where that is not known.
        log_scale: Half the logarithm of the determinant of N, without the shared error where that is infinite.
    """

    whiten: Array
    unwhiten: Array
    log_scale: float

    @property
    def std(self) -> Array:
        """Standard deviation of each bin's error [m/s], shape (n,); about the profile's own mean where only that is known."""
        return np.asarray(np.sqrt(np.einsum("nm,nm->n", self.unwhiten, self.unwhiten)))

    @property
    def half_log_det(self) -> float:
        """Half the log-determinant of one component's error covariance: of all bins, or of their differences where only these are known."""
        known, bins = self.whiten.shape
        return (
            self.log_scale
            if known == bins
            else float(np.linalg.slogdet(np.diff(self.unwhiten, axis=0))[1])
        )


def bin_noise(
    depth: Array, own_std: Array, extra_std: Array, common_std: float, correlation_depth: float
) -> BinNoise:
    """Return the noise of a profile's bins; see the module.

    Args:
        depth: shape (n,) [m].
        own_std: shape (n,) [m/s], s.
        extra_std: shape (n,) [m/s], e.
        common_std: c [m/s]; inf for a platform of unknown velocity.
        correlation_depth: L [m]; 0 for independent errors.
    """
    n = depth.size
    if correlation_depth > 0.0 and n > 1:
        correlation = np.exp(-np.abs(depth[:, None] - depth) / correlation_depth)
        cov = np.outer(own_std, own_std) * correlation + np.diag(extra_std**2)
        lower = np.asarray(
            np.linalg.cholesky(cov + (common_std**2 if np.isfinite(common_std) else 0.0)),
            dtype=np.float64,
        )
    else:
        std = np.hypot(own_std, extra_std)
        lower = np.diag(std)
        if 0.0 < common_std < np.inf:
            lower = np.asarray(
                np.linalg.cholesky(np.diag(std**2) + common_std**2), dtype=np.float64
            )
    whiten = np.asarray(scipy.linalg.solve_triangular(lower, np.eye(n), lower=True))
    log_scale = float(np.log(np.diag(lower)).sum())
    if np.isfinite(common_std):
        return BinNoise(whiten, lower, log_scale)
    complement = _orthogonal_complement(whiten.sum(axis=1))
    return BinNoise(complement.T @ whiten, lower @ complement, log_scale)


def profile_noise(
    observation: Observation,
    used: NDArray[np.intp],
    basis: Basis,
    representation_std: Array,
    at: Observation | ProfileGroup | None = None,
) -> BinNoise:
    """Return the noise of a profile's usable bins.

    Args:
        observation: The profile.
        used: Positions of its usable bins.
        basis: Basis flows.
        representation_std: shape (Z,) [m/s], representation error of the basis, by level.
        at: Has the place of the representation error; None for the profile's own.
    """
    grid, depth, at = basis.grid, observation.depth[used], at or observation
    place = to_local(grid.projection, at.longitude, at.latitude)
    (of_levels,) = basis.local_error(np.array([place], dtype=np.float64), representation_std)
    extra, own = np.interp(depth, grid.levels, of_levels), observation.error_std[used]
    return bin_noise(depth, own, extra, observation.common_std, observation.correlation_depth)


def _orthogonal_complement(vector: Array) -> Array:
    """Return an orthonormal basis, shape (n, n - 1), of the complement of a vector: the other columns of its Householder reflection."""
    reflector = vector / np.linalg.norm(vector)
    reflector[0] += np.copysign(1.0, reflector[0])
    return np.eye(vector.size)[:, 1:] - np.outer(reflector, reflector[1:]) * (
        2.0 / (reflector @ reflector)
    )


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

    def ones(self) -> Array:
        """Return the rows of a velocity of one in all bins, shape (k,)."""
        return np.asarray(self.q.T @ self.noise.whiten.sum(axis=1))

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


def dependence_inflation(residual: Array, size: NDArray[np.intp]) -> Array:
    """Return the factors by which correlated errors inflate the error variance of profiles' bins, shape (n,), at least 1.

    Bins smoothed by an inversion, or affected by structure that the basis cannot represent, leave residuals that are correlated
    along the profile; treated as independent they would count many times over. For a first-order autoregressive error of
    lag-one correlation rho the mean of n bins has (1 + rho) / (1 - rho) times the variance of n independent ones. The
    residuals' own mean square is applied too when it is above one. Below three standard errors of rho the factor is 1.

    Args:
        residual: shape (n, m, 2), measured minus estimated over the bins' error, neighbours in depth next to each other; 0 beyond
            the last bin.
        size: shape (n,), number of values, of both components.
    """
    square = np.sum(residual**2, axis=(1, 2))
    product = np.sum(residual[:, 1:] * residual[:, :-1], axis=(1, 2))
    rho = np.divide(product, square, out=np.zeros_like(square), where=square > 0.0)
    rho = np.where((rho > 3.0 / np.sqrt(size)) & (size > 2), rho, 0.0)
    return np.where(rho > 0.0, (1.0 + rho) / (1.0 - rho) * np.maximum(1.0, square / size), 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class PathRows(Bins):
    """A mean along a path: one row a component, y = H w + noise of unit variance.

    Attributes:
        by_level: shape (2, Z, r), H.
    """

    by_level: Array

    def design(self) -> Array:
        """Return H, shape (2, Z r)."""
        return self.by_level.reshape(2, -1)

    def matvec(self, weights: Array) -> Array:
        """Return H times weights, shape (..., 2); ``weights`` of shape (..., Z, r)."""
        return np.asarray(np.tensordot(weights, self.by_level, axes=([-2, -1], [1, 2])))


def mean_noise(mean: PathMean, basis: Basis, places: Array, representation_std: Array) -> BinNoise:
    """Return the noise of a mean along a path, as that of one bin.

    Args:
        mean: The mean.
        basis: Basis flows.
        places: shape (m, 2) [m], local east and north, of the points.
        representation_std: shape (Z,) [m/s], representation error of the basis, by level.
    """
    by_level = basis.local_error(places, representation_std)
    between = depth_weights(DepthFunctions("hat", 0.0), mean.depth, basis.grid.levels)
    std = float(np.hypot(mean.used_std, mean.weight @ np.sum(between * by_level, axis=1)))
    return BinNoise(np.array([[1.0 / std]]), np.array([[std]]), float(np.log(std)))


def depth_means(mean: PathMean, basis: Basis) -> Array:
    """Return the weight of each level at each point in the mean, shape (m, Z); above and below the levels the nearest level holds."""
    return np.asarray(mean.weight[:, None] * basis.depth_weights(mean.depth))


def path_rows(mean: PathMean, basis: Basis, representation_std: Array) -> PathRows:
    """Return the rows of a mean along a path."""
    grid = basis.grid
    places = np.column_stack(to_local(grid.projection, mean.longitude, mean.latitude))
    by_level = depth_means(mean, basis)
    noise = mean_noise(mean, basis, places, representation_std)
    offset = np.einsum("mz,cmz->c", by_level, basis.horizontal.velocity(places, basis.offset))
    design = by_level.T @ basis.horizontal.velocity(places, basis.modes)
    return PathRows(
        np.ones((1, 1)), noise, local_mean(mean, grid.projection) - offset, design / noise.std[0]
    )


def profiles_before_path(rows: Iterable[ProfileRows | PathRows | None]) -> list[ProfileRows]:
    """Return the profiles up to the first mean along a path, after which there is another prior."""
    before = takewhile(lambda each: not isinstance(each, PathRows), rows)
    return [each for each in before if isinstance(each, ProfileRows)]
