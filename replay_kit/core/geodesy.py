"""Longitude and latitude to the local east-north frame and back, and the rotation of vectors between them.

The local frame is the azimuthal equidistant projection (WGS84) about a region's centre. Away from the centre its axes
are not true east and north: the angle between them is the meridian convergence, and vectors turn by it.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pyproj import Geod, Proj

from replay_kit.core.arrays import Array
from replay_kit.core.grid import Grid, Projection

_ELLIPSOID = Geod(ellps="WGS84")


@lru_cache(maxsize=64)
def _proj(projection: Projection) -> Proj:
    return Proj(proj="aeqd", lat_0=projection.latitude, lon_0=projection.longitude, ellps="WGS84", units="m")


def to_local(projection: Projection, longitude: ArrayLike, latitude: ArrayLike) -> tuple[Array, Array]:
    """Return local (east, north) [m] of places given in degrees; the shapes are kept, any longitude convention is read."""
    east, north = _proj(projection)(np.asarray(longitude, dtype=np.float64), np.asarray(latitude, dtype=np.float64))
    return np.asarray(east, dtype=np.float64), np.asarray(north, dtype=np.float64)


def to_geographic(projection: Projection, east: ArrayLike, north: ArrayLike) -> tuple[Array, Array]:
    """Return (longitude, latitude) [degrees] of local points [m]; longitudes in -180..180."""
    longitude, latitude = _proj(projection)(np.asarray(east, dtype=np.float64), np.asarray(north, dtype=np.float64), inverse=True)
    return np.asarray(longitude, dtype=np.float64), np.asarray(latitude, dtype=np.float64)


def grid_bearing_of_true_north(projection: Projection, longitude: ArrayLike, latitude: ArrayLike) -> Array:
    """Return the angle [rad], clockwise from the local north axis, in which true north points at each place; NaN where a place is NaN."""
    longitude, latitude = np.asarray(longitude, dtype=np.float64), np.asarray(latitude, dtype=np.float64)
    known = np.isfinite(longitude) & np.isfinite(latitude)
    if not known.all() or not known.size:
        # pyproj takes neither no places nor places that are not numbers
        turns = np.full(known.shape, np.nan)
        if known.any():
            turns[known] = grid_bearing_of_true_north(projection, longitude[known], latitude[known])
        return turns
    factors = _proj(projection).get_factors(longitude, latitude)
    return -np.deg2rad(np.asarray(factors.meridian_convergence, dtype=np.float64))


def rotate_to_local(
    projection: Projection, longitude: ArrayLike, latitude: ArrayLike, east: ArrayLike, north: ArrayLike
) -> tuple[Array, Array]:
    """Return vector components along the local axes.

    Args:
        projection: The local frame.
        longitude: Places [degrees].
        latitude: Places [degrees].
        east: Components towards true east, broadcast against the places.
        north: Components towards true north.
    """
    return _rotate(grid_bearing_of_true_north(projection, longitude, latitude), east, north)


def rotate_to_geographic(
    projection: Projection, longitude: ArrayLike, latitude: ArrayLike, east: ArrayLike, north: ArrayLike
) -> tuple[Array, Array]:
    """Return vector components towards true east and true north; the inverse of ``rotate_to_local``."""
    return _rotate(-grid_bearing_of_true_north(projection, longitude, latitude), east, north)


def _rotate(clockwise: Array, east: ArrayLike, north: ArrayLike) -> tuple[Array, Array]:
    cos, sin = np.cos(clockwise), np.sin(clockwise)
    east, north = np.asarray(east, dtype=np.float64), np.asarray(north, dtype=np.float64)
    return cos * east + sin * north, cos * north - sin * east


def distance(longitude: ArrayLike, latitude: ArrayLike, other_longitude: ArrayLike, other_latitude: ArrayLike) -> Array:
    """Return geodesic distances [m] on WGS84 between places given in degrees."""
    x0, y0, x1, y1 = np.broadcast_arrays(longitude, latitude, other_longitude, other_latitude)
    _, _, metres = _ELLIPSOID.inv(x0, y0, x1, y1)
    return np.asarray(metres, dtype=np.float64)


def heading_deg(east: ArrayLike, north: ArrayLike) -> Array:
    """Return the compass direction [degrees clockwise from north, in [0, 360)] that a vector points to."""
    return np.mod(np.rad2deg(np.arctan2(east, north)), 360.0)


def unwrap_longitude(longitude: ArrayLike, near: float) -> Array:
    """Return longitudes moved by whole turns to within 180 degrees of ``near``, so that regions may cross the antimeridian."""
    longitude = np.asarray(longitude, dtype=np.float64)
    return near + np.mod(longitude - near + 180.0, 360.0) - 180.0


def inside_grid(grid: Grid, east: ArrayLike, north: ArrayLike) -> NDArray[np.bool_]:
    """Return whether local points [m] lie inside the grid's outline, its edge included to a millimetre; the shape is kept."""
    ring = outline(grid)
    start, edge = ring, np.roll(ring, -1, axis=0) - ring
    east, north = np.broadcast_arrays(np.asarray(east, dtype=np.float64), np.asarray(north, dtype=np.float64))
    dx, dy = east[..., None] - start[:, 0], north[..., None] - start[:, 1]
    # even-odd rule: count the edges that a ray towards growing east crosses
    straddles = (dy >= 0.0) != (dy - edge[:, 1] >= 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        left_of = dx < dy / edge[:, 1] * edge[:, 0]
    inside = np.sum(straddles & left_of, axis=-1) % 2 == 1
    along = np.clip((dx * edge[:, 0] + dy * edge[:, 1]) / np.sum(edge**2, axis=1), 0.0, 1.0)
    to_edge = np.hypot(dx - along * edge[:, 0], dy - along * edge[:, 1]).min(axis=-1)
    return np.asarray(inside | (to_edge < 1e-3))


def wet_column(grid: Grid, east: float, north: float) -> NDArray[np.bool_]:
    """Return which levels are wet at the grid point nearest to a local point [m], shape (Z,)."""
    nearest = np.argmin((grid.east - east) ** 2 + (grid.north - north) ** 2)
    return np.asarray(grid.wet.reshape(grid.levels.size, -1)[:, nearest])


def outline(grid: Grid) -> Array:
    """Return the grid points around the grid, shape (n, 2) [m], local east and north, the first not repeated."""
    points = np.stack([grid.east, grid.north], axis=-1)
    return np.concatenate([points[0, :-1], points[:-1, -1], points[-1, :0:-1], points[:0:-1, 0]])
