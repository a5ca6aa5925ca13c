"""The command that plans a glider's mission on an estimate."""

import json
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer
import xarray as xr
from rich.console import Console
from rich.table import Table

from planners import Bathymetry, Glider, MissionPlan, MissionSettings, NoGo, SteadyFlight, plan_mission, plan_scenarios
from planners.mission_flights import fly_mission, surfacing_ellipses
from planners.mission_output import as_glide, legs_table, to_csv, to_geojson, to_json
from replay_kit.cli_options import ConfigOption, JsonOption, OverwriteOption, console_beside, place, write_json, write_text
from replay_kit.config import load_config
from replay_kit.errors import ConfigError, ForecastError, PlanError
from replay_kit.flow import FlowEstimate
from replay_kit.flow_netcdf import load
from replay_kit.job import check_paths
from replay_kit.results import ResultWriter, read_estimate
from replay_kit.types import Array, Place

_DEPTH_NAMES = (
    "sea_floor_depth_below_sea_surface",
    "sea_floor_depth_below_geoid",
    "depth",
    "height_above_mean_sea_level",
    "elevation",
    "z",
)
_UPWARDS = ("height_above_mean_sea_level", "elevation", "z")


def plan(
    flows: Annotated[
        list[Path],
        typer.Argument(
            metavar="FLOW.nc|OUT.mcap...", help="Estimate of --save-estimate or of a result; several hold for increasing times."
        ),
    ],
    start: Annotated[str, typer.Option("--start", metavar="LON,LAT,DEPTH", help="Where it begins [degrees, degrees, m].")],
    goal: Annotated[list[str], typer.Option("--goal", metavar="LON,LAT,DEPTH", help="Where to go; may be repeated, in order.")],
    out: Annotated[Path | None, typer.Option("--out", "-o", metavar="PLAN.mcap", help="Predicted track and legs, for any viewer.")] = None,
    geojson: Annotated[Path | None, typer.Option("--geojson", metavar="FILE", help="Track, surfacings and goals; - prints them.")] = None,
    csv: Annotated[Path | None, typer.Option("--csv", metavar="FILE", help="One line a leg; - prints them.")] = None,
    config: ConfigOption = None,
    depth: Annotated[float, typer.Option("--depth", help="Of the dives [m].")] = 500.0,
    dives: Annotated[int, typer.Option("--dives", min=1, help="Between surfacings.")] = 1,
    surface_time: Annotated[float, typer.Option("--surface-time", help="Adrift at each surfacing [s].")] = 0.0,
    legs: Annotated[int | None, typer.Option("--legs", min=1, help="Surfacings; as many as is best by default.")] = None,
    objective: Annotated[Literal["time", "energy", "closest"], typer.Option("--objective", help="What is to be least.")] = "time",
    angles: Annotated[str, typer.Option("--angles", metavar="MIN,MAX", help="Glide angles [degrees].")] = "15,35",
    flight_model: Annotated[bool, typer.Option("--flight-model", help="Speed from glide angle and buoyancy, not constant.")] = False,
    no_go: Annotated[
        Path | None,
        typer.Option("--no-go", metavar="GEOJSON", help="Polygons not to enter; a property surface_only lets dives pass below."),
    ] = None,
    bathymetry: Annotated[Path | None, typer.Option("--bathymetry", metavar="FILE.nc", help="Depth of the bottom on a grid.")] = None,
    samples: Annotated[int, typer.Option("--samples", min=0, help="Fly it through so many samples of the estimate: ellipses.")] = 0,
    seed: Annotated[int, typer.Option("--seed", help="Of the samples.")] = 0,
    risk: Annotated[
        float | None, typer.Option("--risk", metavar="SHARE", help="Keep away so far that no larger share of the samples trespasses.")
    ] = None,
    json_file: JsonOption = None,
    overwrite: OverwriteOption = False,
) -> None:
    """Plan a mission of dives: headings, glide angles and surfacings to a goal or several."""
    if sum(str(path) == "-" for path in (geojson, csv, json_file)) > 1:
        raise ConfigError("--geojson, --csv and --json: only one of them can have standard output; give the others files")
    check_paths([*flows, config, no_go, bathymetry], [out, geojson, csv, json_file], overwrite)
    planner = load_config(config).planner
    shallow, steep = _pair(angles)
    glider = Glider(planner.speed, SteadyFlight() if flight_model else None, shallow, steep)
    settings = MissionSettings(depth, dives, surface_time, objective, planner.tolerance, legs)
    estimates = [_estimate(path) for path in flows]
    begin, goals = place(start, "--start"), tuple(_goal(text) for text in goal)
    assert begin is not None
    drawn = _samples(estimates, samples, seed, risk)
    how: dict[str, Any] = {
        "vehicle": glider,
        "settings": settings,
        "no_go": () if no_go is None else read_areas(no_go),
        "bathymetry": None if bathymetry is None else read_bathymetry(bathymetry),
        "start_time_ns": estimates[0].time_ns or 0,
    }
    if risk is None:
        flow = estimates[0] if len(estimates) == 1 else estimates
        made = plan_mission(flow, begin, goals, **how)
    else:
        made, _ = plan_scenarios(estimates[0], drawn, begin, goals, allowed=risk, **how)
    ellipses, spread = _spread(drawn, made)
    projection = estimates[0].grid.projection
    print_mission(made, spread, console_beside(json_file, geojson, csv))
    write_text(geojson, to_geojson(made, projection, ellipses) + "\n")
    write_text(csv, to_csv(made, ellipses))
    write_json(json_file, {**to_json(made, ellipses), "samples": spread})
    if out is not None:
        with ResultWriter(out, overwrite) as writer:
            told = {str(int(row["leg"])): json.dumps(row) for row in legs_table(made, ellipses)}
            writer.start(projection, made.start_time_ns, {"mission": {"status": made.status, "message": made.message}, "legs": told}, "")
            writer.plan(as_glide(made, projection), projection)


def _estimate(path: Path) -> FlowEstimate:
    """Return the estimate in a file of either kind, told by its first bytes; what cannot be read the reader complains of."""
    with suppress(OSError), path.open("rb") as file:
        if file.read(5) == b"\x89MCAP":
            return read_estimate(path)
    return load(path)


def _goal(text: str) -> Place:
    goal = place(text, "--goal")
    assert goal is not None
    return goal


def _pair(text: str) -> tuple[float, float]:
    parts = text.split(",")
    try:
        shallow, steep = (float(part) for part in parts)
    except ValueError as error:
        raise ConfigError(f"--angles: expected two numbers MIN,MAX, got {text!r}") from error
    return shallow, steep


def _samples(estimates: list[FlowEstimate], count: int, seed: int, risk: float | None) -> tuple[FlowEstimate, ...]:
    """Return samples of the first estimate, none when none are asked for.

    Raises:
        ConfigError: There are too few of them, or a risk does not go with the other options.
    """
    if risk is not None and not (0.0 <= risk < 1.0 and count > 0 and len(estimates) == 1):
        raise ConfigError(
            f"--risk: expected a share from 0 to below 1, --samples and one estimate, got {risk:g}, {count} and {len(estimates)}"
        )
    if 0 < count < 3:
        raise ConfigError(f"--samples: an ellipse needs three or more, got {count}")
    return estimates[0].sample(count, seed) if count else ()


def _spread(drawn: tuple[FlowEstimate, ...], made: MissionPlan) -> tuple[Array | None, dict[str, float] | None]:
    """Return the ellipses of the surfacings in samples of an estimate, and how far they miss the last goal."""
    if not drawn or len(made.headings_deg) == 0:
        return None, None
    flights = fly_mission(drawn, made)
    within = float(np.mean(np.all(flights.miss <= made.settings.tolerance, axis=1)))
    median, ninety = (float(np.quantile(flights.miss[:, -1], q)) for q in (0.5, 0.9))
    return surfacing_ellipses(flights, made), {"count": len(drawn), "reached": within, "miss_median_m": median, "miss_90_percent_m": ninety}


def read_areas(path: Path) -> tuple[NoGo, ...]:
    """Return the polygons of a GeoJSON file as areas; holes count as area.

    Raises:
        PlanError: It is no GeoJSON, or holds something else than polygons.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        features = document["features"] if document["type"] == "FeatureCollection" else [document]
        areas = []
        for k, feature in enumerate(features):
            properties, geometry = feature.get("properties") or {}, feature["geometry"]
            rings = {"Polygon": lambda c: [c[0]], "MultiPolygon": lambda c: [part[0] for part in c]}[geometry["type"]](
                geometry["coordinates"]
            )
            name, surface_only = str(properties.get("name", f"no-go area {k + 1}")), bool(properties.get("surface_only", False))
            areas += [NoGo(tuple((float(corner[0]), float(corner[1])) for corner in ring), name, surface_only) for ring in rings]
    except OSError as error:
        raise PlanError(f"{path}: cannot read the no-go areas: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, AttributeError, IndexError) as error:
        raise PlanError(f"{path}: expected GeoJSON features that are polygons of longitude and latitude: {error!r}") from error
    return tuple(areas)


def read_bathymetry(path: Path) -> Bathymetry:
    """Return the depth of the bottom in a NetCDF file, found by its standard name or as ``depth``, ``elevation`` or ``z``.

    Raises:
        ForecastError: There is no such variable on longitude and latitude.
    """
    try:
        with xr.open_dataset(path, engine="h5netcdf") as opened:
            dataset = opened.load()
    except (OSError, ValueError) as error:
        raise ForecastError(f"{path}: cannot read the bathymetry: {error}") from error
    found = [(name, str(v.attrs.get("standard_name", name))) for name, v in dataset.data_vars.items() if v.ndim == 2]
    chosen = next((pair for pair in found if pair[1] in _DEPTH_NAMES), None)
    axes: dict[str, Any] = {}
    for name, variable in dataset.variables.items():
        kind = str(variable.attrs.get("standard_name", name)).lower()
        axes |= {axis: variable for axis in ("longitude", "latitude") if kind in (axis, axis[:3])}
    if chosen is None or len(axes) < 2:
        raise ForecastError(
            f"{path}: expected one of {', '.join(_DEPTH_NAMES)} on longitude and latitude, found {', '.join(map(str, dataset))}"
        )
    values = np.asarray(dataset[chosen[0]], dtype=np.float64) * (-1.0 if chosen[1] in _UPWARDS else 1.0)
    longitude, latitude = (np.asarray(axes[axis], dtype=np.float64) for axis in ("longitude", "latitude"))
    if longitude.ndim == 1:
        # depths lie along the axes in the order of their dimensions
        values = values if dataset[chosen[0]].dims[0] == axes["latitude"].dims[0] else values.T
        longitude, latitude = np.meshgrid(longitude, latitude)
    return Bathymetry(longitude, latitude, values)


def print_mission(made: MissionPlan, spread: dict[str, float] | None, console: Console) -> None:
    """Print a mission: its outcome, and what to tell the glider at each surfacing."""
    console.print(f"{made.status}: {made.message}", soft_wrap=True)
    if len(made.headings_deg) == 0:
        return
    console.print(f"{made.duration / 3600.0:.2f} h, {made.energy / 1e3:.0f} kJ, {len(made.headings_deg)} legs")
    if spread is not None:
        console.print(
            f"in {spread['count']:.0f} samples of the estimate: {100.0 * spread['reached']:.0f} % within the tolerance, "
            f"median miss {spread['miss_median_m']:.0f} m, 90 % within {spread['miss_90_percent_m']:.0f} m"
        )
    table = Table("leg", "heading", "glide angle", "pitch", "depth [m]", "after [h]", "surfacing at", box=None)
    for row in legs_table(made, None):
        angles = (f"{row[name]:.1f}" for name in ("heading_deg", "glide_angle_deg", "pitch_deg"))
        where = f"{row['longitude']:.4f}, {row['latitude']:.4f}"
        table.add_row(f"{row['leg']:.0f}", *angles, f"{row['depth_m']:.0f}", f"{row['surfacing_s'] / 3600.0:.2f}", where)
    console.print(table)
