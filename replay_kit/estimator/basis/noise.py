"""The error covariance of a profile's bins, and the whitening by it.

Each component of a profile errs with covariance N, the same for both:

    N_ij = s_i s_j exp(-|z_i - z_j| / L) + e_i^2 [i = j] + c^2,

with s the instrument's own errors, correlated along the profile over L, e the representation error of the basis, and c the error of the
platform's velocity, which all bins share. A platform of unknown velocity is the limit c -> inf: the profile is then known up to a
constant, and each component loses one degree of freedom. That is the same as estimating the platform's velocity with a flat prior beside
the weights and then taking the marginal of the weights.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from replay_kit.core.arrays import Array


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


def _orthogonal_complement(vector: Array) -> Array:
    """Return an orthonormal basis, shape (n, n - 1), of the complement of a vector: the other columns of its Householder reflection."""
    reflector = vector / np.linalg.norm(vector)
    reflector[0] += np.copysign(1.0, reflector[0])
    return np.eye(vector.size)[:, 1:] - np.outer(reflector, reflector[1:]) * (
        2.0 / (reflector @ reflector)
    )
