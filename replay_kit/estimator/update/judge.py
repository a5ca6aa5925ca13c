"""Gate: consistency of a measurement with the estimate, and adaptation of its errors.

The rows of a measurement carry all its information on the unknowns; the residual of the compression is noise alone. An improbably large
residual square per degree of freedom shows errors larger than stated. With errors so adapted, the normalised innovation squared is tested
against chi-square: above the threshold the measurement is rejected.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtrs
from scipy.special import chdtri

from replay_kit.core.arrays import Array, Indices, Mask


@dataclass(frozen=True, slots=True, eq=False)
class Judgements:
    """Gate decisions on n measurements of a column.

    Attributes:
        error_factor: shape (n,), factors on the error variances, at least 1.
        statistic: shape (n,), normalised innovations squared with these factors.
        threshold: shape (n,), chi-square quantiles; inf without a gate.
        nis: shape (n,), normalised innovations squared with stated errors, including the compression's residual.
        rows: shape (n,), numbers of rows.
        left: shape (n,), degrees of freedom of the compression's residual.
    """

    error_factor: Array
    statistic: Array
    threshold: Array
    nis: Array
    rows: Indices
    left: Indices

    @property
    def accepted(self) -> Mask:
        """Mask of assimilated measurements."""
        return np.asarray(self.statistic <= self.threshold)


def judged(
    innovation: Array, covariance: Array, residual: tuple[Array, int], probability: float | None
) -> Judgements:
    """Return the gate decisions on measurements of one layout.

    Args:
        innovation: shape (n, m), innovations of rows of unit noise.
        covariance: shape (m, m), covariance of their prediction.
        residual: Residual squares of the compression, shape (n,), and their degrees of freedom.
        probability: Probability that valid measurements exceed the gate; None accepts all with their stated errors.
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
    """Return the normalised innovations squared, shape (n,), for a noise variance."""
    lower, _ = dpotrf(covariance + noise * np.eye(len(covariance)), lower=1)
    white, _ = dtrtrs(lower, innovation.T, lower=1)
    return np.asarray(np.sum(white**2, axis=0))


@lru_cache(maxsize=1024)
def quantile(probability: float, dof: int) -> float:
    """Return the chi-square quantile of an exceedance probability; inf without degrees of freedom."""
    return float(chdtri(dof, probability)) if dof else np.inf
