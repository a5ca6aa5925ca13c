"""Layouts: the observation of a water column by values at one position, common to values of equal depths and errors.

Whitened by W, W N W' = 1, and compressed by W J = Q R, Q orthonormal, the values are the rows R a of unit noise (``columns.py``).
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dtrtri

from replay_kit.core.arrays import Array

# Share of the largest singular value of W J below which one is rounding.
_ROUNDING = 1e-10


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Observation of a column by the used values of a measurement, common to equal depths and errors.

    Attributes:
        levels: shape (m, Z), functions of the levels at the values' depths; (m, 0) for sums over several positions.
        functions: shape (m, K), J for one component.
        whiten: shape (w, m), W.
        q: shape (w, p), Q.
        r: shape (p, K), R.
        std: shape (m,) [m/s], error of each value with representation error.
        half_log_det: Half the log determinant of N.
        unwhiten: shape (m, w), for values known up to a constant; None for others.
    """

    levels: Array
    functions: Array
    whiten: Array
    q: Array
    r: Array
    std: Array
    half_log_det: float
    unwhiten: Array | None = None

    def known(self, values: Array) -> Array:
        """Return the known part of values, shape (..., m, n): for relative ones without a constant."""
        return values if self.unwhiten is None else self.unwhiten @ (self.whiten @ values)

    @staticmethod
    def of(levels: Array, functions: Array, covariance: Array, is_relative: bool) -> "Layout":
        """Return the layout of levels, functions, and N, shape (m, m) [m^2/s^2], without an infinite common error.

        Raises:
            numpy.linalg.LinAlgError: A covariance is not positive definite.
        """
        lower = np.asarray(np.linalg.cholesky(covariance))
        whiten, std, unwhiten = dtrtri(lower, lower=1)[0], np.sqrt(np.diag(covariance)), None
        half_log_det = float(np.log(np.diag(lower)).sum())
        if is_relative:
            ones = whiten.sum(axis=1)
            half_log_det += 0.5 * float(np.log(ones @ ones))
            complement = np.linalg.qr(ones[:, None], mode="complete")[0][:, 1:]
            whiten, unwhiten = complement.T @ whiten, lower @ complement
            std = np.sqrt(np.sum(unwhiten**2, axis=1))
        # functions may depend on each other, as levels' do on the constant: no row may be made of rounding
        q, size, along = np.linalg.svd(whiten @ functions, full_matrices=False)
        kept = size > _ROUNDING * size.max(initial=0.0)
        r = size[kept, None] * along[kept]
        return Layout(levels, functions, whiten, q[:, kept], r, std, half_log_det, unwhiten)
