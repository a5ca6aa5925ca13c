"""Gate decisions: each measurement is judged against its prediction by the chi-square quantile of its normalised innovation squared."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

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


class Seen(NamedTuple):
    """n measurements of a column with one layout.

    Attributes:
        rows: shape (m, q), rows of each.
        y: shape (n, m), values.
        square: shape (n,), residual square of the compression.
        left: Degrees of freedom of this residual.
        persistence: shape (n,), factors on error variances, see ``Column.compressed``.
        at: shape (n,), indices among the column's measurements.
    """

    rows: Array
    y: Array
    square: Array
    left: int
    persistence: Array
    at: Indices


def judged(
    seen: Sequence[Seen], n: int, before: Array, covariance: Array, probability: float | None
) -> Judgements:
    """Return the gate decisions on all measurements of a column."""
    each = [
        judged_layout(
            column.y - column.rows @ before,
            column.rows @ covariance @ column.rows.T,
            (column.square, column.left),
            probability,
            column.persistence,
        )
        for column in seen
    ]
    if len(each) == 1:
        return each[0]
    order = np.argsort(np.concatenate([column.at for column in seen]))
    parts = (
        np.concatenate([getattr(column, name) for column in each])[order]
        for name in Judgements.__slots__
    )
    return Judgements(*parts)


def judged_layout(
    innovation: Array,
    covariance: Array,
    residual: tuple[Array, int],
    probability: float | None,
    persistence: Array | float = 1.0,
) -> Judgements:
    """Return the gate decisions on measurements of one layout.

    A residual of the compression improbable as noise shows larger errors, adapted first.

    Args:
        innovation: shape (n, m), innovations of rows of unit noise.
        covariance: shape (m, m), covariance of their prediction.
        residual: Residual squares of the compression, shape (n,), and their degrees of freedom.
        probability: Probability that valid measurements exceed the gate; None accepts all as stated.
        persistence: Factors on variances, shape (n,), of errors that persist from bin to bin.
    """
    square, left = residual
    n, rows = innovation.shape
    scale, threshold = np.ones(n), np.inf
    if probability is not None:
        threshold = quantile(probability, rows)
        if left:
            scale = np.where(square > quantile(probability, left), square / left, 1.0)
        scale = scale * persistence
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
