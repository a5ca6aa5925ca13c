"""Orthonormal directions spanned by rows: of many rows at once, and the new ones of further rows."""

import numpy as np
import scipy.linalg

from replay_kit.core.arrays import Array
from replay_kit.estimator.prior.hybrid import Prior

# A residual of G outside the directions is a new direction above this share of G; below it there is only rounding, which the modes of a
# smooth kernel amplify.
TOLERANCE = 5e-11


def directions(rows: Array) -> Array:
    """Return an orthonormal basis, shape (s, r), of the span of rows, shape (m, r), up to ``TOLERANCE`` of the longest."""
    q, r, _ = scipy.linalg.qr(rows.T, mode="economic", pivoting=True)
    size = np.abs(np.diag(r))
    return np.ascontiguousarray(q[:, size > TOLERANCE * size[0]].T)


def new_directions(directions: Array, rows: Array) -> Array:
    """Return orthonormal directions, shape (c, r), c <= 2, of the rows' components outside given directions.

    Args:
        directions: shape (s, r), orthonormal.
        rows: shape (2, r).
    """
    found = np.empty((0, rows.shape[1]))
    bound = TOLERANCE * np.linalg.norm(rows, axis=1)
    residual = rows - (rows @ directions.T) @ directions
    for row, least in zip(residual, bound, strict=True):
        if np.linalg.norm(row) > least:
            # project twice: the residual of a row that is nearly inside the span is mostly rounding
            row = row - (directions @ row) @ directions
            row = row - (found @ row) @ found
            length = np.linalg.norm(row)
            if length > least:
                found = np.vstack([found, row / length])
    return found


def nonzero_mode_std(prior: Prior) -> Array:
    """Return the prior standard deviation of the modes' weights, shape (r,), with zeros replaced by 1e-12 of the largest."""
    std = prior.mode_std()
    return np.asarray(np.maximum(std, 1e-12 * std.max() or 1.0))
