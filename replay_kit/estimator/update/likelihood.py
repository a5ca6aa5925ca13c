"""How likely several profiles are together, before any of them is known: their joint Gaussian under the prior.

With the compressed rows of each profile (``kalman.py``) whitened by the bins' errors, y = H w + noise of unit variance, the rows of all
profiles have mean H mean and covariance S = H P H' + 1. What the compression leaves out is noise alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from replay_kit.core.arrays import Array
from replay_kit.core.observation import Observation
from replay_kit.estimator.filter import ReducedBasisEstimator


@dataclass(frozen=True, slots=True)
class Likelihood:
    """What profiles are together under the prior.

    Attributes:
        log: Natural logarithm of their density, without the constant of 2 pi.
        nis: Normalised square of what the prior does not predict.
        dof: Numbers measured.
    """

    log: float
    nis: float
    dof: int


@dataclass(frozen=True, slots=True, eq=False)
class JointPrediction:
    """The prediction of certain bins of certain profiles, whatever velocities they then have.

    Attributes:
        estimator: Whose prior predicts.
        bins: For each profile the indices of the bins predicted.
        mean: shape (R,), predicted rows about the basis' offset.
        chol: shape (R, R), lower factor of the rows' covariance.
        log_error: Sum over the numbers measured of the logarithm of their stated error.
    """

    estimator: ReducedBasisEstimator
    bins: tuple[NDArray[np.intp], ...]
    mean: Array
    chol: Array
    log_error: float

    def of(self, profiles: Sequence[Observation]) -> Likelihood:
        """Return the likelihood of profiles that differ from those predicted in velocity alone.

        Args:
            profiles: As many as were predicted, with the same places, depths and errors.
        """
        parts, left_out = [], 0.0
        for profile, used in zip(profiles, self.bins, strict=True):
            if used.size:
                rows, values = self.estimator.rows(profile, used)
                compressed, noise = rows.compress(values)
                parts.append(compressed)
                left_out += noise
        whitened = solve_triangular(self.chol, np.concatenate(parts) - self.mean, lower=True)
        nis = float(whitened @ whitened) + left_out
        half_log_det = float(np.log(np.diag(self.chol)).sum())
        return Likelihood(-0.5 * nis - half_log_det - self.log_error, nis, 2 * sum(used.size for used in self.bins))


def predict_jointly(estimator: ReducedBasisEstimator, profiles: Sequence[Observation], bins: Sequence[NDArray[np.intp]]) -> JointPrediction:
    """Return the joint prediction of profiles.

    Args:
        estimator: Basis and prior.
        profiles: Places, depths and errors.
        bins: For each profile the indices of its bins to predict, at least one in all.
    """
    designs, images, log_error = [], [], 0.0
    for profile, used in zip(profiles, bins, strict=True):
        if used.size:
            rows, _ = estimator.rows(profile, used)
            designs.append(rows.design())
            # the prior times each row of H: a row is a combination over levels of the modes at the place
            by_level = estimator.prior.times_modes(rows.basis)
            images.append(np.einsum("kz,zcym->ckym", rows.r, by_level).reshape(2 * rows.r.shape[0], -1))
            log_error += 2.0 * rows.noise.log_scale
    design, image = np.concatenate(designs), np.concatenate(images)
    covariance = design @ image.T
    covariance = 0.5 * (covariance + covariance.T)
    covariance[np.diag_indices_from(covariance)] += 1.0
    return JointPrediction(estimator, tuple(bins), design @ estimator.prior.mean, np.linalg.cholesky(covariance), log_error)
