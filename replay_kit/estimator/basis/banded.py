"""Cholesky factors of banded matrices, solved for many right-hand sides at once.

LAPACK's ``pbtrf`` factors in blocks, but its ``pbtrs`` solves column by column and reads the factor once for each. Here the solution runs
over blocks of the factor with matrix products (Golub and Van Loan, Matrix Computations, section 4.3.5), several times as fast.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack
from scipy.linalg.blas import dtrsm, strsm

from replay_kit.core.arrays import Array
from replay_kit.core.errors import EstimatorError

#: Lower band of a symmetric matrix, shape (n, b + 1): element [j, d] is that of row j + d and column j; single or double precision.
Band = NDArray[np.floating]

_BLOCK = 256


def rows_and_columns(band: Band) -> Band:
    """Return a view of a lower band, shape (n, n), by column and row; only elements between the diagonal and the band's edge are meant."""
    n, step, item = len(band), band.shape[1] - 1, band.itemsize
    return np.lib.stride_tricks.as_strided(band, (n, n), (step * item, item))


def factored(band: Band) -> Band:
    """Return the lower Cholesky factor in the place of a symmetric positive definite band.

    Raises:
        EstimatorError: The matrix is not positive definite.
    """
    factor = lapack.spbtrf if band.dtype == np.float32 else lapack.dpbtrf
    lower, info = factor(band.T, lower=1, overwrite_ab=1)
    if info > 0:
        raise EstimatorError(
            f"the equations of the basis are singular at unknown {info} of {len(band)}; set a larger [estimator] nugget"
        )
    return np.asarray(lower.T)


def solve(factor: Band, right: Array) -> Array:
    """Return the solution, shape (n, k), of L L' x = right, from the factor that ``factored`` returns; in its precision."""
    x = np.array(right, dtype=factor.dtype, order="C")
    triangular = strsm if factor.dtype == np.float32 else dtrsm
    blocks = list(_blocks(factor))
    for at in blocks:
        x[at.columns] = triangular(1.0, at.diagonal, x[at.columns], lower=1)
        x[at.full_rows] -= at.full.T @ x[at.columns]
        x[at.last_rows] -= at.last.T @ x[at.columns]
    for at in reversed(blocks):
        x[at.columns] -= at.full @ x[at.full_rows]
        x[at.columns] -= at.last @ x[at.last_rows]
        x[at.columns] = triangular(1.0, at.diagonal, x[at.columns], lower=1, trans_a=1)
    return np.asarray(x)


class _Block:
    """Some columns of a lower band: the block on the diagonal, the rows below that have all of them, and those after with the last ones."""

    def __init__(self, elements: Band, width: int, start: int, stop: int) -> None:
        n = len(elements)
        self.elements, self.columns = elements, slice(start, stop)
        self.full_rows = slice(stop, max(stop, min(n, start + width + 1)))
        self.last_rows = slice(self.full_rows.stop, max(self.full_rows.stop, min(n, stop + width)))

    @property
    def diagonal(self) -> Band:
        """By row and column; above the diagonal it has no meaning."""
        return self.elements[self.columns, self.columns].T

    @property
    def full(self) -> Band:
        """By column and row."""
        return self.elements[self.columns, self.full_rows]

    @property
    def last(self) -> Band:
        """By column and row, zero beyond the band's edge."""
        return np.tril(self.elements[self.columns, self.last_rows], -1)


def _blocks(factor: Band) -> Iterator[_Block]:
    elements, width = rows_and_columns(factor), factor.shape[1] - 1
    step = min(_BLOCK, width + 1)
    for start in range(0, len(factor), step):
        yield _Block(elements, width, start, min(start + step, len(factor)))
