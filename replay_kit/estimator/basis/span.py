"""The least error of a basis: the residual of a velocity after its least-squares fit by the basis."""

import numpy as np
import scipy.linalg

from replay_kit.core.arrays import Array


def fit_residual(design: Array, values: Array) -> Array:
    """Return values, shape (n,), minus their least-squares fit by the columns of a design, shape (n, m)."""
    solution = scipy.linalg.lstsq(design, values, cond=1e-10, lapack_driver="gelsd")[0]
    return np.asarray(values - design @ solution)
