"""A flow as a CF dataset for people and programs, velocities towards true east and north with errors; and along a track as OG1.0."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from replay_kit.core.arrays import Array
from replay_kit.core.errors import EstimatorError
from replay_kit.core.flow.cf import CONVENTIONS, call_text, described, encoded, write_dataset
from replay_kit.core.flow.estimate import FlowEstimate, checked_depth, warn_outside
from replay_kit.core.flow.points import evaluate, wet_at
from replay_kit.core.quantities import to_time_ns

_COMPONENTS = {"u": "eastward sea water velocity", "v": "northward sea water velocity"}
_ERROR = "standard_error"
#: Attributes of the variables, after CF.
ATTRIBUTES = {
    **{
        name: {"standard_name": words.replace(" ", "_"), "long_name": words, "units": "m s-1"}
        for name, words in _COMPONENTS.items()
    },
    **{
        f"{name}_{_ERROR}": {
            "standard_name": f"{words.replace(' ', '_')} {_ERROR}",
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
    time: Any = None,
) -> xr.Dataset:
    """Return velocity and standard error as a CF dataset, NaN where dry and below the last level; see ``FlowEstimate.to_xarray``.

    Below the last level nothing is known: ``velocity`` continues the last level's flow there, a grid does not show it.

    Returns:
        Dataset with ``u``, ``v`` and, when the flow has an uncertainty, ``u_standard_error``, ``v_standard_error``, on dimensions
        (depth, latitude, longitude), or (depth, y, x) with two-dimensional longitude and latitude on a curvilinear grid.
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
    flows, asked = [flow], list[int]()
    through: tuple[str, ...] = ()
    if time is not None:
        flow.require_model_of_time()
        time_ns = to_time_ns(time)
        warn_outside([flow], time_ns, 4)
        asked, through = time_ns.ravel().tolist(), ("time",) * min(time_ns.ndim, 1)
        flows = [flow if flow.process is None else flow.at(each) for each in asked]
    values = np.array([evaluate(one, lon, lat, levels[:, None, None], wet_at) for one in flows])
    values = values if through else values[0]
    regular = bool(np.all(lon == lon[0]) and np.all(lat == lat[:, :1]))
    dims = (*through, "depth", *(("latitude", "longitude") if regular else ("y", "x")))
    dataset = xr.Dataset(
        coords={
            "depth": ("depth", levels, ATTRIBUTES["depth"] | {"axis": "Z"}),
            **_times(asked, [one.time_ns for one in flows], through),
            **_places(lon, lat, regular),
        }
    )
    for k, name in enumerate(_COMPONENTS):
        ancillary = {}
        if flow.n_modes:
            ancillary["ancillary_variables"] = of_error = f"{name}_{_ERROR}"
            dataset[of_error] = (dims, values[..., 2 + k], ATTRIBUTES[of_error])
        dataset[name] = (dims, values[..., k], ATTRIBUTES[name] | ancillary)
    made_by = call_text("to_dataset", (flow if through else flows[0]).time_ns)
    return encoded(described(dataset, "Ocean current estimate", made_by, flow.about))


def _times(
    asked: list[int], held: Sequence[int | None], dims: tuple[str, ...]
) -> dict[str, xr.Variable]:
    """Return the coordinates of the times that were asked for, none for the flow's own, and of those that it holds for [ns, UTC]."""
    found = {}
    for name, times in {
        "time": asked or held,
        **({"estimate_time": held} if asked else {}),
    }.items():
        if None not in times:
            dates = np.array(times, "M8[ns]").reshape(-1 if dims else ())
            axis = {"axis": "T"} if name == "time" else {}
            found[name] = xr.Variable(dims, dates, ATTRIBUTES[name] | axis)
    return found


def _places(lon: Array, lat: Array, regular: bool) -> dict[str, xr.Variable]:
    """Return the coordinates of a grid's longitudes and latitudes, both (J, I) [degrees]: axes where it is regular."""
    if not regular:
        each = {"latitude": lat, "longitude": lon}
        return {name: xr.Variable(("y", "x"), at, ATTRIBUTES[name]) for name, at in each.items()}
    return {
        name: xr.Variable(name, at, ATTRIBUTES[name] | {"axis": axis})
        for name, at, axis in (("latitude", lat[:, 0], "Y"), ("longitude", lon[0], "X"))
    }


def write_grid(flow: FlowEstimate, path: Path) -> None:
    """Write the flow on its own grid as CF NetCDF; the file appears whole or not at all.

    Raises:
        ConfigError: The file cannot be written.
    """
    write_dataset(to_dataset(flow), path)


def of_points(
    columns: Mapping[str, Array], coordinates: Sequence[str], about: Mapping[str, str]
) -> xr.Dataset:
    """Return velocities at points as a CF dataset; see ``Velocities.to_xarray``.

    Args:
        columns: Values of the points by the names of ``Velocities``, each shape (n,).
        coordinates: Those that are coordinates.
        about: Global attributes of the flow.
    """
    values = {name: ("point", column, ATTRIBUTES[name]) for name, column in columns.items()}
    dataset = xr.Dataset(values).set_coords(coordinates)
    about = {"featureType": "point", **about}
    title, made_by = "Ocean current estimate at points", "Velocities.to_xarray"
    return encoded(described(dataset, title, made_by, about))


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
    points, values, single = "N_MEASUREMENTS", dict[str, Any](), dict[str, Any]()
    for name, column in columns.items():
        term = {"vocabulary": f"{_VOCABULARY}/{_TERMS[name]}/"} if name in _TERMS else {}
        values[name.upper()] = (points, column, ATTRIBUTES[name] | term)
    for name, word in _TERMS_OF_FIXES.items():
        long_name = {"long_name": f"{name} of each GPS location"}
        attributes = ATTRIBUTES[name] | long_name | {"vocabulary": f"{_VOCABULARY}/{word}/"}
        # of the column's type, NaN or NaT
        missing = np.full_like(columns[name], "NaT" if name == "time" else np.nan)
        values[f"{name.upper()}_GPS"] = (points, missing, attributes)
        long_name = {"long_name": f"{name} of the first point of the track"}
        single[f"DEPLOYMENT_{name.upper()}"] = (columns[name][0], ATTRIBUTES[name] | long_name)
    start = np.datetime_as_string(columns["time"][0], "s").translate(_DIGITS)
    single |= {
        "TRAJECTORY": (
            f"{platform}_{start}",
            {"cf_role": "trajectory_id", "long_name": "trajectory name"},
        ),
        "PLATFORM_SERIAL_NUMBER": (platform, {"long_name": "glider serial number"}),
    }
    people = dict(about)
    for name, value in stated.items():
        if name.isupper():
            single[name] = (value, {"long_name": name.lower().replace("_", " ")})
        else:
            people[name] = value
    dataset = xr.Dataset(values | {name: ((), *each) for name, each in single.items()})
    result = described(
        dataset.set_coords([name.upper() for name in _TERMS]),
        "Ocean current estimate along the track of a glider",
        "Velocities.to_og1",
        {**_FIXED, "id": f"{platform}_{start}", "start_date": start, **people},
    )
    for end in ("time_coverage_start", "time_coverage_end"):
        result.attrs[end] = result.attrs[end].translate(_DIGITS)
    return encoded(result)


_DIGITS = str.maketrans("", "", "-:Z")
