"""Bathymetry from NetCDF with the names and signs of GEBCO, ETOPO, NEMO and ROMS; on a grid and under tracks."""

# xarray, which is slow to load, is needed for a file alone
from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from planners.hazards.bottom import Bathymetry
from replay_kit.core.arrays import Array
from replay_kit.core.errors import ForecastError
from replay_kit.core.files.inputs import exceeds_claim
from replay_kit.core.geodesy import to_local, unwrap_longitude
from replay_kit.core.grid import Grid, Projection, Seabed
from replay_kit.core.region import bounds_of
from replay_kit.core.region import inside as within
from replay_kit.core.words.quantities import metres

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
# Spacings of a file's points kept beyond the ends of a region.
_BEYOND = 2.0


def read_bathymetry(path: Path, region: Grid) -> Bathymetry:
    """Return the bottom depth in a NetCDF file or Zarr store; only the surroundings of a region are read.

    The variable is found by standard name, or else by name. The attribute ``positive`` decides the sign; without it heights are positive up
    and depths down. Units are metres. Of water levels at several times the lowest is used. Land in ``mask_rho`` of ROMS
    is unknown depth.

    Args:
        path: The file.
        region: Region in which the depth is needed.

    Raises:
        ForecastError: No such variable on longitude and latitude exists, its unit is not a length, or it has no water.
    """
    # loads xarray
    from replay_kit.forecast.files import opened_file

    try:
        with opened_file(path) as dataset:
            return _in_region(path, dataset.squeeze(), region)
    except (
        OSError,
        ValueError,
        LookupError,
        RuntimeError,
        TypeError,
        OverflowError,
        MemoryError,
    ) as error:
        raise ForecastError(f"{path}: cannot read the bathymetry: {error}") from error


def _in_region(path: Path, dataset: xr.Dataset, region: Grid) -> Bathymetry:
    from replay_kit.forecast.names import find_coordinates

    wanted = (*_DEPTHS, *_HEIGHTS)
    found, names = next(_named(dataset, wanted, lambda one: one.ndim == 2), None), list[str]()
    if found is not None:
        dataset = dataset.rename(_degrees(dataset))
        with suppress(ForecastError):
            *names, _ = find_coordinates(dataset, dataset[found[1].name].dims, str(path))
    if found is None or not names:
        there = ", ".join(map(str, dataset.variables))
        raise ForecastError(
            f"{path}: expected one of {', '.join(wanted)} on longitude and latitude, found {there}"
        )
    name, variable = found[0], dataset[found[1].name]
    axes = [dataset[one] for one in names]
    up, flat = _is_up(path, variable, name), axes[0].ndim == 1
    dims = (axes[1].dims[0], axes[0].dims[0]) if flat else variable.dims
    variable = variable.transpose(*dims)
    axes = axes if flat else [axis.transpose(*dims) for axis in axes]
    cut = dict(zip(dims, _window(_values(axes[0]), _values(axes[1]), region), strict=True))
    # the cut is what is read
    dataset, variable = dataset.isel(cut), variable.isel(cut)
    _check_claim(path, variable)
    longitude, latitude = (_values(axis.isel(cut, missing_dims="ignore")) for axis in axes)
    if flat:
        longitude, latitude = np.meshgrid(longitude, latitude)
    values = _values(variable) * _scale(path, variable) * (-1.0 if up else 1.0)
    low = _lowest_water(path, dataset, variable)
    values = values if low is None else values + np.where(np.isfinite(low), low, 0.0)
    if "mask_rho" in dataset and dataset["mask_rho"].dims == variable.dims:
        values = np.where(_values(dataset["mask_rho"]) > 0.5, values, np.nan)
    if not np.any(values > 0.0):
        raise ForecastError(
            f"{path}: {variable.name} as a {'height, positive up' if up else 'depth, positive down'}, has no water; give it the attribute "
            f'positive = "{"down" if up else "up"}" if its sign is opposite'
        )
    # continuous where the region lies across the seam of the file
    longitude = unwrap_longitude(longitude, float(region.longitude.mean()))
    lowest = None if low is None else (float(np.nanmin(low)), float(np.nanmax(low)))
    return Bathymetry(longitude, latitude, values, lowest)


def _values(array: xr.DataArray) -> Array:
    """Return the values of a part of a file."""
    # xarray loads slowly: without a file it is not needed
    from replay_kit.forecast.variables import unpacked

    return unpacked(array).astype(float)


def _check_claim(path: Path, array: xr.DataArray) -> None:
    """Raise ForecastError for an array too large to be plausible for the file."""
    if why := exceeds_claim(path, 8 * array.size):
        raise ForecastError(f"{path}: cannot read {array.name}: {why}; mend the file")


def _named(
    dataset: xr.Dataset, names: Sequence[str], fits: Callable[[xr.DataArray], bool]
) -> Iterator[tuple[str, xr.DataArray]]:
    """Yield each name with a fitting variable of that standard name or name, in the order of the names."""
    for wanted in names:
        for name in dataset.variables:
            variable = dataset[name]
            called = str(variable.attrs.get("standard_name", "")).lower(), str(name).lower()
            if wanted in called and fits(variable):
                yield wanted, variable


def _is_up(path: Path, variable: xr.DataArray, wanted: str) -> bool:
    """Return whether a variable found by a name is positive up."""
    usual = "up" if wanted in _HEIGHTS else "down"
    positive = str(variable.attrs.get("positive", usual)).lower()
    if positive not in ("up", "down"):
        raise ForecastError(
            f"{path}: {variable.name} has the attribute positive = {positive!r}; expected up or down"
        )
    return positive == "up"


def _degrees(dataset: xr.Dataset) -> dict[str, str]:
    """Return new names of axes that are called x and y, if in degrees."""
    units = {name: str(dataset[name].attrs.get("units", "")).lower() for name in dataset.variables}
    usual = (("x", "lon"), ("y", "lat"))
    return {
        old: new
        for old, new in usual
        if units.get(old, "").startswith("degree") and new not in units
    }


def _lowest_water(path: Path, dataset: xr.Dataset, depth: xr.DataArray) -> Array | None:
    """Return the lowest water level at any time, shape of the depths [m]; None if absent at their points."""
    for _, level in _named(dataset, _LEVELS, lambda one: set(depth.dims) <= set(one.dims)):
        _check_claim(path, level)
        times = _values(level.transpose(..., *depth.dims)).reshape(-1, *depth.shape)
        low = np.fmin.reduce(times, axis=0) * _scale(path, level)
        return low if np.isfinite(low).any() else None
    return None


def _window(longitude: Array, latitude: Array, region: Grid) -> tuple[Any, Any]:
    """Return the rows and columns in and around a region, ordered across the file's seam; all if none lies in it."""
    from replay_kit.forecast.grids.horizontal import region_block, runs

    ends = []
    for values, of_region in ((longitude, region.longitude), (latitude, region.latitude)):
        steps = [np.abs(np.diff(values, axis=k)) for k in range(values.ndim)]
        beyond = _BEYOND * max(float(np.median(each)) for each in steps)
        ends.append((float(of_region.min()) - beyond, float(of_region.max()) + beyond))
    (west, east), (south, north) = ends
    block = region_block(longitude, latitude, (west, south, east, north))
    if block is None:
        return slice(None), slice(None)
    columns = runs(block[1])
    return runs(block[0])[0], columns[0] if len(columns) == 1 else block[1]


def bathymetry_notes(bathymetry: Bathymetry, grid: Grid) -> tuple[str, ...]:
    """Return notes on a bathymetry in a region: lowest water, gaps, uncovered water."""
    notes = list[str]()
    inside = within(bounds_of(grid), bathymetry.longitude, bathymetry.latitude)
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
    west = unwrap_longitude(grid.longitude, float(bathymetry.longitude.mean()))
    covered = (bathymetry.longitude, west), (bathymetry.latitude, grid.latitude)
    if any(
        theirs.min() < ours.min() - 1e-9 or theirs.max() > ours.max() + 1e-9
        for ours, theirs in covered
    ):
        notes.append("the bathymetry does not cover the whole region; missions stay inside it")
    return tuple(notes)


def _scale(path: Path, variable: xr.DataArray) -> float:
    """Return the metres per unit of a variable."""
    unit = str(variable.attrs.get("units", "m")).strip().lower()
    if (found := metres(unit)) is None:
        raise ForecastError(
            f"{path}: {variable.name} is in {unit!r}; expected metres, km, cm or ft"
        )
    return found


# Most cells along a side of the grid.
_CELLS = 160


def seabed_of(bathymetry: Bathymetry, region: Grid) -> Seabed:
    """Return a bathymetry interpolated bilinearly to a regular grid around a region, no finer than its own points.

    Args:
        bathymetry: Bathymetry of the region.
        region: Region to cover.
    """
    spacing = _spacing(*to_local(region.projection, bathymetry.longitude, bathymetry.latitude))
    axes = []
    for values in (region.east, region.north):
        least, most = float(values.min()), float(values.max())
        axes.append(np.linspace(least, most, int(np.clip((most - least) / spacing + 1, 2, _CELLS))))
    return Seabed(axes[0], axes[1], depth_at(bathymetry, region.projection, *np.meshgrid(*axes)))


def depth_at(bathymetry: Bathymetry, projection: Projection, east: Array, north: Array) -> Array:
    """Return the bottom depth at places of any shape [m], by bilinear interpolation; NaN where unknown.

    Args:
        bathymetry: Bathymetry.
        projection: Local frame.
        east: Local east of the places [m].
        north: Local north of the places [m].
    """
    # loads slowly, and a plan without a bathymetry needs none
    from replay_kit.forecast.grids.horizontal import bilinear, find_cells

    found = np.full(east.shape, np.nan)
    if east.size == 0:
        return found
    x, y = to_local(projection, bathymetry.longitude, bathymetry.latitude)
    beyond = 2.0 * max(float(np.nanmax(np.hypot(*np.diff([x, y], axis=k)))) for k in (1, 2))
    near = (x > east.min() - beyond) & (x < east.max() + beyond)
    near &= (y > north.min() - beyond) & (y < north.max() + beyond)
    rows, columns = (np.flatnonzero(near.any(axis=axis)) for axis in (1, 0))
    if min(rows.size, columns.size) < 2:
        return found
    cut = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    return bilinear(bathymetry.depth[cut], *find_cells(x[cut], y[cut], east, north))


def _spacing(east: Array, north: Array) -> float:
    """Return the distance between points along the rows of a grid [m]."""
    return float(np.nanmedian(np.hypot(np.diff(east, axis=1), np.diff(north, axis=1))))
