"""Whether a path keeps clear of land and areas, checked independently of the planner."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_geographic, to_local
from replay_kit.core.grid import Grid
from replay_kit.studies.twins.reachable import Pair, in_water

Polygon = tuple[tuple[float, float], ...]
# Distance between the points that are checked [m].
SPACING = 10.0


def corners_of(grid: Grid, polygon: Polygon) -> Array:
    """Return the corners of a polygon of longitudes and latitudes in a grid's local frame, shape (n, 2) [m]."""
    return np.column_stack(to_local(grid.projection, *np.array(polygon).T))


def polygon_of(grid: Grid, corners: Array) -> Polygon:
    """Return the longitudes and latitudes of corners in a grid's local frame, shape (n, 2) [m]."""
    longitude, latitude = to_geographic(grid.projection, *corners.T)
    return tuple((float(x), float(y)) for x, y in zip(longitude, latitude, strict=True))


def ends_of(grid: Grid, pair: Pair) -> Array:
    """Return start and goal in a grid's local frame, shape (2, 2) [m]."""
    return corners_of(grid, tuple((end.longitude, end.latitude) for end in (pair.start, pair.target)))


def winds_around(corners: Array, points: Array) -> NDArray[np.bool_]:
    """Return which points, shape (n, 2), a polygon winds around, by the sum of the angles that its edges are seen under.

    Args:
        corners: shape (m, 2), the first not repeated.
        points: shape (n, 2).
    """
    total = np.zeros(len(points))
    for begin, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        (x0, y0), (x1, y1) = (begin - points).T, (end - points).T
        total += np.arctan2(x0 * y1 - y0 * x1, x0 * x1 + y0 * y1)
    return np.asarray(np.abs(total) > np.pi)


def densely(track: Array, spacing: float = SPACING) -> Array:
    """Return a path, shape (n, d) [m], with points between so that none are farther apart than a spacing [m]."""
    pieces = np.maximum(np.ceil(np.linalg.norm(np.diff(track, axis=0), axis=1) / spacing).astype(int), 1)
    number = np.concatenate([[0.0], *(i + np.arange(1, n + 1) / n for i, n in enumerate(pieces))])
    return np.column_stack([np.interp(number, np.arange(len(track)), values) for values in track.T])


def crossed(grid: Grid, areas: Sequence[Polygon], track: Array) -> str | None:
    """Return what a path, shape (n, 3) [m], goes through: ``land`` (or out of the grid), ``area``; None when it keeps clear."""
    dense = densely(track)
    longitude, latitude = to_geographic(grid.projection, dense[:, 0], dense[:, 1])
    if not in_water(grid, longitude[:, None], latitude[:, None], dense[:, 2:])[0]:
        return "land"
    inside = [winds_around(corners_of(grid, area), dense[:, :2]).any() for area in areas]
    return "area" if any(inside) else None
