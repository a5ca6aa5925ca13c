"""Fields from one grid to another: bilinear in the cells of any orthogonal grid, linear in depth; functions of arrays."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from replay_kit.core.arrays import Array

_STEPS = 12
# Water this near to a level that has no other beside it, or above the first, has its current [m].
_NEAR = 15.0


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


def reach(depths: Array, surface: Array | float = 0.0) -> tuple[Array, Array]:
    """Return between which depths levels say what the current is [m], each of the shape of one level.

    One level does for 15 m about it. Several do from the surface, where the first of them lies within 15 m or half the first spacing of it,
    else from the first, down to half the last spacing below the last.

    Args:
        depths: shape (Z, ...) [m], increasing.
        surface: Height of the surface [m]: levels that move with it do for where they are at rest, too.
    """
    moved = np.abs(surface) + 1e-6 * depths[-1]
    if len(depths) == 1:
        return depths[0] - _NEAR - moved, depths[0] + _NEAR + moved
    first, last = 0.5 * (depths[1] - depths[0]), 0.5 * (depths[-1] - depths[-2])
    # levels in the middle of layers of one thickness lie at half the spacing but for rounding
    to_surface = depths[0] + surface <= np.maximum(1.001 * first, _NEAR)
    return np.where(to_surface, -np.inf, depths[0] - moved), depths[-1] + last + moved


def at_depths(values: Array, depths: Array, within: tuple[Array, Array], wanted: Array) -> Array:
    """Return values at fixed depths, shape (..., L, J, I): linear between levels, constant beyond the first and last, NaN out of reach.

    Args:
        values: shape (..., Z, J, I).
        depths: Of the levels [m], shape (Z, J, I), increasing.
        within: The least and the greatest depth that the levels do for [m], shape (J, I) each, see ``reach``.
        wanted: shape (L,) [m].
    """
    found, last = [], len(depths) - 1
    for depth in wanted:
        upper = np.clip((depths <= depth).sum(axis=0) - 1, 0, max(last - 1, 0))
        pair = [np.minimum(upper + k, last)[None] for k in (0, 1)]
        above, below = (np.take_along_axis(depths, index, axis=0)[0] for index in pair)
        share = np.clip((depth - above) / np.where(below > above, below - above, 1.0), 0.0, 1.0)
        low, high = (
            np.take_along_axis(
                values, np.broadcast_to(index, (*values.shape[:-3], *index.shape)), axis=-3
            )[..., 0, :, :]
            for index in pair
        )
        # a weight of zero on a dry level leaves the other as it is
        mixed = np.where(
            share == 0.0, low, np.where(share == 1.0, high, (1.0 - share) * low + share * high)
        )
        found.append(np.where((within[0] <= depth) & (depth <= within[1]), mixed, np.nan))
    return np.stack(found, axis=-3)


def to_levels(values: Array, levels: Array, within: tuple[float, float], wanted: Array) -> Array:
    """Return fields at other depths, shape (..., L, J, I), as ``at_depths`` does.

    Args:
        values: shape (..., Z, J, I).
        levels: shape (Z,) [m], increasing.
        within: The least and the greatest depth that the levels of the file do for [m], of which these may be a choice.
        wanted: shape (L,) [m].
    """
    least, greatest = (np.full(values.shape[-2:], depth) for depth in within)
    return at_depths(
        values, np.broadcast_to(levels[:, None, None], values.shape[-3:]), (least, greatest), wanted
    )
