"""A plan that learns: what the next profile is worth by its place, the error before and after, the candidates."""

import json
from collections.abc import Mapping
from html import escape
from math import cos, radians
from typing import Any

from replay_kit.results.views.contents import Contents
from replay_kit.show.colors import scale
from replay_kit.show.page.section import Figure, column, table_html


def learning_html(contents: Contents) -> str:
    """Return the predicted error before and after the plan, and the candidates; nothing for a plan that does not learn."""
    record = _record(contents)
    if not record:
        return ""
    unit = record["unit"]
    rows = [_cells(row) for row in record["candidates"]]
    heads = [
        "candidate",
        f"predicted error [{unit}]",
        f"{record['found']} in samples [{unit}]",
        "interval of 90 %",
        "within the tolerance",
        "",
    ]
    return _before_and_after(record) + table_html(
        heads, rows, "Candidates, in currents drawn from the estimate"
    )


def _before_and_after(record: Mapping[str, Any]) -> str:
    before, after, unit = record["error_before"], record["error_after"], record["unit"]
    what = (
        "the current in the box, a component"
        if record["objective"] == "map"
        else "where the stretch without fixes ends"
    )
    return (
        f"<p>Predicted error of {what} (root mean square): {_number(before)} {unit} before the "
        f"profiles, {_number(after)} {unit} after.</p>"
    )


def _cells(row: Mapping[str, Any]) -> list[str]:
    interval = "" if row["low"] is None else f"{_number(row['low'])} to {_number(row['high'])}"
    within = "" if row["within"] is None else f"{100.0 * row['within']:.0f} %"
    return [
        escape(row["name"]),
        _number(row["predicted"]),
        _number(row["found"]),
        interval,
        within,
        "planned" if row["chosen"] else "",
    ]


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:,.0f}" if abs(value) >= 100.0 else f"{value:.3g}"


def _record(contents: Contents) -> dict[str, Any]:
    """Return what the result says of a plan that learns; empty for others."""
    return {
        name: json.loads(text)
        for name, text in contents.record.metadata.get("learning", {}).items()
    }


def value_figure(contents: Contents) -> Figure | None:
    """Return the map of what the next profile is worth; None for a plan that does not learn."""
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
    data = {
        "value": {
            "longitude": column(value["longitude"]),
            "latitude": column(value["latitude"]),
            "value": column(value["value"]),
        },
        "surfacings": _line([{"longitude": start[0], "latitude": start[1]}, *fixes]),
    }
    traces: list[dict[str, Any]] = [_field(unit), *_trace("surfacings", "surfacings", "solid")]
    if len(blind) > 1:
        data["without_fixes"] = _line(blind)
        traces += _trace("without_fixes", "without fixes", "dot")
    layout = {
        "height": 520,
        "xaxis": {"title": {"text": "longitude [° east]"}, "constrain": "domain"},
        "yaxis": {
            "title": {"text": "latitude [° north]"},
            "scaleanchor": "x",
            "scaleratio": 1.0 / max(_narrowed(start[1]), 0.1),
        },
        "legend": {"orientation": "h", "y": 1.08},
    }
    caption = (
        f"By how much one more profile reduces the predicted error [{unit}], by its place, taken half way through the plan. The line joins "
        "its surfacings; where it is dotted the vehicle has no fixes."
    )
    return Figure(
        "next-profile",
        "Value of the next profile",
        caption,
        f"Map of what one profile is worth in {unit}, with the plan's surfacings.",
        data,
        traces,
        layout,
    )


def _field(unit: str) -> dict[str, Any]:
    return {
        "type": "scatter",
        "mode": "markers",
        "x": "$value.longitude",
        "y": "$value.latitude",
        "showlegend": False,
        "marker": {
            "size": 11,
            "symbol": "square",
            "color": "$value.value",
            "colorscale": scale("amp"),
            "showscale": True,
            "colorbar": {"title": {"text": f"[{unit}]"}},
        },
        "text": "$value.value",
        "hovertemplate": f"%{{x:.3f}}, %{{y:.3f}}: %{{text:.3g}} {unit}<extra></extra>",
    }


def _trace(table: str, name: str, dash: str) -> list[dict[str, Any]]:
    """Return a line over a light one, to be seen on both ends of the colour scale."""
    where = {"type": "scatter", "x": f"${table}.longitude", "y": f"${table}.latitude"}
    halo = {
        **where,
        "mode": "lines",
        "line": {"color": "#ffffff", "width": 5},
        "showlegend": False,
        "hoverinfo": "skip",
    }
    line = {
        **where,
        "mode": "lines+markers",
        "name": name,
        "line": {"color": "#1b2733", "width": 1.8, "dash": dash},
        "marker": {"size": 6, "color": "#1b2733", "line": {"color": "#ffffff", "width": 1}},
        "hovertemplate": f"{name}: %{{x:.4f}}, %{{y:.4f}}<extra></extra>",
    }
    return [halo, line]


def _line(places: list[dict[str, Any]]) -> dict[str, Any]:
    return {name: column([place[name] for place in places]) for name in ("longitude", "latitude")}


def _narrowed(latitude: float) -> float:
    """Return the length of a degree of longitude over that of latitude."""
    return cos(radians(latitude))
