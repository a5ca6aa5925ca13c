"""What a study says, for console, JSON and files, and the parts of its page: words, tables, charts, how to repeat the study."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.colors import LINES
from replay_kit.show.figures.on_page import figure_of
from replay_kit.show.figures.values import Axis, Chart, Mark, Panel
from replay_kit.show.page.page import page_html
from replay_kit.show.page.section import Figure, Section, items_html, table_html
from replay_kit.studies.reports.tables import (
    Cell,
    Table,
    grouped,
    json_text,
    plain,
    print_tables,
    to_text,
    write_files,
)

if TYPE_CHECKING:
    from rich.console import Console


PAGE = "index.html"


@dataclass(frozen=True, slots=True, eq=False)
class StudyReport:
    """What a study says so far.

    Attributes:
        name: Of its JSON file.
        answer: Its JSON object; undefined figures are null.
        tables: Printed, those that have rows.
        words: Printed below the tables.
        csv: The text of its tables by the name of the file.
        pages: Makes the other files by name; None while the study is unfinished.
        beside: What is in the folder beside the page, for the console; empty for what goes without saying.
    """

    name: str
    answer: Mapping[str, Any]
    tables: Sequence[Table]
    words: Sequence[str]
    csv: Mapping[str, str]
    pages: Callable[[], Mapping[str, str | bytes]] | None
    beside: str = ""

    def print(self, console: "Console") -> None:
        """Print it for people."""
        print_tables(console, self.tables)
        for text in self.words:
            console.print(text)

    def write(self, out: Path) -> None:
        """Write its files into a folder that exists, each whole or not at all; existing ones are replaced."""
        write_files(out, {**self.csv, f"{self.name}.json": json_text(self.answer)})
        write_files(out, self.pages() if self.pages else {})


def words_html(paragraphs: Sequence[str]) -> str:
    """Return paragraphs of Markdown that have `code` and *emphasis* at most as HTML."""
    return "".join(f"<p>{_marked(text)}</p>" for text in paragraphs)


def list_html(items: Sequence[str]) -> str:
    """Return such lines as a list."""
    return items_html([_marked(text) for text in items])


def _marked(text: str) -> str:
    coded = re.sub(r"`([^`]+)`", r"<code>\1</code>", escape(text, quote=False))
    return re.sub(r"\*([^*]+)\*", r"<em>\1</em>", coded)


def tables_html(tables: Sequence[Table]) -> str:
    """Return those tables that have rows as HTML."""
    return "".join(
        table_html(
            table.columns,
            [[_cell(to_text(cell)) for cell in row] for row in table.rows],
            table.title,
        )
        for table in tables
        if table.rows
    )


def _cell(text: str) -> str:
    # what is not met is what a reader looks for
    return f"<strong>{escape(text)}</strong>" if text == "NOT MET" else escape(text)


def study_page(title: str, sections: Sequence[Section], answer: Mapping[str, Any]) -> str:
    """Return the page of a study: its sections, then how to make it again.

    Args:
        title: Of the page.
        sections: From top to bottom.
        answer: Options, ``job`` and ``versions`` of the JSON object of ``--json``; what else it holds is not shown.
    """
    return page_html(title, [*sections, _again(answer)])


def _again(answer: Mapping[str, Any]) -> Section:
    job = answer.get("job", {})
    shown = {**{name: value for name, value in answer.items() if _is_setting(value)}, **job}
    options = [
        [escape(name.replace("_", " ")), escape(_option(value))]
        for name, value in plain(shown).items()
    ]
    versions = [[escape(name), escape(version)] for name, version in answer["versions"].items()]
    html = table_html(("what", "value"), options, "Inputs and options") + table_html(
        ("package", "version"), versions, "Versions"
    )
    return Section("again", "Make it again", html)


def _is_setting(value: Any) -> bool:
    return isinstance(value, str | int | float) or (
        isinstance(value, list) and len(value) > 0 and not isinstance(value[0], dict | list)
    )


def _option(value: Any) -> str:
    return (
        ", ".join(map(to_text, value))
        if isinstance(value, list)
        else "none"
        if value is None
        else to_text(value)
    )


_COLORS = (*LINES[:3], "ink", *LINES[3:], "#8C8C8C")
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
    if not panel.y.labels:
        return Chart(key, title, x, [panel], caption, height=400 + 14 * len(panel.marks))
    # the first name at the top
    y = replace(panel.y, ends=(len(panel.y.labels) - 0.5, -0.5))
    height = 210 + 46 * len(panel.y.labels)
    return Chart(key, title, x, [replace(panel, y=y)], caption, height=height)


def chart_figure(chart: Chart, known: Sequence[str] = ()) -> Figure:
    """Return a chart as a figure of a page, its data a table with a pair of columns for each mark, filled up with nothing.

    Args:
        chart: Of one panel, as of ``one_chart``.
        known: Names that have one colour, symbol and dash in all charts of the page.
    """
    (panel,), columns, marks = chart.panels, dict[str, Array](), list[Mark]()
    most = max((len(mark.x) for mark in panel.marks), default=0)
    for k, mark in enumerate(panel.marks):
        number = known.index(mark.name) if mark.name in known else k
        names = [f"{mark.name}: {axis.label}" for axis in (chart.x, panel.y)]
        for name, values in zip(names, (mark.x, mark.y), strict=True):
            columns[name] = np.pad(values, (0, most - len(values)), constant_values=np.nan)
        color = _COLORS[number % len(_COLORS)]
        symbol = _SYMBOLS[number % len(_SYMBOLS)] if mark.symbol == "circle" else mark.symbol
        marks.append(
            replace(
                mark,
                x=f"values.{names[0]}",
                y=f"values.{names[1]}",
                color=color,
                edge=color,
                symbol=symbol,
                size=8.0,
                dash=_DASHES[number % len(_DASHES)],
            )
        )
    words = (
        f"{chart.title}: {panel.y.label} against {chart.x.label}. "
        f"{' '.join(_in_words(mark, panel.y.labels) for mark in panel.marks)}"
    )
    tables = {"values": columns}
    whole = replace(chart, panels=[replace(panel, marks=marks)], alternative=words, tables=tables)
    return figure_of(whole)


def _in_words(mark: Mark, labels: Sequence[str]) -> str:
    """Return a mark in words: at named positions each value, of others the first and the last."""
    known = [(x, y) for x, y in zip(mark.x, mark.y, strict=True) if np.isfinite(x + y)]
    if not known:
        return f"{mark.name}: no values."
    if labels:
        by_name = grouped(known, lambda point: labels[int(point[1])])
        texts = [
            f"{name} {','.join(to_text(float(x)) for x, _ in alike)}"
            for name, alike in by_name.items()
        ]
        return f"{mark.name}: {'; '.join(texts)}."
    ends = [f"{to_text(float(y))} at {to_text(float(x))}" for x, y in (known[0], known[-1])]
    return f"{mark.name}: {' to '.join(dict.fromkeys(ends))}."


def misses_chart(key: str, title: str, misses: Mapping[str, Sequence[Cell]]) -> Chart:
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
