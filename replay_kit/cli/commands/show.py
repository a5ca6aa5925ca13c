"""``report``, ``status``, ``plot``, ``export`` and ``layout``: results as page, screen, figures, tables and viewer layout."""

from collections.abc import Mapping
from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from replay_kit.cli.console import console_beside
from replay_kit.cli.options import (
    HTML,
    OUTPUTS,
    TO_OPTIONS,
    Answer,
    Ending,
    Replacing,
    argument,
    option,
    output,
    place,
)
from replay_kit.config.option import PLACE
from replay_kit.core.errors import ConfigError
from replay_kit.core.words.quantities import parse_time

if TYPE_CHECKING:
    from replay_kit.results.views.contents import Contents
    from replay_kit.show.status.status import Status
    from replay_kit.workflows.sound import Sound


_Result = Annotated[
    Path,
    argument(
        "RESULT", help="A result of replay or plan; of a truncated one the readable part is used."
    ),
]


def _told(contents: "Contents", line: str) -> int:
    """Print losses of a result, then a line; return the exit code."""
    from replay_kit.show.text import print_lines

    print_lines(console_beside(), [*contents.notes, line])
    return contents.exit_code


def report(
    result: _Result,
    /,
    *,
    out: Annotated[Path | None, output("REPORT.html"), HTML] = None,
    replacing: Replacing = Replacing(),
) -> int:
    """Return exit code 0, or 4 when part of the result was lost.

    Args:
        out: Self-contained HTML page. Default: the result's name with .html.
    """
    from replay_kit.workflows.report import page_of
    from replay_kit.workflows.report import report as write_report

    page = out or page_of(result)
    size, contents = write_report(result, page, replacing.overwrite)
    return _told(contents, f"Report: {page} ({size / 1e6:.1f} MB); open it in a browser.")


def status(
    *results: Annotated[Path, argument("RESULT")],
    html: Annotated[Path | None, option("PAGE.html", group=OUTPUTS), HTML] = None,
    now: Annotated[str | None, option("TIME")] = None,
    answer: Answer = Answer(),
) -> int:
    """Return exit code 0, also with alarms, or 4 when part of a result was lost.

    Args:
        results: Results of replay, also of a running --follow.
        html: Also write a page that reloads itself.
        now: Time relative to which ages are stated, ISO 8601 UTC, or 'clock'. Default: the end of the result.
    """
    if len(results) > 1 and html is not None:
        raise ConfigError("--html: expected one result, got several; write a page for each")
    replace(answer, overwrite=answer.overwrite or html is not None).check(results, html)
    moment = _moment(now)

    from replay_kit.workflows.status import read_status, write_pages

    each = [read_status(path, moment) for path in results]
    from replay_kit.show.summary import print_summary
    from replay_kit.show.text import print_lines

    beside = answer.console()
    for found, outcome, sound in each:
        print_lines(beside, sound.lines)
        print_summary(found, outcome, beside, verbose=answer.verbose, titled=True)
    if html is not None:
        write_pages(*each[0][:2], html)
    figures = [_figures(found, sound) for found, _, sound in each]
    answer.write({"results": figures} if len(results) > 1 else figures[0])
    return max(sound.exit_code for *_, sound in each)


def _figures(found: "Mapping[str, Status]", sound: "Sound") -> dict[str, Any]:
    """Return the status of a result as JSON; for several vehicles by name."""
    lost = {"losses": list(sound.lines)}
    if "" in found:
        return {**found[""].figures, **lost}
    return {"vehicles": {name: status.figures for name, status in found.items()}, **lost}


def _moment(text: str | None) -> int | None:
    """Return the time of an option [ns, UTC]; None without it."""
    if text is None:
        return None
    if text == "clock":
        import time

        return time.time_ns()
    return _time_of(text, "--now", ", or clock for the present time")


def _time_of(text: str, name: str, other: str = "") -> int:
    """Return the time of an option [ns, UTC]; errors name the option."""
    try:
        return parse_time(text)
    except ConfigError as error:
        raise ConfigError(f"{name}: {error}{other}") from error


_PICTURES = Ending((".png", ".svg", ".pdf"))


_VEHICLE = Annotated[
    str | None,
    option(
        "NAME",
        help="One of several vehicles of the result. Default: all; of figures only the map shows all.",
    ),
]


@TO_OPTIONS
@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """Selection and width of a figure.

    Attributes:
        at: Place of series; depth of map and plan, and a mark on the map [degrees, degrees, m].
        depth: Depth of map and plan [m].
        time: Time of map, ISO 8601 UTC: the current published last before it, and nothing later.
        columns: Width in journal columns: 85 or 175 mm.
    """

    vehicle: _VEHICLE = None

    at: Annotated[str | None, option("LON,LAT,DEPTH"), PLACE] = None
    depth: Annotated[float | None, option("D")] = None
    time: Annotated[str | None, option("TIME")] = None
    columns: Literal[1, 2] = 2


def plot(
    result: _Result,
    figure: Annotated[
        Literal["map", "section", "series", "dac", "trust", "plan"], argument("FIGURE")
    ],
    /,
    *,
    out: Annotated[Path, output("F.png|svg|pdf"), _PICTURES],
    look: Look = Look(),
    replacing: Replacing = Replacing(),
) -> int:
    """Return exit code 0, or 4 when part of the result was lost.

    Args:
        figure: Kind of figure.
        out: Figure; its ending selects the format.
    """
    replacing.check([result], out)
    at = None if look.at is None else astuple(place(look.at, "--at"))
    time_ns = None if look.time is None else _time_of(look.time, "--time")

    from replay_kit.core.files.atomic import write_whole
    from replay_kit.show.figures.draw import figure_bytes
    from replay_kit.show.figures.kinds import drawn_figure
    from replay_kit.show.figures.map import Chosen
    from replay_kit.workflows.report import opened_contents

    with opened_contents(result) as contents:
        shown = (
            contents
            if figure == "map" and look.vehicle is None
            else contents.for_vehicle(look.vehicle)
        )
        chosen = Chosen(at, look.depth, time_ns)
        write_whole(
            out, figure_bytes(drawn_figure(shown, figure, chosen, look.columns), out.suffix.lower())
        )
    return _told(contents, f"Figure: {out}")


_FILES = Ending((".nc", ".csv", ".kml", ".geojson"))
_TABLES = Literal[
    "series",
    "track",
    "section",
    "dives",
    "innovations",
    "surface",
    "surfacings",
    "plans",
    "estimate",
]


def export(
    result: _Result,
    /,
    *,
    out: Annotated[Path, output("X.nc|csv|kml|geojson"), _FILES],
    at: Annotated[list[str] | None, option("LON,LAT,DEPTH"), PLACE] = None,
    table: _TABLES | None = None,
    vehicle: _VEHICLE = None,
    replacing: Replacing = Replacing(),
) -> int:
    """Return exit code 0, or 4 when part of the result was lost.

    Args:
        out: File; its ending selects the format.
        at: Place of a series of the current [degrees, degrees, m]; may be repeated.
        table: Table, or estimate, to export. Default: all tables; in CSV the series with --at, else the track.
    """
    replacing.check([result], out)
    places = [astuple(place(text, "--at")) for text in at or ()]

    from replay_kit.show.export import export as write
    from replay_kit.workflows.report import opened_contents

    with opened_contents(result) as contents:
        shown = contents if vehicle is None else contents.for_vehicle(vehicle)
        rows = write(shown, out, places, table)
    counted = ", ".join(f"{name} {count} rows" for name, count in rows.items())
    return _told(contents, f"{out}: {counted}")


def layout(
    result: _Result,
    /,
    *,
    out: Annotated[Path, output("LAYOUT.json"), Ending((".json",))],
    replacing: Replacing = Replacing(),
) -> int:
    """Return exit code 0.

    Args:
        out: Layout file to import into the viewer.
    """
    replacing.check([result], out)

    from replay_kit.results.layout import write_layout

    count = write_layout(result, out)
    console_beside().print(
        f"{out}: {count} panels; import it in Foxglove or Lichtblick, and open {result} there."
    )
    return 0
