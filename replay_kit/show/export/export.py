"""A result to a file of another program; the ending of its name says which."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from replay_kit.core.atomic import atomic_file
from replay_kit.core.errors import ConfigError
from replay_kit.core.text import csv_cell
from replay_kit.results.views.contents import Contents
from replay_kit.show.export.features import FEATURES, features_of, geojson_text, kml_text
from replay_kit.show.export.netcdf import write_netcdf
from replay_kit.show.export.tables import TABLES, At

#: Endings of the files.
ENDINGS = (".nc", ".csv", ".kml", ".geojson")


def export(
    contents: Contents, path: Path, places: Sequence[At] = (), table: str | None = None
) -> dict[str, int]:
    """Write tables of a result to a file, and return the number of rows of each table written.

    A CSV file has one table; NetCDF has all that have rows; KML and GeoJSON have the track, places, surfacings, and the last
    plan with its ellipses and the areas that it keeps out of.

    Args:
        contents: Of the result.
        path: The file; its ending says the form.
        places: Of ``series``.
        table: One of ``TABLES``; None for all, in CSV for ``series`` where there are places, else for ``track``.

    Raises:
        ConfigError: The ending or the table is not known, a series has no place, or the file cannot be written.
    """
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        raise ConfigError(
            f"{path}: expected a name that ends in one of {', '.join(ENDINGS)}, got '{path.suffix}'; choose another name"
        )
    if table is not None and table not in TABLES:
        raise ConfigError(f"table: expected one of {', '.join(TABLES)}, got '{table}'")
    if table is None and ending == ".csv":
        table = "series" if places else "track"
    if table == "series" and not places:
        raise ConfigError("series: expected one or more places, got none; give --at LON,LAT,DEPTH")
    shown = list(TABLES) if ending == ".nc" else list(FEATURES)
    if table is not None and ending in (".kml", ".geojson") and table not in FEATURES:
        raise ConfigError(
            f"table: expected one of {', '.join(FEATURES)} in {ending}, got '{table}'; .nc and .csv hold the others"
        )
    names = shown if table is None else [table]
    tables = {name: TABLES[name](contents, places) for name in names}
    if ending == ".nc":
        write_netcdf(tables, contents.projection, path)
    else:
        with atomic_file(path) as file:
            file.write(_text(tables, ending, contents).encode())
    return {name: len(rows) for name, rows in tables.items()}


def _text(tables: dict[str, pd.DataFrame], ending: str, contents: Contents) -> str:
    if ending == ".csv":
        (rows,) = tables.values()
        texts = rows.select_dtypes(exclude=["number", "bool", "datetime"])
        rows = rows.assign(**{name: column.map(csv_cell) for name, column in texts.items()})
        return str(
            rows.to_csv(index=False, date_format="%Y-%m-%dT%H:%M:%S.%fZ", lineterminator="\n")
        )
    features = features_of(tables, contents.projection, contents.last_plan)
    return geojson_text(features) if ending == ".geojson" else kml_text(features)
