"""``export``: a result as NetCDF, CSV, KML or GeoJSON."""

from pathlib import Path
from typing import Annotated, Literal

from replay_kit.cli.console import console_beside
from replay_kit.cli.options import (
    OUTPUTS,
    TO_OUTPUTS,
    Ending,
    Replacing,
    argument,
    option,
)
from replay_kit.config.option import PLACE, numbers
from replay_kit.core.paths import check_paths

_ENDINGS = Ending((".nc", ".csv", ".kml", ".geojson"))
_TABLES = Literal["series", "track", "section", "dives", "innovations", "surfacings", "plans"]


def export(
    result: Annotated[
        Path,
        argument(
            "RESULT.mcap",
            "A result of replay or plan; of a truncated one the readable part is exported.",
        ),
    ],
    /,
    *,
    out: Annotated[
        Path,
        option(
            "--out -o",
            "File; its ending selects the format.",
            metavar="X.nc|csv|kml|geojson",
            group=OUTPUTS,
        ),
        _ENDINGS,
    ],
    at: Annotated[
        list[str] | None,
        option(
            "--at",
            "Place of a series of the current [degrees, degrees, m]; may be repeated.",
            metavar="LON,LAT,DEPTH",
        ),
        PLACE,
    ] = None,
    table: Annotated[
        _TABLES | None,
        option(
            "--table",
            "Export only this table. Default: all; in CSV the series with --at, else the track.",
        ),
    ] = None,
    replacing: Annotated[Replacing, TO_OUTPUTS] = Replacing(),
) -> int:
    """Return 0, or 4 when part of the result was lost."""
    check_paths([result], [out], replacing.overwrite)
    places = [numbers(text, "--at", PLACE.form) for text in at or ()]

    from replay_kit.show.export import export as write
    from replay_kit.show.text import print_lines
    from replay_kit.workflows.report import opened

    with opened(result) as contents:
        rows = write(contents, out, [(place[0], place[1], place[2]) for place in places], table)
    print_lines(console := console_beside(None), contents.notes)
    console.print(
        f"{out}: " + ", ".join(f"{name} {count} rows" for name, count in rows.items()),
        soft_wrap=True,
    )
    return contents.exit_code
