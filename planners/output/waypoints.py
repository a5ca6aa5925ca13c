"""Waypoints for people, other programs and gliders: CSV, GeoJSON, JSON, a Slocum's list of waypoints, a Seaglider's file of targets."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from planners.mission.waypoints import Waypoints
from planners.output.formats import collection_text, csv_text, feature, position
from replay_kit.core.errors import PlanError


def waypoint_text(waypoints: Waypoints, path: Path) -> str:
    """Return waypoints in the form that a file's name tells: .csv, .geojson, .json, .ma (Slocum), .targets or targets (Seaglider).

    Raises:
        PlanError: The name tells none.
    """
    return FORMS[check_form(path)](waypoints)


def check_form(path: Path) -> str:
    """Return the form that a file's name tells.

    Raises:
        PlanError: It tells none.
    """
    form = path.suffix.lower() or f".{path.name.lower()}"
    if form not in FORMS:
        raise PlanError(f"{path}: expected a name of waypoints that ends in one of {', '.join(FORMS)}")
    return form


def waypoint_rows(waypoints: Waypoints) -> list[dict[str, float | None]]:
    """Return one row a waypoint; the time of one that is not reached is None."""
    return [
        {
            "waypoint": k + 1,
            "longitude": round(float(waypoints.longitude[k]), 7),
            "latitude": round(float(waypoints.latitude[k]), 7),
            "radius_m": waypoints.radius,
            "glide_angle_deg": round(float(waypoints.glide_angles_deg[k]), 4),
            "pitch_deg": round(float(waypoints.pitches_deg[k]), 4),
            "depth_m": float(waypoints.depths[k]),
            "dives": int(waypoints.yos),
            "reached_s": round(float(time), 3) if np.isfinite(time) else None,
        }
        for k, time in enumerate(waypoints.times)
    ]


def waypoint_json(waypoints: Waypoints) -> dict[str, Any]:
    """Return waypoints and what is lost by heading for them as JSON."""
    return {
        "message": waypoints.message,
        "off_end_m": waypoints.off_end,
        "delay_s": waypoints.delay,
        "off_track_m": waypoints.off_track,
        "waypoints": waypoint_rows(waypoints),
    }


def _csv(waypoints: Waypoints) -> str:
    return csv_text(waypoint_rows(waypoints), "waypoint")


def _json(waypoints: Waypoints) -> str:
    return json.dumps(waypoint_json(waypoints), indent=2, allow_nan=False) + "\n"


def _geojson(waypoints: Waypoints) -> str:
    """Return the waypoints as points, and where the glider surfaces on the way as one feature of many points."""
    near = float(waypoints.longitude[0])
    about = {name: value for name, value in waypoint_json(waypoints).items() if name != "waypoints"}
    features = [feature("MultiPoint", [position(x, y, near) for x, y in waypoints.surfacings], {"name": "surfacings on the way", **about})]
    for k, row in enumerate(waypoint_rows(waypoints)):
        at = position(float(waypoints.longitude[k]), float(waypoints.latitude[k]), near)
        features.append(feature("Point", at, {"name": f"waypoint {k + 1}", **row}))
    return collection_text(features) + "\n"


def _slocum(waypoints: Waypoints) -> str:
    """Return a ``goto_list`` that is run once from its first waypoint on.

    References: Slocum G2 Glider Operators Training Guide, Teledyne Webb Research 2012, ``goto_l10.ma``.
    """
    lines = [
        "behavior_name=goto_list",
        f"# {waypoints.message}",
        "<start:b_arg>",
        f"    b_arg: num_waypoints(nodim) {len(waypoints.times)}",
        "    b_arg: num_legs_to_run(nodim) -2  # the list once",
        "    b_arg: start_when(enum) 0  # immediately",
        "    b_arg: list_stop_when(enum) 7  # within the distance of a waypoint",
        f"    b_arg: list_when_wpt_dist(m) {waypoints.radius:g}",
        "    b_arg: initial_wpt(enum) 0  # the first",
        "<end:b_arg>",
        "<start:waypoints>",
        "# longitude latitude, degrees and minutes",
        *(f"{_minutes(x)} {_minutes(y)}" for x, y in zip(waypoints.longitude, waypoints.latitude, strict=True)),
        "<end:waypoints>",
    ]
    return "\n".join(lines) + "\n"


def _seaglider(waypoints: Waypoints) -> str:
    """Return a file of targets, each leading to the next and the last to itself.

    References: Seaglider File Formats Manual, University of Washington 2012, ``targets``.
    """
    lines, last = [f"/ {waypoints.message}"], len(waypoints.times)
    for k, (x, y) in enumerate(zip(waypoints.longitude, waypoints.latitude, strict=True), start=1):
        lines.append(f"WP{k:03d} lat={_minutes(y)} lon={_minutes(x)} radius={waypoints.radius:g} goto=WP{min(k + 1, last):03d}")
    return "\n".join(lines) + "\n"


def _minutes(degrees: float) -> str:
    """Return an angle as whole degrees with minutes behind: -70.5 is -7030.0000."""
    # rounded before it is split, or 59.99999 minutes become 60
    units = round(abs(float(degrees)) * 60e4)
    whole, rest = divmod(units, 600000)
    return f"{'-' if degrees < 0.0 and units else ''}{whole}{rest / 1e4:07.4f}"


#: How waypoints are written, by the ending of the file's name.
FORMS: dict[str, Callable[[Waypoints], str]] = {
    ".csv": _csv,
    ".geojson": _geojson,
    ".json": _json,
    ".ma": _slocum,
    ".targets": _seaglider,
}
