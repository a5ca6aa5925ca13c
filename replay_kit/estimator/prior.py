"""The prior of the weights: mean and covariance over the ensemble's members."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist

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


def mixed_prior(member_weights: Array, velocity_modes: Array, nodes: Array, shares: tuple[float, float, float], radius: float) -> Prior:
    """Return a mix of three covariances that err in different ways (hybrid covariance, Hamill and Snyder 2000).

    The sample covariance of E members has at most E - 1 directions and takes chance correlations between far places for real
    ones. One Z x Z covariance for each mode has full rank, but knows no correlation between modes. The sample covariance
    tapered with distance on the grid (Gaspari and Cohn 1999) and projected on the modes has full rank and no chance
    correlations, but none of the true long ones either.

    Args:
        member_weights: shape (E, Z, r).
        velocity_modes: shape (2N, r) [m/s for a weight of one], the modes at the nodes.
        nodes: shape (N, 2) [m], east and north.
        shares: Of the sample covariance, the covariances by mode, the localised covariance.
        radius: Where the taper reaches zero [m].
    """
    n_members, n_levels, n_modes = member_weights.shape
    stacked = member_weights.reshape(n_members, -1)
    mean = stacked.mean(axis=0)
    anomalies = (stacked - mean) / np.sqrt(n_members - 1.0)
    by_level = anomalies.reshape(n_members, n_levels, n_modes)
    of_sample, by_mode, localised = shares
    cov = of_sample * (anomalies.T @ anomalies)
    modes = np.arange(n_modes)
    block = cov.reshape(n_levels, n_modes, n_levels, n_modes)
    block[:, modes, :, modes] += by_mode * np.einsum("ezm,eym->mzy", by_level, by_level)
    if localised > 0.0:
        cov += localised * localised_cov(by_level, velocity_modes, nodes, radius)
    return Prior(mean, cov)


def localised_cov(anomalies: Array, velocity_modes: Array, nodes: Array, radius: float) -> Array:
    """Return the projection of the tapered covariance on the modes, shape (Z r, Z r), level pair by level pair.

    Args:
        anomalies: shape (E, Z, r), of the weights, over sqrt(E - 1).
        velocity_modes: shape (2N, r).
        nodes: shape (N, 2) [m].
        radius: [m].
    """
    _, n_levels, n_modes = anomalies.shape
    taper = np.tile(gaspari_cohn(cdist(nodes, nodes), radius), (2, 2))
    fields = np.einsum("ezr,nr->zen", anomalies, velocity_modes, optimize=True)
    # least squares, because the kernel's nugget leaves the modes only nearly orthonormal at the nodes
    projector = np.linalg.pinv(velocity_modes)
    out = np.empty((n_levels, n_modes, n_levels, n_modes))
    for z in range(n_levels):
        for y in range(z + 1):
            pair = projector @ (taper * (fields[z].T @ fields[y])) @ projector.T
            out[z, :, y], out[y, :, z] = pair, pair.T
    return out.reshape(n_levels * n_modes, n_levels * n_modes)


def gaspari_cohn(distance: Array, radius: float) -> Array:
    """Return the fifth-order taper of Gaspari and Cohn (1999, eq. 4.10): 1 at no distance, 0 from ``radius`` on.

    Args:
        distance: [m], any shape.
        radius: Twice the function's half-width c [m].
    """
    r = np.minimum(2.0 * np.abs(distance) / radius, 2.0)
    inner = 1.0 + r**2 * (-5.0 / 3.0 + r * (5.0 / 8.0 + r * (0.5 - 0.25 * r)))
    outside = np.maximum(r, 1.0)
    outer = (
        4.0 + outside * (-5.0 + outside * (5.0 / 3.0 + outside * (5.0 / 8.0 + outside * (-0.5 + outside / 12.0)))) - 2.0 / (3.0 * outside)
    )
    return np.where(r <= 1.0, inner, np.maximum(outer, 0.0))
