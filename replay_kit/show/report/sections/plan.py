"""Report section on plans: command, depth profile, and errors of predicted surfacings."""

import json
from collections.abc import Mapping
from html import escape

import numpy as np

from replay_kit.results.views.contents import Contents
from replay_kit.results.views.track import LastPlan, thinned
from replay_kit.show.figures.plan import profile_figure, surfacing_figure
from replay_kit.show.numbers import fixed, leg_number, number, sentence
from replay_kit.show.page.page import Section
from replay_kit.show.page.parts import table_html
from replay_kit.show.sentences import energy_sentence, odds_sentence, outcomes_sentence

_STATUS = {
    "reached": "the predicted path passes the goal within the tolerance",
    "uncertain": "the predicted path passes the goal, but fewer flights than required arrive",
    "partial": "the predicted path ends at the requested horizon, before the goal",
    "unsafe": "the predicted path violates a constraint, or more flights than accepted do",
    "unreachable": "the best path found does not pass the goal within the tolerance",
    "failed": "no usable path was found",
}


def last_plan_html(contents: Contents, plan: LastPlan) -> str:
    """Return the outcome of the last plan as a table."""
    row = plan.row
    rows = [
        ["status", f"<strong>{escape(row['status'])}</strong>: {_STATUS.get(row['status'], '')}"],
        ["message", escape(row["message"])],
    ]
    if plan.energy is not None:
        stated = "" if plan.battery else "; the energy of the battery was not stated"
        rows.append(["energy", energy_sentence(plan.energy, plan.battery).html + stated])
    if plan.odds is not None:
        rows.append(["odds of arriving", _odds(plan.odds)])
    if plan.areas:
        rows.append(
            [
                "no-go areas",
                ", ".join(
                    escape(area.name + (" (surface only)" if area.surface_only else ""))
                    for area in plan.areas
                ),
            ]
        )
    if (named := contents.metadata.get("replay_kit.inputs", {}).get("bathymetry")) is not None:
        name, _, digest = named.partition(" sha256:")
        rows.append(["bathymetry", f"{escape(name)}, SHA-256 <code>{escape(digest)}</code>"])
    if (bottom := plan.bottom) is not None:
        height = float(np.nanmin(bottom - plan.track["depth"].to_numpy(np.float64)))
        rows.append(["least height above the bottom", f"{height:.0f} m"])
    return table_html(["what", "of the last plan"], rows, "The last plan")


def _odds(odds: Mapping[str, float]) -> str:
    more = sentence(
        "; {safe:share} violate no constraint; within {radius:,.0f} m",
        odds,
        "plan.odds.",
    )
    return odds_sentence(odds).html + more.html


_PLANS, _TITLE = 30, "How does the plan turn out?"


def plan_section(contents: Contents) -> Section:
    """Return the section on the last plan, earlier plans, and predicted surfacings."""
    plan = contents.last_plan
    if plan is None:
        note = (contents.outcome.plan or {}).get("message", "")
        why = (
            f"No plan was found: {note}"
            if note
            else "The result holds no plan: no goal was given, or none was due"
        )
        return Section(
            "plan",
            _TITLE,
            missing=[f"{why}; replay-kit plan makes one on this estimate."],
            menu="Plan",
            answer="There is none.",
        )
    figures = [profile_figure(contents, plan)] if len(plan.track) else []
    found = contents.outcome.surfacings
    if len(contents.result.surfacings):
        figures.append(surfacing_figure(contents))
    html = (
        last_plan_html(contents, plan)
        + _departures_html(contents)
        + _legs_html(plan)
        + _plans_html(contents)
        + ("" if found is None else f"<p>{outcomes_sentence(found).html}.</p>")
    )
    status = str(plan.row["status"])
    answer = f"{escape(status.capitalize())}: {_STATUS.get(status, '')}."
    return Section("plan", _TITLE, html, figures, menu="Plan", answer=answer)


def _legs_html(plan: LastPlan) -> str:
    """Return the legs of a plan as an HTML table."""
    forms = {
        **{"heading_deg": ".0f", "glide_angle_deg": ".1f", "depth_m": ".0f"},
        **{"surfacing_s": ".1f", "longitude": ".4f", "latitude": ".4f"},
    }
    rows = []
    for leg in plan.legs:
        row = [str(leg["leg"])]
        for name, form in forms.items():
            value = leg[name] / 3600.0 if name == "surfacing_s" else leg[name]
            row.append(leg_number(leg["leg"], name, leg[name], f"{value:{form}}"))
        rows.append(row)
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
    """Return the compared departures as an HTML table; empty for a single one."""
    rows = [json.loads(row) for row in contents.metadata.get("departures", {}).values()]
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
        "duration [h]",
        "energy [kJ]",
        "odds of arriving",
        "",
    ]
    return table_html(heads, cells, "Departures compared") if rows else ""


def _plans_html(contents: Contents) -> str:
    plans = contents.result.plans
    kept = thinned(len(plans), _PLANS)
    rows = []
    forms = {
        **{"heading_deg": ("heading_deg", 1.0, 0), "glide_angle_deg": ("glide_angle_deg", 1.0, 1)},
        **{
            "duration": ("duration_s", 3600.0, 1),
            "closest_approach": ("closest_approach_m", 1.0, 0),
        },
    }
    for row in kept.tolist():
        plan, cells = plans.iloc[row], list[str]()
        for name, (key, unit, digits) in forms.items():
            value, steers = float(plan[name]), name in ("heading_deg", "glide_angle_deg")
            known = np.isfinite(value) and not (steers and plan["status"] == "failed")
            text = fixed(value / unit, digits) if known else ""
            # the outcome has the last plan alone
            last = known and row == len(plans) - 1
            cells.append(number(f"plan.{key}", value, text) if last else text)
        head = str(plan.name)[:16], escape(plan["status"])
        rows.append([*head, *cells, escape(plan["message"])])
    thin = f"; {len(kept)} of {len(plans)}" if len(kept) < len(plans) else ""
    heads = [
        "begins (UTC)",
        "status",
        "heading [° true]",
        "glide angle [°]",
        "duration [h]",
        "misses the goal by [m]",
        "message",
    ]
    return table_html(heads, rows, f"All plans, oldest first{thin}")
