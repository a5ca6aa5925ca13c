"""Figures as values to figures of a page: plotly's traces and layouts on the columns that the page offers as CSV."""

import math
import textwrap
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.colors import LIGHT, scale
from replay_kit.show.figures.values import Axis, Chart, Mark, Panel, Tables, Values, values_of
from replay_kit.show.page.section import Figure, column, times

_MODES = {"points": "markers", "joined": "lines+markers"}
# Between panels, as a share of the height of a figure.
_GAP = 0.1
# Characters of a line of a name beside an axis: half a phone's width would be too much; and most names along one.
_NAME, _NAMES = 22, 40


def figure_of(chart: Chart) -> Figure:
    """Return a chart as a figure of a page."""
    marks = [mark for panel in chart.panels for mark in panel.marks]
    x_axis = _axis(chart.x, chart.tables, [mark.x for mark in marks])
    layout: dict[str, Any] = {"height": chart.height, "xaxis": x_axis, "shapes": []}
    traces, named = [], set[str]()
    room = (1.0 - _GAP * (len(chart.panels) - 1)) / sum(panel.share for panel in chart.panels)
    top = 1.0
    for number, panel in enumerate(chart.panels):
        axis = f"y{number + 1}" if number else "y"
        bottom = max(top - room * panel.share, 0.0)
        y_axis = _axis(panel.y, chart.tables, [mark.y for mark in panel.marks])
        layout[f"yaxis{axis[1:]}"] = {**y_axis, "domain": [bottom, top]}
        layout["xaxis"]["anchor"] = axis
        layout["shapes"] += _shapes(panel, axis)
        top = bottom - _GAP
        for mark in panel.marks:
            again = {"showlegend": False} if mark.name in named else {}
            traces += [{**trace, "yaxis": axis, **again} for trace in traces_of(mark)]
            named.add(mark.name)
    if chart.panels[0].y.labels:
        # below the title of the axis, which lies as far below a low chart as below a high one
        low = {"orientation": "h", "x": 0, "y": -75 / (chart.height - 170), "yanchor": "top"}
        layout["legend"] = low
    if chart.equal:
        layout["xaxis"]["constrain"] = layout["yaxis"]["constrain"] = "domain"
        layout["yaxis"] |= {"scaleanchor": "x", "scaleratio": chart.equal}
    return Figure(
        chart.key,
        chart.title,
        chart.caption,
        chart.alternative,
        tables_of(chart.tables),
        traces,
        layout,
    )


def tables_of(tables: Tables) -> dict[str, dict[str, Any]]:
    """Return tables as a page holds them; those of packed fields stay as they are."""
    return {
        key: dict(table)
        if "field" in table
        else {name: column_of(name, values) for name, values in table.items()}
        for key, table in tables.items()
    }


def column_of(name: str, values: Any) -> list[Any]:
    """Return a column for JSON: times to the second, degrees and kilometres to a metre or better, other numbers to five digits."""
    array = np.asarray(values)
    if array.dtype.kind == "M":
        return times(array.astype("datetime64[ns]").astype(np.int64))
    if array.dtype.kind != "f":
        return list((array.astype(int) if array.dtype.kind == "b" else array).tolist())
    return column(
        array, 9 if name.endswith(("longitude", "latitude")) else 6 if name.endswith("_km") else 5
    )


def traces_of(mark: Mark) -> list[dict[str, Any]]:
    """Return the traces of a mark: itself, and what lies below it."""
    color, x, y = color_of(mark.color), _values(mark.x), _values(mark.y)
    trace: dict[str, Any] = {
        "type": "bar" if mark.kind == "bars" else "scatter",
        "mode": _MODES.get(mark.kind, "lines"),
        **{"x": x, "y": y, "text": _values(mark.text), "customdata": _values(mark.detail)},
        **{"name": mark.name, "legendgroup": mark.name, "showlegend": bool(mark.name)},
        "hoverinfo": "skip" if mark.hover == "skip" else "all",
        "hovertemplate": mark.hover.removeprefix("skip"),
        "visible": True if mark.shown else "legendonly",
        "marker": {
            **{"color": color, "size": mark.size, "symbol": mark.symbol},
            "line": {"color": color_of(mark.edge or mark.color), "width": int(bool(mark.edge))},
            **_shaded(mark),
        },
        "line": {
            **{"color": color, "width": mark.width, "dash": mark.dash},
            "shape": "hvh" if mark.step else "linear",
        },
    }
    if mark.error is not None:
        trace["error_y"] = {"type": "data", "array": _values(mark.error), "thickness": 1}
    if mark.kind == "ring":
        trace |= {"fill": "toself", "fillcolor": f"{mark.color}2e"}
    below = {"type": "scatter", "mode": "lines", "x": x, "showlegend": False, "hoverinfo": "skip"}
    if mark.base is not None:
        trace |= {"fill": "tonexty", "fillcolor": {"$color": "land"}}
        return [{**below, "y": _values(mark.base), "line": {"width": 0}}, trace]
    if mark.halo:
        return [{**below, "y": y, "line": {"color": "#ffffff", "width": mark.width + 3.0}}, trace]
    return [trace]


def color_of(color: str) -> Any:
    """Return the colour of a role as the page's style has it; others as they are."""
    return {"$color": color} if color in LIGHT else color


def _shaded(mark: Mark) -> dict[str, Any]:
    if mark.shade is None:
        return {}
    name, colors, label = mark.shade
    bar = {"colorbar": {"title": {"text": label}}} if label else {}
    return {"color": f"${name}", "colorscale": scale(colors), "showscale": bool(label), **bar}


def _values(values: Values | None) -> Any:
    if values is None:
        return None
    return f"${values}" if isinstance(values, str) else column_of("_km", values)


def _axis(axis: Axis, tables: Tables, along: list[Values]) -> dict[str, Any]:
    """Return an axis along which marks have values, which a logarithmic one alone looks at."""
    text = f"{axis.label} [{axis.unit}]" if axis.unit else axis.label
    # names say what they are of
    out: dict[str, Any] = {} if axis.labels else {"title": {"text": text}}
    out |= {"rangemode": "tozero"} if axis.from_zero else {}
    out |= {} if axis.ends is None else {"range": list(axis.ends)}
    if axis.labels:
        named = range(0, len(axis.labels), 1 + len(axis.labels) // _NAMES)
        texts = ["<br>".join(textwrap.wrap(axis.labels[k], _NAME)) for k in named]
        out |= {"tickmode": "array", "tickvals": list(named), "ticktext": texts, "zeroline": False}
    elif axis.log:
        values = np.concatenate([values_of(tables, each) for each in along])
        ticks = log_ticks(values.astype(np.float64))
        texts = [f"{tick:.10g}" for tick in ticks]
        out |= {"type": "log", "tickmode": "array", "tickvals": ticks, "ticktext": texts}
    return out


def log_ticks(values: Array) -> list[float]:
    """Return round numbers around the positive ones of some values, more of them where the values are alike."""
    known = values[(values > 0.0) & np.isfinite(values)]
    least, largest = (float(known.min()), float(known.max())) if known.size else (1.0, 1.0)
    decades = range(math.floor(math.log10(least)) - 1, math.ceil(math.log10(largest)) + 2)
    digits = (
        (1.0,)
        if largest > 1e4 * least
        else (1.0, 2.0, 5.0)
        if largest > 4.0 * least
        else (1.0, 1.2, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0)
    )
    return [
        tick
        for decade in decades
        for digit in digits
        if least / 2.0 <= (tick := float(f"{digit}e{decade}")) <= 2.0 * largest
    ]


def _shapes(panel: Panel, axis: str) -> list[dict[str, Any]]:
    """Return the band and the level that the values of a panel are compared with."""
    out, across = [], {"xref": "paper", "x0": 0, "x1": 1, "yref": axis}
    if panel.band is not None:
        low, high, name = panel.band
        look = {"fillcolor": {"$color": "three"}, "opacity": 0.18, "line": {"width": 0}}
        legend = {"layer": "below", "name": name, "showlegend": True}
        out.append({**across, "type": "rect", "y0": low, "y1": high, **look, **legend})
    if panel.level is not None:
        line = {"color": {"$color": "soft"}, "width": 1, "dash": "dot"}
        out.append({**across, "type": "line", "y0": panel.level, "y1": panel.level, "line": line})
    return out
