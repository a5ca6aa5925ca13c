"""Errors of measured values, and lossless compression of a profile.

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
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.flow.functions import DepthFunctions, depth_weights
from replay_kit.core.observation import LinearMeasurement
from replay_kit.estimator.basis.modes import Basis

# Between levels the representation error is linear; above and below them that of the nearest holds.
_LINEAR = DepthFunctions("hat", 0.0)
# Share of the largest row of R below which a row is rounding.
_ROUNDING = 1e-10


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


def bin_noise(covariance: Array, relative: bool) -> BinNoise:
    """Return the noise of a measurement's values; see the module.

    Args:
        covariance: shape (n, n) [m^2/s^2], of one component, without the shared error where that is infinite.
        relative: Whether it is infinite.
    """
    lower = np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
    whiten = np.asarray(scipy.linalg.solve_triangular(lower, np.eye(len(lower)), lower=True))
    log_scale = float(np.log(np.diag(lower)).sum())
    if not relative:
        return BinNoise(whiten, lower, log_scale)
    complement = _orthogonal_complement(whiten.sum(axis=1))
    return BinNoise(complement.T @ whiten, lower @ complement, log_scale)


def measurement_noise(
    observation: LinearMeasurement,
    used: NDArray[np.intp],
    basis: Basis,
    representation_std: Array,
    places: Array,
) -> BinNoise:
    """Return the noise of a measurement's usable values.

    Args:
        observation: The measurement.
        used: Positions of its usable values.
        basis: Basis flows.
        representation_std: shape (Z,) [m/s], representation error of the basis, by level.
        places: shape (P, 2) or (1, 2) [m], local east and north, of the representation error.
    """
    between = depth_weights(_LINEAR, observation.depth, basis.grid.levels)
    extra = np.sum(between * basis.local_error(places, representation_std), axis=1)
    covariance = observation.covariance(used)
    covariance[np.diag_indices_from(covariance)] += observation.at_values(extra)[used] ** 2
    return bin_noise(covariance, observation.reference == "relative")


def _orthogonal_complement(vector: Array) -> Array:
    """Return an orthonormal basis, shape (n, n - 1), of the complement of a vector: the other columns of its Householder reflection."""
    reflector = vector / np.linalg.norm(vector)
    reflector[0] += np.copysign(1.0, reflector[0])
    return np.eye(vector.size)[:, 1:] - np.outer(reflector, reflector[1:]) * (
        2.0 / (reflector @ reflector)
    )


def compress(noise: BinNoise, functions: Array) -> tuple[Array, Array]:
    """Return orthonormal columns Q, shape (m, k), and R, shape (k, q), with Q R the whitened functions.

    Differences between values do not determine all functions of depth: what is left of a constant is rounding, and makes no row.

    Args:
        noise: Of n values, of which m combinations are known.
        functions: shape (n, q), at the values.
    """
    q, r = np.linalg.qr(noise.whiten @ functions)
    known, bins = noise.whiten.shape
    if known in (0, bins):
        return q, r
    kept = is_significant(r)
    return (q[:, kept], r[kept]) if kept.any() else (q, r)


def is_significant(r: Array) -> NDArray[np.bool_]:
    """Return which rows of R, shape (k, q), are more than rounding, shape (k,)."""
    size = np.abs(r).max(axis=1)
    return np.asarray(size > _ROUNDING * size.max())


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
