"""Planned missions as tables and JSON, and reasons not to hand one to a vehicle."""

from collections.abc import Iterator, Mapping
from math import isfinite
from pathlib import Path
from typing import Any

from rich.console import Console

from planners.output import (
    as_plan,
    legs_table,
    places_table,
    to_csv,
    to_json,
    waypoint_json,
    waypoint_text,
)
from replay_kit.core.plan import share_interval
from replay_kit.core.region import collection_file, continuous_positions, feature
from replay_kit.core.words.text import time_text
from replay_kit.show.sentences import energy_sentence
from replay_kit.show.text import print_table
from replay_kit.workflows.planning.run import PlannedMission, Together

# Figures of odds, each with its unit.
_ODDS = (
    *("count", "radius_m", "deadline_s", "reached", "arrival_median_s", "arrival_90_percent_s"),
    *("miss_median_m", "miss_90_percent_m", "safe"),
)

# Columns of the table of legs, as templates of a row.
_LEG = {
    "leg": "{leg:.0f}",
    "heading": "{heading_deg:.1f}",
    "glide angle": "{glide_angle_deg:.1f}",
    "pitch": "{pitch_deg:.1f}",
    "arrives with": "{turns}",
    "depth [m]": "{depth_m:.0f}",
    "after [h]": "{hours:.2f}",
    "UTC": "{when}",
    "surfacing at": "{longitude:.4f}, {latitude:.4f}",
}


def texts_of(
    planned: PlannedMission, geojson: Path | None, csv: Path | None, waypoints: Path | None
) -> Iterator[tuple[Path, str]]:
    """Yield each requested file with its text: mission map, table of legs, and waypoint list."""
    made, odds, projection = planned.plan, planned.odds, planned.on.region.projection
    if geojson is not None:
        # loads the messages of results
        from replay_kit.results.geojson import plan_features

        # all goals and surfacings in place of the last goal and the surfacings before it
        every = plan_features(as_plan(made, projection, odds), projection)
        drawn = [one for one in every if one["properties"]["role"] not in ("goal", "planned")]
        rows = places_table(made, odds)
        longitude, latitude = ([row[name] for row in rows] for name in ("longitude", "latitude"))
        at = continuous_positions(longitude, latitude, made.start.longitude)
        drawn += [feature("Point", *one) for one in zip(at, rows, strict=True)]
        yield geojson, collection_file(drawn)
    if csv is not None:
        yield csv, to_csv(made, odds)
    if waypoints is not None and planned.waypoints is not None:
        yield waypoints, waypoint_text(planned.waypoints, waypoints)


def plans_json(made: Together) -> dict[str, Any]:
    """Return plans for JSON: a single one with the planners' figures, ``samples`` and ``waypoints``, null if absent."""
    each = {
        name: {
            **to_json(planned.plan, planned.odds),
            "samples": _samples_json(planned),
            "waypoints": None if planned.waypoints is None else waypoint_json(planned.waypoints),
            "notes": list(planned.notes),
            "departures": departures_table(planned),
        }
        for name, planned in made.planned.items()
    }
    if not made.goals:
        return each[""]
    return {
        "vehicles": each,
        "goals": dict(made.goals),
        "goals_left": list(made.left),
        "separation": list(made.separation),
    }


def _samples_json(planned: PlannedMission) -> dict[str, Any] | None:
    if (odds := planned.odds) is None:
        return None
    figures = {name: getattr(odds, name.removesuffix("_m").removesuffix("_s")) for name in _ODDS}
    return {
        **{name: value if isfinite(value) else None for name, value in figures.items()},
        "reached_interval": share_interval(odds.reached, odds.count),
        "violations": dict(odds.violations),
        "allowed": planned.job.risk,
        "held": planned.held,
    }


def print_plans(made: Together, console: Console, withheld: Mapping[str, str]) -> None:
    """Print plans: odds, outcome, loss by waypoints, and the commands to a glider at each surfacing.

    Args:
        made: The plans.
        console: Console.
        withheld: Reason not to write the files of a plan, by vehicle.
    """
    if made.goals:
        _print_together(made, console)
    for name, planned in made.planned.items():
        if name:
            console.print()
            console.print(name, style="bold")
        _print_mission(planned, console)
        if name in withheld:
            whose = f"file of {name}" if name else "other file"
            console.print(f"{withheld[name]}; no {whose} is written without --write-unsafe")


def _print_mission(planned: PlannedMission, console: Console) -> None:
    made, battery = planned.plan, planned.job.battery
    console.print(f"{made.status}: {made.message}")
    for note in planned.notes:
        console.print(f"note: {note}")
    if planned.departures:
        _print_departures(planned, console)
    if len(made.headings_deg) == 0:
        return
    energy = energy_sentence(made.energy, None if battery is None else battery * 1e6)
    rows = legs_table(made, planned.odds)
    legs = f"{len(rows)} legs at {rows[0]['speed_m_s']:.2f} m/s"
    console.print(f"{made.duration / 3600.0:.2f} h, {energy}, {legs}")
    if planned.waypoints is not None:
        console.print(planned.waypoints.message)
    print_table(console, None, [*_LEG], (_leg_cells(row, made.start_time_ns) for row in rows))


def _leg_cells(row: Mapping[str, Any], start_ns: int) -> list[str]:
    # with which the leg still arrives
    turns = row.get("heading_from_deg"), row.get("heading_to_deg")
    more = {
        "turns": "-" if None in turns else "{:.0f} to {:.0f}".format(*turns),
        "hours": row["surfacing_s"] / 3600.0,
        "when": time_text(start_ns + round(row["surfacing_s"] * 1e9)) if start_ns else "-",
    }
    return [template.format_map({**row, **more}) for template in _LEG.values()]


def _print_departures(planned: PlannedMission, console: Console) -> None:
    """Print the compared departures, the planned one marked."""
    columns = "departure", "status", "arrival", "hours", "energy [kJ]", "legs", "arrive", ""
    rows = [
        (
            row["departure"],
            row["status"],
            row["arrival"] or f"misses by {row['miss_m'] / 1e3:.1f} km",
            f"{row['duration_s'] / 3600.0:.2f}",
            f"{row['energy_j'] / 1e3:.0f}",
            str(row["legs"]),
            "" if row["reached"] is None else f"{100.0 * row['reached']:.0f} %",
            ", ".join(row["best"]),
        )
        for row in departures_table(planned)
    ]
    print_table(console, "Departures compared", columns, rows)


def departures_table(planned: PlannedMission) -> list[dict[str, Any]]:
    """Return the compared departures, one row each, for JSON and for results.

    ``best`` marks the departure ``planned`` for the mission and the one that ``arrives first``. ``arrival`` is null if the goal is not
    reached.
    """
    rows: list[dict[str, Any]] = [
        {
            "departure": time_text((plan := departure.plan).start_time_ns),
            "status": plan.status,
            "arrival": time_text(plan.start_time_ns + round(plan.duration * 1e9))
            if plan.status in ("reached", "uncertain")
            else None,
            "duration_s": plan.duration,
            "energy_j": plan.energy,
            "legs": len(plan.headings_deg),
            "miss_m": float(plan.closest_approach[-1]),
            "reached": None if departure.odds is None else departure.odds.reached,
            "best": ["planned"] * (plan.start_time_ns == planned.plan.start_time_ns),
        }
        for departure in planned.departures
    ]
    arriving = [row for row in rows if row["arrival"]]
    if arriving:
        min(arriving, key=lambda row: row["arrival"])["best"].append("arrives first")
    return rows


def unsafe_reason(planned: PlannedMission) -> str | None:
    """Return the reason not to hand a mission to a vehicle without confirmation; None if it is safe."""
    made, few, odds, job = planned.plan, planned.waypoints, planned.odds, planned.job
    violating = 0.0 if odds is None else 1.0 - odds.safe
    if few is not None and (
        few.violation is not None or (job.risk is None and violating > job.accepted_risk)
    ):
        share = "" if few.violation else f" in {100.0 * violating:.0f} % of the samples"
        other = "no other tolerance tried is, a larger --margin may be"
        if planned.helps is not None:
            other = f"--waypoint-tolerance {planned.helps:g} is safe"
        return f"the waypoints are not safe{share}; {other}"
    if few is not None and made.status == "unsafe":
        return "waypoints of an unsafe plan"
    if job.risk is None or odds is None:
        return None
    if made.status != "unsafe" and violating <= job.risk + 1e-9:
        return None
    drivers = ", ".join(
        f"{name} {100.0 * share:.0f} %"
        for name, share in sorted(odds.violations.items(), key=lambda one: -one[1])
    )
    least = f"the least found is {100.0 * violating:.0f} %"
    by = f", from {drivers}" if drivers else ""
    return f"the risk of {100.0 * job.risk:g} % cannot be kept: {least}{by}"


def _print_together(made: Together, console: Console) -> None:
    """Print the assignment of goals, the separation of each two missions, and unassigned goals."""
    columns = ("glider", "goal", "status", "hours", "arrives")
    rows = [
        (
            name,
            f"goal {made.goals[name]}",
            planned.plan.status,
            f"{planned.plan.duration / 3600.0:.1f}",
            "-" if planned.odds is None else f"{100.0 * planned.odds.reached:.0f} %",
        )
        for name, planned in made.planned.items()
    ]
    print_table(console, "Gliders", columns, rows)
    for name, goal in made.goals.items():
        if goal is None:
            console.print(f"{name}: no goal is left for it, or none that it can reach")
    for goal in made.left:
        console.print(f"goal {goal}: no glider goes there")
    for row in made.separation:
        console.print(_apart(row))


def _apart(row: Mapping[str, Any]) -> str:
    """Return the separation of two missions, as text."""
    first, second = row["vehicles"]
    text = f"{first} and {second}: at least {row['least_distance_m'] / 1e3:.1f} km apart, at {row['time']}"
    if row["separation_m"] is None:
        return text
    if row["nearer_in_samples"] is not None:
        text += f"; nearer than {row['separation_m'] / 1e3:g} km in {100.0 * row['nearer_in_samples']:.0f} % of the samples"
    if not row["kept"]:
        text += (
            f"; {row['separation_m'] / 1e3:g} km are not kept: no route around was found for either"
        )
    return text
