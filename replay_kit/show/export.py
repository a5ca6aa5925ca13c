"""Export of a result's tables and map features; the file's ending gives the format.

NetCDF has a dimension for each table, which prefixes its columns if there are several; KML is 2.2 with times, GeoJSON has Mapbox's
simplestyle 1.1.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import escape

import numpy as np
import pandas as pd

from replay_kit.core.arrays import Array
from replay_kit.core.errors import ConfigError
from replay_kit.core.files.atomic import write_whole
from replay_kit.core.flow.points import WASHED, velocity_along
from replay_kit.core.geodesy import rotate_to_geographic, to_geographic
from replay_kit.core.region import Feature, collection_text
from replay_kit.core.words.colors import LIGHT
from replay_kit.core.words.text import csv_cell
from replay_kit.results.geojson import ROLES, features_of, place_features
from replay_kit.results.views.along_track import times_in, vector_column
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.current import KEPT, At
from replay_kit.show.figures.figure import ON_MAP

if TYPE_CHECKING:
    import xarray as xr


def series_table(contents: Contents, places: Sequence[At]) -> pd.DataFrame:
    """Return time series of the current at positions, see ``Contents.series``; empty without positions or a current."""
    tables = {number: contents.series(place) for number, place in enumerate(places)}
    if contents.slices is None or not tables:
        return pd.DataFrame()
    return pd.concat(tables, names=["place"]).reset_index(0).reset_index(drop=True)


def track_table(contents: Contents, places: Sequence[At]) -> pd.DataFrame:
    """Return the positions with the last estimate at each; NaN for an unknown depth."""
    fixes = contents.result.fixes
    if contents.estimate is None or not len(fixes):
        return fixes.reset_index()
    known = (fixes["depth"] >= -WASHED).to_numpy()
    # without the warning of times outside the data, which nobody asked for
    track = fixes.assign(depth=fixes["depth"].where(known, 0.0))
    found = velocity_along(contents.estimate, track).to_pandas()
    found.loc[~known, [*KEPT]] = np.nan
    measured = {name: fixes[name].to_numpy() for name in ("depth", "dead_reckoned")}
    return found.assign(**measured)


def section_table(contents: Contents, places: Sequence[At]) -> pd.DataFrame:
    """Return the bins of used profiles: measured velocity, and the velocity estimated just after the profile."""
    bins = contents.bins
    east, north, distance = contents.track.at(bins.time_ns)
    longitude, latitude = to_geographic(contents.projection, east, north)
    table = {"time": bins.time_ns.astype("datetime64[ns]"), "longitude": longitude}
    table |= {"latitude": latitude, "depth": bins.depth, "distance": distance}
    for name in ("measured", "estimated", "residual"):
        true = _true(contents, longitude, latitude, bins.values[name])
        table |= dict(zip((f"u_{name}", f"v_{name}"), true, strict=True))
    if contents.estimate is not None:
        found = contents.estimate.velocity_at(longitude, latitude, bins.depth)
        table |= {name: getattr(found, name) for name in KEPT[2:]}
    return pd.DataFrame(table)


def dives_table(contents: Contents, places: Sequence[At]) -> pd.DataFrame:
    """Return the dives: observations used, and DAC as measured, corrected for the flight-model error, and estimated."""
    means, table = contents.mean_currents, contents.result.dives.reset_index()
    if not len(means):
        return table
    east, north, _ = contents.track.at(times_in(means))
    longitude, latitude = to_geographic(contents.projection, east, north)
    columns = {"dive": means["dive"].to_numpy(), "longitude": longitude, "latitude": latitude}
    for name in ("measured", "corrected", "estimated"):
        local = vector_column(means, f"mean_current_{name}")
        error = means[f"mean_current_{name}_standard_error"].to_numpy()
        ends = f"dac_eastward_{name}", f"dac_northward_{name}", f"dac_{name}_standard_error"
        true = _true(contents, longitude, latitude, local)
        columns |= dict(zip(ends, (*true, error), strict=True))
    return table.merge(pd.DataFrame(columns), on="dive", how="outer")


def _true(contents: Contents, longitude: Array, latitude: Array, local: Array) -> tuple[Array, ...]:
    """Return velocities along local axes, shape (n, 2), towards true east and north."""
    return rotate_to_geographic(contents.projection, longitude, latitude, *local.T)


def plans_table(contents: Contents, places: Sequence[At]) -> pd.DataFrame:
    """Return the predicted tracks and status of the plans."""
    tracks = contents.result.plan_tracks.reset_index()
    status = contents.result.plans["status"].to_numpy()
    return tracks.assign(status=status[tracks["plan"].to_numpy(int)])


def _held(name: str) -> Callable[[Contents, Sequence[At]], pd.DataFrame]:
    """Return the maker of a table that the result holds."""
    return lambda contents, places: getattr(contents.result, name).reset_index()


#: Each table by its name.
TABLES: Mapping[str, Callable[[Contents, Sequence[At]], pd.DataFrame]] = {
    **{"series": series_table, "track": track_table, "section": section_table},
    **{"dives": dives_table, "innovations": _held("innovations"), "surface": _held("surface")},
    **{"surfacings": _held("surfacings"), "plans": plans_table},
}
#: The estimate in place of tables, as a file of ``--save-estimate``.
ESTIMATE = "estimate"
# The tables that have places on a map, which files of maps hold.
_MAPPED = ("series", "track", "surfacings", "plans")
#: By the endings of the files the tables that they may hold.
ENDINGS: Mapping[str, tuple[str, ...]] = {
    **dict.fromkeys((".nc", ".csv"), (*TABLES,)),
    **dict.fromkeys((".kml", ".geojson"), _MAPPED),
}


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
    if table is not None and table not in ENDINGS[ending]:
        holding = [one for one, held in ENDINGS.items() if table in held] or [".nc"]
        raise ConfigError(
            f"{path}: expected a name that ends in {' or '.join(holding)} for the table {table}, got {ending}; choose another name"
        )
    names = ENDINGS[ending] if table is None else (table,)
    if ENDINGS[ending] == _MAPPED:
        series = series_table(contents, places) if "series" in names else pd.DataFrame()
        every = [*features_of(contents), *place_features(series, contents.projection)]
        roles = [ROLES[one["properties"]["role"]] for one in every]
        found = [styled(one) for one, table in zip(every, roles, strict=True) if table in names]
        in_json = collection_text(found, indent=1) + "\n" if ending == ".geojson" else ""
        write_whole(path, in_json or kml_text(found))
        return {name: roles.count(name) for name in names}
    tables = {name: _joined_table(name, contents, places) for name in names}
    if ending == ".nc":
        # loads xarray
        from replay_kit.core.flow.dataset import write_dataset

        write_dataset(to_dataset(tables, contents), path)
    else:
        write_whole(path, _csv_text(tables[names[0]]))
    return {name: len(rows) for name, rows in tables.items()}


def _joined_table(name: str, contents: Contents, places: Sequence[At]) -> pd.DataFrame:
    """Return a table of a result; for several vehicles with a column ``vehicle``, and common values once."""
    table = TABLES[name]
    if "" in contents.each or name in ("series", "surface"):
        return table(contents, places)
    each = [table(one, places).assign(vehicle=vehicle) for vehicle, one in contents.each.items()]
    return pd.concat([rows for rows in each if len(rows)] or each[:1], ignore_index=True)


def _csv_text(rows: pd.DataFrame) -> str:
    texts = rows.select_dtypes(exclude=["number", "bool", "datetime"])
    rows = rows.assign(**{name: column.map(csv_cell) for name, column in texts.items()})
    form = "%Y-%m-%dT%H:%M:%S.%fZ"
    return str(rows.to_csv(index=False, date_format=form, lineterminator="\n"))


# Attributes of columns by what their names hold, the first that fits; those without have no unit.
_METRES, _SPEED = {"units": "m"}, {"units": "m s-1"}
_UNITS = {
    "_deg|_bearing": {"units": "degree"},
    "delay": {"units": "s"},
    "distance|ellipse_m": _METRES,
    "innovation|residual|measured|corrected|estimated|rms": _SPEED,
    "nis": {"units": "1"},
    "bottom": _METRES | {"standard_name": "sea_floor_depth_below_sea_surface"},
    "": {},
}
# Data types by their kinds; counts and flags have no unit.
_KINDS = {"M": "datetime64[ns]", "b": "int8", "i": "int32", "u": "int32", "f": "float64"}
_COORDINATES = ("time", "latitude", "longitude", "depth")


def to_dataset(tables: Mapping[str, pd.DataFrame], contents: Contents) -> "xr.Dataset":
    """Return tables by name as one CF dataset, without empty ones.

    Args:
        tables: Tables by name.
        contents: Contents of the result, for the local frame of components along local axes, and global attributes.
    """
    import xarray as xr

    from replay_kit.core.flow.dataset import described_dataset

    attrs = {
        "local_frame": "Components of innovations are along the axes of the local frame (azimuthal equidistant, WGS84); others are true.",
        "local_frame_longitude": contents.projection.longitude,
        "local_frame_latitude": contents.projection.latitude,
    }
    dataset = xr.Dataset(attrs=attrs)
    for table, rows in tables.items():
        if not len(rows):
            continue
        before = f"{table}_" if len(tables) > 1 else ""
        for column in rows:
            values = rows[column].to_numpy()
            if (kind := values.dtype.kind) in _KINDS:
                values = values.astype(_KINDS[kind])
            else:
                values = np.array([str(value).encode() for value in values])
            about = _attributes(table, str(column), values.dtype.kind)
            dataset[f"{before}{column}"] = (table, values, about)
        held = [f"{before}{name}" for name in _COORDINATES if name in rows]
        dataset = dataset.set_coords(held)
    of_estimate = {} if contents.estimate is None else contents.estimate.about
    title = f"Ocean current estimate: {', '.join(map(str, dataset.dims))}"
    return described_dataset(dataset, title, "export", of_estimate)


def _attributes(table: str, column: str, kind: str) -> dict[str, Any]:
    """Return the attributes of a column: those of its own name, or of the coordinate or velocity at its end or beginning."""
    from replay_kit.core.flow.dataset import ATTRIBUTES

    named = {"long_name": f"{column.replace('_', ' ')} ({table})"}
    units = next(units for part, units in _UNITS.items() if re.search(part, column))
    (end,) = re.findall(r"(?:^|_)(longitude|latitude|depth)$", column) or [column]
    known = {} if end == "estimate_time" else ATTRIBUTES.get(end, {})
    if re.fullmatch("[uv]_(measured|estimated)", column):
        known = {"standard_name": ATTRIBUTES[column[0]]["standard_name"]}
    whole = {"units": "1"} if kind == "i" else {}
    return whole | units | known | named


def styled(item: Feature) -> Feature:
    """Return a feature with colours and widths as simplestyle properties."""
    look = ON_MAP.get(item["properties"]["role"], {"kind": "points", "color": "three"})
    color = LIGHT.get(look["color"], look["color"])
    style: dict[str, Any] = {"marker-color": color, "marker-size": "small"}
    if look["kind"] != "points":
        style = {"stroke": color, "stroke-width": look.get("width", 3), "stroke-opacity": 1.0}
        style |= {"fill": color, "fill-opacity": 0.15} if look["kind"] == "ring" else {}
    return {**item, "properties": item["properties"] | style}


# What KML has in elements of its own, or only a drawing needs.
_OWN = re.compile("name|description|coordTimes|depth_m|role|last|marker-.*|stroke.*|fill.*")


def kml_text(features: Sequence[Feature]) -> str:
    """Return styled features as KML with times for the slider of Google Earth; tracks use its extension."""
    places = "".join(map(_placemark, features))
    names = 'xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2"'
    return f'<?xml version="1.0" encoding="UTF-8"?>\n<kml {names}><Document>\n{places}</Document></kml>\n'


def _placemark(item: Feature) -> str:
    about, kind = item["properties"], item["geometry"]["type"]
    data = "".join(
        f'<Data name="{escape(key)}"><value>{escape(str(value))}</value></Data>'
        for key, value in about.items()
        if not _OWN.fullmatch(key)
    )
    said = about.get("description")
    text = "" if said is None else f"<description>{escape(said)}</description>"
    when = about.get("surfaces", about.get("time", "") if kind == "Point" else "")
    time = f"<TimeStamp><when>{when}</when></TimeStamp>" if when else ""
    shape = _shape(kind, item["geometry"]["coordinates"], about.get("coordTimes", ()))
    return (
        f"<Placemark><name>{escape(about['name'])}</name>{text}{time}{_style(about)}"
        f"<ExtendedData>{data}</ExtendedData>{shape}</Placemark>\n"
    )


def _shape(kind: str, at: Any, times: Sequence[str]) -> str:
    """Return a KML geometry, with longitudes wrapped to 180 degrees."""
    if kind == "MultiPoint":
        return f"<MultiGeometry>{''.join(_shape('Point', one, ()) for one in at)}</MultiGeometry>"
    if kind == "Polygon":
        rings = [f"BoundaryIs>{_shape('LinearRing', ring, ())}</" for ring in at]
        sides = zip(("outer", *["inner"] * len(at)), rings, strict=False)
        return f"<Polygon>{''.join(f'<{side}{ring}{side}BoundaryIs>' for side, ring in sides)}</Polygon>"
    points = [at] if kind == "Point" else at
    places = [((longitude + 180.0) % 360.0 - 180.0, latitude) for longitude, latitude in points]
    if times:
        when = "".join(f"<when>{time}</when>" for time in times)
        each = (f"<gx:coord>{x:.7f} {y:.7f} 0</gx:coord>" for x, y in places)
        return f"<gx:Track>{when}{''.join(each)}</gx:Track>"
    text = f"<coordinates>{' '.join(f'{x:.7f},{y:.7f}' for x, y in places)}</coordinates>"
    return f"<{kind}>{text}</{kind}>"


def _style(about: Mapping[str, Any]) -> str:
    """Return a KML style; colours are in the order opacity, blue, green, red."""
    forms = {
        "marker-color": "<IconStyle><color>ff{}</color></IconStyle>",
        "stroke": "<LineStyle><color>ff{}</color><width>{}</width></LineStyle>",
        "fill": "<PolyStyle><color>26{}</color></PolyStyle>",
    }
    turned = {
        key: "".join(about[key][k : k + 2] for k in (5, 3, 1)) for key in forms if key in about
    }
    width = about.get("stroke-width")
    return f"<Style>{''.join(forms[key].format(color, width) for key, color in turned.items())}</Style>"
