"""Tables of a result in one CF NetCDF file, with a dimension for each table, which prefixes its columns if there are several."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from replay_kit.core.flow.cf import described, write_dataset
from replay_kit.core.flow.dataset import ATTRIBUTES
from replay_kit.core.grid import Projection

_SPEED = {"units": "m s-1"}
_METRES = {"units": "m"}
# Units of columns that are no coordinates and no velocity of ``ATTRIBUTES``, by what their names hold; the first that fits.
_UNITS = (
    ("_deg", {"units": "degree"}),
    ("_bearing", {"units": "degree"}),
    ("delay", {"units": "s"}),
    ("distance", _METRES),
    ("ellipse_m", _METRES),
    ("innovation", _SPEED),
    ("residual", _SPEED),
    ("measured", _SPEED),
    ("corrected", _SPEED),
    ("estimated", _SPEED),
    ("rms", _SPEED),
    ("nis", {"units": "1"}),
    ("bottom", _METRES | {"standard_name": "sea_floor_depth_below_sea_surface"}),
)
# Data types by their kinds; counts and flags have no unit.
_KINDS = {"M": "datetime64[ns]", "b": "int8", "i": "int32", "u": "int32", "f": "float64"}
_COORDINATES = ("time", "latitude", "longitude", "depth")
_COMPONENTS = {
    "u": "eastward",
    "v": "northward",
    "dac_eastward": "eastward",
    "dac_northward": "northward",
}


def write_netcdf(
    tables: Mapping[str, pd.DataFrame], projection: Projection, path: Path, about: Mapping[str, str]
) -> None:
    """Write tables to a NetCDF file, completely or not at all.

    Args:
        tables: Tables by name; empty ones are omitted.
        projection: Local frame of components along local axes.
        path: File.
        about: Further global attributes.

    Raises:
        ConfigError: The file cannot be written.
    """
    write_dataset(to_dataset(tables, projection, about), path)


def to_dataset(
    tables: Mapping[str, pd.DataFrame], projection: Projection, about: Mapping[str, str]
) -> xr.Dataset:
    """Return tables as one CF dataset; see ``write_netcdf``."""
    attrs = {
        "local_frame": "Components of innovations are along the axes of the local frame (azimuthal equidistant, WGS84); others are true.",
        "local_frame_longitude": projection.longitude,
        "local_frame_latitude": projection.latitude,
    }
    dataset = xr.Dataset(attrs=attrs)
    for table, rows in tables.items():
        if not len(rows):
            continue
        before = f"{table}_" if len(tables) > 1 else ""
        coordinates = [f"{before}{name}" for name in _COORDINATES if name in rows]
        for column in rows:
            values, attributes = _values(rows[column]), _attributes(table, str(column))
            if values.dtype.kind == "i":
                attributes.setdefault("units", "1")
            dataset[f"{before}{column}"] = (table, values, attributes)
        dataset = dataset.set_coords(coordinates)
    return described(
        dataset,
        f"Ocean current estimate: {', '.join(map(str, dataset.dims))}",
        "export",
        about,
    )


def _values(column: pd.Series) -> Any:
    """Return a column in a data type of CF."""
    values = column.to_numpy()
    if (kind := values.dtype.kind) in _KINDS:
        return values.astype(_KINDS[kind])
    texts = [str(value).encode() for value in column]
    return np.array(texts, dtype=f"S{max(map(len, texts))}")


def _attributes(table: str, column: str) -> dict[str, Any]:
    attrs: dict[str, Any] = {"long_name": f"{column.replace('_', ' ')} ({table})"}
    if column in _COORDINATES or (column in ATTRIBUTES and column != "estimate_time"):
        return attrs | {
            key: value for key, value in ATTRIBUTES[column].items() if key != "long_name"
        }
    component, _, kind = column.rpartition("_")
    if (
        component in _COMPONENTS
        and kind in ("measured", "estimated")
        and not column.startswith("dac")
    ):
        attrs["standard_name"] = f"{_COMPONENTS[component]}_sea_water_velocity"
    for end, name in (("_longitude", "longitude"), ("_latitude", "latitude"), ("_depth", "depth")):
        if column.endswith(end):
            attrs |= {key: value for key, value in ATTRIBUTES[name].items() if key != "long_name"}
    units = next((units for part, units in _UNITS if part in column), {})
    return {**units, **attrs}
