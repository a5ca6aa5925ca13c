"""The joint likelihood of several profiles under the prior, before any of them is assimilated.

With the compressed rows of each profile whitened by the bins' errors, y = H x + noise of unit variance, the rows of all profiles have the
covariance H H' + 1. The compression residual is noise alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from replay_kit.core.arrays import Array
from replay_kit.core.observation import Flag, Observation
from replay_kit.estimator.estimator import ReducedBasisEstimator
from replay_kit.estimator.update.columns import Column
from replay_kit.estimator.update.screening import screened


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
        lower: shape (R, R), lower factor of the rows' covariance.
        log_error: Half the log-determinant of the measured values' error covariance.
    """

    estimator: ReducedBasisEstimator
    bins: tuple[NDArray[np.intp], ...]
    lower: Array
    log_error: float

    def of(self, profiles: Sequence[Observation]) -> Likelihood:
        """Return the likelihood of profiles that differ from those predicted in velocity alone.

        Args:
            profiles: As many as were predicted, with the same places, depths and errors.
        """
        each = [column.compressed(0) for column in _columns(self.estimator, profiles, self.bins)]
        whitened = solve_triangular(self.lower, np.concatenate([y for y, _, _ in each]), lower=True)
        nis = float(whitened @ whitened) + sum(square for _, square, _ in each)
        half_log_det = float(np.log(np.diag(self.lower)).sum())
        dof = sum(y.size + left for y, _, left in each)
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
    columns = _columns(estimator, profiles, bins)
    rows = np.concatenate([column.rows(0) @ column.design for column in columns])
    lower = np.linalg.cholesky(rows @ rows.T + np.eye(len(rows)))
    noise = sum(len(column.axes) * column.layouts[0].half_log_det for column in columns)
    return JointPrediction(estimator, tuple(bins), lower, noise)


def _columns(
    estimator: ReducedBasisEstimator,
    profiles: Sequence[Observation],
    bins: Sequence[NDArray[np.intp]],
) -> list[Column]:
    """Return the columns of the profiles with information: one bin relative to a platform of unknown velocity has none."""
    groups = []
    for profile, used in zip(profiles, bins, strict=True):
        flags = np.full(profile.depth.size, Flag.FAIL, np.int8)
        flags[used] = Flag.GOOD
        groups.append((replace(profile, flags=flags),))
    return estimator.observer.columns(screened(groups, estimator.grid))
