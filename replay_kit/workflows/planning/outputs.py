"""A planned mission for people and other programs: table, JSON, GeoJSON, CSV, waypoint files, a result MCAP."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console

from planners.mission.waypoints import Waypoints
from planners.output.mission import as_glide, legs_table, to_csv, to_geojson, to_json
from planners.output.waypoints import waypoint_json, waypoint_text
from replay_kit.config.run import RunConfig
from replay_kit.results import ResultWriter
from replay_kit.results.text import print_table
from replay_kit.workflows.planning.mission import PlannedMission, mission_settings
from replay_kit.workflows.planning.request import PlanJob
from replay_kit.workflows.replay.provenance import plan_metadata, run_settings_toml


def print_mission(planned: PlannedMission, console: Console) -> None:
    """Print a mission: its outcome, what its waypoints lose, and the commands to the glider at each surfacing."""
    made, figures = planned.plan, planned.samples
    console.print(f"{made.status}: {made.message}", soft_wrap=True)
    if len(made.headings_deg) == 0:
        return
    console.print(f"{made.duration / 3600.0:.2f} h, {made.energy / 1e3:.0f} kJ, {len(made.headings_deg)} legs")
    if planned.waypoints is not None:
        console.print(planned.waypoints.message, soft_wrap=True)
    if figures is not None:
        moored = made.settings.weights.closest == 0.0
        within, off = ("stay within the radius", "farthest from the mooring") if moored else ("within the tolerance", "miss")
        console.print(
            f"in {figures['count']:.0f} samples of the estimate: {100.0 * figures['reached']:.0f} % {within}, "
            f"{off} in the median {figures['miss_median_m']:.0f} m, 90 % within {figures['miss_90_percent_m']:.0f} m",
            soft_wrap=True,
        )
        console.print(_violations(figures), soft_wrap=True)
    columns = "leg", "heading", "glide angle", "pitch", "depth [m]", "after [h]", "surfacing at"
    print_table(console, None, columns, map(_leg_cells, legs_table(made, None)))


def _leg_cells(row: Mapping[str, Any]) -> tuple[str, ...]:
    angles = (f"{row[name]:.1f}" for name in ("heading_deg", "glide_angle_deg", "pitch_deg"))
    where = f"{row['longitude']:.4f}, {row['latitude']:.4f}"
    return f"{row['leg']:.0f}", *angles, f"{row['depth_m']:.0f}", f"{row['surfacing_s'] / 3600.0:.2f}", where


def _violations(figures: dict[str, Any]) -> str:
    """Return how many of the samples violate a constraint, which, and how many may, in words."""
    share = 1.0 - figures["safe"]
    named = ", ".join(f"{name} {100.0 * part:.0f} %" for name, part in figures["violations"].items())
    counted = f"{100.0 * share:.0f} % of them violate a constraint" + (f" ({named})" if named else "")
    if figures["allowed"] is None:
        return counted
    allowed = f"{100.0 * figures['allowed']:.0f} % allowed"
    kept = share <= figures["allowed"] + 1e-9
    return f"{counted}; {allowed}" if kept else f"{counted}, more than the {allowed}: no margin tried kept enough of them clear"


def mission_json(planned: PlannedMission) -> dict[str, Any]:
    """Return a mission for ``--json``: the planners' figures, ``samples`` and ``waypoints``, null where there are none."""
    few = None if planned.waypoints is None else waypoint_json(planned.waypoints)
    return {**to_json(planned.plan, planned.ellipses), "samples": planned.samples, "waypoints": few}


def mission_geojson(planned: PlannedMission) -> str:
    """Return track, surfacings, ellipses and goals as GeoJSON text."""
    return to_geojson(planned.plan, planned.projection, planned.ellipses) + "\n"


def mission_csv(planned: PlannedMission) -> str:
    """Return the legs as CSV text, one line a leg."""
    return to_csv(planned.plan, planned.ellipses)


def waypoint_file(waypoints: Waypoints, path: Path) -> str:
    """Return the text of a waypoint file, in the format that its ending chooses."""
    return waypoint_text(waypoints, path)


def write_mission(
    path: Path, overwrite: bool, planned: PlannedMission, job: PlanJob, options: Mapping[str, object], config: RunConfig
) -> None:
    """Write a mission as a result MCAP of its own.

    Args:
        path: The result.
        overwrite: Replace an existing one.
        planned: The mission.
        job: What was asked for; its files are recorded with their hashes.
        options: What was asked for beyond the configuration, recorded as it was given; None for what was not.
        config: All settings; those that the mission was planned with are attached as ``config.toml``.

    Raises:
        ConfigError: The result exists and may not be replaced, or cannot be written.
        ReplayKitError: It could not be written whole.
    """
    read = {**{f"flow{k}": flow for k, flow in enumerate(job.flows)}, "no_go": job.no_go, "bathymetry": job.bathymetry}
    mission = planned.plan
    legs = {str(row["leg"]): json.dumps(row) for row in legs_table(mission, planned.ellipses)}
    about = {**plan_metadata(read, options), "mission": {"status": mission.status, "message": mission.message}, "legs": legs}
    with ResultWriter(path, overwrite) as writer:
        writer.start(planned.projection, mission.start_time_ns, about, run_settings_toml(_effective_config(config, job)))
        writer.plan(as_glide(mission, planned.projection), planned.projection)


def _effective_config(config: RunConfig, job: PlanJob) -> RunConfig:
    """Return the configuration that a mission was planned with; weights of an objective have no place in a configuration."""
    _, settings = mission_settings(config.planner, job.kind.objective, job.spline)
    planned: dict[str, object] = {"kind": "mission", "max_duration": settings.max_duration}
    if isinstance(settings.objective, str):
        planned["objective"] = settings.objective
    return config.model_copy(update={"planner": config.planner.model_copy(update=planned)})
