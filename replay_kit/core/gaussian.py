"""Scores of Gaussian predictions: pure functions of arrays."""

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import ndtr, ndtri

from replay_kit.core.arrays import Array


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
