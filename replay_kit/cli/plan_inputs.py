"""What the command that plans reads: estimates, areas, depths of the bottom, options that are more than one number, and where it writes."""

import json
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, get_args

import numpy as np
import typer
import xarray as xr

from planners import Bathymetry, NoGo, Weights
from planners.mission.values import Objective
from planners.output.waypoints import FORMS
from replay_kit.cli.options import ends_in, place
from replay_kit.core.errors import ConfigError, ForecastError, PlanError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.load import load
from replay_kit.core.plan import Place
from replay_kit.results import read_estimate

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
    typer.Option("--waypoints", metavar="FILE", callback=ends_in(*FORMS), help="Few places to head for: .csv .geojson .json .ma .targets."),
]
WaypointToleranceOption = Annotated[
    float | None, typer.Option("--waypoint-tolerance", min=0.0, help="Off the way without a waypoint [m]; the plan's by default.")
]
NoGoOption = Annotated[
    Path | None,
    typer.Option("--no-go", metavar="GEOJSON", help="Polygons not to enter; a property surface_only lets dives pass below."),
]

_DEPTH_NAMES = (
    "sea_floor_depth_below_sea_surface",
    "sea_floor_depth_below_geoid",
    "depth",
    "height_above_mean_sea_level",
    "elevation",
    "z",
)
_UPWARDS = ("height_above_mean_sea_level", "elevation", "z")


def read_flow(path: Path) -> FlowEstimate:
    """Return the estimate in a file of either kind, told by its first bytes; what cannot be read the reader complains of."""
    with suppress(OSError), path.open("rb") as file:
        if file.read(5) == b"\x89MCAP":
            return read_estimate(path)
    return load(path)


def goal_of(text: str) -> Place:
    """Return the place of an option ``--goal``."""
    goal = place(text, "--goal")
    assert goal is not None
    return goal


def pair_of(text: str, option: str, names: str) -> tuple[float, float]:
    """Return the two numbers of an option.

    Raises:
        ConfigError: They are not two.
    """
    try:
        first, second = (float(part) for part in text.split(","))
    except ValueError as error:
        raise ConfigError(f"{option}: expected two numbers {names}, got {text!r}") from error
    return first, second


def objective_of(text: str) -> Objective | Weights:
    """Return an objective by its name, or weights such as ``time=1,energy=0.02,closest=5``.

    Raises:
        ConfigError: It is neither.
    """
    for name in get_args(Objective):
        if text == name:
            return name  # type: ignore[no-any-return]
    try:
        pairs = [part.partition("=") for part in text.split(",")]
        return Weights(**{name: float(value) for name, _, value in pairs})
    except (TypeError, ValueError, PlanError) as error:
        known = ", ".join(get_args(Objective))
        raise ConfigError(f"--objective: expected one of {known}, or weights time=A,energy=B,closest=C, got {text!r}") from error


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
            name, surface_only = str(properties.get("name", f"no-go area {k + 1}")), properties.get("surface_only") or False
            if surface_only not in (True, False):
                raise ValueError(f"surface_only of {name} is {surface_only!r}, neither true nor false")
            areas += [NoGo(tuple((float(corner[0]), float(corner[1])) for corner in ring), name, bool(surface_only)) for ring in rings]
    except OSError as error:
        raise PlanError(f"{path}: cannot read the no-go areas: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, AttributeError, IndexError) as error:
        # not its repr: that of bytes which are no text holds the file
        what = f"{type(error).__name__}: {error}"
        raise PlanError(f"{path}: expected GeoJSON features that are polygons of longitude and latitude: {what}") from error
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
