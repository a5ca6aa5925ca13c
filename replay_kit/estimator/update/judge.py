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
    scale, threshold, rows = 1.0, np.inf, len(innovation)
    if probability is not None:
        threshold = quantile(probability, rows)
        if left and square > quantile(probability, left):
            scale = square / left
    of_rows, log_det = _normalised(innovation, covariance, 1.0)
    statistic = of_rows if scale == 1.0 else _normalised(innovation, covariance, scale)[0]
    return Judgement(scale, statistic, threshold, of_rows + square, log_det, rows, left)


def _normalised(innovation: Array, covariance: Array, noise: float) -> tuple[float, float]:
    """Return the normalised square of an innovation, and the logarithm of its covariance's determinant, with a variance of noise."""
    lower, _ = dpotrf(covariance + noise * np.eye(len(innovation)), lower=1)
    white, _ = dtrtrs(lower, innovation, lower=1)
    return float(white @ white), 2.0 * float(np.log(lower.diagonal()).sum())


@lru_cache(maxsize=1024)
def quantile(probability: float, dof: int) -> float:
    """Return the value that a chi-square variable exceeds with a probability; inf without degrees of freedom."""
    return float(chdtri(dof, probability)) if dof else np.inf
