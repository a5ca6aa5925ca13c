"""Adaptive sampling: the value of the next profile by its place, the error before and after, the candidates."""

import json
from collections.abc import Mapping
from html import escape
from math import cos, radians
from typing import Any

import numpy as np

from replay_kit.core.colors import ON_FIELD
from replay_kit.results.views.contents import Contents
from replay_kit.show.figures.values import Axis, Chart, Mark, Panel
from replay_kit.show.page.section import table_html

_PLACE = ("longitude", "latitude")


def learning_html(contents: Contents) -> str:
    """Return the predicted error before and after the plan, and the candidates; nothing for other plans."""
    record = _record(contents)
    if not record:
        return ""
    heads, rows = candidate_table(record)
    cells = [[escape(row[0]), *row[1:]] for row in rows]
    return _before_and_after(record) + table_html(
        heads, cells, "Candidates, in currents drawn from the estimate"
    )


def candidate_table(record: Mapping[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Return the headings and the rows of the candidates that were compared, as the page and ``plan`` show them.

    Args:
        record: ``unit``, ``found`` and ``candidates`` of a plan that learns.
    """
    unit = record["unit"]
    heads = [
        "candidate",
        f"predicted error [{unit}]",
        f"{record['found']} in samples [{unit}]",
        "interval of 90 %",
        "within the tolerance",
        "",
    ]
    return heads, [_cells(row) for row in record["candidates"]]


def _before_and_after(record: Mapping[str, Any]) -> str:
    before, after, unit = record["error_before"], record["error_after"], record["unit"]
    what = (
        "the current in the box, a component"
        if record["objective"] == "map"
        else "the position at the end of the dead-reckoned leg"
    )
    return (
        f"<p>Predicted error of {what} (root mean square): {_number(before)} {unit} before the "
        f"profiles, {_number(after)} {unit} after.</p>"
    )


def _cells(row: Mapping[str, Any]) -> list[str]:
    interval = "" if row["low"] is None else f"{_number(row['low'])} to {_number(row['high'])}"
    within = "" if row["within"] is None else f"{100.0 * row['within']:.0f} %"
    return [
        row["name"],
        _number(row["predicted"]),
        _number(row["found"]),
        interval,
        within,
        "planned" if row["chosen"] else "",
    ]


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:,.0f}" if abs(value) >= 100.0 else f"{value:.3g}"


def _record(contents: Contents) -> dict[str, Any]:
    """Return what the result holds of adaptive sampling; empty for other plans."""
    return {
        name: json.loads(text)
        for name, text in contents.record.metadata.get("learning", {}).items()
    }


def value_chart(contents: Contents) -> Chart | None:
    """Return the map of the value of the next profile; None for other plans."""
    record = _record(contents)
    if not record or not record["value"]["value"]:
        return None
    value, unit = record["value"], record["value"]["unit"]
    legs = [
        json.loads(text)
        for _, text in sorted(contents.record.metadata["legs"].items(), key=lambda one: int(one[0]))
    ]
    fixes = [leg for leg in legs if not leg["blind"]]
    blind = ([fixes[-1]] if fixes else []) + [leg for leg in legs if leg["blind"]]
    start = record["start"]
    data: dict[str, Any] = {"value": {name: np.array(value[name]) for name in (*_PLACE, "value")}}
    field = Mark(
        "points",
        "value.longitude",
        "value.latitude",
        symbol="square",
        size=11.0,
        shade=("value.value", "amp", f"[{unit}]"),
        hover=f"%{{x:.3f}}, %{{y:.3f}}: %{{text:.3g}} {unit}<extra></extra>",
        text="value.value",
    )
    marks = [field]
    lines = {"surfacings": [dict(zip(_PLACE, start, strict=False)), *fixes], "dead-reckoned": blind}
    for (name, places), dash in zip(lines.items(), ("solid", "dot"), strict=True):
        if len(places) > 1:
            table = name.replace("-", "_")
            data[table] = {axis: np.array([place[axis] for place in places]) for axis in _PLACE}
            marks.append(_way(table, name, dash))
    panel = Panel("value", Axis("latitude", "° north"), marks)
    return Chart(
        "next-profile",
        "Value of the next profile",
        Axis("longitude", "° east"),
        [panel],
        f"Reduction of the predicted error [{unit}] by one more profile, against its place, taken half way through the plan. The line "
        "joins the surfacings; where it is dotted the vehicle is dead-reckoned.",
        f"Map of the value of one profile in {unit}, with the plan's surfacings.",
        data,
        520,
        1.0 / max(cos(radians(start[1])), 0.1),
    )


def _way(table: str, name: str, dash: str) -> Mark:
    """Return a line over a light one, to be seen on both ends of the colour scale."""
    look: Any = {"color": ON_FIELD, "dash": dash, "width": 1.8, "edge": "#ffffff", "halo": True}
    hover = f"{name}: %{{x:.4f}}, %{{y:.4f}}<extra></extra>"
    return Mark("joined", f"{table}.longitude", f"{table}.latitude", name, hover=hover, **look)
