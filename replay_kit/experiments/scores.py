"""How an estimate and its stated uncertainty compare with a known truth: pure functions of arrays."""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri

from replay_kit.flow import FlowEstimate
from replay_kit.scoring import ScoredPoints, rms_length
from replay_kit.types import Array


@dataclass(frozen=True, slots=True)
class Score:
    """An estimate against the truth over all scored points.

    Attributes:
        rmse: Root mean square length of the error vector [m/s].
        rel_error: ``rmse`` over the truth's RMS speed.
        coverage50: Share of components inside their central 50 % interval; NaN without uncertainty.
        coverage90: Share of components inside their central 90 % interval; NaN without uncertainty.
        crps: Mean continuous ranked probability score of a component [m/s]; the mean absolute error without uncertainty.
    """

    rmse: float
    rel_error: float
    coverage50: float
    coverage90: float
    crps: float


def score(flow: FlowEstimate, at: ScoredPoints) -> Score:
    """Return the scores of an estimate."""
    error = flow.velocity(*at.place) - at.velocity
    rmse = rms_length(error)
    relative = rmse / rms_length(at.velocity)
    if flow.n_modes == 0:
        return Score(rmse, relative, np.nan, np.nan, float(np.mean(np.abs(error))))
    std = flow.standard_error(*at.place)
    return Score(rmse, relative, coverage(error, std, 0.5), coverage(error, std, 0.9), float(np.mean(crps_gaussian(error, std))))


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
