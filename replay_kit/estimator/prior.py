"""The prior of the weights: mean and covariance over the ensemble's members."""

from dataclasses import dataclass

import numpy as np

from replay_kit.types import Array


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """Gaussian prior of the stacked weights, level after level, r a level.

    Attributes:
        mean: shape (Z r,).
        cov: shape (Z r, Z r).
    """

    mean: Array
    cov: Array


def diagonal_prior(member_weights: Array) -> Prior:
    """Return the paper's prior: mean over members, and the variances alone.

    Args:
        member_weights: shape (E, Z, r).
    """
    stacked = member_weights.reshape(member_weights.shape[0], -1)
    return Prior(stacked.mean(axis=0), np.diag(stacked.var(axis=0, ddof=1)))


def hybrid_prior(member_weights: Array, sample_share: float) -> Prior:
    """Return a mix of the sample covariance and of one covariance between levels for each mode.

    The sample covariance knows which modes go together but has at most E - 1 directions; the covariances by mode have full
    rank and couple a mode's levels only.

    Args:
        member_weights: shape (E, Z, r).
        sample_share: Weight of the sample covariance, 0 to 1; the rest is the covariances by mode.
    """
    n_members, n_levels, n_modes = member_weights.shape
    stacked = member_weights.reshape(n_members, -1)
    mean = stacked.mean(axis=0)
    anomalies = (stacked - mean) / np.sqrt(n_members - 1.0)
    cov = sample_share * (anomalies.T @ anomalies)
    by_level = anomalies.reshape(n_members, n_levels, n_modes)
    of_mode = np.einsum("ezm,eym->mzy", by_level, by_level)
    block = cov.reshape(n_levels, n_modes, n_levels, n_modes)
    modes = np.arange(n_modes)
    block[:, modes, :, modes] += (1.0 - sample_share) * of_mode
    return Prior(mean, cov)
