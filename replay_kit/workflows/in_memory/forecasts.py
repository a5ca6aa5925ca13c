"""A dataset or an ensemble as the file of a forecast."""

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from replay_kit.core.errors import ForecastError
from replay_kit.core.geodesy import rotate_to_geographic
from replay_kit.core.grid import Ensemble

if TYPE_CHECKING:
    import xarray as xr


def is_forecast(value: object) -> bool:
    """Return whether a value is an ``Ensemble`` or an xarray ``Dataset``."""
    return isinstance(value, Ensemble) or (
        hasattr(value, "data_vars") and hasattr(value, "to_netcdf")
    )


def write_forecast(path: Path, value: Any) -> None:
    """Write a forecast as NetCDF.

    Args:
        path: The file.
        value: As of ``is_forecast``.

    Raises:
        ForecastError: Its values cannot be read or written.
    """
    dataset = _dataset_of(value) if isinstance(value, Ensemble) else value
    halves = [name for name, held in dataset.variables.items() if held.dtype == np.float16]
    if halves:
        named = ", ".join(map(str, halves))
        warnings.warn(f"{named}: 16-bit numbers have three digits; read as they are", stacklevel=4)
        dataset = dataset.assign({name: dataset[name].astype(np.float32) for name in halves})
    try:
        dataset.to_netcdf(path, engine="h5netcdf")
    # a lazy dataset reads its file here, with whatever library it was opened with
    except Exception as error:
        said = " ".join(str(error).split())[:200]
        raise ForecastError(
            f"ensemble: expected a Dataset whose values can be read and written as NetCDF, got {type(error).__name__}: {said}; "
            "is the file that it was opened from still there?"
        ) from error


def _dataset_of(ensemble: Ensemble) -> "xr.Dataset":
    """Return an ensemble along true east and north."""
    # takes half a second to load
    import xarray as xr

    grid = ensemble.grid
    east, north = rotate_to_geographic(
        grid.projection, grid.longitude, grid.latitude, *np.moveaxis(ensemble.velocity, 1, 0)
    )
    dims = ("realization", "depth", "y", "x")
    names = ("eastward_sea_water_velocity", "northward_sea_water_velocity")
    dataset = xr.Dataset(
        {
            short: (dims, values, {"standard_name": name, "units": "m s-1"})
            for short, name, values in zip(("u", "v"), names, (east, north), strict=True)
        },
        {
            "realization": ("realization", np.arange(len(east)), {"standard_name": "realization"}),
            "depth": (
                "depth",
                grid.levels,
                {"standard_name": "depth", "units": "m", "positive": "down"},
            ),
            "longitude": (
                ("y", "x"),
                grid.longitude,
                {"standard_name": "longitude", "units": "degrees_east"},
            ),
            "latitude": (
                ("y", "x"),
                grid.latitude,
                {"standard_name": "latitude", "units": "degrees_north"},
            ),
        },
    )
    if ensemble.time_ns is None:
        return dataset
    return dataset.assign_coords(time=((), np.datetime64(ensemble.time_ns, "ns")))
