"""A planned mission for people and other programs: table, JSON, GeoJSON, CSV, waypoint files, a result MCAP."""

import json
from collections.abc import Mapping
from dataclasses import replace
from math import nan
from pathlib import Path
from typing import Any

from rich.console import Console

from planners.output.mission import (
    as_plan,
    legs_table,
    to_csv,
    to_geojson,
    to_json,
)
from planners.output.waypoints import waypoint_json, waypoint_text
from planners.waypoints import Waypoints
from replay_kit.config.plan import PlanRequest
from replay_kit.config.run import RunConfig
from replay_kit.core.text import time_text
from replay_kit.show.sentences import energy_sentence
from replay_kit.show.text import print_table
from replay_kit.workflows.planning.mission import PlannedMission, mission_planner


def print_mission(planned: PlannedMission, console: Console, battery: float | None = None) -> None:
    """Print a mission: its odds and outcome, what its waypoints lose, and the commands to the glider at each surfacing.

    Args:
        planned: The mission.
        console: Where to.
        battery: Energy that the vehicle has [MJ]; None when it is not stated.
    """
    made = planned.plan
    if planned.departures:
        _print_departures(planned, console)
    console.print(f"{made.status}: {made.message}")
    for note in planned.notes:
        console.print(f"note: {note}")
    if len(made.headings_deg) == 0:
        return
    energy = energy_sentence(made.energy, None if battery is None else battery * 1e6)
    console.print(f"{made.duration / 3600.0:.2f} h, {energy}, {len(made.headings_deg)} legs")
    if planned.waypoints is not None:
        console.print(planned.waypoints.message)
    columns = (
        "leg",
        "heading",
        "glide angle",
        "pitch",
        "arrives with",
        "depth [m]",
        "after [h]",
        "UTC",
        "surfacing at",
    )
    print_table(
        console,
        None,
        columns,
        (_leg_cells(row, made.start_time_ns) for row in legs_table(made, planned.odds)),
    )


def _print_departures(planned: PlannedMission, console: Console) -> None:
    """Print the departures that were compared, the one that is planned marked."""
    rows = departures_table(planned)
    columns = (
        "departure",
        "status",
        "arrival",
        "hours",
        "energy [kJ]",
        "legs",
        *(("arrive",) if planned.samples is not None else ()),
        "",
    )
    print_table(console, "Departures compared", columns, (_departure_cells(row) for row in rows))


def _departure_cells(row: Mapping[str, Any]) -> tuple[str, ...]:
    arrival = row["arrival"] or f"misses by {row['miss_m'] / 1e3:.1f} km"
    share = () if row["reached"] is None else (f"{100.0 * row['reached']:.0f} %",)
    return (
        row["departure"],
        row["status"],
        arrival,
        f"{row['duration_s'] / 3600.0:.2f}",
        f"{row['energy_j'] / 1e3:.0f}",
        str(row["legs"]),
        *share,
        ", ".join(row["best"]),
    )


def departures_table(planned: PlannedMission) -> list[dict[str, Any]]:
    """Return the departures that were compared, one row each, for ``--json`` and for results.

    ``best`` names what a departure is best at: ``planned``, the one of the mission, and ``arrives first``. ``arrival`` is null where the
    goal is not reached.
    """
    arriving = [one for one in planned.departures if one.status in ("reached", "uncertain")]
    first = min(arriving, key=lambda one: one.start_time_ns + one.duration * 1e9, default=None)
    rows = []
    for one in planned.departures:
        arrival = (
            time_text(one.start_time_ns + round(one.duration * 1e9)) if one in arriving else None
        )
        best = ["planned"] if one.start_time_ns == planned.plan.start_time_ns else []
        rows.append(
            {
                "departure": time_text(one.start_time_ns),
                "status": one.status,
                "arrival": arrival,
                "duration_s": one.duration,
                "energy_j": one.energy,
                "legs": one.legs,
                "miss_m": one.miss,
                "reached": one.reached,
                "best": [*best, *(["arrives first"] if one is first else [])],
            }
        )
    return rows


def _leg_cells(row: Mapping[str, Any], start_ns: int) -> tuple[str, ...]:
    angles = (f"{row[name]:.1f}" for name in ("heading_deg", "glide_angle_deg", "pitch_deg"))
    where = f"{row['longitude']:.4f}, {row['latitude']:.4f}"
    when = time_text(start_ns + round(row["surfacing_s"] * 1e9)) if start_ns else "-"
    return (
        f"{row['leg']:.0f}",
        *angles,
        _headings_text(row),
        f"{row['depth_m']:.0f}",
        f"{row['surfacing_s'] / 3600.0:.2f}",
        when,
        where,
    )


def _headings_text(row: Mapping[str, Any]) -> str:
    """Return the headings with which a leg still arrives."""
    low, high = row.get("heading_from_deg"), row.get("heading_to_deg")
    return "-" if low is None or high is None else f"{low:.0f} to {high:.0f}"


def unsafe_reason(planned: PlannedMission, job: PlanRequest) -> str | None:
    """Return why a mission must not be handed to a vehicle unasked; None when it may be."""
    figures, made = planned.samples, planned.plan
    few = planned.waypoints
    if few is not None and few.violation is not None:
        return "the waypoints are not safe"
    if (
        few is not None
        and figures is not None
        and job.risk is None
        and 1.0 - figures["safe"] > job.accepted_risk
    ):
        return (
            f"the waypoints are not safe in {100.0 * (1.0 - figures['safe']):.0f} % of the samples"
        )
    if few is not None and made.status == "unsafe":
        return "waypoints of a plan that is not safe"
    if (
        job.risk is None
        or figures is None
        or (made.status != "unsafe" and 1.0 - figures["safe"] <= job.risk + 1e-9)
    ):
        return None
    drivers = ", ".join(
        f"{name} {100.0 * share:.0f} %"
        for name, share in sorted(figures["violations"].items(), key=lambda one: -one[1])
    )
    least, asked = 100.0 * (1.0 - figures["safe"]), 100.0 * job.risk
    return f"the risk of {asked:g} % cannot be kept: the least found is {least:.0f} %" + (
        f", from {drivers}" if drivers else ""
    )


def mission_json(planned: PlannedMission) -> dict[str, Any]:
    """Return a mission for ``--json``: the planners' figures, ``samples`` and ``waypoints``, null where there are none."""
    few = None if planned.waypoints is None else waypoint_json(planned.waypoints)
    more = {"samples": planned.samples, "waypoints": few, "notes": list(planned.notes)}
    return {
        **to_json(planned.plan, planned.odds),
        **more,
        "departures": departures_table(planned),
    }


def mission_geojson(planned: PlannedMission) -> str:
    """Return track, surfacings, ellipses and goals as GeoJSON text."""
    return to_geojson(planned.plan, planned.on.region.projection, planned.odds)


def mission_csv(planned: PlannedMission) -> str:
    """Return the legs as CSV text, one line a leg."""
    return to_csv(planned.plan, planned.odds)


def waypoint_file(waypoints: Waypoints, path: Path) -> str:
    """Return the text of a waypoint file, in the format that its ending chooses."""
    return waypoint_text(waypoints, path)


def write_mission(
    path: Path,
    overwrite: bool,
    planned: PlannedMission,
    config: RunConfig,
) -> None:
    """Write a mission as a result MCAP of its own.

    Args:
        path: The result.
        overwrite: Replace an existing one.
        planned: The mission.
        config: All settings; those that the mission was planned with are attached as ``config.toml``, and what was asked for is recorded,
            its files with their hashes.

    Raises:
        ConfigError: The result exists and may not be replaced, or cannot be written.
        ReplayKitError: It could not be written whole.
    """
    from replay_kit.workflows.planning.record import write_plan  # with what it records of a replay

    mission, battery = planned.plan, config.plan.battery
    records = {
        "legs": {str(row["leg"]): json.dumps(row) for row in legs_table(mission, planned.odds)}
    }
    if planned.departures:
        records["departures"] = {
            row["departure"]: json.dumps(row) for row in departures_table(planned)
        }
    made = replace(
        as_plan(mission, planned.on.region.projection, planned.odds),
        battery=nan if battery is None else battery * 1e6,
    )
    write_plan(path, overwrite, made, planned.on, records, _effective_config(config, planned))


def _effective_config(config: RunConfig, planned: PlannedMission) -> RunConfig:
    """Return the configuration that a mission was planned with; weights of an objective have no place in a configuration."""
    settings = mission_planner(config.plan, config.planner).settings
    made: dict[str, object] = {"kind": "mission", "max_duration": settings.max_duration}
    made["samples"] = planned.drawn
    if isinstance(settings.objective, str):
        made["objective"] = settings.objective
    return config.model_copy(update={"planner": config.planner.model_copy(update=made)})
