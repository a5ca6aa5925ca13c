"""A policy for people and programs: a table of headings by place and time as CSV or JSON, and arrows for a map as GeoJSON."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from planners.mission.policy import Policy
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Projection
from replay_kit.core.region import collection_text, cut_at_antimeridian, feature, positions
from replay_kit.core.text import csv_text

_FORMS = (".csv", ".json", ".geojson")
# Length of an arrow in spacings of the table.
_ARROW = 0.6


def policy_rows(policy: Policy) -> list[dict[str, float]]:
    """Return one row for each time and place from which the goal is reached."""
    return [
        {
            "after_s": round(float(policy.table.times[k]), 3),
            "longitude": round(float(policy.longitude[i]), 7),
            "latitude": round(float(policy.latitude[i]), 7),
            "heading_deg": round(float(policy.headings_deg[k, i]), 1),
            "hours_left": round(float(policy.hours_left[k, i]), 2),
        }
        for k, i in np.argwhere(np.isfinite(policy.headings_deg)).tolist()
    ]


def policy_json(policy: Policy) -> dict[str, Any]:
    """Return the policy with how it is to be flown and how it fares in the samples."""
    plan = policy.plan
    return {
        "message": policy.message,
        "goal": [plan.goals[0].longitude, plan.goals[0].latitude],
        "radius_m": plan.settings.tolerance,
        "near_m": policy.table.near,
        "glide_angle_deg": policy.angle_deg,
        "depth_m": plan.settings.depth,
        "dives": plan.settings.yos,
        "samples": None if policy.risk is None else asdict(policy.risk),
        "headings": policy_rows(policy),
    }


def policy_text(policy: Policy, path: Path) -> str:
    """Return a policy in the form that a file's name tells: .csv, .json or .geojson.

    Raises:
        PlanError: It tells none.
    """
    form = path.suffix.lower()
    if form not in _FORMS:
        raise PlanError(f"{path}: expected a policy's name that ends in one of {', '.join(_FORMS)}")
    rows = policy_rows(policy)
    if form == ".csv":
        return csv_text(rows, rows[0])
    if form == ".json":
        return json.dumps(policy_json(policy), indent=2, allow_nan=False) + "\n"
    near, length = policy.plan.start.longitude, _ARROW * policy.table.spacing
    features = []
    for row in rows:
        bearing = np.deg2rad(row["heading_deg"])
        frame = Projection(row["longitude"], row["latitude"])
        arrow = np.outer([0.0, length], [np.sin(bearing), np.cos(bearing)])
        line = positions(*to_geographic(frame, *arrow.T), near)
        features.append(feature("LineString", line, {"name": "heading", **row}))
    return collection_text([cut_at_antimeridian(one) for one in features]) + "\n"
