"""Whether a measurement agrees with the estimate, and how large its errors are.

The rows of a measurement carry all that it says of the unknowns; what the compression leaves is noise alone. Its square over its degrees of
freedom shows errors that are larger than stated, where it is improbable. With errors so adapted, the normalised square of the innovation is
held against chi-square: beyond it the measurement is rejected.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.special import chdtri

from replay_kit.core.arrays import Array


@dataclass(frozen=True, slots=True)
class Judgement:
    """The decision on one measurement.

    Attributes:
        error_factor: Factor on its error variance, at least 1.
        statistic: Normalised square of the innovation, with that factor.
        threshold: Chi-square quantile that it is held against; inf without a gate.
        nis: The same with the stated errors, what the compression left included.
        log_det: Logarithm of the determinant of the rows' covariance over that of their stated noise.
        rows: Number of rows.
        left: Degrees of freedom of what the compression left.
    """

    error_factor: float
    statistic: float
    threshold: float
    nis: float
    log_det: float
    rows: int
    left: int

    @property
    def accepted(self) -> bool:
        """Whether the measurement is assimilated."""
        return self.statistic <= self.threshold


def judged(
    innovation: Array, covariance: Array, residual: tuple[float, int], probability: float | None
) -> Judgement:
    """Return the decision on a measurement.

    Args:
        innovation: shape (m,), of rows of unit noise.
        covariance: shape (m, m), of their prediction.
        residual: Square that the compression leaves, and its degrees of freedom.
        probability: That sound measurements exceed the gate; None accepts all with their stated errors.
    """
    square, left = residual
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    values, along = np.maximum(values, 0.0), vectors.T @ innovation
    scale, threshold, rows = 1.0, np.inf, len(innovation)
    if probability is not None:
        threshold = quantile(probability, rows)
        if left and square > quantile(probability, left):
            scale = square / left
    statistic = float(np.sum(along**2 / (values + scale)))
    nis = float(np.sum(along**2 / (values + 1.0))) + square
    log_det = float(np.log1p(values).sum())
    return Judgement(scale, statistic, threshold, nis, log_det, rows, left)


@lru_cache(maxsize=1024)
def quantile(probability: float, dof: int) -> float:
    """Return the value that a chi-square variable exceeds with a probability; inf without degrees of freedom."""
    return float(chdtri(dof, probability)) if dof else np.inf
