"""Report section on plans: command, depth profile, and errors of predicted surfacings."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from html import escape
from typing import Any

import numpy as np

from replay_kit.core.plan import Plan
from replay_kit.results.geojson import finite_or_none
from replay_kit.results.innovations import thinned
from replay_kit.results.mcap.schemas import attributes
from replay_kit.results.views.contents import Contents
from replay_kit.show.figures.section import profile_figure, surfacing_figure
from replay_kit.show.numbers import sentence
from replay_kit.show.page.page import Section, table_html
from replay_kit.show.sentences import energy_sentence, odds_sentence, outcomes_sentence

_STATUS = {
    "reached": "the predicted path passes the goal within the tolerance",
    "uncertain": "the predicted path passes the goal, but fewer flights than required arrive",
    "partial": "the predicted path ends at the requested horizon, before the goal",
    "unsafe": "the predicted path violates a constraint, or more flights than accepted do",
    "unreachable": "the best path found does not pass the goal within the tolerance",
    "failed": "no usable path was found",
}


def last_plan_html(contents: Contents, plan: Plan) -> str:
    """Return the outcome of the last plan as a table."""
    rows = {
        "status": f"<strong>{escape(plan.status)}</strong>: {_STATUS.get(plan.status, '')}",
        "message": escape(plan.message),
    }
    if plan.energy > 0.0:
        stated = "" if plan.battery > 0.0 else "; the energy of the battery was not stated"
        rows["energy"] = energy_sentence(plan.energy, plan.battery).html + stated
    if plan.odds is not None:
        form = "; {safe:share} violate no constraint; within {radius:,.0f} m"
        more = sentence(form, asdict(plan.odds), "plan.odds.")
        rows["odds of arriving"] = odds_sentence(plan.odds).html + more.html
    if plan.areas:
        names = (area.name + " (surface only)" * area.surface_only for area in plan.areas)
        rows["no-go areas"] = ", ".join(map(escape, names))
    if (named := contents.metadata.get("replay_kit.inputs", {}).get("bathymetry")) is not None:
        name, _, digest = named.partition(" sha256:")
        rows["bathymetry"] = f"{escape(name)}, SHA-256 <code>{escape(digest)}</code>"
    if plan.bottom is not None:
        height = float(np.nanmin(plan.bottom - plan.track[:, 2]))
        rows["least height above the bottom"] = f"{height:.0f} m"
    cells = [[what, text] for what, text in rows.items()]
    return table_html(["what", "of the last plan"], cells, "The last plan")


_PLANS, _TITLE = 30, "How does the plan turn out?"


def plan_section(contents: Contents) -> Section:
    """Return the section on the last plan, earlier plans, and predicted surfacings."""
    plan, found = contents.last_plan, contents.outcome.surfacings
    if plan is None:
        note = (contents.outcome.plan or {}).get("message", "")
        lacks = "The result holds no plan: no goal was given, or none was due"
        why = f"{f'No plan was found: {note}' if note else lacks}; replay-kit plan makes one on this estimate."
        return Section("plan", _TITLE, missing=[why], menu="Plan", answer="There is none.")
    figures = [profile_figure(contents, plan)] if len(plan.track) else []
    if len(contents.result.surfacings):
        figures.append(surfacing_figure(contents))
    departures = [*map(json.loads, contents.metadata.get("departures", {}).values())]
    for row in departures:
        row["arrives"] = row["arrival"] or f"misses by {row['miss_m'] / 1e3:.1f} km"
        row["best"] = ", ".join(row["best"])
    rows = [_row(_DEPARTURE, row) for row in departures]
    at = "plan.statistics.leg_{:03d}#".format
    legs = [_row(_LEG, leg, at(leg["leg"])) for leg in plan.legs]
    html = [
        last_plan_html(contents, plan),
        table_html([*_DEPARTURE], rows, "Departures compared") if rows else "",
        table_html([*_LEG], legs, "Legs of the last plan") if legs else "",
        _plans_html(contents),
        "" if found is None else f"<p>{outcomes_sentence(found).html}.</p>",
    ]
    answer = f"{escape(plan.status.capitalize())}: {_STATUS.get(plan.status, '')}."
    return Section("plan", _TITLE, "".join(html), figures, menu="Plan", answer=answer)


def _columns(table: str) -> dict[str, str]:
    """Return the columns of a table by their headings, as templates of a row."""
    return dict(line.split(": ", 1) for line in table.strip().splitlines())


_LEG = _columns("""
leg: {leg}
heading [° true]: {heading_deg:.0f}
glide angle [°]: {glide_angle_deg:.1f}
depth [m]: {depth_m:.0f}
surfaces after [h]: {surfacing_s:hours}
longitude: {longitude:.4f}
latitude: {latitude:.4f}
""")
_PLAN = _columns("""
begins (UTC): {begins}
status: {status}
heading [° true]: {heading_deg:.0f}
glide angle [°]: {glide_angle_deg:.1f}
duration [h]: {duration_s:hours}
misses the goal by [m]: {closest_approach_m:,.0f}
message: {message}
""")


_DEPARTURE = _columns("""
departure (UTC): {departure}
status: {status}
arrival (UTC): {arrives}
duration [h]: {duration_s:hours}
energy: {energy_j:kJ}
odds of arriving: {reached:share}
: {best}
""")


def _row(columns: Mapping[str, str], record: Mapping[str, Any], at: str = "") -> list[str]:
    """Return the cells of a row; with the path of its record in the outcome, numbers keep their fields."""
    each = [sentence(form, record, at) for form in columns.values()]
    return [cell.html if at else escape(str(cell)) for cell in each]


def _plans_html(contents: Contents) -> str:
    """Return all plans as an HTML table; the numbers of the last one are those of the outcome."""
    plans, rows = contents.result.plans, []
    kept = thinned(len(plans), _PLANS)
    named = "heading_deg glide_angle_deg duration_s=duration closest_approach_m=closest_approach"
    for count in kept.tolist():
        plan = plans.iloc[count]
        record = {name: finite_or_none(value) for name, value in attributes(plan, named).items()}
        if plan["status"] == "failed":
            record |= dict.fromkeys(("heading_deg", "glide_angle_deg"))
        about = {"begins": str(plan.name)[:16], **plan[["status", "message"]]}
        rows.append(_row(_PLAN, record | about, "plan." * (count == len(plans) - 1)))
    thin = f"; {len(kept)} of {len(plans)}" if len(kept) < len(plans) else ""
    return table_html([*_PLAN], rows, f"All plans, oldest first{thin}")
