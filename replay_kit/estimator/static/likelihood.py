"""The joint likelihood of several profiles under the prior, before any of them is assimilated.

With the compressed rows of each profile (``update/rows.py``) whitened by the bins' errors, y = H w + noise of unit variance, the
rows of all profiles have mean H mean and covariance S = H P H' + 1. The compression residual is noise alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from replay_kit.core.arrays import Array
from replay_kit.core.observation import Observation
from replay_kit.estimator.static.filter import ReducedBasisEstimator
from replay_kit.estimator.update.posterior import prior_covariance
from replay_kit.estimator.update.rows import ProfileRows


@dataclass(frozen=True, slots=True)
class Likelihood:
    """The joint likelihood of profiles under the prior.

    Attributes:
        log: Natural logarithm of their density, without the constant of 2 pi.
        nis: Normalised innovation squared.
        dof: Number of measured values; of a profile relative to a platform of unknown velocity that of its differences.
    """

    log: float
    nis: float
    dof: int


@dataclass(frozen=True, slots=True, eq=False)
class JointPrediction:
    """The prediction of chosen bins of profiles, independent of their measured velocities.

    Attributes:
        estimator: Has the prior.
        bins: For each profile the indices of the bins predicted.
        mean: shape (R,), predicted rows about the offset of the basis.
        chol: shape (R, R), lower factor of the rows' covariance.
        log_error: Half the log-determinant of the measured values' error covariance.
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
        parts, residual, dof = [], 0.0, 0
        for rows in _known_rows(self.estimator, profiles, self.bins):
            parts.append(rows.y)
            residual += float(rows.stack.residual_square[0])
            dof += rows.stack.layouts[0].dof
        whitened = solve_triangular(self.chol, np.concatenate(parts) - self.mean, lower=True)
        nis = float(whitened @ whitened) + residual
        half_log_det = float(np.log(np.diag(self.chol)).sum())
        return Likelihood(-0.5 * nis - half_log_det - self.log_error, nis, dof)


def predict_jointly(
    estimator: ReducedBasisEstimator,
    profiles: Sequence[Observation],
    bins: Sequence[NDArray[np.intp]],
) -> JointPrediction:
    """Return the joint prediction of profiles.

    Args:
        estimator: Basis and prior.
        profiles: Places, depths and errors.
        bins: For each profile the indices of its bins to predict, at least one in all.
    """
    all_rows = _known_rows(estimator, profiles, bins)
    log_error = sum(len(rows.basis) * rows.stack.layouts[0].half_log_det for rows in all_rows)
    mean = np.concatenate([rows.matvec(estimator.prior_weights) for rows in all_rows])
    covariance = prior_covariance(estimator.prior, all_rows)
    covariance[np.diag_indices_from(covariance)] += 1.0
    return JointPrediction(
        estimator, tuple(bins), mean, np.asarray(np.linalg.cholesky(covariance)), log_error
    )


def _known_rows(
    estimator: ReducedBasisEstimator,
    profiles: Sequence[Observation],
    bins: Sequence[NDArray[np.intp]],
) -> list[ProfileRows]:
    """Return the rows of the profiles with information: one bin relative to a platform of unknown velocity has none."""
    rows = (
        estimator.rows(profile, used)
        for profile, used in zip(profiles, bins, strict=True)
        if used.size
    )
    return [each for each in rows if each.at_one_place and each.stack.layouts[0].dof]
