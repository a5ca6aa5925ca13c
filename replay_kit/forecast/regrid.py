"""Fields from one grid to another: bilinear in the cells of any orthogonal grid, linear in depth; functions of arrays."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from replay_kit.core.arrays import Array

_STEPS = 12


def find_cells(
    east: Array, north: Array, at_east: Array, at_north: Array
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return the fractional indices (j, i) of points in a curvilinear grid, and which points lie in it.

    The nearest node starts a Newton iteration on the bilinear map of the cell.

    Args:
        east: Of the nodes [m], shape (J, I).
        north: Of the nodes [m], shape (J, I).
        at_east: Of the points [m], any shape.
        at_north: Of the points [m], the same shape.
    """
    ny, nx = east.shape
    _, nearest = cKDTree(np.column_stack([east.ravel(), north.ravel()])).query(
        np.column_stack([at_east.ravel(), at_north.ravel()])
    )
    j, i = (
        index.astype(np.float64).reshape(at_east.shape)
        for index in np.unravel_index(nearest, east.shape)
    )
    miss = np.zeros_like(j)
    for _ in range(_STEPS):
        (e, e_j, e_i), (n, n_j, n_i) = _mapped(east, j, i), _mapped(north, j, i)
        d_e, d_n = at_east - e, at_north - n
        determinant = e_j * n_i - e_i * n_j
        miss = np.hypot(d_e, d_n) / np.sqrt(np.abs(determinant))
        j = np.clip(j + (d_e * n_i - d_n * e_i) / determinant, 0.0, ny - 1.0)
        i = np.clip(i + (d_n * e_j - d_e * n_j) / determinant, 0.0, nx - 1.0)
    return j, i, miss < 1e-3


def _mapped(values: Array, j: Array, i: Array) -> tuple[Array, Array, Array]:
    """Return the bilinear interpolation of values at fractional indices, and its derivatives with them."""
    low_j = np.minimum(j.astype(np.intp), values.shape[0] - 2)
    low_i = np.minimum(i.astype(np.intp), values.shape[1] - 2)
    s, t = j - low_j, i - low_i
    a, b = values[low_j, low_i], values[low_j, low_i + 1]
    c, d = values[low_j + 1, low_i], values[low_j + 1, low_i + 1]
    return (
        (1 - s) * ((1 - t) * a + t * b) + s * ((1 - t) * c + t * d),
        (1 - t) * (c - a) + t * (d - b),
        (1 - s) * (b - a) + s * (d - c),
    )


def bilinear(values: Array, j: Array, i: Array, inside: NDArray[np.bool_]) -> Array:
    """Return fields at fractional indices, shape (..., *points); NaN outside, and where less than half of the cell's weight is water.

    Args:
        values: shape (..., J, I), NaN on land.
        j: Of the points.
        i: Of the points.
        inside: Which points lie in the grid.
    """
    low_j = np.minimum(j.astype(np.intp), values.shape[-2] - 2)
    low_i = np.minimum(i.astype(np.intp), values.shape[-1] - 2)
    s, t = j - low_j, i - low_i
    total, weight = (
        np.zeros((*values.shape[:-2], *j.shape)),
        np.zeros((*values.shape[:-2], *j.shape)),
    )
    for dj, along_j in ((0, 1.0 - s), (1, s)):
        for di, along_i in ((0, 1.0 - t), (1, t)):
            corner = values[..., low_j + dj, low_i + di]
            share = np.where(np.isfinite(corner), along_j * along_i, 0.0)
            total += share * np.nan_to_num(corner)
            weight += share
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(inside & (weight >= 0.5), total / weight, np.nan)


def to_levels(values: Array, levels: Array, wanted: Array) -> Array:
    """Return fields at other depths, shape (..., L, J, I): linear between levels, constant above the first, NaN below the last.

    Args:
        values: shape (..., Z, J, I).
        levels: shape (Z,) [m], increasing.
        wanted: shape (L,) [m].
    """
    if levels.size == 1:
        return np.where((wanted <= levels[0] + 1e-6)[:, None, None], values, np.nan)
    upper = np.clip(np.searchsorted(levels, wanted, side="right") - 1, 0, levels.size - 2)
    share = np.clip((wanted - levels[upper]) / (levels[upper + 1] - levels[upper]), 0.0, 1.0)[
        :, None, None
    ]
    # a weight of zero on a dry level leaves the other as it is
    low, high = values[..., upper, :, :], values[..., upper + 1, :, :]
    found = np.where(
        share == 0.0, low, np.where(share == 1.0, high, (1.0 - share) * low + share * high)
    )
    return np.where((wanted <= levels[-1] * (1.0 + 1e-6))[:, None, None], found, np.nan)
