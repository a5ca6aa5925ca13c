"""Global attributes and encodings of CF and ACDD: title, extent, provenance, times and fill values."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from replay_kit.core import __version__
from replay_kit.core.files.atomic import write_whole

if TYPE_CHECKING:
    import xarray as xr

CONVENTIONS = "CF-1.8, CF-1.11, ACDD-1.3"
CF_TIME = {"units": "seconds since 1970-01-01", "calendar": "standard"}
#: Of a coordinate of time: days have 86,400 seconds.
LEAP_SECONDS = {"units_metadata": "leap_seconds: none"}
# Of equal gaps between longitudes the one at the antimeridian is the widest [degrees].
_ROUNDED = 1e-6
_AXES = (
    ("lat", "latitude", "degrees_north"),
    ("lon", "longitude", "degrees_east"),
    ("vertical", "depth", "m"),
)


def described(
    dataset: xr.Dataset, title: str, made_by: str, about: Mapping[str, str] | None = None
) -> xr.Dataset:
    """Return a dataset with global attributes, the coverage content type of each variable, and encodings of times and gaps.

    Args:
        dataset: Dataset whose coordinates have standard names.
        title: Title.
        made_by: Program for the attribute ``history``, without a time of writing, so that equal values give equal bytes.
        about: Further attributes, such as creator and licence.
    """
    for name, variable in dataset.variables.items():
        standard = str(variable.attrs.get("standard_name", ""))
        # one of the kinds of ISO 19115-1
        variable.attrs["coverage_content_type"] = (
            "coordinate"
            if name in dataset.coords
            else "qualityInformation"
            if standard.endswith("standard_error")
            else "modelResult"
            if standard.endswith("sea_water_velocity")
            else "auxiliaryInformation"
        )
        # a coordinate has a value everywhere
        missing = variable.isnull().values if variable.dtype.kind in "Mf" else np.array(False)
        fills = missing.any() and name not in dataset.dims
        variable.encoding["_FillValue"] = np.nan if fills else None
        if variable.dtype.kind == "M":
            variable.attrs |= LEAP_SECONDS
            # CF before 1.9 has no 64-bit integers, which nanoseconds need
            variable.encoding |= {**CF_TIME, "dtype": "float64"}
            if missing.all():
                # xarray cannot tell whether no date at all is one of the calendar, and warns
                del variable.encoding["calendar"]
    return dataset.assign_attrs(
        {
            "Conventions": CONVENTIONS,
            "title": title,
            "summary": f"{title}. Velocities toward true east and north, from an ensemble forecast and a vehicle's measurements.",
            "keywords": "ocean currents, sea water velocity, ensemble forecast, data assimilation, underwater glider, ADCP",
            "source": f"replay-kit {__version__}",
            "product_version": __version__,
            "processing_level": "analysis",
            "standard_name_vocabulary": "CF Standard Name Table",
            "history": f"replay-kit {made_by}",
            **_coverage(dataset),
            **(about or {}),
        }
    )


def _coverage(dataset: xr.Dataset) -> dict[str, Any]:
    """Return the spatial and temporal coverage of a dataset."""
    found: dict[str, Any] = {}
    for short, name, units in _AXES:
        if (axis := np.sort(_all_of(dataset, name))).size:
            if short == "lon":
                # the widest gap is outside: across the antimeridian the first longitude is greater than the last
                gaps = np.diff(axis, append=axis[0] + 360.0 + _ROUNDED)
                axis = np.roll(axis, -1 - np.argmax(gaps))
            ends = {"min": float(axis[0]), "max": float(axis[-1]), "units": units}
            found |= {f"geospatial_{short}_{key}": value for key, value in ends.items()}
    if "geospatial_vertical_min" in found:
        # depth below the instantaneous water level
        crs = "geospatial_bounds_vertical_crs"
        found |= {"geospatial_vertical_positive": "down", crs: "EPSG:5831"}
    if {"geospatial_lat_min", "geospatial_lon_min"} <= found.keys():
        south, north, west, east = (
            found[f"geospatial_{axis}_{end}"] for axis in ("lat", "lon") for end in ("min", "max")
        )
        east += 360.0 * (east < west)
        box = f"{south} {west}, {north} {west}, {north} {east}, {south} {east}, {south} {west}"
        found |= {"geospatial_bounds": f"POLYGON (({box}))", "geospatial_bounds_crs": "EPSG:4326"}
    if (times := _all_of(dataset, "time")).size:
        if times.dtype.kind == "f":
            times = np.round(times * 1e9).astype("M8[ns]")
        times, second = np.unique(times), np.timedelta64(1, "s")
        first, last = np.datetime_as_string(times[[0, -1]].astype("M8[s]"))
        found |= {
            "time_coverage_start": f"{first}Z",
            "time_coverage_end": f"{last}Z",
            "time_coverage_duration": f"PT{(times[-1] - times[0]) / second:.0f}S",
            # of a single time the step to the next is nothing
            "time_coverage_resolution": f"PT{np.median(np.diff(times)) / second if times.size > 1 else 0.0:.0f}S",
        }
    return found


def _all_of(dataset: xr.Dataset, standard: str) -> np.ndarray:
    """Return the finite values of all variables with a standard name."""
    values = [
        variable.values[variable.notnull().values]
        for name, variable in dataset.variables.items()
        if variable.attrs.get("standard_name", name) == standard
    ]
    return np.concatenate(values) if values else np.empty(0)


def write_dataset(dataset: xr.Dataset, path: Path) -> None:
    """Write a dataset as compressed NetCDF, completely or not at all.

    Raises:
        ConfigError: The file cannot be created.
        ReplayKitError: Writing fails, for example on a full disk.
    """
    for variable in dataset.variables.values():
        if variable.dtype.kind == "f" and variable.ndim:
            variable.encoding |= {"zlib": True, "complevel": 4}
    # made in memory, since the HDF5 library crashes the process when a disk is full
    write_whole(path, netcdf_bytes(dataset))


def netcdf_bytes(dataset: xr.Dataset) -> bytes:
    """Return a dataset as NetCDF-4 bytes, its variables encoded as they state.

    ``to_netcdf`` would take a lock named after the buffer's address from the scheduler, where the process is a worker of Dask. Addresses
    are used again by other missions, and the scheduler then no longer knows the lock. No other thread sees the buffer.
    """
    import h5netcdf
    from xarray.backends import H5NetCDFStore

    buffer = io.BytesIO()
    with h5netcdf.File(buffer, "w") as file:
        dataset.dump_to_store(H5NetCDFStore(file))
    return buffer.getvalue()
