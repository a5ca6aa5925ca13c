"""The bottom as results hold it: around a region on a grid, and under the track of a plan."""

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator

from planners import Bathymetry
from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_local
from replay_kit.core.grid import Grid, Projection, Seabed

# Most cells along a side of the grid, and points of a bathymetry along a side between which depths are interpolated.
_CELLS, _POINTS = 160, 400


def seabed_of(bathymetry: Bathymetry, region: Grid) -> Seabed:
    """Return a bathymetry on a regular grid around a region, no finer than its own points, linear between them.

    Args:
        bathymetry: Of the region.
        region: What the grid covers.
    """
    east, north = to_local(region.projection, bathymetry.longitude, bathymetry.latitude)
    spacing = float(np.median(np.hypot(np.diff(east, axis=1), np.diff(north, axis=1))))
    axes = []
    for values in (region.east, region.north):
        least, most = float(values.min()), float(values.max())
        axes.append(np.linspace(least, most, int(np.clip((most - least) / spacing + 1, 2, _CELLS))))
    return Seabed(axes[0], axes[1], _depth_at(bathymetry, region.projection, *np.meshgrid(*axes)))


def depth_along(bathymetry: Bathymetry, projection: Projection, track: Array) -> Array:
    """Return the depth of the bottom under a track, linear between the points of a bathymetry, shape (n,) [m]; NaN where unknown.

    Args:
        bathymetry: The bottom.
        projection: The local frame.
        track: shape (n, 3) [m], local east, north, depth.
    """
    return _depth_at(bathymetry, projection, track[:, 0], track[:, 1])


def _depth_at(bathymetry: Bathymetry, projection: Projection, east: Array, north: Array) -> Array:
    if east.size == 0:
        return np.full(east.shape, np.nan)
    points = np.stack(to_local(projection, bathymetry.longitude, bathymetry.latitude), axis=-1)
    wanted = np.stack([east, north], axis=-1)
    cut = _around(points, wanted.reshape(-1, 2))
    near, depth = points[cut].reshape(-1, 2), bathymetry.depth[cut].ravel()
    return np.asarray(LinearNDInterpolator(near, depth)(wanted))


def _around(points: Array, wanted: Array) -> tuple[NDArray[np.intp], ...]:
    """Return the rows and columns of points, shape (J, I, 2) [m], around those wanted, shape (n, 2) [m]; thinned where too many."""
    beyond = 2.0 * max(
        float(np.nanmax(np.linalg.norm(np.diff(points, axis=axis), axis=-1))) for axis in (0, 1)
    )
    inside = np.all(
        (points >= wanted.min(axis=0) - beyond) & (points <= wanted.max(axis=0) + beyond), axis=-1
    )
    inside |= not inside.any()
    each = [np.flatnonzero(inside.any(axis=axis)) for axis in (1, 0)]
    return np.ix_(
        *(
            np.unique(
                np.rint(np.linspace(at[0], at[-1], min(at[-1] - at[0] + 1, _POINTS))).astype(
                    np.intp
                )
            )
            for at in each
        )
    )
