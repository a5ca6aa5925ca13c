"""The command that plans a glider's mission on an estimate."""

from pathlib import Path
from typing import Annotated

import typer

from replay_kit.cli.options import (
    ConfigOption,
    JsonOption,
    OverwriteOption,
    console_beside,
    ends_in,
    numbers,
    place,
    write_json,
    write_text,
)
from replay_kit.config.run import load_config
from replay_kit.core.errors import ConfigError
from replay_kit.core.plan import Place
from replay_kit.workflows.planning.mission import make_mission
from replay_kit.workflows.planning.outputs import mission_csv, mission_geojson, mission_json, print_mission, waypoint_file, write_mission
from replay_kit.workflows.planning.request import MissionKind, MissionRequest
from replay_kit.workflows.replay.job import check_paths

MissionOption = Annotated[
    Path | None,
    typer.Option("--out", "-o", metavar="PLAN.mcap", callback=ends_in(".mcap"), help="Predicted track and legs, for any viewer."),
]
GeojsonOption = Annotated[
    Path | None,
    typer.Option(
        "--geojson", metavar="FILE", callback=ends_in(".geojson", ".json", stream=True), help="Track, surfacings and goals; - prints them."
    ),
]
CsvOption = Annotated[
    Path | None, typer.Option("--csv", metavar="FILE", callback=ends_in(".csv", stream=True), help="One line a leg; - prints them.")
]
WaypointsOption = Annotated[
    Path | None,
    typer.Option(
        "--waypoints",
        metavar="FILE",
        callback=ends_in(".csv", ".geojson", ".json", ".ma", ".targets"),
        help="Few places to head for: .csv .geojson .json .ma .targets.",
    ),
]
WaypointToleranceOption = Annotated[
    float | None, typer.Option("--waypoint-tolerance", min=0.0, help="Off the way without a waypoint [m]; the plan's by default.")
]
NoGoOption = Annotated[
    Path | None,
    typer.Option("--no-go", metavar="GEOJSON", help="Polygons not to enter; a property surface_only lets dives pass below."),
]


def plan(
    flows: Annotated[
        list[Path],
        typer.Argument(
            metavar="FLOW.nc|OUT.mcap...", help="Estimate of --save-estimate or of a result; several hold for increasing times."
        ),
    ],
    start: Annotated[str, typer.Option("--start", metavar="LON,LAT,DEPTH", help="Where it begins [degrees, degrees, m].")],
    goal: Annotated[list[str], typer.Option("--goal", metavar="LON,LAT,DEPTH", help="Where to go; may be repeated, in order.")],
    out: MissionOption = None,
    geojson: GeojsonOption = None,
    csv: CsvOption = None,
    config: ConfigOption = None,
    depth: Annotated[float | None, typer.Option("--depth", help="Of the dives [m]; 500 by default.")] = None,
    dives: Annotated[int | None, typer.Option("--dives", min=1, help="Between surfacings; 1 by default.")] = None,
    surface_time: Annotated[float | None, typer.Option("--surface-time", help="Adrift at each surfacing [s]; 0 by default.")] = None,
    legs: Annotated[int | None, typer.Option("--legs", min=1, help="Surfacings; as many as is best by default.")] = None,
    max_legs: Annotated[int | None, typer.Option("--max-legs", min=1, help="Most surfacings considered; 60 by default.")] = None,
    objective: Annotated[
        str | None,
        typer.Option("--objective", help="time, energy, closest, or weights of hours, kJ and km off: time=1,energy=0.02,closest=5."),
    ] = None,
    mooring: Annotated[
        str | None, typer.Option("--mooring", metavar="RADIUS,HOURS", help="Stay within a radius [m] of the goal for so long.")
    ] = None,
    surfacings_only: Annotated[
        bool, typer.Option("--surfacings-only", help="A mooring counts surfacings, not the track between them.")
    ] = False,
    line: Annotated[bool, typer.Option("--line", help="Follow the line from start to goal.")] = False,
    line_weight: Annotated[
        float | None, typer.Option("--line-weight", min=0.0, help="Hours that an hour a kilometre off the line costs more; 10 by default.")
    ] = None,
    angles: Annotated[str | None, typer.Option("--angles", metavar="MIN,MAX", help="Glide angles [degrees]; 15,35 by default.")] = None,
    flight_model: Annotated[bool, typer.Option("--flight-model", help="Speed from glide angle and buoyancy, not constant.")] = False,
    no_go: NoGoOption = None,
    bathymetry: Annotated[Path | None, typer.Option("--bathymetry", metavar="FILE.nc", help="Depth of the bottom on a grid.")] = None,
    waypoints: WaypointsOption = None,
    waypoint_tolerance: WaypointToleranceOption = None,
    spline: Annotated[
        int, typer.Option("--spline", min=0, help="Optimise in a B-spline of so many points a kernel length; 0: in the flow itself.")
    ] = 0,
    samples: Annotated[
        int | None, typer.Option("--samples", min=0, help="Fly it through so many samples of the estimate: ellipses.")
    ] = None,
    seed: Annotated[int | None, typer.Option("--seed", min=0, help="Of the samples.")] = None,
    risk: Annotated[
        float | None, typer.Option("--risk", metavar="SHARE", help="Keep away so far that no larger share of the samples trespasses.")
    ] = None,
    json_file: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Plan a mission of dives: headings, glide angles and surfacings to a goal or several, near a place, or along a line."""
    if sum(str(path) == "-" for path in (geojson, csv, json_file)) > 1:
        raise ConfigError("--geojson, --csv and --json: only one of them can have standard output; give the others files")
    check_paths([*flows, config, no_go, bathymetry], [out, geojson, csv, json_file, waypoints], overwrite)
    moored = None if mooring is None else pair_of(mooring, "--mooring", "RADIUS,HOURS")
    kind = MissionKind(moored, surfacings_only, line, line_weight, objective)
    places = place_of(start, "--start"), tuple(place_of(text, "--goal") for text in goal)
    request = MissionRequest(tuple(flows), *places, kind, no_go, bathymetry, spline, risk, waypoints is not None, waypoint_tolerance)
    request.check()
    least, most = (None, None) if angles is None else pair_of(angles, "--angles", "MIN,MAX")
    dive = {"depth": depth, "dives": dives, "surface_time": surface_time, "legs": legs, "max_legs": max_legs}
    flown = {"min_angle": least, "max_angle": most, "flight_model": flight_model or None, "samples": samples, "seed": seed}
    settings = load_config(config, {"planner": {**dive, **flown}})
    planned = make_mission(request, settings.planner)
    print_mission(planned, console_beside(json_file, geojson, csv))
    write_text(geojson, mission_geojson(planned))
    write_text(csv, mission_csv(planned))
    if waypoints is not None and (listed := waypoint_file(planned, waypoints)) is not None:
        write_text(waypoints, listed)
    write_json(json_file, mission_json(planned))
    if out is not None:
        asked = {"start": start, "goals": " ".join(goal), "objective": objective, "mooring": mooring, "spline": spline, "risk": risk}
        asked |= {"surfacings_only": surfacings_only, "line_weight": kind.cross_track_weight}
        write_mission(out, overwrite, planned, request, asked, settings)


def place_of(text: str, option: str) -> Place:
    """Return the place of an option that must be given."""
    found = place(text, option)
    assert found is not None
    return found


def pair_of(text: str, option: str, names: str) -> tuple[float, float]:
    """Return the two numbers of an option.

    Raises:
        ConfigError: They are not two.
    """
    try:
        first, second = numbers(text, option, 2) or ()
    except ConfigError as error:
        raise ConfigError(f"{option}: expected two numbers {names}, got {text!r}") from error
    return first, second
