"""Components on the faces of a C-grid to cell centres, and land by values that never change; functions of arrays."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array


def to_centres(
    faces: Array, valid: NDArray[np.bool_], axis: int
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the mean of a component at the two faces of each cell, weighted by which of them are water, and whether any is.

    Args:
        faces: shape (..., n + 1, ...) [m/s]; values on dry faces count for nothing.
        valid: Water, of the same shape.
        axis: Of the faces.
    """
    first, last = (
        np.take(np.where(valid, faces, 0.0), _range(faces, axis, k), axis) for k in (0, 1)
    )
    wet = [np.take(valid, _range(faces, axis, k), axis) for k in (0, 1)]
    weight = wet[0].astype(np.float64) + wet[1]
    return (first + last) / np.maximum(weight, 1.0), weight > 0.0


def _range(faces: Array, axis: int, first: int) -> NDArray[np.intp]:
    return np.arange(first, faces.shape[axis] - 1 + first)


def never_changing(values: Array, constants: Iterable[float]) -> NDArray[np.bool_]:
    """Return where all members have the same one of some constants, shape (Z, J, I).

    Zeros count from the sea bed up, in columns that are dry there: a level that is at rest everywhere is no land.

    Args:
        values: shape (E, Z, J, I).
        constants: 0, and what a fill value becomes that packing cannot hold.
    """
    found = np.zeros(values.shape[1:], dtype=bool)
    for constant in constants:
        # unpacked in single or double precision; one step of the packing is far more
        same = np.all(np.abs(values - constant) <= 1e-6 * abs(constant), axis=0)
        if constant == 0.0:
            below = np.logical_and.accumulate(same[::-1], axis=0)[::-1]
            at_rest = same.all(axis=(1, 2), keepdims=True)
            same = np.where(at_rest, same.all(axis=0), below)
        found |= same
    return found
