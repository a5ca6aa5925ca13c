"""The joint likelihood of several profiles under the prior, before any of them is assimilated.

With the compressed rows of each profile whitened by the bins' errors, y = H x + noise of unit variance, the rows of all profiles have the
covariance H H' + 1. The compression residual is noise alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from replay_kit.core.observation import Flag, Observation
from replay_kit.estimator.estimator import ReducedBasisEstimator
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


def joint_likelihood(
    estimator: ReducedBasisEstimator,
    profiles: Sequence[Observation],
    bins: Sequence[NDArray[np.intp]],
) -> Likelihood:
    """Return the joint likelihood of profiles.

    One bin relative to a platform of unknown velocity has no information.

    Args:
        estimator: Has the prior.
        profiles: The profiles.
        bins: For each the indices of its bins that count, at least one in all.
    """
    groups = []
    for profile, used in zip(profiles, bins, strict=True):
        flags = np.full(profile.depth.size, Flag.FAIL, np.int8)
        flags[used] = Flag.GOOD
        groups.append((replace(profile, flags=flags),))
    columns = estimator.observer.columns(screened(groups, estimator.grid))
    rows = np.concatenate([column.rows(0) @ column.design for column in columns])
    values, squares, left = zip(*(column.compressed(0) for column in columns), strict=True)
    lower = np.linalg.cholesky(rows @ rows.T + np.eye(len(rows)))
    whitened = solve_triangular(lower, np.concatenate(values), lower=True)
    nis = float(whitened @ whitened) + sum(squares)
    half_log_det = float(np.log(np.diag(lower)).sum())
    half_log_det += sum(len(column.axes) * column.layouts[0].half_log_det for column in columns)
    return Likelihood(-0.5 * nis - half_log_det, nis, len(rows) + sum(left))
