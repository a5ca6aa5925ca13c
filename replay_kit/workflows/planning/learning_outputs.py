"""A plan that learns for people and other programs: tables, JSON, GeoJSON, CSV, a result MCAP."""

import json
from collections.abc import Mapping
from math import isfinite, nan
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from planners.learning.values import LearnPlan
from replay_kit.config.run import RunConfig
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.plan import Plan
from replay_kit.core.region import collection_file, feature, positions
from replay_kit.core.text import csv_text, time_text
from replay_kit.show.report.sections.learning import candidate_table
from replay_kit.show.text import print_table
from replay_kit.workflows.planning.learning import Learnt
from replay_kit.workflows.planning.record import write_plan

_COLUMNS = (
    "leg",
    "heading_deg",
    "glide_angle_deg",
    "pitch_deg",
    "depth_m",
    "speed",
    "surfacing_s",
    "longitude",
    "latitude",
    "blind",
)


def print_learning(learnt: Learnt, console: Console) -> None:
    """Print a plan that learns: its answer, the candidates, and the commands from surfacing to surfacing."""
    plan = learnt.plan
    console.print(f"{plan.status}: {plan.message}")
    for note in plan.notes:
        console.print(f"note: {note}")
    record = {"unit": plan.unit, "found": plan.found_name, "candidates": candidate_rows(plan)}
    print_table(console, "Candidates", *candidate_table(record))
    heads = "leg", "heading", "speed [m/s]", "after [h]", "UTC", "surfacing at", ""
    print_table(
        console,
        None,
        heads,
        [_leg_cells(row, plan.request.start_time_ns) for row in legs_table(plan)],
    )


def _leg_cells(row: Mapping[str, Any], start_ns: int) -> tuple[str, ...]:
    when = time_text(start_ns + round(row["surfacing_s"] * 1e9)) if start_ns else "-"
    where = f"{row['longitude']:.4f}, {row['latitude']:.4f}"
    kind = "dead-reckoned" if row["blind"] else ""
    return (
        str(row["leg"]),
        f"{row['heading_deg']:.1f}",
        f"{row['speed']:.2f}",
        f"{row['surfacing_s'] / 3600.0:.2f}",
        when,
        where,
        kind,
    )


def legs_table(plan: LearnPlan) -> list[dict[str, Any]]:
    """Return the legs, one row each; the keys that missions have too mean the same."""
    vehicle = plan.request.vehicle
    angle = vehicle.min_angle
    pitch = float(np.rad2deg(vehicle.pitch(np.array(np.deg2rad(angle)))))
    return [
        {
            "leg": number,
            "heading_deg": leg.heading_deg,
            "glide_angle_deg": angle,
            "pitch_deg": pitch,
            "depth_m": plan.depth,
            "speed": leg.speed,
            "surfacing_s": leg.ends_s,
            "longitude": leg.ends_at[0],
            "latitude": leg.ends_at[1],
            "blind": leg.blind,
        }
        for number, leg in enumerate(plan.legs, 1)
    ]


def candidate_rows(plan: LearnPlan) -> list[dict[str, Any]]:
    """Return the candidates, one row each, with null for what is not known."""
    names = ("predicted", "found", "low", "high", "within")
    return [
        {
            "name": one.name,
            **{name: _finite(getattr(one, name)) for name in names},
            "chosen": one.chosen,
            "unit": plan.unit,
        }
        for one in plan.candidates
    ]


def _finite(value: float) -> float | None:
    return value if isfinite(value) else None


def learning_json(learnt: Learnt) -> dict[str, Any]:
    """Return a plan that learns for ``--json``."""
    plan = learnt.plan
    return {
        "status": plan.status,
        "message": plan.message,
        "objective": plan.objective,
        "start": [
            plan.request.start.longitude,
            plan.request.start.latitude,
            plan.request.start.depth,
        ],
        "goal": [plan.goal.longitude, plan.goal.latitude, plan.goal.depth],
        "start_time": time_text(plan.request.start_time_ns) if plan.request.start_time_ns else None,
        "duration_s": plan.duration,
        "miss_m": plan.miss,
        "unit": plan.unit,
        "error_before": plan.before,
        "error_after": plan.after,
        "found": plan.found_name,
        "candidates": candidate_rows(plan),
        "value": {
            "unit": plan.value.unit,
            "longitude": plan.value.longitude.tolist(),
            "latitude": plan.value.latitude.tolist(),
            "value": plan.value.value.tolist(),
        },
        "legs": legs_table(plan),
        "figures": dict(plan.statistics),
        "notes": list(plan.notes),
    }


def learning_geojson(learnt: Learnt) -> str:
    """Return track and surfacings as GeoJSON text."""
    plan, rows = learnt.plan, legs_table(learnt.plan)
    near = plan.request.start.longitude
    line = positions(*to_geographic(learnt.on.region.projection, *plan.track.T[:2]), near)
    at = positions([row["longitude"] for row in rows], [row["latitude"] for row in rows], near)
    about = {
        "status": plan.status,
        "message": plan.message,
        "objective": plan.objective,
        "duration_s": plan.duration,
    }
    points = [feature("Point", *one) for one in zip(at, rows, strict=True)]
    return collection_file([feature("LineString", line, about), *points])


def learning_csv(learnt: Learnt) -> str:
    """Return the legs as CSV text, one line a leg."""
    return csv_text(legs_table(learnt.plan), _COLUMNS)


def write_learning(
    path: Path,
    overwrite: bool,
    learnt: Learnt,
    config: RunConfig,
) -> None:
    """Write a plan that learns as a result MCAP of its own.

    Args:
        path: The result.
        overwrite: Replace an existing one.
        learnt: The plan.
        config: All settings, attached as ``config.toml``; what was asked for is recorded, its files with their hashes.

    Raises:
        ConfigError: The result exists and may not be replaced, or cannot be written.
        ReplayKitError: It could not be written whole.
    """
    plan = learnt.plan
    records = {
        "legs": {str(row["leg"]): json.dumps(row) for row in legs_table(plan)},
        "learning": {
            name: json.dumps(value)
            for name, value in learning_json(learnt).items()
            if name not in ("legs", "message")
        },
    }
    used = {"kind": "mission", "samples": plan.request.settings.samples}
    made = config.model_copy(update={"planner": config.planner.model_copy(update=used)})
    write_plan(path, overwrite, _published(plan), learnt.on, records, made)


def _published(plan: LearnPlan) -> Plan:
    """Return the plan as results hold it: that of its first leg with the whole track."""
    asked, rows = plan.request, legs_table(plan)
    angle = np.deg2rad(asked.vehicle.min_angle)
    along, down = (float(speed) for speed in asked.vehicle.speeds(np, angle))
    heading = rows[0]["heading_deg"] if rows else 0.0
    local = np.deg2rad(heading)
    return Plan(
        status=plan.status,
        start=asked.start,
        goal=plan.goal,
        start_time_ns=asked.start_time_ns,
        heading_deg=heading,
        glide_angle_deg=asked.vehicle.min_angle,
        speed=float(np.hypot(along, down)),
        velocity_through_water=np.array([along * np.sin(local), along * np.cos(local), down]),
        duration=plan.duration,
        closest_approach=plan.miss,
        track_time=plan.track_time,
        track=plan.track,
        message=plan.message,
        statistics=plan.statistics,
        legs=tuple(rows),
        energy=nan,
    )
