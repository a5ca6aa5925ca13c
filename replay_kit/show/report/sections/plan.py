"""The plans: where to steer, the depth profile over the bottom, and how predicted surfacings turned out."""

import json
from html import escape

import numpy as np

from replay_kit.results.views.contents import Contents
from replay_kit.results.views.last_plan import LastPlan
from replay_kit.results.views.track import thinned
from replay_kit.show.page.section import Figure, Section, column, number, table_html
from replay_kit.show.report.sections.last_plan import (
    last_plan_html,
    profile_figure,
    what_is_missing,
)
from replay_kit.show.report.sections.learning import learning_html, value_figure
from replay_kit.show.report.sections.waypoint import waypoint_figure

_PLANS = 30


def plan_section(contents: Contents) -> Section:
    """Return the last plan, the plans before it, and the surfacings that they predicted."""
    plan = contents.last_plan
    if plan is None:
        note = (contents.outcome.plan or {}).get("message", "")
        why = (
            f"No plan was found: {note}"
            if note
            else "The result holds no plan: no goal was given, or none was due"
        )
        return Section(
            "plan", "Plan", missing=[f"{why}; replay-kit plan makes one on this estimate."]
        )
    figures = [profile_figure(contents, plan)] if len(plan.track) else []
    value = value_figure(contents)
    if value is not None:
        figures.append(value)
    waypoint = waypoint_figure(contents)
    if waypoint is not None:
        figures.append(waypoint)
    if len(contents.result.surfacings):
        figures.append(_surfacings(contents))
    html = (
        last_plan_html(contents, plan)
        + _departures_html(contents)
        + learning_html(contents)
        + _legs_html(plan)
        + _plans_html(contents)
        + _figures_of_surfacings(contents)
    )
    return Section("plan", "Plan", html, figures, what_is_missing(plan))


def _legs_html(plan: LastPlan) -> str:
    """Return the legs of a mission."""
    rows = []
    for leg in plan.legs:
        rows.append(
            [
                str(leg["leg"]),
                f"{leg['heading_deg']:.0f}",
                f"{leg['glide_angle_deg']:.1f}",
                f"{leg['depth_m']:.0f}",
                f"{leg['surfacing_s'] / 3600.0:.1f}",
                f"{leg['longitude']:.4f}",
                f"{leg['latitude']:.4f}",
            ]
        )
    heads = [
        "leg",
        "heading [° true]",
        "glide angle [°]",
        "depth [m]",
        "surfaces after [h]",
        "longitude",
        "latitude",
    ]
    return table_html(heads, rows, "Legs of the last plan") if rows else ""


def _departures_html(contents: Contents) -> str:
    """Return the departures that were compared; nothing where there was one."""
    rows = [json.loads(row) for row in contents.record.metadata.get("departures", {}).values()]
    cells = [
        [
            row["departure"],
            escape(row["status"]),
            row["arrival"] or f"misses by {row['miss_m'] / 1e3:.1f} km",
            f"{row['duration_s'] / 3600.0:.2f}",
            f"{row['energy_j'] / 1e3:.0f}",
            "" if row["reached"] is None else f"{100.0 * row['reached']:.0f} %",
            ", ".join(row["best"]),
        ]
        for row in rows
    ]
    heads = [
        "departure (UTC)",
        "status",
        "arrival (UTC)",
        "lasts [h]",
        "energy [kJ]",
        "samples that arrive",
        "",
    ]
    return table_html(heads, cells, "Departures compared") if rows else ""


def _plans_html(contents: Contents) -> str:
    plans = contents.result.plans
    kept = thinned(len(plans), _PLANS)
    rows = []
    for time, plan in plans.iloc[kept].iterrows():
        steered = plan["status"] != "failed" and np.isfinite(plan["heading_deg"])
        rows.append(
            [
                str(time)[:16],
                escape(plan["status"]),
                f"{plan['heading_deg']:.0f}" if steered else "",
                f"{plan['glide_angle_deg']:.1f}" if steered else "",
                f"{plan['duration'] / 3600.0:.1f}" if np.isfinite(plan["duration"]) else "",
                f"{plan['closest_approach']:.0f}" if np.isfinite(plan["closest_approach"]) else "",
                escape(plan["message"]),
            ]
        )
    thin = f"; {len(kept)} of {len(plans)}" if len(kept) < len(plans) else ""
    heads = [
        "begins (UTC)",
        "status",
        "heading [° true]",
        "glide angle [°]",
        "lasts [h]",
        "misses the goal by [m]",
        "message",
    ]
    return table_html(heads, rows, f"The plans, in the order in which they were made{thin}")


def _figures_of_surfacings(contents: Contents) -> str:
    figures = contents.outcome.surfacings
    if not figures:
        return ""
    median, delay, share = (
        figures["distance_median_m"],
        figures["delay_median_s"],
        figures["inside_ellipse"],
    )
    text = (
        f"{number('surfacings.count', figures['count'], str(figures['count']))} surfacings were predicted by the plan "
        "before: in the median "
        f"{number('surfacings.distance_median_m', median, f'{median:,.0f}')} m off, at "
        f"{number('surfacings.delay_median_s', delay, f'{delay / 60.0:+.0f}')} minutes"
    )
    if share is not None:
        text += f"; {number('surfacings.inside_ellipse', share, f'{100.0 * share:.0f} %')} lie inside the ellipse of 90 %"
    return f"<p>{text}. If the vehicle flew other plans than these, the distances include the difference of the two.</p>"


def _surfacings(contents: Contents) -> Figure:
    table = contents.result.surfacings
    radians = np.deg2rad(table["direction_deg"].to_numpy(np.float64))
    distance = table["distance"].to_numpy(np.float64) / 1e3
    data = {
        "time": [str(time)[:19] for time in table.index],
        "east_km": column(distance * np.sin(radians)),
        "north_km": column(distance * np.cos(radians)),
        "delay_min": column(table["delay"].to_numpy(np.float64) / 60.0),
        "inside_ellipse": table["inside_ellipse"].astype(int).tolist(),
    }
    points = {
        "type": "scatter",
        "mode": "markers",
        "x": "$surfacing_errors.east_km",
        "y": "$surfacing_errors.north_km",
        "text": "$surfacing_errors.time",
        "customdata": "$surfacing_errors.delay_min",
        "marker": {"size": 9, "color": {"$color": "one"}},
        "hovertemplate": "%{text}<br>%{x:.2f} km east, %{y:.2f} km north, %{customdata:+.0f} min<extra></extra>",
    }
    reach = float(f"{1.15 * max(distance.max(), 0.1):.3g}")
    layout = {
        "height": 420,
        "xaxis": {
            "title": {"text": "actual minus predicted, east [km]"},
            "range": [-reach, reach],
            "constrain": "domain",
        },
        "yaxis": {
            "title": {"text": "north [km]"},
            "scaleanchor": "x",
            "range": [-reach, reach],
            "constrain": "domain",
        },
        "showlegend": False,
    }
    caption = (
        "Each point: where the vehicle surfaced, seen from where the plan before had predicted it. A cloud beside the "
        "centre is a current that the estimate lacks, or another plan flown."
    )
    return Figure(
        "surfacing-errors",
        "Predicted and actual surfacings",
        caption,
        f"Error of {len(table)} predicted surfacings, east and north.",
        {"surfacing_errors": data},
        [points],
        layout,
    )
