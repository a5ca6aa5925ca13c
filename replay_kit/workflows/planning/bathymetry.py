"""Bathymetry from NetCDF with the names and signs of GEBCO, ETOPO, NEMO and ROMS; on a grid and under tracks."""

# xarray, which is slow to load, is needed for a file alone
from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from planners.hazards.domain import Bathymetry
from replay_kit.core.arrays import Array
from replay_kit.core.errors import ForecastError
from replay_kit.core.files.inputs import exceeds_claim
from replay_kit.core.geodesy import to_local, unwrap_longitude
from replay_kit.core.grid import Grid, Projection, Seabed
from replay_kit.core.region import bounds_of
from replay_kit.core.region import inside_box as within
from replay_kit.core.words.quantities import metres

if TYPE_CHECKING:
    import xarray as xr

# Standard names before the short ones: of models (NEMO: deptho, Bathymetry, bathy_metry; ROMS: h), positive down; and of the world's grids
# (GEBCO: elevation; ETOPO: z, Band1), positive up.
_USUAL = {
    **dict.fromkeys(
        (
            "sea_floor_depth_below_sea_surface",
            "sea_floor_depth_below_geoid",
            "sea_floor_depth_below_mean_sea_level",
            "model_sea_floor_depth_below_geoid",
            "sea_floor_depth",
            *("deptho", "bathymetry", "bathy_metry", "bathy_meter", "depth", "h"),
        ),
        "down",
    ),
    **dict.fromkeys(
        (
            *("height_above_mean_sea_level", "height_above_geoid", "surface_altitude"),
            *("elevation", "altitude", "z", "topo", "band1"),
        ),
        "up",
    ),
}
# Spacings of a file's points kept beyond the ends of a region.
_BEYOND = 2.0
# Most cells along a side of the grid of results.
_CELLS = 160


def read_bathymetry(path: Path, region: Grid) -> Bathymetry:
    """Return the bottom depth in a NetCDF file or Zarr store; only the surroundings of a region are read.

    The variable is found by standard name, or else by name. The attribute ``positive`` decides the sign; without it heights are positive up
    and depths down. Units are metres. Land in ``mask_rho`` of ROMS is unknown depth.

    Args:
        path: The file.
        region: Region in which the depth is needed.

    Raises:
        ForecastError: No such variable on longitude and latitude exists, its unit is not a length, or it has no water.
    """
    # loads xarray
    from replay_kit.forecast.files import opened_file

    unreadable = (
        OSError,
        ValueError,
        LookupError,
        RuntimeError,
        TypeError,
        OverflowError,
        MemoryError,
    )
    try:
        with opened_file(path) as dataset:
            return _in_region(path, dataset.squeeze(), region)
    except unreadable as error:
        raise ForecastError(f"{path}: cannot read the bathymetry: {error}") from error


def _in_region(path: Path, dataset: xr.Dataset, region: Grid) -> Bathymetry:
    from replay_kit.forecast.names import find_coordinates
    from replay_kit.forecast.variables import unpacked_values

    there, names = dataset.variables, list[str]()
    found = {
        called.lower(): name
        for name, one in reversed([*there.items()])
        for called in (str(name), str(one.attrs.get("standard_name", "")))
        if one.ndim == 2
    }
    usual = next((name for name in _USUAL if name in found), None)
    if usual is not None:
        # axes that are called x and y, if in degrees
        units = {name: str(one.attrs.get("units", "")).lower() for name, one in there.items()}
        degrees = {
            old: new
            for old, new in (("x", "lon"), ("y", "lat"))
            if units.get(old, "").startswith("degree") and new not in units
        }
        dataset = dataset.rename(degrees)
        with suppress(ForecastError):
            *names, _ = find_coordinates(dataset, dataset[found[usual]].dims, str(path))
    if usual is None or not names:
        raise ForecastError(
            f"{path}: expected one of {', '.join(_USUAL)} on longitude and latitude, found {', '.join(map(str, there))}"
        )
    name, flat = found[usual], dataset[names[0]].ndim == 1
    dims = [dataset[axis].dims[0] for axis in names[::-1]] if flat else dataset[name].dims
    dataset = dataset.transpose(*dims, ...)
    block = _window(region, *(unpacked_values(dataset[axis]).astype(float) for axis in names))
    # the cut is what is read
    dataset = dataset.isel(dict(zip(dims, block, strict=True)))
    variable = dataset[name]
    if why := exceeds_claim(path, 8 * variable.size):
        raise ForecastError(f"{path}: cannot read {name}: {why}; mend the file")
    longitude, latitude = (unpacked_values(dataset[axis]).astype(float) for axis in names)
    if flat:
        longitude, latitude = np.meshgrid(longitude, latitude)
    sign = str(variable.attrs.get("positive", _USUAL[usual])).lower()
    if sign not in ("up", "down"):
        raise ForecastError(
            f"{path}: {name} has the attribute positive = {sign!r}; expected up or down"
        )
    unit = str(variable.attrs.get("units", "m")).strip().lower()
    if (metre := metres(unit)) is None:
        raise ForecastError(f"{path}: {name} is in {unit!r}; expected metres, km, cm or ft")
    values = unpacked_values(variable).astype(float) * metre
    values = -values if sign == "up" else values
    if "mask_rho" in dataset and dataset["mask_rho"].dims == variable.dims:
        values = np.where(unpacked_values(dataset["mask_rho"]) > 0.5, values, np.nan)
    if not np.any(values > 0.0):
        what, other = ("height", "down") if sign == "up" else ("depth", "up")
        raise ForecastError(
            f"{path}: {name} as a {what}, positive {sign}, has no water; give it the attribute "
            f'positive = "{other}" if its sign is opposite'
        )
    # continuous where the region lies across the seam of the file
    longitude = unwrap_longitude(longitude, float(region.longitude.mean()))
    return Bathymetry(longitude, latitude, values)


def _window(region: Grid, longitude: Array, latitude: Array) -> tuple[Any, Any]:
    """Return the rows and columns in and around a region, ordered across the file's seam; all if none lies in it."""
    from replay_kit.forecast.grids.horizontal import index_runs, region_block

    ends = []
    for values, of_region in ((longitude, region.longitude), (latitude, region.latitude)):
        steps = [np.abs(np.diff(values, axis=k)) for k in range(values.ndim)]
        beyond = _BEYOND * max(float(np.median(each)) for each in steps)
        ends.append((float(of_region.min()) - beyond, float(of_region.max()) + beyond))
    (west, east), (south, north) = ends
    block = region_block(longitude, latitude, (west, south, east, north))
    if block is None:
        return slice(None), slice(None)
    columns = index_runs(block[1])
    return index_runs(block[0])[0], columns[0] if len(columns) == 1 else block[1]


def bathymetry_notes(bathymetry: Bathymetry, grid: Grid) -> tuple[str, ...]:
    """Return notes on a bathymetry in a region: gaps, uncovered water."""
    notes, longitude, latitude = list[str](), bathymetry.longitude, bathymetry.latitude
    inside = within(bounds_of(grid), longitude, latitude)
    if gaps := int(np.sum(inside & np.isnan(bathymetry.depth))):
        notes.append(
            f"the bathymetry has no depth at {gaps} of its {int(inside.sum())} points in the region; they count as land"
        )
    west = unwrap_longitude(grid.longitude, float(longitude.mean()))
    covered = all(
        ours.min() <= theirs.min() + 1e-9 and theirs.max() <= ours.max() + 1e-9
        for ours, theirs in ((longitude, west), (latitude, grid.latitude))
    )
    if not covered:
        notes.append("the bathymetry does not cover the whole region; missions stay inside it")
    return tuple(notes)


def seabed_of(bathymetry: Bathymetry, region: Grid) -> Seabed:
    """Return a bathymetry interpolated bilinearly to a regular grid around a region, no finer than its own points.

    Args:
        bathymetry: Bathymetry of the region.
        region: Region to cover.
    """
    at = to_local(region.projection, bathymetry.longitude, bathymetry.latitude)
    spacing = float(np.nanmedian(np.hypot(*np.diff(at, axis=2))))
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
