"""Grid functions: block inside a region, rotation to local axes, interpolation to other points."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array, Values
from replay_kit.core.geodesy import (
    grid_bearing_of_true_north,
    to_geographic,
    to_local,
    unwrap_longitude,
)
from replay_kit.core.grid import Ensemble, Grid, Projection
from replay_kit.forecast.names import Axes


def centre_longitude(longitude: Array) -> float:
    """Return the central longitude [degrees], also across the antimeridian."""
    radians = np.deg2rad(longitude)
    mean = np.rad2deg(np.arctan2(np.mean(np.sin(radians)), np.mean(np.cos(radians))))
    unwrapped = unwrap_longitude(longitude, float(mean))
    return float(unwrap_longitude(0.5 * (unwrapped.min() + unwrapped.max()), 0.0))


_STEPS = 12
Index = NDArray[np.int64]


def index_runs(index: Index) -> list[slice]:
    """Return positions as slices of successive ones, which are read faster."""
    cuts = np.flatnonzero(np.diff(index) != 1) + 1
    return [slice(int(run[0]), int(run[-1]) + 1) for run in np.split(index, cuts)]


def region_block(
    longitude: Array, latitude: Array, region: tuple[float, float, float, float]
) -> tuple[Index, Index] | None:
    """Return the rows and columns of the smallest block with all grid points inside a region; None without any.

    Columns are in their order in space, also where the region crosses the seam of a global grid.

    Args:
        longitude: Longitude [degrees east], shape (J, I), or (I,) for a separable grid.
        latitude: Latitude [degrees north], shape (J, I) or (J,).
        region: West, south, east, north [degrees]; west > east crosses the antimeridian.
    """
    west, south, east, north = region
    width = (east - west) % 360.0 or 360.0
    # a tolerance of some 10 m, because file coordinates are often float32
    inside_x = np.mod(longitude - west + 1e-4, 360.0) <= width + 2e-4
    inside_y = (latitude >= south - 1e-4) & (latitude <= north + 1e-4)
    if longitude.ndim == 2:
        inside = inside_x & inside_y
        inside_y, inside_x = (np.asarray(inside.any(axis=axis)) for axis in (1, 0))
    rows, found = np.flatnonzero(inside_y), np.flatnonzero(inside_x)
    if rows.size == 0 or found.size == 0:
        return None
    count, columns = longitude.shape[-1], np.arange(found[0], found[-1] + 1)
    gaps = np.diff(found)
    if gaps.size and gaps.max() > count - columns.size + 1 and columns_round(longitude) == count:
        split = int(np.argmax(gaps))
        columns = np.r_[found[split + 1] : count, 0 : found[split] + 1]
    return np.arange(rows[0], rows[-1] + 1), columns


def columns_round(longitude: Array) -> int | None:
    """Return the number of columns round the globe; None for a regional grid.

    The last of them adjoins the first. Columns after it repeat the first ones: ORCA grids have two of these, others one.

    Args:
        longitude: Longitude [degrees east], shape (J, I), or (I,) for a separable grid.
    """
    row = longitude if longitude.ndim == 1 else longitude[longitude.shape[0] // 2]
    step = float(np.median((np.diff(row) + 180.0) % 360.0 - 180.0))
    for count in range(row.size, max(row.size - 3, 1), -1):
        seam = float((row[0] - row[count - 1] + 180.0) % 360.0 - 180.0)
        if 0.0 < seam * step < 2.0 * step**2:
            return count
    return None


def projection_of(longitude: Array, latitude: Array) -> Projection:
    """Return the local frame about the centre of positions [degrees]."""
    return Projection(centre_longitude(longitude), 0.5 * float(latitude.min() + latitude.max()))


def local_grid(
    longitude: Array,
    latitude: Array,
    levels: Array,
    wet: NDArray[np.bool_],
    place_at: tuple[float, float] | None,
) -> Grid:
    """Return the grid in a local frame about its centre.

    Args:
        longitude: Longitude [degrees east], shape (J, I).
        latitude: Latitude [degrees north], shape (J, I).
        levels: Depths of the levels [m], shape (Z,).
        wet: Water points, shape (Z, J, I).
        place_at: New (longitude, latitude) of the grid's centre, distances kept; None leaves it.
    """
    projection = projection_of(longitude, latitude)
    longitude = unwrap_longitude(longitude, projection.longitude)
    east, north = to_local(projection, longitude, latitude)
    if place_at is not None:
        projection = Projection(*place_at)
        longitude, latitude = to_geographic(projection, east, north)
        longitude = unwrap_longitude(longitude, place_at[0])
    return Grid(projection, longitude, latitude, east, north, levels, wet)


def turn_to_local(
    projection: Projection, longitude: Array, latitude: Array, axes: Axes
) -> NDArray[np.complex128]:
    """Return the rotation from true east, or a grid's first axis, to the first local axis, as complex numbers, shape (J, I).

    A grid's first axis is that of growing i; the second is 90 degrees anticlockwise of it, as in the orthogonal curvilinear grids of
    ocean models.
    """
    if axes == "true":
        clockwise = grid_bearing_of_true_north(projection, longitude, latitude)
        return np.asarray(np.cos(clockwise) - 1j * np.sin(clockwise))
    east, north = to_local(projection, unwrap_longitude(longitude, projection.longitude), latitude)
    along = np.gradient(east, axis=1) + 1j * np.gradient(north, axis=1)
    return np.asarray(along / np.abs(along))


def turned_velocity(
    velocity: Values, turn: NDArray[np.complex128], out: Values | None = None
) -> Values:
    """Return rotated velocities, shape (E, 2, Z, J, I), computed in double precision; ``out`` may be the input itself."""
    out = np.empty_like(velocity) if out is None else out
    cos, sin = turn.real, turn.imag
    for member, found in zip(velocity, out, strict=True):
        found[0], found[1] = member[0] * cos - member[1] * sin, member[0] * sin + member[1] * cos
    return out


def in_frame(ensemble: Ensemble, projection: Projection) -> Ensemble:
    """Return an ensemble in another local frame, with unchanged positions and velocities along its axes."""
    grid = ensemble.grid
    east, north = to_local(projection, grid.longitude, grid.latitude)
    turn, other = (
        turn_to_local(frame, grid.longitude, grid.latitude, "true")
        for frame in (grid.projection, projection)
    )
    return replace(
        ensemble,
        grid=replace(grid, projection=projection, east=east, north=north),
        velocity=turned_velocity(ensemble.velocity, other * turn.conj()),
    )


def find_cells(
    east: Array, north: Array, at_east: Array, at_north: Array
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return the fractional indices (j, i) of points in a curvilinear grid, and whether they lie inside.

    The nearest node starts a Newton iteration on the bilinear map of the cell.

    Args:
        east: East of the nodes [m], shape (J, I).
        north: North of the nodes [m], shape (J, I).
        at_east: East of the points [m], any shape.
        at_north: North of the points [m], same shape.
    """
    # loads slowly, and forecasts on one regular grid need none
    from scipy.spatial import cKDTree

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
    """Return bilinearly interpolated values at fractional indices, and their derivatives by j and i."""
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


def bilinear(values: Values, j: Array, i: Array, inside: NDArray[np.bool_]) -> Array:
    """Return fields at fractional indices, shape (..., *points); NaN outside, and if water has less than half of the weight.

    Args:
        values: Fields, NaN on land, shape (..., J, I).
        j: Fractional row of the points.
        i: Fractional column of the points.
        inside: Whether the points lie in the grid.
    """
    low_j = np.minimum(j.astype(np.intp), values.shape[-2] - 2)
    low_i = np.minimum(i.astype(np.intp), values.shape[-1] - 2)
    s, t = j - low_j, i - low_i
    total = np.zeros((*values.shape[:-2], *j.shape))
    weight = np.zeros((*values.shape[:-2], *j.shape))
    for dj, along_j in ((0, 1.0 - s), (1, s)):
        for di, along_i in ((0, 1.0 - t), (1, t)):
            corner = values[..., low_j + dj, low_i + di]
            share = np.where(np.isfinite(corner), along_j * along_i, 0.0)
            total += share * np.nan_to_num(corner)
            weight += share
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(inside & (weight >= 0.5), total / weight, np.nan)
