"""The error of a profile's bins, and what makes it white.

Each component of a profile errs with covariance N, the same for both:

    N_ij = s_i s_j exp(-|z_i - z_j| / L) + e_i^2 [i = j] + c^2,

with s the instrument's own errors, correlated along the profile over L, e what the basis cannot show of a bin, and c the error that all
bins share because the platform's velocity has it. A platform of unknown velocity is the limit c -> inf: what is left is the profile up to a
constant, and one degree of freedom of each component goes. That is the same as estimating the platform's velocity beside the weights
with nothing known of it, and then looking at the weights alone.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from replay_kit.core.arrays import Array


@dataclass(frozen=True, slots=True, eq=False)
class BinNoise:
    """What whitens the bins of a profile, and back.

    Attributes:
        whiten: shape (m, n) [s/m]; m = n, or n - 1 where the platform's velocity is not known.
        unwhiten: shape (n, m) [m/s]; with ``whiten`` it gives a profile back, less its constant part where that is not known.
        log_scale: Half the logarithm of the determinant of N without the shared error.
    """

    whiten: Array
    unwhiten: Array
    log_scale: float

    @property
    def std(self) -> Array:
        """Standard deviation of each bin's error [m/s], shape (n,); about the profile's own mean where only that is known."""
        return np.asarray(np.sqrt(np.einsum("nm,nm->n", self.unwhiten, self.unwhiten)))


def bin_noise(depth: Array, own_std: Array, extra_std: Array, common_std: float, correlation_depth: float) -> BinNoise:
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
        alike = np.exp(-np.abs(depth[:, None] - depth) / correlation_depth)
        cov = np.outer(own_std, own_std) * alike + np.diag(extra_std**2)
        lower = np.asarray(np.linalg.cholesky(cov + (common_std**2 if np.isfinite(common_std) else 0.0)), dtype=np.float64)
    else:
        std = np.hypot(own_std, extra_std)
        lower = np.diag(std)
        if 0.0 < common_std < np.inf:
            lower = np.asarray(np.linalg.cholesky(np.diag(std**2) + common_std**2), dtype=np.float64)
    whiten = np.asarray(scipy.linalg.solve_triangular(lower, np.eye(n), lower=True))
    log_scale = float(np.log(np.diag(lower)).sum())
    if np.isfinite(common_std):
        return BinNoise(whiten, lower, log_scale)
    rest = _complement(whiten.sum(axis=1))
    return BinNoise(rest.T @ whiten, lower @ rest, log_scale)


def _complement(vector: Array) -> Array:
    """Return an orthonormal basis, shape (n, n - 1), of what is orthogonal to a vector: the rest of its Householder reflection."""
    reflector = vector / np.linalg.norm(vector)
    reflector[0] += np.copysign(1.0, reflector[0])
    return np.eye(vector.size)[:, 1:] - np.outer(reflector, reflector[1:]) * (2.0 / (reflector @ reflector))
