"""Whether a measurement agrees with the estimate, and how large its errors are.

The rows of a measurement carry all that it says of the unknowns; what the compression leaves is noise alone. Its square over its degrees of
freedom shows errors that are larger than stated, where it is improbable. With errors so adapted, the normalised square of the innovation is
held against chi-square: beyond it the measurement is rejected.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtrs
from scipy.special import chdtri

from replay_kit.core.arrays import Array, Indices, Mask


@dataclass(frozen=True, slots=True, eq=False)
class Judgements:
    """The decisions on n measurements of a column.

    Attributes:
        error_factor: shape (n,), factors on their error variances, at least 1.
        statistic: shape (n,), normalised squares of the innovations, with these factors.
        threshold: shape (n,), chi-square quantiles that they are held against; inf without a gate.
        nis: shape (n,), the same with the stated errors, what the compression left included.
        rows: shape (n,), numbers of rows.
        left: shape (n,), degrees of freedom of what the compression left.
    """

    error_factor: Array
    statistic: Array
    threshold: Array
    nis: Array
    rows: Indices
    left: Indices

    @property
    def accepted(self) -> Mask:
        """Which measurements are assimilated."""
        return np.asarray(self.statistic <= self.threshold)


def judged(
    innovation: Array, covariance: Array, residual: tuple[Array, int], probability: float | None
) -> Judgements:
    """Return the decisions on measurements of one layout.

    Args:
        innovation: shape (n, m), of rows of unit noise.
        covariance: shape (m, m), of their prediction.
        residual: Squares that the compression leaves, shape (n,), and their degrees of freedom.
        probability: That sound measurements exceed the gate; None accepts all with their stated errors.
    """
    square, left = residual
    n, rows = innovation.shape
    scale, threshold = np.ones(n), np.inf
    if probability is not None:
        threshold = quantile(probability, rows)
        if left:
            scale = np.where(square > quantile(probability, left), square / left, 1.0)
    of_rows = _normalised(innovation, covariance, 1.0)
    statistic = of_rows.copy()
    for i in np.flatnonzero(scale != 1.0).tolist():
        statistic[i] = _normalised(innovation[i : i + 1], covariance, float(scale[i]))[0]
    counts = np.full(n, rows), np.full(n, left)
    return Judgements(scale, statistic, np.full(n, threshold), of_rows + square, *counts)


def _normalised(innovation: Array, covariance: Array, noise: float) -> Array:
    """Return the normalised squares of innovations, shape (n,), with a variance of noise."""
    lower, _ = dpotrf(covariance + noise * np.eye(len(covariance)), lower=1)
    white, _ = dtrtrs(lower, innovation.T, lower=1)
    return np.asarray(np.sum(white**2, axis=0))


@lru_cache(maxsize=1024)
def quantile(probability: float, dof: int) -> float:
    """Return the value that a chi-square variable exceeds with a probability; inf without degrees of freedom."""
    return float(chdtri(dof, probability)) if dof else np.inf
