"""Export of a result's tables and map features; the file's ending gives the format."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pandas as pd

from replay_kit.core.errors import ConfigError
from replay_kit.core.files.atomic import write_whole
from replay_kit.core.flow.points import WASHED, velocity_along
from replay_kit.core.geodesy import rotate_to_geographic, to_geographic
from replay_kit.core.words.text import csv_cell
from replay_kit.results.geojson import ROLES, features_of, place_features
from replay_kit.results.views.contents import Contents
from replay_kit.show.export.kml import geojson_text, kml_text

_CURRENT = ("depth", "u", "v", "u_standard_error", "v_standard_error")
#: A place: longitude, latitude [degrees] and depth [m].
At = tuple[float, float, float]


def series_table(contents: Contents, places: Sequence[At]) -> pd.DataFrame:
    """Return time series of the current at positions, see ``Contents.series``; empty without positions or a current."""
    tables = []
    for number, place in enumerate(places):
        if (found := contents.series(place)) is not None:
            at = {"place": number, "time": found.time_ns.astype("datetime64[ns]")}
            at |= dict(zip(("longitude", "latitude"), place, strict=False))
            tables.append(pd.DataFrame(at | {name: getattr(found, name) for name in _CURRENT}))
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()


def track_table(contents: Contents, places: Sequence[At]) -> pd.DataFrame:
    """Return the positions with the last estimate at each; NaN for an unknown depth."""
    fixes = contents.result.fixes
    if contents.estimate is None or not len(fixes):
        return fixes.reset_index()
    depth = fixes["depth"].to_numpy(np.float64)
    unknown = ~(depth >= -WASHED)
    # without the warning of times outside the data, which nobody asked for
    track = fixes.assign(depth=np.where(unknown, 0.0, depth))
    found = velocity_along(contents.estimate, track).to_pandas()
    found.loc[unknown, [*_CURRENT[1:]]] = np.nan
    found["depth"] = depth
    return found.assign(dead_reckoned=fixes["dead_reckoned"].to_numpy(bool)).reset_index(drop=True)


def section_table(contents: Contents, places: Sequence[At]) -> pd.DataFrame:
    """Return the bins of used profiles: measured velocity, and the velocity estimated just after the profile."""
    bins, projection = contents.bins, contents.projection
    east, north, distance = contents.track.at(bins.time_ns)
    longitude, latitude = to_geographic(projection, east, north)
    table = {
        "time": bins.time_ns.astype("datetime64[ns]"),
        "longitude": longitude,
        "latitude": latitude,
        "depth": bins.depth,
        "distance": distance,
    }
    measured = bins.estimated + bins.residual
    parts = {"measured": measured, "estimated": bins.estimated, "residual": bins.residual}
    for name, values in parts.items():
        u, v = rotate_to_geographic(projection, longitude, latitude, *values.T)
        table |= {f"u_{name}": u, f"v_{name}": v}
    if contents.estimate is not None:
        found = contents.estimate.velocity_at(longitude, latitude, bins.depth)
        table |= {name: getattr(found, name) for name in _CURRENT[3:]}
    return pd.DataFrame(table)


def dives_table(contents: Contents, places: Sequence[At]) -> pd.DataFrame:
    """Return the dives: observations used, and DAC as measured, corrected for the flight-model error, and estimated."""
    means, track = contents.mean_currents, contents.track
    table = contents.result.dives.reset_index()
    if not means.time_ns.size:
        return table
    east, north, _ = track.at(means.time_ns)
    longitude, latitude = to_geographic(contents.projection, east, north)
    columns = {"dive": means.dive, "longitude": longitude, "latitude": latitude}
    for name, error in zip(("measured", "corrected", "estimated"), means.errors.T, strict=True):
        pairs = getattr(means, name).T
        u, v = rotate_to_geographic(contents.projection, longitude, latitude, *pairs)
        columns |= {f"dac_eastward_{name}": u, f"dac_northward_{name}": v}
        columns[f"dac_{name}_standard_error"] = error
    return table.merge(pd.DataFrame(columns), on="dive", how="outer")


def plans_table(contents: Contents, places: Sequence[At]) -> pd.DataFrame:
    """Return the predicted tracks and status of the plans."""
    plans, tracks = contents.result.plans, contents.result.plan_tracks.reset_index()
    status = plans["status"].to_numpy()
    return tracks.assign(status=[status[int(number)] for number in tracks["plan"]])


#: Each table by its name.
TABLES: Mapping[str, Callable[[Contents, Sequence[At]], pd.DataFrame]] = MappingProxyType(
    {
        "series": series_table,
        "track": track_table,
        "section": section_table,
        "dives": dives_table,
        "innovations": lambda contents, _: contents.result.innovations.reset_index(),
        "surface": lambda contents, _: contents.result.surface.reset_index(),
        "surfacings": lambda contents, _: contents.result.surfacings.reset_index(),
        "plans": plans_table,
    }
)


#: The estimate in place of tables, as a file of ``--save-estimate``.
ESTIMATE = "estimate"
#: Endings of the files, and the tables that have places on a map, which those of maps hold.
ENDINGS = (".nc", ".csv", ".kml", ".geojson")
_MAPPED = ("series", "track", "surfacings", "plans")


def export(
    contents: Contents, path: Path, places: Sequence[At] = (), table: str | None = None
) -> dict[str, int]:
    """Write tables of a result to a file; return the number of rows, or map features, by table.

    CSV holds one table, NetCDF all that are not empty, KML and GeoJSON track, surfacings, and the last plan.

    Args:
        contents: Contents of the result.
        path: File; its ending gives the format.
        places: Positions of ``series``.
        table: One of ``TABLES``, or ``ESTIMATE``; None for all tables, in CSV for ``series`` with positions, otherwise ``track``.

    Raises:
        ConfigError: Unknown ending or table, a series without a position, or the file cannot be written.
    """
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        raise ConfigError(
            f"{path}: expected a name that ends in one of {', '.join(ENDINGS)}, got '{path.suffix}'; choose another name"
        )
    if table is not None and table not in (*TABLES, ESTIMATE):
        raise ConfigError(f"table: expected one of {', '.join(TABLES)}, {ESTIMATE}, got '{table}'")
    if table == ESTIMATE and ending == ".nc":
        if contents.estimate is None:
            raise ConfigError(contents.without_estimate)
        contents.estimate.save(path)
        return {ESTIMATE: 1}
    if table is None and ending == ".csv":
        table = "series" if places else "track"
    if table == "series" and not places:
        raise ConfigError("series: expected one or more places, got none; give --at LON,LAT,DEPTH")
    own = [*TABLES] if ending in (".nc", ".csv") else [*_MAPPED]
    if table is not None and table not in own:
        raise ConfigError(
            f"table: expected one of {', '.join(own)} in {ending}, got '{table}'; .nc and .csv hold the others"
        )
    names = own if table is None else [table]
    if ending in (".kml", ".geojson"):
        return _write_features(contents, path, names, places)
    tables = {name: _of_all(name, contents, places) for name in names}
    if ending == ".nc":
        # loads xarray
        from replay_kit.show.export.netcdf import write_netcdf

        about = {} if contents.estimate is None else contents.estimate.about
        write_netcdf(tables, contents.projection, path, about)
    else:
        write_whole(path, _csv_text(tables[names[0]]))
    return {name: len(rows) for name, rows in tables.items()}


def _write_features(
    contents: Contents, path: Path, names: Sequence[str], places: Sequence[At]
) -> dict[str, int]:
    """Write the features of tables; return their number by table."""
    series = series_table(contents, places) if "series" in names else pd.DataFrame()
    every = [*features_of(contents), *place_features(series, contents.projection)]
    of = [ROLES[one["properties"]["role"]] for one in every]
    found = [one for one, table in zip(every, of, strict=True) if table in names]
    text = geojson_text if path.suffix.lower() == ".geojson" else kml_text
    write_whole(path, text(found))
    return {name: of.count(name) for name in names}


def _of_all(name: str, contents: Contents, places: Sequence[At]) -> pd.DataFrame:
    """Return a table of a result; for several vehicles with a column ``vehicle``, and common values once."""
    table = TABLES[name]
    if "" in contents.each or name in ("series", "surface"):
        return table(contents, places)
    each = [table(one, places).assign(vehicle=vehicle) for vehicle, one in contents.each.items()]
    held = [rows for rows in each if len(rows)]
    return pd.concat(held, ignore_index=True) if held else each[0]


def _csv_text(rows: pd.DataFrame) -> str:
    texts = rows.select_dtypes(exclude=["number", "bool", "datetime"])
    rows = rows.assign(**{name: column.map(csv_cell) for name, column in texts.items()})
    form = "%Y-%m-%dT%H:%M:%S.%fZ"
    return str(rows.to_csv(index=False, date_format=form, lineterminator="\n"))
