"""The directions in which rows lie: of many rows at once, and what further ones add."""

import numpy as np
import scipy.linalg

from replay_kit.core.arrays import Array

# What is left of G outside the directions is a direction above this share of G; below there is only rounding, which the modes of a
# smooth kernel amplify.
TOLERANCE = 5e-11


def directions(rows: Array) -> Array:
    """Return an orthonormal basis, shape (s, r), of the span of rows, shape (m, r), up to ``TOLERANCE`` of the longest."""
    q, r, _ = scipy.linalg.qr(rows.T, mode="economic", pivoting=True)
    size = np.abs(np.diag(r))
    return np.ascontiguousarray(q[:, size > TOLERANCE * size[0]].T)


def new_directions(directions: Array, rows: Array) -> Array:
    """Return orthonormal directions, shape (c, r), c <= 2, of what rows have outside of given ones.

    Args:
        directions: shape (s, r), orthonormal.
        rows: shape (2, r).
    """
    found = np.empty((0, rows.shape[1]))
    bound = TOLERANCE * np.linalg.norm(rows, axis=1)
    left = rows - (rows @ directions.T) @ directions
    for rest, least in zip(left, bound, strict=True):
        if np.linalg.norm(rest) > least:
            # once more, because what is left of a row that is nearly inside is mostly rounding
            rest = rest - (directions @ rest) @ directions
            rest = rest - (found @ rest) @ found
            length = np.linalg.norm(rest)
            if length > least:
                found = np.vstack([found, rest / length])
    return found
