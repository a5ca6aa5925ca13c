"""What CF and ACDD ask of every dataset: what it is, where and when, what made it; times and fill values as files have them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from replay_kit.core.version import __version__

if TYPE_CHECKING:
    import xarray as xr

#: Of each variable of a file, as xarray takes it.
Encoding = dict[str, dict[str, object]]

CONVENTIONS = "CF-1.8, CF-1.11, ACDD-1.3"
CF_TIME = {"units": "seconds since 1970-01-01", "calendar": "standard"}
#: Of a coordinate of time: days have 86,400 seconds.
LEAP_SECONDS = {"units_metadata": "leap_seconds: none"}
_AXES = (
    ("lat", "latitude", "degrees_north"),
    ("lon", "longitude", "degrees_east"),
    ("vertical", "depth", "m"),
)


def described(
    dataset: xr.Dataset, title: str, history: str, about: Mapping[str, str] | None = None
) -> xr.Dataset:
    """Return a dataset with its global attributes, and with the kind of each variable.

    Args:
        dataset: Its coordinates have their standard names.
        title: What it holds.
        history: What made it; without a time of writing, so that the same values give the same bytes.
        about: Further attributes, such as who made it and under which licence.
    """
    for name, variable in dataset.variables.items():
        variable.attrs["coverage_content_type"] = _content(str(name), variable, dataset)
        if variable.dtype.kind == "M":
            variable.attrs |= LEAP_SECONDS
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
            "history": history,
            **_coverage(dataset),
            **(about or {}),
        }
    )


def _content(name: str, variable: xr.Variable, dataset: xr.Dataset) -> str:
    """Return the kind of a variable, one of ISO 19115-1."""
    standard = str(variable.attrs.get("standard_name", ""))
    if name in dataset.coords:
        return "coordinate"
    if standard.endswith("standard_error"):
        return "qualityInformation"
    return "modelResult" if standard.endswith("sea_water_velocity") else "auxiliaryInformation"


def _coverage(dataset: xr.Dataset) -> dict[str, object]:
    """Return where and when the values of a dataset are."""
    found: dict[str, object] = {}
    for short, name, units in _AXES:
        if (axis := _all_of(dataset, name)).size:
            ends = {"min": float(axis.min()), "max": float(axis.max()), "units": units}
            found |= {f"geospatial_{short}_{key}": value for key, value in ends.items()}
    if "geospatial_vertical_min" in found:
        # depth below the instantaneous water level
        crs = "geospatial_bounds_vertical_crs"
        found |= {"geospatial_vertical_positive": "down", crs: "EPSG:5831"}
    if {"geospatial_lat_min", "geospatial_lon_min"} <= found.keys():
        south, north, west, east = (
            found[f"geospatial_{axis}_{end}"] for axis in ("lat", "lon") for end in ("min", "max")
        )
        corners = ((south, west), (north, west), (north, east), (south, east), (south, west))
        box = ", ".join(f"{latitude} {longitude}" for latitude, longitude in corners)
        found |= {"geospatial_bounds": f"POLYGON (({box}))", "geospatial_bounds_crs": "EPSG:4326"}
    if (times := _all_of(dataset, "time")).size:
        if times.dtype.kind == "f":
            times = np.round(times * 1e9).astype("M8[ns]")
        steps = np.diff(np.unique(times)) / np.timedelta64(1, "s")
        first, last = np.datetime_as_string(np.array([times.min(), times.max()], "M8[s]"))
        duration = (times.max() - times.min()) / np.timedelta64(1, "s")
        found |= {
            "time_coverage_start": f"{first}Z",
            "time_coverage_end": f"{last}Z",
            "time_coverage_duration": f"PT{duration:.0f}S",
            # of a single time the step to the next is nothing
            "time_coverage_resolution": f"PT{np.median(steps) if steps.size else 0.0:.0f}S",
        }
    return found


def _all_of(dataset: xr.Dataset, standard: str) -> np.ndarray:
    """Return the values of all variables of a standard name that are not missing."""
    values = [
        variable.values[variable.notnull().values]
        for name, variable in dataset.variables.items()
        if variable.attrs.get("standard_name", name) == standard
    ]
    return np.concatenate(values) if values else np.empty(0)


def encoding_of(dataset: xr.Dataset) -> Encoding:
    """Return how variables are written: times as float64 seconds, and with a fill value those alone that miss something.

    CF before 1.9 has no 64-bit integers, which nanoseconds need; a coordinate has a value everywhere.
    """
    encoding: Encoding = {}
    for name, variable in dataset.variables.items():
        missing = variable.isnull().values if variable.dtype.kind in "Mf" else np.array(False)
        each: dict[str, object] = {
            "_FillValue": np.nan if missing.any() and name not in dataset.dims else None
        }
        if variable.dtype.kind == "M":
            # of no date at all xarray cannot tell whether it is one of the calendar, and warns
            each |= (
                {"units": CF_TIME["units"], "dtype": "float64"}
                if missing.all()
                else {**CF_TIME, "dtype": "float64"}
            )
        encoding[str(name)] = each
    return encoding


def encoded(dataset: xr.Dataset) -> xr.Dataset:
    """Return a dataset that ``to_netcdf`` writes as ``encoding_of`` says."""
    for name, encoding in encoding_of(dataset).items():
        dataset.variables[name].encoding.update(encoding)
    return dataset


def history(made_by: str, time_ns: int | None) -> str:
    """Return the global attribute ``history``: program, version, function and the time of the estimate.

    CF leaves its form open. It has no time of writing, because the same flow must give the same bytes.

    Args:
        made_by: The function that made the dataset.
        time_ns: Of the flow [ns, UTC]; None without one.
    """
    at = "" if time_ns is None else f", time = {np.datetime64(time_ns, 'ns')}Z"
    return f"replay-kit {__version__}: {made_by}(flow{at})"
