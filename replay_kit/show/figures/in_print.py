"""Figures as values drawn with matplotlib into axes of a figure for a paper."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import (
    DAILY,
    HOURLY,
    MINUTELY,
    MONTHLY,
    SECONDLY,
    AutoDateLocator,
    ConciseDateFormatter,
)

from replay_kit.core.arrays import Array
from replay_kit.core.colors import PRINT
from replay_kit.show.figures.values import Axis, Chart, Mark, Panel, Tables, values_of

#: Where a point of a map lies in its axes: of east and north [km].
Place = Callable[[Array, Array], tuple[Array, Array]]
# Points of a printed figure for a pixel of a page, of the width of lines and of the size of marks.
_WIDTH, _SIZE = 0.55, 0.45
_SYMBOLS = {"diamond": "D", "square": "s", "triangle-up": "^", "x": "x", "cross": "+", "star": "*"}
_DASHES = {"solid": "-", "dash": "--", "dot": ":", "dashdot": "-."}
# Labels of an axis of time in a figure of two panels beside each other.
_TIMES = 7


def drawing_of(chart: Chart, number: int, most: int = _TIMES) -> Callable[[Axes], None]:
    """Return what draws a panel of a chart into axes.

    Args:
        chart: The chart.
        number: Of the panel, from 0.
        most: Labels of an axis of time that fit.
    """
    return partial(_draw_panel, chart, chart.panels[number], most)


def draw_mark(axes: Axes, mark: Mark, tables: Tables, place: Place | None = None) -> None:
    """Draw a mark into axes.

    Args:
        axes: The axes.
        mark: The mark; nothing is drawn of one that is not shown at first.
        tables: The columns.
        place: Where the points of a map lie; None for charts.
    """
    if not mark.shown:
        return
    x, y = (values_of(tables, values) for values in (mark.x, mark.y))
    x, y = (x, y) if place is None else place(x, y)
    color, width = color_of(mark.color), _WIDTH * mark.width
    if mark.halo:
        axes.plot(x, y, color="white", linewidth=width + 1.1, solid_capstyle="round")
    if mark.kind == "bars":
        wide = float(np.diff(x).min())
        axes.bar(x, y, wide, color=color, alpha=0.6, label=mark.name)
        return
    if mark.kind == "ring":
        _draw_rings(axes, x, y, color)
    # the ground below a line, or a band without one
    on_land = mark.kind == "line"
    if mark.base is not None:
        fill: Any = {"color": PRINT["land"]} if on_land else {"color": color, "alpha": 0.22}
        fill["label"] = None if on_land else mark.name
        axes.fill_between(x, y, values_of(tables, mark.base), linewidth=0.0, **fill)
    if mark.kind == "area":
        return
    dots = mark.kind in ("points", "joined")
    look: Any = {
        **{"color": color, "linewidth": width, "label": mark.name or None},
        "linestyle": "none" if mark.kind == "points" else _DASHES[mark.dash],
        "drawstyle": "steps-mid" if mark.step else "default",
        "marker": _SYMBOLS.get(mark.symbol, "o") if dots else None,
        "markersize": _SIZE * mark.size,
        "markerfacecolor": "none" if mark.symbol.endswith("-open") else color,
    }
    look |= {"markeredgecolor": color_of(mark.edge), "markeredgewidth": 0.6} if mark.edge else {}
    look |= {"alpha": 0.45} if mark.kind == "ring" else {}
    if mark.symbol == "cross":
        # a cross of lines on a light one is seen on any field and hides little
        axes.plot(x, y, "+", color="white", markersize=_SIZE * mark.size, markeredgewidth=2.2)
        look |= {"markeredgewidth": 1.2}
    if mark.error is None:
        axes.plot(x, y, **look)
    else:
        axes.errorbar(x, y, values_of(tables, mark.error), elinewidth=0.6, **look)


def _draw_rings(axes: Axes, x: Array, y: Array, color: str) -> None:
    """Fill closed lines with gaps between them."""
    for ring in np.split(np.column_stack([x, y]), np.flatnonzero(np.isnan(x))):
        known = ring[np.isfinite(ring[:, 0])]
        axes.fill(known[:, 0], known[:, 1], facecolor=color_of(color), alpha=0.06, zorder=2.5)


def color_of(color: str) -> str:
    """Return the printed colour of a role; others as they are."""
    return PRINT.get(color, color)


def _draw_panel(chart: Chart, panel: Panel, most: int, axes: Axes) -> None:
    if panel.level is not None:
        axes.axhline(panel.level, color=PRINT["soft"], linewidth=0.5)
    if panel.band is not None:
        low, high, name = panel.band
        axes.axhspan(low, high, color=PRINT["three"], alpha=0.2, linewidth=0.0, label=name)
    for mark in panel.marks:
        draw_mark(axes, mark, chart.tables)
    axes.set(xlabel=_text(chart.x), ylabel=_text(panel.y), xlim=chart.x.ends, ylim=panel.y.ends)
    if panel.y.from_zero:
        axes.set_ylim(0.0, None)
    if panel.note:
        axes.text(0.02, 0.97, panel.note, transform=axes.transAxes, va="top", fontsize=6.0)
    if values_of(chart.tables, panel.marks[0].x).dtype.kind == "M":
        date_axis(axes, most)
    if chart.equal:
        axes.set_box_aspect(1.0)


def _text(axis: Axis) -> str:
    unit = "m s$^{-1}$" if axis.unit == "m/s" else axis.unit
    return f"{axis.label} [{unit}]" if unit else axis.label


def date_axis(axes: Axes, most: int = _TIMES) -> None:
    """Give an axis of time few labels, with the year beside them.

    Args:
        axes: The axes.
        most: Number of labels that fit.
    """
    locator: Any = AutoDateLocator(minticks=2, maxticks=most)  # type: ignore[no-untyped-call]  # matplotlib has no types of dates
    # with few labels, spans between two and four days, hours and so on would else have no step
    for unit, whole in ((SECONDLY, 60), (MINUTELY, 60), (HOURLY, 24), (MONTHLY, 12)):
        locator.intervald[unit] = [*locator.intervald[unit], whole]
    locator.intervald[DAILY] = [1, 2, 3, 4, 5, 7, 14, 21]
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
    # beside the date at the right end the middle of narrow axes has no room
    axes.set_xlabel("time (UTC)", loc="left" if most < _TIMES else "center")
