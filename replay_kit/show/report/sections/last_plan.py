"""The last plan: its outcome, energy and odds in words."""

from html import escape

import numpy as np

from replay_kit.results.views.contents import Contents
from replay_kit.results.views.last_plan import LastPlan
from replay_kit.show.page.section import number, table_html

_STATUS = {
    "reached": "the predicted path passes the goal within the tolerance",
    "uncertain": "the predicted path passes the goal, but fewer samples of the estimate than asked for arrive",
    "partial": "the predicted path ends at the horizon that was asked for, before the goal",
    "unsafe": "the predicted path, or more samples of the estimate than accepted, violates a constraint",
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
    rows += [["energy", _energy(plan.energy, plan.battery)]] if plan.energy is not None else []
    rows += [["odds of arriving", odds]] if (odds := _odds(plan)) else []
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
    if (
        named := contents.record.metadata.get("replay_kit.inputs", {}).get("bathymetry")
    ) is not None:
        name, _, digest = named.partition(" sha256:")
        rows.append(["bathymetry", f"{escape(name)}, SHA-256 <code>{escape(digest)}</code>"])
    if (bottom := plan.bottom) is not None:
        height = float(np.nanmin(bottom - plan.track["depth"].to_numpy(np.float64)))
        rows.append(["least height above the bottom", f"{height:.0f} m"])
    return table_html(["what", "of the last plan"], rows, "The last plan")


def _energy(energy: float, battery: float | None) -> str:
    text = number("plan.energy_j", energy, f"{energy / 1e3:,.0f} kJ")
    if battery is None:
        return f"{text}; the energy of the battery was not stated"
    stated = number("plan.battery_j", battery, f"{battery / 1e6:g} MJ")
    return f"{text}, {100.0 * energy / battery:.1f} % of {stated}" + (
        ": more than the battery holds" if energy > battery else ""
    )


def _odds(plan: LastPlan) -> str:
    odds = plan.odds
    if odds is None:
        return ""
    said = {
        name: number(f"plan.odds.{name}", odds[name], f"{100.0 * odds[name]:.0f} %")
        for name in ("reached", "reached_held", "safe")
    }
    count = number("plan.odds.n_samples", odds["n_samples"], f"{odds['n_samples']:.0f}")
    median, most = (
        number(f"plan.odds.{name}", odds[name], f"{odds[name]:,.0f} m")
        for name in ("miss_median", "miss_90_percent")
    )
    return (
        f"{said['reached']} of {count} samples of the estimate arrive with headings corrected at each surfacing, "
        f"{said['reached_held']} with headings held; "
        f"{said['safe']} violate no constraint; they end {median} off in the median, 90 % within {most}"
    )


def what_is_missing(plan: LastPlan) -> list[str]:
    """Return what the result does not hold of its last plan, and what would give it."""
    out = []
    if plan.energy is None:
        out.append(
            "The result holds no energy of the plan: a single glide has none, a mission (--planner mission) has."
        )
    if plan.odds is None and plan.row["status"] != "failed":
        out.append(
            "The result holds no odds of arriving: [planner] samples = 40 flies each mission through as many samples of the estimate."
        )
    if plan.bottom is None:
        out.append(
            "The result holds no depth of the bottom: --bathymetry keeps plans above it and shows it here."
        )
    return out
