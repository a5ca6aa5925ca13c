"""The charts of the page: the error against the number of pings, and the miss distances of the glides."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.colors import LINES
from replay_kit.show.figures.on_page import figure_of
from replay_kit.show.figures.values import Axis, Chart, Mark, Panel
from replay_kit.show.page.section import Figure
from replay_kit.studies.paper.text import grouped, to_text

_COLORS = (*LINES[:3], "ink", *LINES[3:], "#8C8C8C")
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
# Shorter miss distances [m] are drawn at this one.
_LEAST_MISS = 1.0


def lines_by(points: Iterable[tuple[str, float, float]]) -> list[Mark]:
    """Return a line for each label of points, which are label, x and y, in the order in which labels first come."""
    each = grouped(points, lambda point: point[0]).items()
    values = [
        (label, np.array([point[1:] for point in alike], np.float64)) for label, alike in each
    ]
    return [Mark("joined", at[:, 0], at[:, 1], label) for label, at in values]


def one_chart(key: str, title: str, caption: str, x: Axis, panel: Panel) -> Chart:
    """Return a chart of one panel.

    Args:
        key: Unique in the page.
        title: What it shows.
        caption: What to see in it, as HTML.
        x: The horizontal axis.
        panel: The panel; its marks have values of their own, and names.
    """
    return Chart(key, title, x, [panel], caption, height=400 + 14 * len(panel.marks))


def chart_figure(chart: Chart) -> Figure:
    """Return a chart as a figure of a page, its data a table with a pair of columns for each mark, filled up with nothing.

    Args:
        chart: Of one panel, as of ``one_chart``.
    """
    (panel,), columns, marks = chart.panels, dict[str, Array](), list[Mark]()
    most = max((len(mark.x) for mark in panel.marks), default=0)
    for number, mark in enumerate(panel.marks):
        names = [f"{mark.name}: {axis.label}" for axis in (chart.x, panel.y)]
        for name, values in zip(names, (mark.x, mark.y), strict=True):
            columns[name] = np.pad(values, (0, most - len(values)), constant_values=np.nan)
        color = _COLORS[number % len(_COLORS)]
        marks.append(
            replace(
                mark,
                x=f"values.{names[0]}",
                y=f"values.{names[1]}",
                color=color,
                edge=color,
                symbol=_SYMBOLS[number % len(_SYMBOLS)],
                size=8.0,
                dash=_DASHES[number % len(_DASHES)],
            )
        )
    words = (
        f"{chart.title}: {panel.y.label} against {chart.x.label}. "
        f"{' '.join(map(_in_words, panel.marks))}"
    )
    tables = {"values": columns}
    whole = replace(chart, panels=[replace(panel, marks=marks)], alternative=words, tables=tables)
    return figure_of(whole)


def _in_words(mark: Mark) -> str:
    """Return the first and the last value of a mark in words."""
    known = [(x, y) for x, y in zip(mark.x, mark.y, strict=True) if np.isfinite(x + y)]
    if not known:
        return f"{mark.name}: no values."
    ends = [f"{to_text(float(y))} at {to_text(float(x))}" for x, y in (known[0], known[-1])]
    return f"{mark.name}: {' to '.join(dict.fromkeys(ends))}."


def misses_chart(key: str, title: str, misses: Mapping[str, Sequence[float]]) -> Chart:
    """Return the distribution of miss distances, a line for each flow that was planned on.

    Args:
        key: Unique in the page.
        title: What it shows.
        misses: Of each plan [m], by the flow's label; those below 1 m are drawn at 1 m.
    """
    marks = []
    for label, values in misses.items():
        ordered = np.sort(np.maximum(np.asarray(values, dtype=np.float64), _LEAST_MISS))
        # a step at each: the share rises where a plan misses by so much
        shares = np.repeat(np.arange(ordered.size + 1) / ordered.size, 2)[1:-1]
        marks.append(Mark("line", np.repeat(ordered, 2), shares, label))
    caption = (
        "Share of the plans whose miss distance in the truth is no larger. The farther up and left a line lies, the better the plans; "
        f"distances below {_LEAST_MISS:g} m are drawn at {_LEAST_MISS:g} m."
    )
    y = Axis("share of the plans [1]")
    x = Axis("miss distance in the truth [m]", log=True)
    return one_chart(key, title, caption, x, Panel(title, y, marks, level=0.5))
