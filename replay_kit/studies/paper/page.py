"""The paper's study on the console, as CSV, JSON and Markdown, and as a page with charts."""

import json
import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any, Literal

import numpy as np
from pydantic_core import to_jsonable_python

from replay_kit.core.arrays import Array
from replay_kit.core.words.colors import LINES
from replay_kit.core.words.text import csv_text
from replay_kit.show.figures.figure import Axis, Figure, Mark, Panel
from replay_kit.show.page.page import Section, page_html, table_html
from replay_kit.studies.paper.methods import LABELS
from replay_kit.studies.paper.run import ErrorRow, PaperTables
from replay_kit.workflows.replay.inputs.provenance import package_versions

PAGE = "index.html"
_TABLES = ("table1", "table2", "table3", "sparse")
FILES = (*(f"{name}.csv" for name in _TABLES), "paper.json", "report.md", PAGE)
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
_RUNGS = {"full": " (full rank)", "members": " (one a member)"}

#: Title, and rows of cells by column name.
TextTable = tuple[str, Sequence[Mapping[str, str]]]


def to_json(tables: PaperTables) -> dict[str, Any]:
    """Return the JSON object of ``paper.json`` and ``--json``; undefined figures are null."""
    answer = to_jsonable_python(tables, inf_nan_mode="null")
    if not tables.unfinished:
        del answer["unfinished"]
    return {**answer, "versions": package_versions()}


def files_of(tables: PaperTables) -> dict[str, str]:
    """Return the files of the study so far by name, with report and page once finished."""
    answer = to_json(tables)
    files = {f"{name}.csv": csv_text(rows, rows[0]) for name in _TABLES if (rows := answer[name])}
    files["paper.json"] = json.dumps(answer, indent=1, allow_nan=False) + "\n"
    if not tables.unfinished:
        files |= {"report.md": to_markdown(tables), PAGE: paper_page(tables)}
    return files


def to_markdown(tables: PaperTables) -> str:
    """Return the study as Markdown: conditions and tables."""
    parts = ["# The paper's study on this ensemble", conditions(tables)]
    for title, rows in text_tables(tables):
        lines = [rows[0], ["---"] * len(rows[0]), *(row.values() for row in rows)]
        parts += [f"**{title}**", "\n".join("| " + " | ".join(cells) + " |" for cells in lines)]
    return "\n\n".join(parts) + "\n"


def conditions(tables: PaperTables) -> str:
    """Return the conditions of the study as text."""
    rows, columns = tables.grid
    levels = ", ".join(f"{level:.4g}" for level in tables.levels)
    turns = f"Each of the {tables.truths} members is the truth in turn in Tables I and II: medians, and the worst truth. "
    modes = "all modes" if tables.plan_modes is None else f"at most {tables.plan_modes} modes"
    return (
        f"{tables.members} members of {tables.ensemble} on {rows} x {columns} points and levels {levels} m; truth {tables.truth}; seed "
        f"{tables.seed}. {turns if tables.truths > 1 else ''}Table III shows truth {tables.shown_truth}; plans are made "
        f"on the estimates after Table II's last ping, with {modes}. Relative error: RMSE over the RMS speed of the truth, over all "
        "wet grid points. Bound: the least-squares fit of the truth within a method's span. Elements in H: two for each mode and node, of "
        "whole flows for each level too, of the default one for each mode and point of its lattice. The paper and the naive basis take "
        "R = (0.01 m/s)^2 in Table I and (0.12 m/s)^2 in Table II for every bin; the default takes the bins' own error, 0.01 and "
        f"{tables.noise:g} m/s, and adds what its basis leaves of members that are shifted by a correlation length, at the profile's place."
    )


def text_tables(tables: PaperTables) -> list[TextTable]:
    """Return all tables of a study for display."""
    over = f"; medians over {tables.truths} truths" if tables.truths > 1 else ""
    by_pings: dict[int, dict[str, str]] = {}
    for row in tables.sparse:
        label = LABELS[row.method] + ("" if row.modes is None else f", {row.modes} modes")
        cells = by_pings.setdefault(row.pings, {"pings": str(row.pings)})
        cells[label] = number(row.rel_error)
    glides = [
        {
            "planned on": LABELS[row.flow],
            # the paper's column of digits ends at the metre, and plans on the truth itself pass closer than that
            "median [m]": number(row.median, 0 if row.median >= 10.0 else 2),
            "quartiles [m]": f"{number(row.lower_quartile, 0)} to {number(row.upper_quartile, 0)}",
            "90 % interval of the median [m]": f"{number(row.median_low, 0)} to {number(row.median_high, 0)}",
            "within 250 m": row.note or f"{row.within_250} of {row.pairs}",
            "time [s]": number(row.seconds, 1),
        }
        for row in tables.table3
    ]
    pings, depth = tables.sparse[-1].pings, f"{tables.target_depth:g} m"
    return [
        (
            f"Table I: each grid point measured once, no noise, R = (0.01 m/s)^2{over}",
            _error_cells(tables.table1),
        ),
        (
            f"Table II: {pings} random pings of 22 bins, noise {tables.noise:g} m/s{over}",
            _error_cells(tables.table2),
        ),
        (f"Relative error on the way through the pings of Table II{over}", list(by_pings.values())),
        (
            f"Table III: closest approach to a target at {depth}, planned on each flow, flown in the truth",
            glides,
        ),
    ]


def _error_cells(rows: Sequence[ErrorRow]) -> list[dict[str, str]]:
    several = len(rows[0].rel_error_by_truth) > 1
    noted = any(row.note for row in rows)
    return [
        {
            "estimator": LABELS[row.method],
            "modes": number(row.modes, 0) + _RUNGS.get(row.rung, "") * (row.modes is not None),
            "elements in H": number(row.elements, 0),
            "rel. error": number(row.rel_error),
            "RMSE [m/s]": number(row.rmse, 4),
            "bound [m/s]": number(row.bound, 4),
            **({"worst rel. error": number(row.rel_error_worst)} if several else {}),
            **({"worst RMSE [m/s]": number(row.rmse_worst, 4)} if several else {}),
            "time [s]": number(row.seconds, 1),
            **({"note": row.note} if noted else {}),
        }
        for row in rows
    ]


def number(value: float | None, digits: int = 3) -> str:
    """Return a number with fixed decimals; a dash if undefined or infinite."""
    return f"{value:.{digits}f}" if value is not None and math.isfinite(value) else "-"


def paper_page(tables: PaperTables) -> str:
    """Return the page of the finished study."""
    table1, table2, sparse, table3 = (
        table_html(list(rows[0]), [[escape(cell) for cell in row.values()] for row in rows], title)
        for title, rows in text_tables(tables)
    )
    errors: dict[str, list[tuple[float, float]]] = {}
    for row in tables.sparse:
        errors.setdefault(LABELS[row.method], []).append((row.pings, row.rel_error))
    few = _figure(
        "sparse",
        "Relative error against the number of pings",
        "Error on the way through the pings of Table II. Lower is better; at 1 (dotted) an estimate is no better than no current at all.",
        (Axis("pings", log=True), Axis("RMSE / RMS speed of the truth [1]", log=True)),
        ("joined", {label: np.array(points).T for label, points in errors.items()}, 1.0),
    )
    shares = {}
    for glide in tables.table3:
        if misses := glide.closest_approach:
            # a step at each: the share rises where a plan misses by so much
            share = np.repeat(np.arange(len(misses) + 1) / len(misses), 2)[1:-1]
            ordered = np.sort(np.maximum(misses, _LEAST_MISS))
            shares[LABELS[glide.flow]] = np.stack([np.repeat(ordered, 2), share])
    glides = _figure(
        "glides",
        "Closest approach of the glides to their targets",
        "Share of the plans whose miss distance in the truth is no larger. The farther up and left a line lies, the better the plans; "
        f"distances below {_LEAST_MISS:g} m are drawn at {_LEAST_MISS:g} m.",
        (Axis("miss distance in the truth [m]", log=True), Axis("share of the plans [1]")),
        ("line", shares, 0.5),
    )
    sections = [
        Section("errors", "Errors", f"<p>{escape(conditions(tables))}</p>{table1}{table2}"),
        Section("few", "Sparse logs", sparse, [few]),
        Section("plans", "Glides", table3, [glides]),
    ]
    return page_html("The paper's study on this ensemble", sections)


def _figure(
    key: str,
    title: str,
    caption: str,
    axes: tuple[Axis, Axis],
    drawn: tuple[Literal["joined", "line"], Mapping[str, Array], float],
) -> Figure:
    """Return a figure of one panel.

    Args:
        key: Unique in the page.
        title: Title.
        caption: Caption as HTML.
        axes: Horizontal and vertical axis.
        drawn: Kind of the lines; their points, shape (2, n), by name; reference value of y.
    """
    kind, lines, level = drawn
    marks, words = [], [f"{title}: {axes[1].label} against {axes[0].label}."]
    for ordinal, (name, (x, y)) in enumerate(lines.items()):
        color, symbol, dash = (each[ordinal % len(each)] for each in (_COLORS, _SYMBOLS, _DASHES))
        marks.append(Mark(kind, x, y, name, color, symbol, dash, size=7.0))
        known = np.stack([x, y])[:, np.isfinite(x + y)]
        ends = [f"{_short(y)} at {_short(x)}" for x, y in known[:, [0, -1]].T] if known.size else []
        words.append(f"{name}: {' to '.join(dict.fromkeys(ends)) or 'no values'}.")
    return Figure(key, title, [Panel(title, *axes, marks, level=level)], caption, " ".join(words))


def _short(value: float) -> str:
    """Return a number with four digits, or whole from 1000 on."""
    return f"{value:.0f}" if abs(value) >= 1e3 else f"{value:.4g}"
