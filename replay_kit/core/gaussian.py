"""How Gaussian predictions compare with what came: pure functions of arrays."""

import numpy as np
from scipy.special import ndtr, ndtri

from replay_kit.core.arrays import Array


def coverage(error: Array, std: Array, share: float) -> float:
    """Return which share of errors lies in the central interval that should hold ``share`` of them."""
    return float(np.mean(np.abs(error) <= ndtri(0.5 + 0.5 * share) * std))


def crps_gaussian(error: Array, std: Array) -> Array:
    """Return the continuous ranked probability score of Gaussian predictions (Gneiting et al. 2005, Mon. Wea. Rev. 133, eq. 5).

    Args:
        error: Predicted mean minus what came, any shape.
        std: Predicted standard deviation, broadcast against it; where it is 0 the score is the absolute error.
    """
    error, std = np.broadcast_arrays(error, std)
    z = np.divide(error, std, out=np.zeros(error.shape), where=std > 0.0)
    density = np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi)
    spread = std * (z * (2.0 * ndtr(z) - 1.0) + 2.0 * density - 1.0 / np.sqrt(np.pi))
    return np.where(std > 0.0, spread, np.abs(error))
