"""A flow as a CF dataset for people and programs, velocities towards true east and north with errors; and along a track as OG1.0."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from replay_kit.core.arrays import Array
from replay_kit.core.errors import EstimatorError
from replay_kit.core.flow.cf import (
    CONVENTIONS,
    Encoding,
    described,
    encoded,
    encoding_of,
    history,
)
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.file import write_dataset
from replay_kit.core.geodesy import to_local
from replay_kit.core.grid import Grid
from replay_kit.core.version import __version__

_COMPONENTS = {"u": "eastward sea water velocity", "v": "northward sea water velocity"}
#: Attributes of the variables, after CF.
ATTRIBUTES = {
    **{
        name: {"standard_name": words.replace(" ", "_"), "long_name": words, "units": "m s-1"}
        for name, words in _COMPONENTS.items()
    },
    **{
        f"{name}_standard_error": {
            "standard_name": f"{words.replace(' ', '_')} standard_error",
            "long_name": f"standard error of {words}",
            "units": "m s-1",
        }
        for name, words in _COMPONENTS.items()
    },
    "longitude": {"standard_name": "longitude", "long_name": "longitude", "units": "degrees_east"},
    "latitude": {"standard_name": "latitude", "long_name": "latitude", "units": "degrees_north"},
    "depth": {
        "standard_name": "depth",
        "long_name": "depth below the surface",
        "units": "m",
        "positive": "down",
    },
    "time": {"standard_name": "time", "long_name": "time"},
    "estimate_time": {"long_name": "time for which the velocity holds"},
}


def to_dataset(
    flow: FlowEstimate,
    longitude: ArrayLike | None = None,
    latitude: ArrayLike | None = None,
    depth: ArrayLike | None = None,
    asked_ns: int | None = None,
) -> xr.Dataset:
    """Return velocity and standard error towards true east and north as a CF dataset, NaN where dry and below the last level.

    Below the last level nothing is known: ``velocity`` continues the last level's flow there, a grid does not show it.

    Args:
        flow: The flow.
        longitude: shape (I,) [degrees east] of a product grid; None, with the other two, for the flow's own grid and levels.
        latitude: shape (J,) [degrees north].
        depth: shape (D,) [m], positive down.
        asked_ns: What ``time`` says [ns, UTC], beside ``estimate_time``, the flow's own; None for that alone.

    Returns:
        Dataset with ``u``, ``v`` and, when the flow has an uncertainty, ``u_standard_error``, ``v_standard_error``, on dimensions
        (depth, latitude, longitude), or (depth, y, x) with two-dimensional longitude and latitude on a curvilinear grid.

    Raises:
        EstimatorError: Only some of the three axes are given, or one is not one-dimensional.
    """
    lon, lat, levels = _target(flow, longitude, latitude, depth)
    east, north = to_local(flow.grid.projection, lon, lat)
    velocity, variance = flow.columns(np.column_stack([east.ravel(), north.ravel()]), levels)
    wet = (
        flow.grid.wet
        if longitude is None
        else wet_at(flow.grid, east, north, levels[:, None, None])
    )
    dims, coords = _coordinates(flow, lon, lat, levels, asked_ns)
    dataset = xr.Dataset(coords=coords)
    for component, name in enumerate(_COMPONENTS):
        ancillary = {}
        if variance is not None:
            ancillary["ancillary_variables"] = of_error = f"{name}_standard_error"
            error = np.sqrt(np.maximum(variance[component], 0.0)).reshape(wet.shape)
            dataset[of_error] = (dims, np.where(wet, error, np.nan), ATTRIBUTES[of_error])
        dataset[name] = (
            dims,
            np.where(wet, velocity[component].reshape(wet.shape), np.nan),
            ATTRIBUTES[name] | ancillary,
        )
    made_by = history("to_dataset", flow.time_ns)
    return encoded(described(dataset, "Ocean current estimate", made_by, flow.about))


def wet_at(grid: Grid, east: ArrayLike, north: ArrayLike, depth: ArrayLike) -> NDArray[np.bool_]:
    """Return True where the grid's nearest point at the nearest level is wet and the point lies in the box of the grid and its levels.

    A point farther than half a cell's diagonal from every grid point is off the grid, hence not wet. Depths above the first level
    take the first level; below the last one the forecast has no water.

    Args:
        grid: The grid.
        east: [m], local frame; the three broadcast together.
        north: [m], local frame.
        depth: [m], positive down.
    """
    east, north = np.broadcast_arrays(
        np.asarray(east, dtype=np.float64), np.asarray(north, dtype=np.float64)
    )
    depth = np.asarray(depth, dtype=np.float64)
    distance, nearest = cKDTree(np.column_stack([grid.east.ravel(), grid.north.ravel()])).query(
        np.stack([east, north], axis=-1)
    )
    level = np.argmin(np.abs(depth[..., None] - grid.levels), axis=-1)
    # A hair more than the half diagonal, so that the corners shared by four cells belong to one.
    on_grid = distance <= 0.5 * np.hypot(_spacing(grid, 0), _spacing(grid, 1)) * (1.0 + 1e-6)
    return np.asarray(
        grid.wet.reshape(grid.levels.size, -1)[level, nearest]
        & on_grid
        & (depth <= grid.levels[-1])
    )


def write_grid(flow: FlowEstimate, path: Path) -> None:
    """Write the flow on its own grid as CF NetCDF; the file appears whole or not at all.

    Raises:
        ConfigError: The file cannot be written.
    """
    dataset = to_dataset(flow)
    compressed: Encoding = {
        str(name): {"zlib": True, "complevel": 4, "_FillValue": np.nan}
        for name in dataset.data_vars
    }
    write_dataset(dataset, Path(path), encoding_of(dataset) | compressed)


def _target(
    flow: FlowEstimate,
    longitude: ArrayLike | None,
    latitude: ArrayLike | None,
    depth: ArrayLike | None,
) -> tuple[Array, Array, Array]:
    """Return longitude and latitude, both (J, I), and depth (D,)."""
    if longitude is None and latitude is None and depth is None:
        return flow.grid.longitude, flow.grid.latitude, flow.levels
    if longitude is None or latitude is None or depth is None:
        raise EstimatorError(
            "to_dataset needs longitude, latitude and depth together, or none of them for the flow's own grid"
        )
    axes = [np.asarray(axis, dtype=np.float64) for axis in (longitude, latitude, depth)]
    if any(axis.ndim != 1 or axis.size == 0 for axis in axes):
        raise EstimatorError(
            f"to_dataset needs one-dimensional axes with values, but got shapes {[axis.shape for axis in axes]}"
        )
    lon, lat = np.meshgrid(axes[0], axes[1])
    return lon, lat, axes[2]


def _coordinates(
    flow: FlowEstimate, lon: Array, lat: Array, depth: Array, asked_ns: int | None
) -> tuple[tuple[str, ...], dict[str, xr.Variable]]:
    lon_attrs, lat_attrs = ATTRIBUTES["longitude"], ATTRIBUTES["latitude"]
    coords = {"depth": xr.Variable("depth", depth, ATTRIBUTES["depth"] | {"axis": "Z"})}
    own = {"time": flow.time_ns}
    times = own if asked_ns is None else {"time": asked_ns, "estimate_time": flow.time_ns}
    for name, time_ns in times.items():
        if time_ns is not None:
            axis = {"axis": "T"} if name == "time" else {}
            value = np.datetime64(time_ns, "ns")
            coords[name] = xr.Variable((), value, ATTRIBUTES[name] | axis)
    if np.all(lon == lon[0]) and np.all(lat == lat[:, :1]):
        coords["latitude"] = xr.Variable("latitude", lat[:, 0], lat_attrs | {"axis": "Y"})
        coords["longitude"] = xr.Variable("longitude", lon[0], lon_attrs | {"axis": "X"})
        return ("depth", "latitude", "longitude"), coords
    coords["latitude"] = xr.Variable(("y", "x"), lat, lat_attrs)
    coords["longitude"] = xr.Variable(("y", "x"), lon, lon_attrs)
    return ("depth", "y", "x"), coords


def _spacing(grid: Grid, axis: int) -> float:
    """Return the largest distance [m] between neighbours along an axis of the horizontal grid; 0 for a single row."""
    return float(np.max(grid.steps(axis), initial=0.0))


_VOCABULARY = "http://vocab.nerc.ac.uk/collection/OG1/current"
# Terms of the coordinates; none is known for an estimated current.
_TERMS = {"time": "TIME", "longitude": "LON", "latitude": "LAT", "depth": "DEPTH"}
_TERMS_OF_FIXES = {"time": "TIME", "longitude": "LON_GPS", "latitude": "LAT_GPS"}
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
        columns: Values of the points by the names of ``Velocities``, each shape (n,).
        platform: Serial number of the glider with its prefix.
        stated: What a person knows of the glider and the mission.
        about: Global attributes of the flow.

    Raises:
        EstimatorError: There is no point, or the time of one is not known.
    """
    if not columns["time"].size or np.isnat(columns["time"]).any():
        raise EstimatorError(
            "to_og1: expected points that all have a time, as along() gives with a column time"
        )
    points = "N_MEASUREMENTS"
    values = {
        name.upper(): (points, column, dict(ATTRIBUTES[name])) for name, column in columns.items()
    }
    for name, term in _TERMS.items():
        values[name.upper()][2]["vocabulary"] = f"{_VOCABULARY}/{term}/"
    first = {name: values[name.upper()] for name in _TERMS_OF_FIXES}
    for name, term in _TERMS_OF_FIXES.items():
        missing = np.full_like(
            first[name][1], np.datetime64("NaT", "ns") if name == "time" else np.nan
        )
        attributes = {
            **ATTRIBUTES[name],
            "long_name": f"{name} of each GPS location",
            "vocabulary": f"{_VOCABULARY}/{term}/",
        }
        values[f"{name.upper()}_GPS"] = (points, missing, attributes)
    start = np.datetime_as_string(first["time"][1][0], "s").replace("-", "").replace(":", "")
    single = {
        "TRAJECTORY": (
            f"{platform}_{start}",
            {"cf_role": "trajectory_id", "long_name": "trajectory name"},
        ),
        "PLATFORM_SERIAL_NUMBER": (platform, {"long_name": "glider serial number"}),
        **{
            f"DEPLOYMENT_{name.upper()}": (
                column[0],
                {**ATTRIBUTES[name], "long_name": f"{name} of the first point of the track"},
            )
            for name, (_, column, _) in first.items()
        },
        **{
            name: (value, {"long_name": name.lower().replace("_", " ")})
            for name, value in stated.items()
            if name.isupper()
        },
    }
    dataset = xr.Dataset(values | {name: ((), *each) for name, each in single.items()})
    people = {name: value for name, value in stated.items() if not name.isupper()}
    result = described(
        dataset.set_coords([name.upper() for name in _TERMS]),
        "Ocean current estimate along the track of a glider",
        f"replay-kit {__version__}: Velocities.to_og1",
        {**_FIXED, "id": f"{platform}_{start}", "start_date": start, **about, **people},
    )
    for end in ("time_coverage_start", "time_coverage_end"):
        result.attrs[end] = result.attrs[end].translate(str.maketrans("", "", "-:Z"))
    return encoded(result)
