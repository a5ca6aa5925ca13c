"""Scores of Gaussian predictions: pure functions of arrays."""

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import ndtr, ndtri

from replay_kit.core.arrays import Array

# Standard deviations between which 90 % of a normal distribution lie.
_NINETY = float(ndtri(0.95))


def normalised_square(innovation: Array, cov: Array) -> tuple[float, float]:
    """Return e' S^-1 e and half the log-determinant of S, from one Cholesky factor.

    Args:
        innovation: shape (m,), e.
        cov: shape (m, m), S.
    """
    lower = np.linalg.cholesky(cov)
    whitened = solve_triangular(lower, innovation, lower=True)
    return float(whitened @ whitened), float(np.log(np.diag(lower)).sum())


def coverage(error: Array, std: Array, share: float) -> float:
    """Return the share of errors inside the central interval that has a probability of ``share``."""
    return float(np.mean(np.abs(error) <= ndtri(0.5 + 0.5 * share) * std))


def crps_gaussian(error: Array, std: Array) -> Array:
    """Return the continuous ranked probability score of Gaussian predictions (Gneiting et al. 2005, Mon. Wea. Rev. 133, eq. 5).

    Args:
        error: Predicted mean minus the outcome, any shape.
        std: Predicted standard deviation, broadcast against it; where it is 0 the score is the absolute error.
    """
    error, std = np.broadcast_arrays(error, std)
    z = np.divide(error, std, out=np.zeros(error.shape), where=std > 0.0)
    density = np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi)
    spread = std * (z * (2.0 * ndtr(z) - 1.0) + 2.0 * density - 1.0 / np.sqrt(np.pi))
    return np.where(std > 0.0, spread, np.abs(error))


def share_interval(share: float, count: int) -> tuple[float, float]:
    """Return the interval of 90 % of a probability that was estimated by the share of some independent trials, one at least.

    References:
        Wilson (1927), Probable inference, the law of succession, and statistical inference.
    """
    middle, wide = share + 0.5 * _NINETY**2 / count, 1.0 + _NINETY**2 / count
    half = _NINETY * ((share * (1.0 - share) + 0.25 * _NINETY**2 / count) / count) ** 0.5
    return max((middle - half) / wide, 0.0), min((middle + half) / wide, 1.0)
