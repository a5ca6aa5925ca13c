"""Transformation between geographic coordinates and the local east-north frame, of positions and vectors.

The local frame is the azimuthal equidistant projection (WGS84) about a region's centre. Away from the centre its axes deviate from true
east and north by the meridian convergence, by which vectors are rotated.
"""

from collections.abc import Callable
from functools import cache, lru_cache, partial
from math import atan, cos, radians, sin, sqrt, tan
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from replay_kit.core.arrays import Array, Indices, Mask
from replay_kit.core.grid import Grid, Projection

if TYPE_CHECKING:
    from pyproj import Geod, Proj

# WGS84: equatorial radius [m], flattening, squared eccentricity
_RADIUS, _FLATTENING = 6_378_137.0, 1.0 / 298.257223563
_ECCENTRICITY = 1.0 - (1.0 - _FLATTENING) ** 2


@cache
def ellipsoid() -> "Geod":
    """Return the geodesics of WGS84."""
    # loads slowly, and commands that show a result project nothing
    from pyproj import Geod

    return Geod(ellps="WGS84")


# each vehicle of an array has some of its own
@lru_cache(maxsize=256)
def _proj(projection: Projection) -> "Proj":
    from pyproj import Proj

    return Proj(
        proj="aeqd", lat_0=projection.latitude, lon_0=projection.longitude, ellps="WGS84", units="m"
    )


def to_local(
    projection: Projection, longitude: ArrayLike, latitude: ArrayLike
) -> tuple[Array, Array]:
    """Return local (east, north) [m] of geographic positions [degrees] in any longitude convention; shapes are kept."""
    place: Any = longitude, latitude
    project: Callable[..., tuple[Any, ...]] = _proj(projection)
    if not (isinstance(longitude, float) and isinstance(latitude, float)):
        # of plain numbers an array takes longer than the projection
        place = np.asarray(longitude, dtype=np.float64), np.asarray(latitude, dtype=np.float64)
        project = partial(_shaped, project)
    # pyproj takes less than two turns; the remainder of less than one is the number itself
    east, north = project(np.fmod(place[0], 360.0), place[1])
    return np.asarray(east, dtype=np.float64), np.asarray(north, dtype=np.float64)


def to_geographic(projection: Projection, east: ArrayLike, north: ArrayLike) -> tuple[Array, Array]:
    """Return (longitude, latitude) [degrees] of local points [m]; longitudes in [-180, 180]."""
    longitude, latitude = _shaped(partial(_proj(projection), inverse=True), east, north)
    return longitude, latitude


def _shaped(function: Callable[..., tuple[Any, ...]], *values: ArrayLike) -> tuple[Array, ...]:
    """Return the results of a function of pyproj in the common shape of its arguments."""
    arguments = np.broadcast_arrays(*(np.asarray(each, np.float64) for each in values))
    # with NumPy before 2.4 it takes an array of one element for a number, and warns
    found = function(*(each.item() if each.size == 1 else each for each in arguments))
    return tuple(np.reshape(each, arguments[0].shape) for each in found)


def grid_bearing_of_true_north(
    projection: Projection, longitude: ArrayLike, latitude: ArrayLike
) -> Array:
    """Return the bearing of true north [rad], clockwise from local north; NaN where a position is NaN."""
    longitude = np.fmod(np.asarray(longitude, dtype=np.float64), 360.0)
    latitude = np.asarray(latitude, dtype=np.float64)
    known = np.isfinite(longitude) & np.isfinite(latitude)
    # pyproj takes neither no places nor places that are not numbers
    turns = np.full(known.shape, np.nan)
    if known.size == 1 and known.all():
        turns[...] = _bearing_at(projection, longitude.item(), latitude.item())
    elif known.any():
        factors = _proj(projection).get_factors(longitude[known], latitude[known])
        turns[known] = -np.deg2rad(factors.meridian_convergence)
    return turns


# all vectors of a measurement turn by the angle at its place
@lru_cache(maxsize=64)
def _bearing_at(projection: Projection, longitude: float, latitude: float) -> float:
    factors = _proj(projection).get_factors(longitude, latitude)
    return -float(np.deg2rad(factors.meridian_convergence))


def true_north_halfway(projection: Projection, begins: Array, ends: Array) -> Array:
    """Return the bearing of true north [rad], shape (L,), clockwise from local north, halfway between positions.

    With it a straight local line and a course of constant heading end at the same point to second order in their length.

    Args:
        projection: The local frame.
        begins: shape (L, 2) [m].
        ends: shape (L, 2) [m].
    """
    if len(begins) == 0:
        return np.zeros(0)
    return grid_bearing_of_true_north(
        projection, *to_geographic(projection, *(0.5 * (begins + ends)).T)
    )


def rotate_to_local(
    projection: Projection,
    longitude: ArrayLike,
    latitude: ArrayLike,
    east: ArrayLike,
    north: ArrayLike,
) -> tuple[Array, Array]:
    """Return vector components along the local axes.

    Args:
        projection: The local frame.
        longitude: Positions [degrees east].
        latitude: Positions [degrees north].
        east: Components towards true east, broadcast against the positions.
        north: Components towards true north.
    """
    return _rotate(grid_bearing_of_true_north(projection, longitude, latitude), east, north)


def rotate_to_geographic(
    projection: Projection,
    longitude: ArrayLike,
    latitude: ArrayLike,
    east: ArrayLike,
    north: ArrayLike,
) -> tuple[Array, Array]:
    """Return vector components towards true east and true north; the inverse of ``rotate_to_local``."""
    return _rotate(-grid_bearing_of_true_north(projection, longitude, latitude), east, north)


def _rotate(clockwise: Array, east: ArrayLike, north: ArrayLike) -> tuple[Array, Array]:
    cos, sin = np.cos(clockwise), np.sin(clockwise)
    east, north = np.asarray(east, dtype=np.float64), np.asarray(north, dtype=np.float64)
    return cos * east + sin * north, cos * north - sin * east


def rate_in_frame(
    projection: Projection,
    east: Any,
    north: Any,
    through_water: tuple[Any, Any],
    current: tuple[Any, Any],
) -> tuple[Any, Any]:
    """Return the rate of a vehicle's local coordinates (east, north) [m/s], for NumPy arrays and CasADi expressions.

    True north deviates from local north, and the projection stretches lengths across its radius: by 4e-4 at 300 km. Azimuths are on the
    auxiliary sphere, with the ellipsoid's radius halfway: relative error 4e-7 within 300 km at 60 degrees of latitude, 2e-6 near the pole.

    Args:
        projection: The local frame.
        east: Position of the vehicle, local [m].
        north: Position of the vehicle, local [m].
        through_water: Velocity through the water, true east and north [m/s].
        current: Current along the local axes, as from ``rotate_to_local`` [m/s].

    References:
        Karney (2013), Algorithms for geodesics, doi:10.1007/s00190-012-0578-z; Snyder (1987), USGS Professional Paper 1395, p. 195.
    """
    square = (
        _RADIUS**2
        * (1.0 - _ECCENTRICITY)
        / (1.0 - _ECCENTRICITY * sin(radians(projection.latitude)) ** 2) ** 2
    )
    # c / sin(c) - 1 of the arc c to the place, over its squared radius
    growth = (1.0 + 7.0 / 60.0 * (east * east + north * north) / square) / (6.0 * square)

    def stretched(u: Any, v: Any) -> tuple[Any, Any]:
        across = growth * (u * north - v * east)
        return u + across * north, v - across * east

    sine, cosine = _azimuth_of_true_north(projection, east, north)
    # the meridian as the projection draws it: what vectors of the local frame were turned by
    sine_drawn, cosine_drawn = stretched(sine, cosine)
    length = (sine_drawn * sine_drawn + cosine_drawn * cosine_drawn) ** 0.5
    true_east = through_water[0] + (cosine_drawn * current[0] - sine_drawn * current[1]) / length
    true_north = through_water[1] + (cosine_drawn * current[1] + sine_drawn * current[0]) / length
    return stretched(cosine * true_east + sine * true_north, cosine * true_north - sine * true_east)


def _azimuth_of_true_north(projection: Projection, east: Any, north: Any) -> tuple[Any, Any]:
    """Return sine and cosine of the bearing of true north, clockwise from local north, at local positions [m]."""
    reduced = atan((1.0 - _FLATTENING) * tan(radians(projection.latitude)))
    sine, cosine = sin(reduced), cos(reduced)
    halfway = sine + 0.5 * cosine * north / _RADIUS
    radius = _RADIUS * (1.0 - _ECCENTRICITY * (1.0 - halfway * halfway)) ** 0.5
    x, y = east / radius, north / radius
    square = x * x + y * y
    # sin(c) / c and (1 - cos(c)) / c^2 of the arc c, exact to 1e-9 within 1500 km
    first = 1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0))
    second = 0.5 * (1.0 - square / 12.0 * (1.0 - square / 30.0 * (1.0 - square / 56.0)))
    lean = y * cosine * second + sine * first
    east_part, north_part = -x * lean, cosine - y * lean
    length = (east_part * east_part + north_part * north_part) ** 0.5
    return east_part / length, north_part / length


def distance(
    longitude: ArrayLike, latitude: ArrayLike, other_longitude: ArrayLike, other_latitude: ArrayLike
) -> Array:
    """Return geodesic distances [m] on WGS84 between positions [degrees]."""
    places = longitude, latitude, other_longitude, other_latitude
    return _shaped(ellipsoid().inv, *places)[2]


def to_local_about(
    longitude: Array, latitude: Array, to_longitude: Array, to_latitude: Array
) -> tuple[Array, Array]:
    """Return east and north [m], shapes (n,), of positions in the local frames about others: ``to_local`` with a projection per row."""
    azimuth, _, metres = _shaped(ellipsoid().inv, longitude, latitude, to_longitude, to_latitude)
    angle = np.deg2rad(azimuth)
    return np.asarray(metres * np.sin(angle)), np.asarray(metres * np.cos(angle))


def to_geographic_about(
    longitude: Array, latitude: Array, east: Array, north: Array
) -> tuple[Array, Array]:
    """Return longitudes and latitudes [degrees], shapes (n,), of local points [m] about positions: ``to_geographic`` by row."""
    azimuth, metres = heading_deg(east, north), np.hypot(east, north)
    to_longitude, to_latitude, _ = _shaped(ellipsoid().fwd, longitude, latitude, azimuth, metres)
    return to_longitude, to_latitude


def heading_deg(east: ArrayLike, north: ArrayLike) -> Array:
    """Return the direction of a vector [degrees clockwise from north, in [0, 360)]."""
    return np.mod(np.rad2deg(np.arctan2(east, north)), 360.0)


def unwrap_longitude(longitude: ArrayLike, near: float) -> Array:
    """Return longitudes moved by whole turns to within 180 degrees of ``near``, so that regions may cross the antimeridian."""
    longitude = np.asarray(longitude, dtype=np.float64)
    return near + np.mod(longitude - near + 180.0, 360.0) - 180.0


def inside_grid(grid: Grid, east: ArrayLike, north: ArrayLike) -> Mask:
    """Return whether local points [m] lie inside the grid's outline or within 1 mm of it; the shape is kept."""
    return np.asarray(_contains(grid)(east, north))


@lru_cache(maxsize=8)
def _contains(grid: Grid) -> Callable[..., Any]:
    """Return the function that tests whether local points lie inside a grid's outline or within 1 mm of it."""
    # loads slowly, and many commands ask nothing of an outline
    import shapely

    polygon = shapely.Polygon(outline(grid)).buffer(1e-3, join_style="mitre")
    shapely.prepare(polygon)
    return partial(shapely.contains_xy, polygon)


def nearest_node(grid: Grid, places: Array, wet: bool = False) -> Indices:
    """Return the index of the grid point nearest to each position, shape (..., 2) [m]; of ``nodes`` with ``wet``."""
    found = _points(grid, wet)(np.nan_to_num(places).reshape(-1, 2))
    return np.asarray(found).reshape(places.shape[:-1])


def wet_above(grid: Grid, points: Array) -> Mask:
    """Return True where the nearest grid point is wet at the last level at or above points, shape (..., 3) [m]."""
    levels, at = grid.levels, nearest_node(grid, points[..., :2])
    last = np.clip(np.searchsorted(levels, points[..., 2], "right") - 1, 0, levels.size - 1)
    return np.asarray(grid.wet.reshape(levels.size, -1)[last, at])


@lru_cache(maxsize=8)
def _points(grid: Grid, wet: bool) -> Callable[[Array], Any]:
    # loads faster than scipy, whose tree is quicker
    import shapely

    points = grid.nodes if wet else np.column_stack([grid.east.ravel(), grid.north.ravel()])
    tree = shapely.STRtree(shapely.points(points))
    return lambda places: tree.nearest(shapely.points(places))


def outline(grid: Grid) -> Array:
    """Return the boundary points of the grid, shape (n, 2) [m], local east and north, the first not repeated."""
    return border(np.stack([grid.east, grid.north], axis=-1))


def border(points: Array) -> Array:
    """Return the outermost of points, shape (J, I, 2), one after the other, shape (n, 2), the first not repeated."""
    return np.concatenate([points[0, :-1], points[:-1, -1], points[-1, :0:-1], points[:0:-1, 0]])


def metres_per_degree(latitude: float) -> tuple[float, float]:
    """Return the lengths of a degree of longitude and of latitude on WGS84 [m] at a latitude [degrees north]."""
    squared = 1.0 - _ECCENTRICITY * sin(radians(latitude)) ** 2
    across = _RADIUS / sqrt(squared)
    along = across * (1.0 - _ECCENTRICITY) / squared
    return radians(across) * cos(radians(latitude)), radians(along)
