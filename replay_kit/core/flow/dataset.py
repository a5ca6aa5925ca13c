"""A flow as a CF dataset with velocities towards true east and north and errors; along a track as OG1.0."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from replay_kit.core.arrays import Array
from replay_kit.core.errors import EstimatorError
from replay_kit.core.flow.cf import CONVENTIONS, described, write_dataset
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.evaluation import checked_depth
from replay_kit.core.flow.points import own_or, velocities, warn_outside, wet_at

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
    dataset, dims = xr.Dataset(), (*through, "depth", *place)
    for name, (own, values) in coords.items():
        axis = {"axis": _AXES[name]} if name in _AXES and own != ("y", "x") else {}
        if values.dtype.kind != "M" or not np.isnat(values).any():
            dataset.coords[name] = (own, values, ATTRIBUTES[name] | axis)
    for name in "uv":
        ancillary = {}
        if flow.n_modes:
            ancillary["ancillary_variables"] = of_error = f"{name}_standard_error"
            dataset[of_error] = (dims, getattr(found, of_error), ATTRIBUTES[of_error])
        dataset[name] = (dims, getattr(found, name), ATTRIBUTES[name] | ancillary)
    return described(dataset, "Ocean current estimate", "to_xarray", flow.about)


def write_grid(flow: FlowEstimate, path: Path) -> None:
    """Write the flow on its own grid as CF NetCDF, completely or not at all.

    Raises:
        ConfigError: The file cannot be written.
    """
    write_dataset(to_dataset(flow), path)


def of_points(
    columns: Mapping[str, Array], coordinates: Sequence[str], about: Mapping[str, str]
) -> xr.Dataset:
    """Return velocities at points as a CF dataset; see ``Velocities.to_xarray``.

    Args:
        columns: Values at the points by attribute of ``Velocities``, each of shape (n,).
        coordinates: Names of the coordinates.
        about: Global attributes of the flow.
    """
    values = {name: ("point", column, ATTRIBUTES[name]) for name, column in columns.items()}
    dataset = xr.Dataset(values).set_coords(coordinates)
    about = {"featureType": "point", **about}
    title, made_by = "Ocean current estimate at points", "Velocities.to_xarray"
    return described(dataset, title, made_by, about)


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
    result = described(
        dataset.set_coords([name.upper() for name in _TERMS]),
        "Ocean current estimate along the track of a glider",
        "Velocities.to_og1",
        {**_FIXED, "id": f"{platform}_{start}", "start_date": start, **people},
    )
    for end in ("time_coverage_start", "time_coverage_end"):
        result.attrs[end] = result.attrs[end].translate(_DIGITS)
    return result


_DIGITS = str.maketrans("", "", "-:Z")
