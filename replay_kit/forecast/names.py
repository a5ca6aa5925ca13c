"""Which variable or dimension of a dataset is which: CF standard names first, then the usual short names."""

from collections.abc import Hashable, Iterable
from typing import Literal

import xarray as xr

from replay_kit.core.errors import ForecastError

Axes = Literal["true", "grid"]

MEMBER_NAMES = ("member", "ensemble", "ens", "number", "realization", "ensemble_member")
_LEAD_NAMES = ("lead", "lead_time", "leadtime", "step", "forecast_period")
_TIME_NAMES = ("time", "valid_time", "time_counter", "ocean_time")
_DEPTH_NAMES = ("depth", "lev", "level", "deptht", "depthu", "z", "z_l", "st_ocean")
_LONGITUDE_NAMES = ("longitude", "lon", "nav_lon", "glamt")
_LATITUDE_NAMES = ("latitude", "lat", "nav_lat", "gphit")
_VELOCITY_STANDARD_NAMES: tuple[tuple[str, str, Axes], ...] = (
    ("eastward_sea_water_velocity", "northward_sea_water_velocity", "true"),
    ("sea_water_x_velocity", "sea_water_y_velocity", "grid"),
)
_VELOCITY_SHORT_NAMES = (("uo", "vo"), ("u", "v"), ("water_u", "water_v"), ("ucur", "vcur"))


def _by_standard_name(ds: xr.Dataset, standard_name: str) -> list[Hashable]:
    return [name for name, variable in ds.variables.items() if variable.attrs.get("standard_name") == standard_name]


def find_velocity(ds: xr.Dataset, where: str) -> tuple[xr.DataArray, xr.DataArray, Axes]:
    """Return the two velocity components and whether they lie along true east and north or along the grid's axes.

    Raises:
        ForecastError: No pair is found, or several variables have the same standard name.
    """
    for east, north, axes in _VELOCITY_STANDARD_NAMES:
        found = _by_standard_name(ds, east), _by_standard_name(ds, north)
        if all(len(names) == 1 for names in found):
            return ds[found[0][0]], ds[found[1][0]], axes
        if any(len(names) > 1 for names in found):
            raise ForecastError(
                f"{where}: several variables have the standard name {east} or {north}: {found[0] + found[1]}; leave one of each"
            )
    for u, v in _VELOCITY_SHORT_NAMES:
        if u in ds and v in ds:
            return ds[u], ds[v], "true"
    raise ForecastError(
        f"{where}: no current found; expected variables with standard names eastward_/northward_sea_water_velocity, "
        f"or named uo/vo, u/v, water_u/water_v or ucur/vcur; got {sorted(map(str, ds.data_vars))}"
    )


def find_coordinate(ds: xr.Dataset, standard_name: Literal["longitude", "latitude"], where: str) -> xr.DataArray:
    """Return the longitude or latitude variable, in one or two dimensions.

    Raises:
        ForecastError: There is none.
    """
    short = _LONGITUDE_NAMES if standard_name == "longitude" else _LATITUDE_NAMES
    candidates = _by_standard_name(ds, standard_name) + [name for name in short if name in ds.variables]
    for name in candidates:
        if ds[name].ndim in (1, 2):
            return ds[name]
    raise ForecastError(f"{where}: no {standard_name} found; expected standard name {standard_name} or one of {', '.join(short)}")


def find_dimension(ds: xr.Dataset, dims: Iterable[Hashable], standard_names: tuple[str, ...], names: tuple[str, ...]) -> str | None:
    """Return the dimension that has one of the standard names on its coordinate, else one of the short names, else None."""
    found = [str(dim) for dim in dims]
    for dim in found:
        if dim in ds.variables and ds[dim].attrs.get("standard_name") in standard_names:
            return dim
    lowered = {dim.lower(): dim for dim in found}
    return next((lowered[name] for name in names if name in lowered), None)


def find_member(ds: xr.Dataset, dims: Iterable[Hashable]) -> str | None:
    """Return the ensemble dimension, or None."""
    return find_dimension(ds, dims, ("realization",), MEMBER_NAMES)


def find_depth(ds: xr.Dataset, dims: Iterable[Hashable]) -> str | None:
    """Return the depth dimension, or None."""
    return find_dimension(ds, dims, ("depth", "height"), _DEPTH_NAMES)


def find_lead(ds: xr.Dataset, dims: Iterable[Hashable]) -> str | None:
    """Return the dimension of forecast periods, or None."""
    return find_dimension(ds, dims, ("forecast_period",), _LEAD_NAMES)


def find_time(ds: xr.Dataset, dims: Iterable[Hashable]) -> str | None:
    """Return the dimension of times, or None."""
    return find_dimension(ds, dims, ("time",), _TIME_NAMES)
