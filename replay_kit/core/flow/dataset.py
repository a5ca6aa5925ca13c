"""A flow as a CF dataset with velocities towards true east and north and errors; along a track as OG1.0.

Also of other datasets the global attributes and encodings of CF and ACDD: title, extent, provenance, times and fill values.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from replay_kit.core import __version__
from replay_kit.core.arrays import Array
from replay_kit.core.errors import EstimatorError
from replay_kit.core.files.atomic import write_whole
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.functions import checked_depth
from replay_kit.core.flow.points import own_or, velocities, warn_outside, wet_at

if TYPE_CHECKING:
    import xarray as xr

CONVENTIONS = "CF-1.8, CF-1.11, ACDD-1.3"
CF_TIME = {"units": "seconds since 1970-01-01", "calendar": "standard"}
#: Of a coordinate of time: days have 86,400 seconds.
LEAP_SECONDS = {"units_metadata": "leap_seconds: none"}
# Of equal gaps between longitudes the one at the antimeridian is the widest [degrees].
_ROUNDED = 1e-6
_COVERED = (
    ("lat", "latitude", "degrees_north"),
    ("lon", "longitude", "degrees_east"),
    ("vertical", "depth", "m"),
)


def described_dataset(
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
    for short, name, units in _COVERED:
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


_KEYS = ("long_name", "units", "standard_name", "positive")
#: Attributes of the variables, after CF.
ATTRIBUTES = {
    name: dict(zip(_KEYS, row.split(" | "), strict=False))
    for name, row in {
        "u": "eastward sea water velocity | m s-1 | eastward_sea_water_velocity",
        "v": "northward sea water velocity | m s-1 | northward_sea_water_velocity",
        "u_standard_error": "standard error of eastward sea water velocity | m s-1 | eastward_sea_water_velocity standard_error",
        "v_standard_error": "standard error of northward sea water velocity | m s-1 | northward_sea_water_velocity standard_error",
        "longitude": "longitude | degrees_east | longitude",
        "latitude": "latitude | degrees_north | latitude",
        "depth": "depth below the surface | m | depth | down",
        "estimate_time": "time for which the velocity holds",
    }.items()
}
ATTRIBUTES["time"] = {"standard_name": "time", "long_name": "time"}
_AXES = {"time": "T", "depth": "Z", "latitude": "Y", "longitude": "X"}


def to_dataset(
    flow: FlowEstimate,
    longitude: ArrayLike | None = None,
    latitude: ArrayLike | None = None,
    depth: ArrayLike | None = None,
    time: Any = None,
) -> xr.Dataset:
    """Return velocity and standard error as a CF dataset, NaN where dry and below the last level; see ``FlowEstimate.to_xarray``.

    Below the last level ``velocity`` continues the last level's flow; the dataset has NaN.

    Returns:
        Dataset with ``u``, ``v`` and, when the flow has an uncertainty, ``u_standard_error``, ``v_standard_error``, on dimensions (depth,
        latitude, longitude), or (depth, y, x) with two-dimensional longitude and latitude on a curvilinear grid.
    """
    given = [axis for axis in (longitude, latitude, depth) if axis is not None]
    axes = [np.asarray(axis, dtype=np.float64) for axis in given]
    if len(axes) not in (0, 3):
        raise EstimatorError(
            "to_dataset needs longitude, latitude and depth together, or none of them for the flow's own grid"
        )
    if any(axis.ndim != 1 or axis.size == 0 for axis in axes):
        raise EstimatorError(
            f"to_dataset needs one-dimensional axes with values, but got shapes {[axis.shape for axis in axes]}"
        )
    lon, lat, levels = flow.grid.longitude, flow.grid.latitude, flow.levels
    if axes:
        (lon, lat), levels = np.meshgrid(*axes[:2]), checked_depth(axes[2])
    asked = own_or(time)
    if time is not None:
        flow.require_model_of_time()
        warn_outside([flow], asked, 4)
    through = ("time",) * min(asked.ndim, 1)
    asked = asked.reshape(-1, 1, 1, 1) if through else asked
    found = velocities([flow], lon, lat, levels[:, None, None], asked, wet_at)
    regular = bool(np.all(lon == lon[0]) and np.all(lat == lat[:, :1]))
    place = ("latitude", "longitude") if regular else ("y", "x")
    coords = {
        "depth": (("depth",), levels),
        "time": (through, found.time[..., 0, 0, 0]),
        "estimate_time": (through, found.estimate_time[..., 0, 0, 0]),
        "latitude": (place[:1], lat[:, 0]) if regular else (place, lat),
        "longitude": (place[1:], lon[0]) if regular else (place, lon),
    }
    if time is None:
        del coords["estimate_time"]
    import xarray as xr  # loads slowly, and who reads a saved flow needs it not

    dataset, dims = xr.Dataset(), (*through, "depth", *place)
    for name, (dims_of_coord, values) in coords.items():
        axis = {"axis": _AXES[name]} if name in _AXES and dims_of_coord != ("y", "x") else {}
        if values.dtype.kind != "M" or not np.isnat(values).any():
            dataset.coords[name] = (dims_of_coord, values, ATTRIBUTES[name] | axis)
    for name in "uv":
        ancillary = {}
        if flow.n_modes:
            ancillary["ancillary_variables"] = of_error = f"{name}_standard_error"
            dataset[of_error] = (dims, getattr(found, of_error), ATTRIBUTES[of_error])
        dataset[name] = (dims, getattr(found, name), ATTRIBUTES[name] | ancillary)
    return described_dataset(dataset, "Ocean current estimate", "to_xarray", flow.about)


def write_grid(flow: FlowEstimate, path: Path) -> None:
    """Write the flow on its own grid as CF NetCDF, completely or not at all.

    Raises:
        ConfigError: The file cannot be written.
    """
    write_dataset(to_dataset(flow), path)


def dataset_of_points(
    columns: Mapping[str, Array], coordinates: Sequence[str], about: Mapping[str, str]
) -> xr.Dataset:
    """Return velocities at points as a CF dataset; see ``Velocities.to_xarray``.

    Args:
        columns: Values at the points by attribute of ``Velocities``, each of shape (n,).
        coordinates: Names of the coordinates.
        about: Global attributes of the flow.
    """
    import xarray as xr

    values = {name: ("point", column, ATTRIBUTES[name]) for name, column in columns.items()}
    dataset = xr.Dataset(values).set_coords(coordinates)
    about = {"featureType": "point", **about}
    title, made_by = "Ocean current estimate at points", "Velocities.to_xarray"
    return described_dataset(dataset, title, made_by, about)


_VOCABULARY = "http://vocab.nerc.ac.uk/collection/OG1/current"
# Terms of the coordinates, and of those of GPS fixes; none is known for an estimated current.
_TERMS = {
    "time": ("TIME", "TIME"),
    "longitude": ("LON", "LON_GPS"),
    "latitude": ("LAT", "LAT_GPS"),
    "depth": ("DEPTH", ""),
}
_FIXED = {
    "platform": "sub-surface gliders",
    "platform_vocabulary": "https://vocab.nerc.ac.uk/collection/L06/current/27/",
    "rtqc_method": "No QC applied",
    "comment": "Currents estimated along a track, not measured. Positions of GPS fixes are not known and missing.",
    "featureType": "trajectory",
    "Conventions": f"{CONVENTIONS}, OG-1.0",
}


def trajectory(
    columns: Mapping[str, Array], platform: str, stated: Mapping[str, str], about: Mapping[str, str]
) -> xr.Dataset:
    """Return velocities along a track as an OG1.0 dataset; see ``Velocities.to_og1``.

    Args:
        columns: Values at the points by attribute of ``Velocities``, each of shape (n,).
        platform: Serial number of the glider with its prefix.
        stated: Attributes of the glider and the mission.
        about: Global attributes of the flow.

    Raises:
        EstimatorError: There is no point, or the time of one is unknown.
    """
    import xarray as xr

    if not columns["time"].size or np.isnat(columns["time"]).any():
        raise EstimatorError(
            "to_og1: expected points that all have a time, as along() gives with a column time"
        )
    start = np.datetime_as_string(columns["time"][0], "s").translate(_DIGITS)
    dataset = xr.Dataset(
        {
            name.upper(): ("N_MEASUREMENTS", column, dict(ATTRIBUTES[name]))
            for name, column in columns.items()
        }
    )
    for name, (term, of_fix) in _TERMS.items():
        column = dataset[name.upper()]
        if of_fix:
            first, fix = f"{name} of the first point of the track", f"{name} of each GPS location"
            dataset[f"DEPLOYMENT_{name.upper()}"] = column[0].assign_attrs(long_name=first)
            dataset[f"{name.upper()}_GPS"] = column.where(False).assign_attrs(
                long_name=fix, vocabulary=f"{_VOCABULARY}/{of_fix}/"
            )
        dataset[name.upper()].attrs["vocabulary"] = f"{_VOCABULARY}/{term}/"
    of_track = {"cf_role": "trajectory_id", "long_name": "trajectory name"}
    dataset["TRAJECTORY"] = ((), f"{platform}_{start}", of_track)
    dataset["PLATFORM_SERIAL_NUMBER"] = ((), platform, {"long_name": "glider serial number"})
    people = dict(about)
    for name, value in stated.items():
        if name.isupper():
            dataset[name] = ((), value, {"long_name": name.lower().replace("_", " ")})
        else:
            people[name] = value
    result = described_dataset(
        dataset.set_coords([name.upper() for name in _TERMS]),
        "Ocean current estimate along the track of a glider",
        "Velocities.to_og1",
        {**_FIXED, "id": f"{platform}_{start}", "start_date": start, **people},
    )
    for end in ("time_coverage_start", "time_coverage_end"):
        result.attrs[end] = result.attrs[end].translate(_DIGITS)
    return result


_DIGITS = str.maketrans("", "", "-:Z")
