"""Plans and their waypoints as tables, JSON, the message of a result, and files for vehicles.

Waypoint files are CSV, GeoJSON, JSON, KML, QGroundControl, Slocum and Seaglider.
"""

import json
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np

from planners.odds.mission import MissionOdds
from planners.request import MissionPlan
from planners.waypoints import Waypoints
from replay_kit.core.errors import PlanError
from replay_kit.core.geodesy import grid_bearing_of_true_north
from replay_kit.core.grid import Projection
from replay_kit.core.plan import Odds, Plan
from replay_kit.core.region import collection_file, continuous_positions, feature
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
        via=plan.goals[:-1],
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


def waypoint_text(waypoints: Waypoints, path: Path) -> str:
    """Return the text of a waypoint file in the format given by its name.

    Endings: .csv, .geojson, .json, .kml, .plan (QGroundControl), .ma (Slocum: ``yo`` if the name begins with it, otherwise ``goto_list``).
    Seaglider: targets or .targets, and science or .science (sampling intervals by depth).

    Raises:
        PlanError: The format is unknown.
    """
    form = check_form(path)
    return (
        _slocum_yo(waypoints)
        if form == ".ma" and path.name.lower().startswith("yo")
        else FORMS[form](waypoints)
    )


def check_form(path: Path) -> str:
    """Return the format given by a file's name.

    Raises:
        PlanError: The format is unknown.
    """
    form = path.suffix.lower() or f".{path.name.lower()}"
    if form not in FORMS:
        raise PlanError(
            f"{path}: expected a name of waypoints that ends in one of {', '.join(FORMS)}"
        )
    return form


def waypoint_rows(waypoints: Waypoints) -> list[dict[str, float | None]]:
    """Return a table with one row per waypoint; the time is None if not reached."""
    return [
        {
            "waypoint": k + 1,
            "longitude": round(float(waypoints.longitude[k]), 7),
            "latitude": round(float(waypoints.latitude[k]), 7),
            "radius_m": float(waypoints.radius[k]),
            "glide_angle_deg": round(float(waypoints.glide_angles_deg[k]), 4),
            "pitch_deg": round(float(waypoints.pitches_deg[k]), 4),
            "depth_m": float(waypoints.depths[k]),
            "dives": int(waypoints.yos),
            "reached_s": round(float(time), 3) if np.isfinite(time) else None,
        }
        for k, time in enumerate(waypoints.times)
    ]


def waypoint_json(waypoints: Waypoints) -> dict[str, Any]:
    """Return the waypoints and their loss against the plan as JSON."""
    return {
        "message": waypoints.message,
        "off_end_m": waypoints.off_end,
        "delay_s": waypoints.delay,
        "off_track_m": waypoints.off_track,
        "waypoints": waypoint_rows(waypoints),
    }


def _csv(waypoints: Waypoints) -> str:
    rows = waypoint_rows(waypoints)
    return csv_text(rows, rows[0])


def _json(waypoints: Waypoints) -> str:
    return json.dumps(waypoint_json(waypoints), indent=2, allow_nan=False) + "\n"


def _geojson(waypoints: Waypoints) -> str:
    """Return the waypoints as point features, and the surfacings between them as one multi-point feature."""
    near = float(waypoints.longitude[0])
    about = {name: value for name, value in waypoint_json(waypoints).items() if name != "waypoints"}
    surfacings = continuous_positions(waypoints.surfacings[:, 0], waypoints.surfacings[:, 1], near)
    features = [feature("MultiPoint", surfacings, {"name": "surfacings on the way", **about})]
    at = continuous_positions(waypoints.longitude, waypoints.latitude, near)
    for place, row in zip(at, waypoint_rows(waypoints), strict=True):
        features.append(feature("Point", place, {"name": f"waypoint {row['waypoint']}", **row}))
    return collection_file(features)


def _slocum(waypoints: Waypoints) -> str:
    """Return a ``goto_list`` that runs once from its first waypoint.

    Positions are longitude and latitude in degrees and minutes, see ``_minutes``.

    References: Slocum G2 Glider Operators Training Guide, Teledyne Webb Research, revision 06/12, "Mission Files (.mi and .ma)",
    ``goto_l10.ma`` and the meanings of ``start_when`` (manualshive.com/manual/teledyne/slocum-g2/1080372, pages 26 to 38).
    """
    lines = [
        "behavior_name=goto_list",
        f"# {waypoints.message}",
        "<start:b_arg>",
        f"    b_arg: num_waypoints(nodim) {len(waypoints.times)}",
        "    b_arg: num_legs_to_run(nodim) -2  # the list once",
        "    b_arg: start_when(enum) 0  # immediately",
        "    b_arg: list_stop_when(enum) 7  # within the distance of a waypoint",
        f"    b_arg: list_when_wpt_dist(m) {np.min(waypoints.radius):g}  # of all: the goals' own",
        "    b_arg: initial_wpt(enum) 0  # the first",
        "<end:b_arg>",
        "<start:waypoints>",
        "# longitude latitude, degrees and minutes",
        *(
            f"{_minutes(x)} {_minutes(y)}"
            for x, y in zip(waypoints.longitude, waypoints.latitude, strict=True)
        ),
        "<end:waypoints>",
    ]
    return "\n".join(lines) + "\n"


def _seaglider(waypoints: Waypoints) -> str:
    """Return a ``targets`` file in which each target leads to the next and the last to itself.

    References: Seaglider File Formats Manual, University of Washington, version 66.12, April 2012, ``targets``
    (sahale.apl.washington.edu/svn/Archive/software/releases/main66.12/docs/File_Formats_Man.html).
    """
    lines, last = [f"/ {waypoints.message}"], len(waypoints.times)
    for k, (x, y) in enumerate(zip(waypoints.longitude, waypoints.latitude, strict=True), start=1):
        lines.append(
            f"WP{k:03d} lat={_minutes(y)} lon={_minutes(x)} radius={waypoints.radius[k - 1]:g} goto=WP{min(k + 1, last):03d}"
        )
    return "\n".join(lines) + "\n"


# Of a Seaglider, each from the depth of the one before it to its own [m]: seconds between samples, and between corrections of its flight.
_SAMPLING = ((50.0, 5, 60), (200.0, 10, 120), (np.inf, 20, 180))


def _science(waypoints: Waypoints) -> str:
    """Return a ``science`` file: sampling intervals of one instrument down to the deepest dive.

    References: Seaglider File Formats Manual, University of Washington, version 66.12, April 2012, ``science``; the checks of
    ``validate.py`` in iop-apl-uw/basestation3: depth, seconds, a digit for each instrument, seconds between guidance and control.
    """
    deepest = float(np.max(waypoints.depths))
    until = [min(depth, deepest) for depth, *_ in _SAMPLING]
    lines = [
        f"{below:g} {every} 1 {control}"
        for above, below, (_, every, control) in zip([0.0, *until], until, _SAMPLING, strict=False)
        if below > above
    ]
    return (
        "\n".join(["/ depth seconds instruments control; a digit for each instrument", *lines])
        + "\n"
    )


def _slocum_yo(waypoints: Waypoints) -> str:
    """Return a ``yo`` file with the shallowest depth and the mean pitch of the dives.

    References: Slocum G2 Glider Operators Training Guide, Teledyne Webb Research, revision 06/12, "Mission Files (.mi and .ma)",
    ``yo10.ma``.
    """
    pitch = float(np.deg2rad(np.mean(waypoints.pitches_deg)))
    lines = [
        "behavior_name=yo",
        f"# {waypoints.message}",
        "<start:b_arg>",
        "    b_arg: start_when(enum) 2  # pitch idle",
        f"    b_arg: num_half_cycles_to_do(nodim) {2 * waypoints.yos}",
        f"    b_arg: d_target_depth(m) {float(np.min(waypoints.depths)):g}",
        f"    b_arg: d_target_altitude(m) {waypoints.clearance:g}  # by the altimeter",
        "    b_arg: d_use_pitch(enum) 3  # servo, radians",
        f"    b_arg: d_pitch_value(X) {-pitch:.4f}",
        "    b_arg: c_use_pitch(enum) 3  # servo, radians",
        f"    b_arg: c_pitch_value(X) {pitch:.4f}",
        "    b_arg: end_action(enum) 2  # resume",
        "<end:b_arg>",
    ]
    return "\n".join(lines) + "\n"


def _qgroundcontrol(waypoints: Waypoints) -> str:
    """Return a plan of MAVLink waypoints at the surface, with their acceptance radius and the fence.

    A fence applies at any depth: areas that forbid surfacing only are omitted, and holes are ignored.

    References: QGroundControl developer guide, Plan File Format; MAVLink common messages, MAV_CMD_NAV_WAYPOINT (16),
    MAV_FRAME_GLOBAL_RELATIVE_ALT (3), MAV_TYPE_SUBMARINE (12), MAV_AUTOPILOT_GENERIC (0).
    """
    places = [
        [round(float(y), 7), round(float(x), 7), 0.0]
        for x, y in zip(waypoints.longitude, waypoints.latitude, strict=True)
    ]
    items = [
        {
            "AMSLAltAboveTerrain": None,
            "Altitude": 0.0,
            "AltitudeMode": 1,
            "autoContinue": True,
            "command": 16,
            "doJumpId": number,
            "frame": 3,
            # no time to hold, no other radius to pass at, no heading to take
            "params": [0.0, float(waypoints.radius[number - 1]), 0.0, None, *place],
            "type": "SimpleItem",
        }
        for number, place in enumerate(places, start=1)
    ]
    mission = {
        "cruiseSpeed": 1,
        "hoverSpeed": 1,
        "firmwareType": 0,
        "vehicleType": 12,
        "globalPlanAltitudeMode": 1,
        "version": 2,
    }
    plan = {
        "fileType": "Plan",
        "groundStation": "QGroundControl",
        "version": 1,
        "mission": {**mission, "items": items, "plannedHomePosition": places[0]},
        "geoFence": {"circles": [], "polygons": _fence(waypoints), "version": 2},
        "rallyPoints": {"points": [], "version": 2},
    }
    return json.dumps(plan, indent=2, allow_nan=False) + "\n"


def _fence(waypoints: Waypoints) -> list[dict[str, Any]]:
    """Return the polygons of a fence, latitude first."""
    return [
        {
            "inclusion": area.fence,
            "polygon": [[round(y, 7), round(x, 7)] for x, y in area.corners],
            "version": 1,
        }
        for area in waypoints.areas
        if not area.surface_only or area.fence
    ]


def _kml(waypoints: Waypoints) -> str:
    """Return the waypoints as placemarks and a connecting line.

    References: OGC 12-007r2, OGC KML 2.3: coordinates are longitude, within 180 degrees, latitude and height.
    """
    places = zip(waypoints.longitude, waypoints.latitude, strict=True)
    texts = [f"{longitude:.7f},{latitude:.7f},0" for longitude, latitude in places]
    placemarks = [
        f"<Placemark><name>waypoint {k}</name><Point><coordinates>{at}</coordinates></Point></Placemark>"
        for k, at in enumerate(texts, 1)
    ]
    line = f"<Placemark><name>way</name><LineString><coordinates>{' '.join(texts)}</coordinates></LineString></Placemark>"
    about = f"<description>{escape(waypoints.message)}</description>"
    parts = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<kml xmlns="http://www.opengis.net/kml/2.2"><Document>',
        about,
        *placemarks,
        line,
    ]
    return "\n".join([*parts, "</Document></kml>"]) + "\n"


def _minutes(degrees: float) -> str:
    """Return an angle as degrees and minutes without a separator: -70.5 is -7030.0000."""
    # rounded before it is split, or 59.99999 minutes become 60
    units = round(abs(float(degrees)) * 60e4)
    whole, rest = divmod(units, 600000)
    return f"{'-' if degrees < 0.0 and units else ''}{whole}{rest / 1e4:07.4f}"


#: How waypoints are written, by the ending of the file's name.
FORMS: dict[str, Callable[[Waypoints], str]] = {
    ".csv": _csv,
    ".geojson": _geojson,
    ".json": _json,
    ".kml": _kml,
    ".plan": _qgroundcontrol,
    ".ma": _slocum,
    ".targets": _seaglider,
    ".science": _science,
}
