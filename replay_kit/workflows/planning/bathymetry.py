"""Depth of the bottom from NetCDF, under the names and signs of GEBCO, ETOPO, NEMO and ROMS files; on a grid and under tracks."""

# xarray, which is slow to load, is needed for a file alone
from __future__ import annotations

import math
from collections.abc import Hashable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from planners.hazards.bottom import Bathymetry
from replay_kit.core.arrays import Array
from replay_kit.core.errors import ForecastError
from replay_kit.core.geodesy import inside_grid, to_local, unwrap_longitude
from replay_kit.core.grid import Grid, Projection, Seabed
from replay_kit.core.inputs import exceeds_claim, open_input, unpacking
from replay_kit.core.quantities import metres

if TYPE_CHECKING:
    import xarray as xr

# Standard names before the short ones: of models (NEMO: deptho, Bathymetry, bathy_metry; ROMS: h), positive down.
_DEPTHS = (
    "sea_floor_depth_below_sea_surface",
    "sea_floor_depth_below_geoid",
    "sea_floor_depth_below_mean_sea_level",
    "model_sea_floor_depth_below_geoid",
    "sea_floor_depth",
    "deptho",
    "bathymetry",
    "bathy_metry",
    "bathy_meter",
    "depth",
    "h",
)
# Of the world's grids (GEBCO: elevation; ETOPO: z, Band1), positive up.
_HEIGHTS = (
    "height_above_mean_sea_level",
    "height_above_geoid",
    "surface_altitude",
    "elevation",
    "altitude",
    "z",
    "topo",
    "band1",
)
# Of the water's surface above the level that depths are counted from, positive up (NEMO: zos; ROMS: zeta).
_LEVELS = (
    "sea_surface_height_above_geoid",
    "sea_surface_height_above_mean_sea_level",
    "water_surface_height_above_reference_datum",
    "zos",
    "zeta",
    "ssh",
)
_LONGITUDES = ("longitude", "lon", "nav_lon", "lon_rho", "x")
_LATITUDES = ("latitude", "lat", "nav_lat", "lat_rho", "y")
# Points kept beyond the ends of a region; and looked at together, about.
_BEYOND, _TOGETHER = 2, 20_000


def read_bathymetry(path: Path, region: Grid) -> Bathymetry:
    """Return the depth of the bottom in a NetCDF file, around a region: no more of a grid of the world is read.

    It is found by its standard name, or else by its name. The attribute ``positive`` decides the sign; without it names of heights are
    positive up and names of depths positive down. Depths are metres where no unit is stated. Where the file has the level of the water at
    some times, the lowest counts. Land by ``mask_rho`` of ROMS is unknown depth.

    Args:
        path: The file.
        region: Where the depth is wanted.

    Raises:
        ForecastError: There is no such variable on longitude and latitude, its unit is not one of length, or it holds no water.
    """
    import h5py
    import xarray as xr

    try:
        open_input(path).close()
        # of a root that is damaged h5netcdf leaves a file half open, which is complained of later
        with h5py.File(path, "r") as file:
            arrays = [
                item for item in file.values() if isinstance(item, h5py.Dataset) and item.size
            ]
            # axes are read at once, and a chunk with any of its values
            axes = sum(item.size for item in arrays if item.ndim == 1)
            claimed = 8 * max(axes, *(math.prod(item.chunks or ()) for item in arrays), 0)
        if why := exceeds_claim(path, claimed):
            raise ForecastError(f"{path}: cannot read the bathymetry: {why}; mend the file")
        with unpacking(claimed):
            opened = xr.open_dataset(path, engine="h5netcdf", phony_dims="access")
        with opened:
            return _in_region(path, opened.squeeze(), region)
    except (
        *(OSError, ValueError, LookupError, RuntimeError, TypeError, OverflowError),
        MemoryError,
    ) as error:
        raise ForecastError(f"{path}: cannot read the bathymetry: {error}") from error


def _in_region(path: Path, dataset: xr.Dataset, region: Grid) -> Bathymetry:
    variable, up = _depth_variable(path, dataset)
    axes = [
        axis
        for axis in (_axis(dataset, variable, names) for names in (_LONGITUDES, _LATITUDES))
        if axis is not None
    ]
    if len(axes) < 2:
        raise _nothing_found(path, dataset)
    _check_claim(path, axes[0], axes[1])
    cut = _window(axes[0], axes[1], region)
    # the cut is what is read
    dataset = dataset.isel(cut)
    variable = variable.isel(cut)
    _check_claim(path, variable)
    axes = [axis.isel(cut, missing_dims="ignore") for axis in axes]
    values = _values(variable) * _scale(path, variable) * (-1.0 if up else 1.0)
    low = _lowest_water(path, dataset, variable)
    values = values if low is None else values + np.where(np.isfinite(low), low, 0.0)
    if "mask_rho" in dataset and dataset["mask_rho"].dims == variable.dims:
        values = np.where(_values(dataset["mask_rho"]) > 0.5, values, np.nan)
    # continuous where the region lies across the seam of the file
    longitude = unwrap_longitude(_values(axes[0]), float(region.longitude.mean()))
    latitude = _values(axes[1])
    if longitude.ndim == 1:
        # depths lie along the axes in the order of their dimensions
        values = values if variable.dims[0] == axes[1].dims[0] else values.T
        longitude, latitude = np.meshgrid(longitude, latitude)
    if not np.any(values > 0.0):
        raise ForecastError(
            f"{path}: {variable.name} as a {'height, positive up' if up else 'depth, positive down'}, has no water; give it the attribute "
            f'positive = "{"down" if up else "up"}" if its sign is the other one'
        )
    lowest = None if low is None else (float(np.nanmin(low)), float(np.nanmax(low)))
    return Bathymetry(longitude, latitude, values, lowest)


def _values(array: xr.DataArray) -> Array:
    """Return the values of a part of a file."""
    # xarray loads slowly: without a file it is not needed
    from replay_kit.forecast.variables import unpacked

    return unpacked(array).astype(float)


def _check_claim(path: Path, *arrays: xr.DataArray) -> None:
    """Raise ForecastError where arrays are larger than the file can be meant to hold."""
    if why := exceeds_claim(path, sum(8 * array.size for array in arrays)):
        raise ForecastError(f"{path}: cannot read {arrays[0].name}: {why}; mend the file")


def _lowest_water(path: Path, dataset: xr.Dataset, depth: xr.DataArray) -> Array | None:
    """Return the lowest level of the water at any time, of the shape of the depths [m]; None where the file has none on their points."""
    for wanted in _LEVELS:
        for name, level in dataset.data_vars.items():
            called = wanted in (str(level.attrs.get("standard_name", "")), str(name).lower())
            if called and set(depth.dims) <= set(level.dims):
                _check_claim(path, level)
                times = _values(level.transpose(..., *depth.dims)).reshape(-1, *depth.shape)
                low = np.fmin.reduce(times, axis=0) * _scale(path, level)
                return low if np.isfinite(low).any() else None
    return None


def _window(longitude: xr.DataArray, latitude: xr.DataArray, region: Grid) -> dict[Hashable, Any]:
    """Return what to keep of each dimension: the points in a region, and two beyond."""
    x = unwrap_longitude(_values(longitude), float(region.longitude.mean()))
    y = _values(latitude)
    ends = [
        (float(values.min()), float(values.max())) for values in (region.longitude, region.latitude)
    ]
    if longitude.ndim == 1:
        return {
            axis.dims[0]: _between(values, *end)
            for axis, values, end in zip((longitude, latitude), (x, y), ends, strict=True)
        }
    inside = np.ones(longitude.shape, dtype=bool)
    for values, (least, most) in zip(
        (x, y.T if latitude.dims != longitude.dims else y), ends, strict=True
    ):
        inside &= (values >= least) & (values <= most)
    if not inside.any():
        return {}
    each = (np.flatnonzero(inside.any(axis=axis)) for axis in (1, 0))
    return {
        name: slice(max(at[0] - _BEYOND, 0), at[-1] + 1 + _BEYOND)
        for name, at in zip(longitude.dims, each, strict=True)
    }


def _between(values: Array, least: float, most: float) -> Any:
    """Return the positions of the values between two, and of two beyond on each side, in their order; a slice where they are in a row."""
    order = np.argsort(values, kind="stable")
    first = int(np.searchsorted(values[order], least))
    last = int(np.searchsorted(values[order], most, side="right"))
    first = min(max(first - _BEYOND, 0), max(values.size - 2, 0))
    kept = order[first : max(last + _BEYOND, first + 2)]
    low, high = int(kept.min()), int(kept.max())
    # in the order of the file, unless the region lies across its seam
    return slice(low, high + 1) if high - low + 1 == kept.size else kept


def bathymetry_notes(bathymetry: Bathymetry, grid: Grid) -> tuple[str, ...]:
    """Return what about a bathymetry a user of it in a region should know: gaps, cells wider than the forecast's, water not covered."""
    east, north = to_local(grid.projection, bathymetry.longitude, bathymetry.latitude)
    known, notes = np.isfinite(east) & np.isfinite(north), list[str]()
    # some rows at a time: each of their points takes the room of many
    rows = np.array_split(np.arange(len(known)), 1 + known.size // _TOGETHER)
    east_of, north_of = (np.where(known, axis, np.inf) for axis in (east, north))
    inside = known & np.concatenate([inside_grid(grid, east_of[at], north_of[at]) for at in rows])
    if bathymetry.lowest_water is not None:
        low, high = bathymetry.lowest_water
        notes.append(
            f"the bottom counts as deep as at the file's lowest water, {low:.1f} to {high:.1f} m above the level of its depths"
        )
    gaps = int(np.sum(inside & np.isnan(bathymetry.depth)))
    if gaps:
        notes.append(
            f"the bathymetry has no depth at {gaps} of its {int(inside.sum())} points in the region; they count as land"
        )
    spacing, cells = (
        np.median(np.hypot(np.diff(x, axis=1), np.diff(y, axis=1)))
        for x, y in ((east, north), (grid.east, grid.north))
    )
    if spacing > 1.05 * cells:
        notes.append(
            f"the bathymetry's points are {spacing / 1e3:.1f} km apart, wider than the forecast's, {cells / 1e3:.1f} km; between four of "
            "them the shallowest counts"
        )
    west = unwrap_longitude(grid.longitude, float(bathymetry.longitude.mean()))
    covered = (bathymetry.longitude, west), (bathymetry.latitude, grid.latitude)
    if any(
        theirs.min() < ours.min() - 1e-9 or theirs.max() > ours.max() + 1e-9
        for ours, theirs in covered
    ):
        notes.append("the bathymetry does not cover all of the region; missions keep inside of it")
    return tuple(notes)


def _depth_variable(path: Path, dataset: xr.Dataset) -> tuple[xr.DataArray, bool]:
    """Return the variable of depths or heights, and whether it is positive up."""
    planes = {name: variable for name, variable in dataset.data_vars.items() if variable.ndim == 2}
    for wanted in (*_DEPTHS, *_HEIGHTS):
        for name, variable in planes.items():
            if wanted in (str(variable.attrs.get("standard_name", "")).lower(), str(name).lower()):
                positive = str(
                    variable.attrs.get("positive", "up" if wanted in _HEIGHTS else "down")
                ).lower()
                if positive not in ("up", "down"):
                    raise ForecastError(
                        f"{path}: {name} has the attribute positive = {positive!r}; expected up or down"
                    )
                return variable, positive == "up"
    raise _nothing_found(path, dataset)


def _nothing_found(path: Path, dataset: xr.Dataset) -> ForecastError:
    found = ", ".join(map(str, dataset.variables))
    return ForecastError(
        f"{path}: expected one of {', '.join((*_DEPTHS, *_HEIGHTS))} on longitude and latitude, found {found}"
    )


def _axis(
    dataset: xr.Dataset, variable: xr.DataArray, names: tuple[str, ...]
) -> xr.DataArray | None:
    """Return the longitudes or latitudes of a variable; x and y only where they are degrees."""
    for wanted in names:
        for name in dataset.variables:
            axis = dataset[name]
            called = wanted in (str(axis.attrs.get("standard_name", "")).lower(), str(name).lower())
            degrees = len(wanted) > 1 or str(axis.attrs.get("units", "")).lower().startswith(
                "degree"
            )
            if called and degrees and axis.ndim > 0 and set(axis.dims) <= set(variable.dims):
                return axis
    return None


def _scale(path: Path, variable: xr.DataArray) -> float:
    """Return the metres of a variable's unit."""
    unit = str(variable.attrs.get("units", "m")).strip().lower()
    if (found := metres(unit)) is None:
        raise ForecastError(
            f"{path}: {variable.name} is in {unit!r}; expected metres, km, cm or ft"
        )
    return found


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
    # loads slowly, and a plan without a bathymetry needs none
    from scipy.interpolate import LinearNDInterpolator

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
