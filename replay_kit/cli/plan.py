"""The command that plans a glider's mission on an estimate."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from planners import (
    Glider,
    Line,
    MissionPlan,
    MissionRequest,
    MissionSettings,
    Mooring,
    fly_scenarios,
    plan_line,
    plan_mission,
    plan_mooring,
    plan_scenarios,
    waypoints_of,
)
from planners.mission.flights import fly_mission, surfacing_ellipses
from planners.mission.waypoints import Waypoints
from planners.output.mission import legs_table, to_csv, to_geojson, to_json
from planners.output.waypoints import waypoint_json, waypoint_text
from replay_kit.cli.options import ConfigOption, JsonOption, OverwriteOption, console_beside, place, write_json, write_text
from replay_kit.cli.plan_inputs import (
    CsvOption,
    GeojsonOption,
    MissionOption,
    NoGoOption,
    WaypointsOption,
    WaypointToleranceOption,
    goal_of,
    objective_of,
    pair_of,
    read_areas,
    read_bathymetry,
    read_flow,
)
from replay_kit.config.planner import PlannerConfig
from replay_kit.config.run import load_config
from replay_kit.core.arrays import Array
from replay_kit.core.errors import ConfigError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.geodesy import to_local
from replay_kit.core.plan import Place
from replay_kit.workflows.paths import check_paths
from replay_kit.workflows.planning import MissionPlanner, config_of, write_plan
from replay_kit.workflows.replay.provenance import plan_metadata

# Hours that an hour a kilometre off a line costs more, when that is not stated.
_LINE_WEIGHT = 10.0


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
    check_together(mooring, line, {"surfacings-only": surfacings_only or None, "line-weight": line_weight, "objective": objective})
    if waypoint_tolerance is not None and waypoints is None:
        raise ConfigError("--waypoint-tolerance: expected --waypoints beside it")
    kind = Kind(None if mooring is None else pair_of(mooring, "--mooring", "RADIUS,HOURS"), surfacings_only, _weight(line, line_weight))
    kind.check(len(goal), risk, waypoints)
    least, most = (None, None) if angles is None else pair_of(angles, "--angles", "MIN,MAX")
    dive = {"depth": depth, "dives": dives, "surface_time": surface_time, "legs": legs, "max_legs": max_legs}
    flown = {"min_angle": least, "max_angle": most, "flight_model": flight_model or None, "samples": samples, "seed": seed}
    run_config = load_config(config, {"planner": {**dive, **flown}})
    planner = run_config.planner
    glider, settings = mission_of(planner, objective, spline)
    estimates = [read_flow(path) for path in flows]
    begin, goals = place(start, "--start"), tuple(goal_of(text) for text in goal)
    assert begin is not None
    drawn = _samples(estimates, planner.samples, planner.seed, risk)
    how: dict[str, Any] = {
        "vehicle": glider,
        "settings": settings,
        "no_go": () if no_go is None else read_areas(no_go),
        "bathymetry": None if bathymetry is None else read_bathymetry(bathymetry),
        "start_time_ns": estimates[0].time_ns or 0,
    }
    flow = estimates[0] if len(estimates) == 1 else estimates
    made, chances = (
        (kind.plan(flow, begin, goals, how), None)
        if risk is None
        else plan_scenarios(estimates[0], drawn, MissionRequest(begin, goals, **how), allowed=risk)
    )
    few = waypoints_of(flow, made, waypoint_tolerance) if waypoints is not None and len(made.headings_deg) else None
    ellipses, spread = _spread(drawn, made, kind)
    if spread is not None:
        chances = chances or fly_scenarios(estimates[0], drawn, made, no_go=how["no_go"], bathymetry=how["bathymetry"])
        spread |= {"safe": chances.safe, "trespass": dict(chances.violations), "allowed": risk}
    projection = estimates[0].grid.projection
    print_mission(made, few, spread, console_beside(json_file, geojson, csv))
    write_text(geojson, to_geojson(made, projection, ellipses) + "\n")
    write_text(csv, to_csv(made, ellipses))
    if waypoints is not None and few is not None:
        write_text(waypoints, waypoint_text(few, waypoints))
    write_json(json_file, {**to_json(made, ellipses), "samples": spread, "waypoints": None if few is None else waypoint_json(few)})
    if out is not None:
        read = {**{f"flow{k}": path for k, path in enumerate(flows)}, "no_go": no_go, "bathymetry": bathymetry}
        asked = {"start": start, "goals": " ".join(goal), "objective": objective, "mooring": mooring, "spline": spline, "risk": risk}
        asked |= {"surfacings_only": surfacings_only, "line_weight": kind.line_weight}
        write_plan(out, overwrite, (made, ellipses), projection, plan_metadata(read, asked), config_of(run_config, settings))


@dataclass(frozen=True, slots=True)
class Kind:
    """What kind of mission is asked for; one to goals unless one of these is given.

    Attributes:
        mooring: Radius [m] and hours of a mooring.
        surfacings_only: Whether a mooring counts surfacings only.
        line_weight: Of a line.
    """

    mooring: tuple[float, float] | None
    surfacings_only: bool
    line_weight: float | None

    def check(self, n_goals: int, risk: float | None, waypoints: Path | None) -> None:
        """Refuse options that do not go together.

        Raises:
            ConfigError: They do not.
        """
        if self.mooring is not None and self.line_weight is not None:
            raise ConfigError("--mooring and --line: a mission is one or the other")
        if (self.mooring is not None or self.line_weight is not None) and (n_goals > 1 or risk is not None):
            raise ConfigError("--mooring and --line: expected one --goal and no --risk")
        if waypoints is not None and self.mooring is not None:
            raise ConfigError("--waypoints: a mooring has none on its way; give the glider the mooring's place")

    def plan(self, flow: FlowEstimate | list[FlowEstimate], begin: Place, goals: tuple[Place, ...], how: dict[str, Any]) -> MissionPlan:
        """Return the mission of this kind."""
        request = MissionRequest(begin, goals, **how)
        if self.mooring is not None:
            radius, hours = self.mooring
            return plan_mooring(flow, request, Mooring(radius, 3600.0 * hours, self.surfacings_only))
        if self.line_weight is not None:
            return plan_line(flow, request, Line(weight=self.line_weight))
        return plan_mission(flow, request)


def check_together(mooring: str | None, line: bool, given: dict[str, Any]) -> None:
    """Refuse options that would do nothing beside, or without, those of a mooring or a line.

    Args:
        mooring: Of the option.
        line: Whether a line is followed.
        given: Values of other options by name; None for those that were not given.

    Raises:
        ConfigError: There is one.
    """
    if given["surfacings-only"] is not None and mooring is None:
        raise ConfigError("--surfacings-only: expected --mooring beside it; only a mooring counts surfacings")
    if given["line-weight"] is not None and not line:
        raise ConfigError("--line-weight: expected --line beside it")
    if given["objective"] is not None and mooring is not None:
        raise ConfigError("--objective: a mooring has none but to stay near its place; leave it out")


def mission_of(planner: PlannerConfig, objective: str | None, spline: int) -> tuple[Glider, MissionSettings]:
    """Return the vehicle and the settings of a configuration, with what only this command has.

    Args:
        planner: The configuration with the command's options laid over it.
        objective: Of the option; None for the configuration's.
        spline: Of the option.
    """
    bound = MissionPlanner.of(planner)
    # a plan by itself may be longer than those of a replay, unless that is configured
    longest = planner.max_duration if "max_duration" in planner.model_fields_set else MissionSettings().max_duration
    aim = bound.settings.objective if objective is None else objective_of(objective)
    return bound.vehicle, replace(bound.settings, objective=aim, spline=spline, max_duration=longest)


def _weight(line: bool, given: float | None) -> float | None:
    """Return the weight of a line; None without one."""
    return (_LINE_WEIGHT if given is None else given) if line else None


def _samples(estimates: list[FlowEstimate], count: int, seed: int, risk: float | None) -> tuple[FlowEstimate, ...]:
    """Return samples of the first estimate, none when none are asked for.

    Raises:
        ConfigError: There are several estimates, or a risk does not go with the other options.
    """
    if risk is not None and not (0.0 <= risk < 1.0 and count > 0 and len(estimates) == 1):
        raise ConfigError(
            f"--risk: expected a share from 0 to below 1, --samples and one estimate, got {risk:g}, {count} and {len(estimates)}"
        )
    if count > 0 and len(estimates) > 1:
        raise ConfigError("--samples: samples of one estimate do not change in time as several do; give one estimate")
    return estimates[0].sample(count, seed) if count else ()


def _spread(drawn: tuple[FlowEstimate, ...], made: MissionPlan, kind: Kind) -> tuple[Array | None, dict[str, Any] | None]:
    """Return the ellipses of the surfacings in samples of an estimate, and how far they miss the last goal or leave the mooring."""
    if not drawn or len(made.headings_deg) == 0:
        return None, None
    flights = fly_mission(drawn, made)
    off, within = flights.miss[:, -1], np.all(flights.miss <= made.settings.tolerance, axis=1)
    if kind.mooring is not None:
        here = np.array(to_local(drawn[0].grid.projection, made.goals[0].longitude, made.goals[0].latitude))
        counted = np.searchsorted(flights.time, made.surfacing_times - 1e-6) if kind.surfacings_only else slice(None)
        off = np.linalg.norm(flights.place[:, counted] - here, axis=2).max(axis=1)
        within = off <= kind.mooring[0]
    median, ninety = (float(np.quantile(off, q)) for q in (0.5, 0.9))
    spread = {"count": len(drawn), "reached": float(np.mean(within)), "miss_median_m": median, "miss_90_percent_m": ninety}
    return surfacing_ellipses(flights, made), spread


def print_mission(made: MissionPlan, few: Waypoints | None, spread: dict[str, Any] | None, console: Console) -> None:
    """Print a mission: its outcome, what its waypoints lose, and what to tell the glider at each surfacing."""
    console.print(f"{made.status}: {made.message}", soft_wrap=True)
    if len(made.headings_deg) == 0:
        return
    console.print(f"{made.duration / 3600.0:.2f} h, {made.energy / 1e3:.0f} kJ, {len(made.headings_deg)} legs")
    if few is not None:
        console.print(few.message, soft_wrap=True)
    if spread is not None:
        moored = made.settings.weights.closest == 0.0
        within, off = ("stay within the radius", "farthest from the mooring") if moored else ("within the tolerance", "miss")
        console.print(
            f"in {spread['count']:.0f} samples of the estimate: {100.0 * spread['reached']:.0f} % {within}, "
            f"{off} in the median {spread['miss_median_m']:.0f} m, 90 % within {spread['miss_90_percent_m']:.0f} m",
            soft_wrap=True,
        )
        console.print(_trespassing(spread), soft_wrap=True)
    table = Table("leg", "heading", "glide angle", "pitch", "depth [m]", "after [h]", "surfacing at", box=None)
    for row in legs_table(made, None):
        angles = (f"{row[name]:.1f}" for name in ("heading_deg", "glide_angle_deg", "pitch_deg"))
        where = f"{row['longitude']:.4f}, {row['latitude']:.4f}"
        table.add_row(f"{row['leg']:.0f}", *angles, f"{row['depth_m']:.0f}", f"{row['surfacing_s'] / 3600.0:.2f}", where)
    console.print(table)


def _trespassing(spread: dict[str, Any]) -> str:
    """Return how many of the samples trespass and where, beside what was allowed, in words."""
    share = 1.0 - spread["safe"]
    named = ", ".join(f"{name} {100.0 * part:.0f} %" for name, part in spread["trespass"].items())
    what = f"{100.0 * share:.0f} % of them trespass" + (f" ({named})" if named else "")
    if spread["allowed"] is None:
        return what
    allowed = f"{100.0 * spread['allowed']:.0f} % allowed"
    kept = share <= spread["allowed"] + 1e-9
    return f"{what}; {allowed}" if kept else f"{what}, more than the {allowed}: no margin tried kept enough clear"
