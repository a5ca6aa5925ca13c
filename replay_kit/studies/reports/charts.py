"""Series as charts of a page: one form for lines, points and distributions, in which colour is never the only difference."""

import math
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any

import numpy as np

from replay_kit.show.page import Figure
from replay_kit.show.page.section import column
from replay_kit.studies.reports.tables import Cell, grouped, to_text

# Okabe and Ito's colours, which colour-blind readers can tell apart too.
_COLOURS: tuple[Any, ...] = (
    "#0072B2",
    "#D55E00",
    "#009E73",
    {"$color": "ink"},
    "#CC79A7",
    "#E69F00",
    "#56B4E9",
    "#8C8C8C",
)
TRUTH, AVERAGED = "truth", "depth_averaged_truth"
#: Names of flows in tables and legends.
LABELS = {
    TRUTH: "truth",
    AVERAGED: "depth-averaged truth",
    "naive3d": "naive 3D basis",
    "paper": "2.5D paper, l = 10 km",
    "paper_cells": "2.5D paper, l = 1.16 cells",
    "default": "2.5D default",
    "nearest": "nearest member",
    "ensemble_mean": "ensemble mean",
}
_SYMBOLS = (
    "circle",
    "square",
    "diamond",
    "triangle-up",
    "x",
    "star",
    "triangle-down",
    "cross",
    "pentagon",
)
_DASHES = ("solid", "dash", "dot", "dashdot", "longdash")
# Characters of a line of a label beside an axis: half a phone's width would be too much.
_LABEL = 22
# Shorter miss distances [m] are drawn at this one.
_LEAST_MISS = 1.0


@dataclass(frozen=True, slots=True)
class Axis:
    """An axis of a chart.

    Attributes:
        title: What it shows, with its unit.
        log: Whether it is logarithmic; values that are not above 0 are then not drawn.
        labels: Names of the positions 0, 1, ..., which then stand beside the axis; empty for numbers.
    """

    title: str
    log: bool = False
    labels: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Series:
    """A series of a chart.

    Attributes:
        label: Its name.
        x: Values along the horizontal axis.
        y: As many along the vertical axis.
        mode: plotly's: ``lines+markers``; ``lines``, which are steps; ``markers``.
        symbol: plotly's; empty for the next of the chart's own.
    """

    label: str
    x: Sequence[float]
    y: Sequence[float]
    mode: str = "lines+markers"
    symbol: str = ""


@dataclass(frozen=True, slots=True)
class Chart:
    """Series over the same axes.

    Attributes:
        key: Unique in the page.
        title: What it shows.
        caption: What to see in it, plain text.
        axes: Horizontal and vertical.
        series: In the legend's order.
        level: A vertical coordinate to compare with, drawn as a line; None for none.
    """

    key: str
    title: str
    caption: str
    axes: tuple[Axis, Axis]
    series: tuple[Series, ...]
    level: float | None = None


def series_by(points: Iterable[tuple[str, float, float]]) -> tuple[Series, ...]:
    """Return a line for each label of points, which are label, x and y, in the order in which labels first come."""
    return tuple(
        Series(label, [x for _, x, _ in alike], [y for _, _, y in alike])
        for label, alike in grouped(points, lambda point: point[0]).items()
    )


def chart_figure(chart: Chart, known: Sequence[str] = ()) -> Figure:
    """Return a chart as a figure of a page, its data a table with a pair of columns for each series, filled up with nothing.

    Args:
        chart: The chart.
        known: Labels that have one colour, symbol and dash in all charts of the page.
    """
    columns: dict[str, list[float | None]] = {}
    traces = []
    for k, series in enumerate(chart.series):
        names = [f"{series.label}: {axis.title}" for axis in chart.axes]
        columns.update(zip(names, (column(series.x), column(series.y)), strict=True))
        number = known.index(series.label) if series.label in known else k
        traces.append(_trace(series, number, chart.axes))
    lines = zip_longest(*columns.values())
    filled = dict(zip(columns, map(list, zip(*lines, strict=True)), strict=True))
    horizontal, vertical = chart.axes
    layout: dict[str, Any] = {
        "height": 400 + 14 * len(chart.series),
        "xaxis": _axis(chart, 0),
        "yaxis": _axis(chart, 1),
    }
    if vertical.labels:
        rows = 46 * len(vertical.labels)
        # below the title of the axis, which lies as far below a low chart as below a high one
        legend = {"orientation": "h", "x": 0, "y": -75 / (rows + 40), "yanchor": "top"}
        layout |= {"height": 210 + rows, "legend": legend}
        layout["yaxis"]["autorange"] = "reversed"
    if chart.level is not None:
        line = {"color": {"$color": "soft"}, "dash": "dot", "width": 1.5}
        layout["shapes"] = [
            {
                "type": "line",
                "xref": "paper",
                "x0": 0,
                "x1": 1,
                "y0": chart.level,
                "y1": chart.level,
                "line": line,
            }
        ]
    words = (
        f"{chart.title}: {vertical.title} against {horizontal.title}. "
        f"{' '.join(_in_words(series, chart.axes) for series in chart.series)}"
    )
    return Figure(chart.key, chart.title, chart.caption, words, {"values": filled}, traces, layout)


def _trace(series: Series, number: int, axes: tuple[Axis, Axis]) -> dict[str, Any]:
    colour, label = _COLOURS[number % len(_COLOURS)], series.label
    return {
        "type": "scatter",
        "mode": series.mode,
        "name": label,
        "x": f"$values.{label}: {axes[0].title}",
        "y": f"$values.{label}: {axes[1].title}",
        "line": {
            "color": colour,
            "dash": _DASHES[number % len(_DASHES)],
            "width": 2,
            "shape": "hv" if series.mode == "lines" else "linear",
        },
        "marker": {
            "color": colour,
            "symbol": series.symbol or _SYMBOLS[number % len(_SYMBOLS)],
            "size": 8,
            "line": {"color": colour, "width": 2},
        },
    }


def _axis(chart: Chart, number: int) -> dict[str, Any]:
    """Return one of the two axes of a chart for plotly."""
    axis = chart.axes[number]
    if axis.labels:
        wrapped = ["<br>".join(textwrap.wrap(label, _LABEL)) for label in axis.labels]
        return {
            "tickmode": "array",
            "tickvals": list(range(len(wrapped))),
            "ticktext": wrapped,
            "zeroline": False,
        }
    out: dict[str, Any] = {"title": {"text": axis.title}}
    if axis.log:
        ticks = ticks_of(chart, number)
        out |= {
            "type": "log",
            "tickmode": "array",
            "tickvals": ticks,
            "ticktext": [f"{tick:.10g}" for tick in ticks],
        }
    return out


def ticks_of(chart: Chart, number: int) -> list[float]:
    """Return the ticks of a logarithmic axis of a chart: 0 the horizontal one, 1 the vertical one."""
    values = [
        value
        for series in chart.series
        for value in (series.x, series.y)[number]
        if 0.0 < value < math.inf
    ]
    return _log_ticks(min(values, default=1.0), max(values, default=1.0))


def _log_ticks(least: float, largest: float) -> list[float]:
    """Return round numbers around positive values, more of them where the values are alike."""
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


def _in_words(series: Series, axes: tuple[Axis, Axis]) -> str:
    """Return a series in words: of named positions each value, of others the first and the last."""
    known = [
        (x, y) for x, y in zip(series.x, series.y, strict=True) if np.isfinite(x) and np.isfinite(y)
    ]
    if not known:
        return f"{series.label}: no values."
    if axes[1].labels:
        by_name: Mapping[str, list[str]] = {axes[1].labels[int(y)]: [] for _, y in known}
        for x, y in known:
            by_name[axes[1].labels[int(y)]].append(to_text(float(x)))
        return f"{series.label}: {'; '.join(f'{name} {chr(44).join(values)}' for name, values in by_name.items())}."
    ends = [f"{to_text(float(y))} at {to_text(float(x))}" for x, y in (known[0], known[-1])]
    return f"{series.label}: {' to '.join(dict.fromkeys(ends))}."


def misses_chart(key: str, title: str, misses: Mapping[str, Sequence[Cell]]) -> Chart:
    """Return the distribution of miss distances, a line for each flow that was planned on.

    Args:
        key: Unique in the page.
        title: What it shows.
        misses: Of each plan [m], by the flow's label; those below 1 m are drawn at 1 m.
    """
    series = []
    for label, values in misses.items():
        ordered = np.sort(np.maximum(np.asarray(values, dtype=np.float64), _LEAST_MISS))
        shares = np.arange(ordered.size + 1) / ordered.size
        series.append(Series(label, [*ordered[:1], *ordered], shares.tolist(), "lines"))
    caption = (
        "Share of the plans whose miss distance in the truth is no larger. The farther up and left a line lies, the better the plans; "
        f"distances below {_LEAST_MISS:g} m are drawn at {_LEAST_MISS:g} m."
    )
    return Chart(
        key,
        title,
        caption,
        (Axis("miss distance in the truth [m]", log=True), Axis("share of the plans [1]")),
        tuple(series),
        0.5,
    )
