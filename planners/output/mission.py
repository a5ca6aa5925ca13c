"""Plans as tables of legs, goals and surfacings, as JSON, and as the message of a result."""

from itertools import pairwise
from typing import Any

import numpy as np

from planners.odds.mission import MissionOdds
from planners.request import MissionPlan
from replay_kit.core.geodesy import grid_bearing_of_true_north
from replay_kit.core.grid import Projection
from replay_kit.core.plan import Odds, Plan
from replay_kit.core.surfacing import ON_LEG
from replay_kit.core.words.text import csv_text


def legs_table(plan: MissionPlan, odds: MissionOdds | None) -> list[dict[str, Any]]:
    """Return a table of the legs: command and end position, one row per leg.

    ``heading_from_deg`` and ``heading_to_deg`` bound the headings with which the leg still arrives; None if the planned one does not.

    Args:
        plan: Plan.
        odds: Odds with ellipses and these bounds; None without samples.
    """
    begins = np.concatenate([[0.0], plan.surfacing_times[:-1]])
    rows = []
    speeds = np.hypot(*plan.vehicle.speeds(np, np.deg2rad(plan.glide_angles_deg)))
    for k, heading in enumerate(plan.headings_deg):
        row: dict[str, Any] = {
            "leg": k + 1,
            "start_s": float(begins[k]),
            "heading_deg": float(heading),
            "glide_angle_deg": float(plan.glide_angles_deg[k]),
            "pitch_deg": float(plan.pitches_deg[k]),
            "speed_m_s": round(float(speeds[k]), 9),
            "depth_m": float(max(plan.yo_depths[k])),
            "dives": sum(bool(depth > before) for before, depth in pairwise(plan.yo_depths[k])),
            "surfacing_s": float(plan.surfacing_times[k]),
            "longitude": float(plan.surfacings[k, 0]),
            "latitude": float(plan.surfacings[k, 1]),
        }
        if odds is not None and len(odds.forgiving):
            about = np.mod(heading + odds.forgiving[k], 360.0).tolist()
            for name, value in zip(("from", "to"), about, strict=True):
                row[f"heading_{name}_deg"] = value if np.isfinite(value) else None
        if odds is not None and len(odds.ellipses):
            row |= zip(ON_LEG, odds.ellipses[k].tolist(), strict=True)
        rows.append(row)
    return rows


def goals_table(plan: MissionPlan) -> list[dict[str, float]]:
    """Return a table of the goals: position, leg, time and miss distance, one row per goal."""
    return [
        {
            "longitude": goal.longitude,
            "latitude": goal.latitude,
            "depth_m": goal.depth,
            "leg": int(plan.goal_legs[k]),
            "met_s": float(plan.goal_times[k]),
            "off_m": float(plan.closest_approach[k]),
        }
        for k, goal in enumerate(plan.goals)
    ]


def to_csv(plan: MissionPlan, odds: MissionOdds | None) -> str:
    """Return the legs as CSV with a header line; ``leg`` only without any."""
    rows = legs_table(plan, odds)
    rounded = [
        {name: None if value is None else round(value, 7) for name, value in row.items()}
        for row in rows
    ]
    return csv_text(rounded, rows[0] if rows else ["leg"])


def to_json(plan: MissionPlan, odds: MissionOdds | None) -> dict[str, Any]:
    """Return the plan as JSON: outcome, energy and legs; NaN becomes null."""
    return {
        "status": plan.status,
        "message": plan.message,
        "duration_s": plan.duration,
        "energy_j": plan.energy,
        "closest_approach_m": [float(miss) for miss in plan.closest_approach],
        "goals": goals_table(plan),
        "legs": legs_table(plan, odds),
        "statistics": {
            name: value if value == value else None for name, value in plan.statistics.items()
        },
    }


def places_table(plan: MissionPlan, odds: MissionOdds | None) -> list[dict[str, Any]]:
    """Return a table of goals and surfacings by name, for a map."""
    goals = [{"name": f"goal {k}", **row} for k, row in enumerate(goals_table(plan), 1)]
    return goals + [{"name": f"surfacing {row['leg']}", **row} for row in legs_table(plan, odds)]


def as_plan(plan: MissionPlan, projection: Projection, odds: MissionOdds | None = None) -> Plan:
    """Return the plan as a message of a result: the first leg's command and the whole predicted track.

    Each leg holds its controls and, with samples, the ellipse of its surfacing. Without legs, heading and glide angle are NaN.

    Args:
        plan: Plan.
        projection: Local frame of its track.
        odds: Odds of the plan; None without samples.
    """
    legs = len(plan.headings_deg)
    heading, angle = (
        float(values[0]) if legs else np.nan
        for values in (plan.headings_deg, np.deg2rad(plan.glide_angles_deg))
    )
    along, down = (
        float(speed) for speed in plan.vehicle.speeds(np, angle if legs else plan.vehicle.angles[0])
    )
    turn = float(grid_bearing_of_true_north(projection, plan.start.longitude, plan.start.latitude))
    local = np.deg2rad(heading) + turn
    return Plan(
        status=plan.status,
        start=plan.start,
        goal=plan.goals[-1],
        start_time_ns=plan.start_time_ns,
        heading_deg=heading,
        glide_angle_deg=float(np.rad2deg(angle)),
        speed=float(np.hypot(along, down)),
        velocity_through_water=np.array([along * np.sin(local), along * np.cos(local), down])
        if legs
        else np.zeros(3),
        duration=plan.duration,
        closest_approach=float(plan.closest_approach[-1]),
        track_time=plan.track_time,
        track=plan.track,
        message=plan.message,
        statistics=plan.statistics,
        # a glide is told by its heading and glide angle alone
        legs=tuple(legs_table(plan, odds)) if plan.settings.yos else (),
        energy=plan.energy,
        odds=None if odds is None else _odds(odds),
    )


def _odds(odds: MissionOdds) -> Odds:
    return Odds(
        odds.count,
        odds.reached,
        odds.safe,
        odds.radius,
        odds.deadline,
        odds.arrival_median,
        odds.arrival_90_percent,
    )
