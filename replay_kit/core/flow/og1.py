"""Velocities along a track as a trajectory after OG1.0, the format of OceanGliders."""

from collections.abc import Mapping

import numpy as np
import xarray as xr

from replay_kit.core.arrays import Array
from replay_kit.core.errors import EstimatorError
from replay_kit.core.flow.cf import CONVENTIONS, described, encoded
from replay_kit.core.flow.netcdf import ATTRIBUTES
from replay_kit.core.version import __version__

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
        missing = np.full_like(first[name][1], np.datetime64("NaT") if name == "time" else np.nan)
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
