"""The paper's study on the console, as CSV, JSON and Markdown, and as a page with charts."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from html import escape
from typing import Any

import numpy as np

from replay_kit.core.words.colors import LINES
from replay_kit.show.figures.figure import Axis, Figure, Mark, Panel
from replay_kit.show.page.page import Section, page_html, table_html
from replay_kit.studies.paper.rows import (
    LABELS,
    ErrorRow,
    GlideRow,
    SparseRow,
    Table,
    answer_of,
    grouped,
    json_text,
    markdown,
    named_columns,
    number,
    rows_to_csv,
    to_text,
)
from replay_kit.studies.paper.run import PaperTables

PAGE = "index.html"
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
_RUNGS = {"full": "full rank", "members": "one a member"}


def to_json(tables: PaperTables) -> dict[str, Any]:
    """Return the JSON object of ``paper.json`` and ``--json``; undefined figures are null."""
    return answer_of(asdict(tables), "numpy", "scipy", "casadi")


def to_markdown(tables: PaperTables) -> str:
    """Return the study as Markdown: conditions and tables."""
    parts = map(markdown, text_tables(tables))
    heading = "# The paper's study on this ensemble"
    return "\n\n".join((heading, conditions(tables), *parts)) + "\n"


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


def text_tables(tables: PaperTables) -> tuple[Table, ...]:
    """Return all tables of a study for display."""
    pings, several = tables.sparse[-1].pings, tables.truths > 1
    over = f"; medians over {tables.truths} truths" if several else ""
    ideal = f"Table I: each grid point measured once, no noise, R = (0.01 m/s)^2{over}"
    noisy = f"Table II: {pings} random pings of 22 bins, noise {tables.noise:g} m/s{over}"
    glides = f"Table III: closest approach to a target at {tables.target_depth:g} m, planned on each flow, flown in the truth"
    return (
        named_columns(ideal, _error_cells(tables.table1, several)),
        named_columns(noisy, _error_cells(tables.table2, several)),
        named_columns(
            f"Relative error on the way through the pings of Table II{over}",
            _sparse_cells(tables.sparse),
        ),
        named_columns(glides, [_glide_cells(row) for row in tables.table3]),
    )


def _error_cells(rows: Sequence[ErrorRow], several: bool) -> list[dict[str, str | int | None]]:
    noted = any(row.note for row in rows)
    return [
        {
            "estimator": LABELS[row.method],
            "modes": f"{row.modes} ({_RUNGS[row.rung]})"
            if row.modes is not None and row.rung in _RUNGS
            else row.modes,
            "elements in H": row.elements,
            "rel. error": number(row.rel_error),
            "RMSE [m/s]": number(row.rmse, 4),
            "bound [m/s]": number(row.bound, 4),
            **(
                {
                    "worst rel. error": number(row.rel_error_worst),
                    "worst RMSE [m/s]": number(row.rmse_worst, 4),
                }
                if several
                else {}
            ),
            "time [s]": number(row.seconds, 1),
            **({"note": row.note} if noted else {}),
        }
        for row in rows
    ]


def _sparse_cells(rows: Sequence[SparseRow]) -> list[dict[str, str | int]]:
    by_pings: dict[int, dict[str, str | int]] = {}
    for row in rows:
        label = LABELS[row.method] + ("" if row.modes is None else f", {row.modes} modes")
        by_pings.setdefault(row.pings, {"pings": row.pings})[label] = number(row.rel_error)
    return list(by_pings.values())


def _glide_cells(row: GlideRow) -> dict[str, str]:
    return {
        "planned on": LABELS[row.flow],
        # the paper's column of digits ends at the metre, and plans on the truth itself pass closer than that
        "median [m]": number(row.median, 0 if row.median >= 10.0 else 2),
        "quartiles [m]": f"{number(row.lower_quartile, 0)} to {number(row.upper_quartile, 0)}",
        "90 % interval of the median [m]": f"{number(row.median_low, 0)} to {number(row.median_high, 0)}",
        "within 250 m": row.note or f"{row.within_250} of {row.pairs}",
        "time [s]": number(row.seconds, 1),
    }


_TABLES = ("table1", "table2", "table3", "sparse")
FILES = (
    *(f"{name}.csv" for name in _TABLES),
    "paper.json",
    "report.md",
    PAGE,
)


def csv_files(tables: PaperTables) -> dict[str, str]:
    """Return the text of each table with rows, by file name."""
    return {f"{name}.csv": rows_to_csv(rows) for name in _TABLES if (rows := getattr(tables, name))}


def files_of(tables: PaperTables) -> Mapping[str, str]:
    """Return the files of the study so far by name, with report and page once finished."""
    files = {**csv_files(tables), "paper.json": json_text(to_json(tables))}
    if tables.unfinished:
        return files
    return {**files, "report.md": to_markdown(tables), PAGE: paper_page(tables)}


def paper_page(tables: PaperTables) -> str:
    """Return the page of the finished study."""
    table1, table2, sparse, table3 = map(_table_html, text_tables(tables))
    misses = {
        LABELS[row.flow]: row.closest_approach for row in tables.table3 if row.closest_approach
    }
    glides = misses_figure("glides", "Closest approach of the glides to their targets", misses)
    sections = [
        Section("errors", "Errors", f"<p>{escape(conditions(tables))}</p>{table1}{table2}"),
        Section("few", "Sparse logs", sparse, [_sparse(tables)]),
        Section("plans", "Glides", table3, [glides]),
    ]
    return page_html("The paper's study on this ensemble", sections)


def _table_html(table: Table) -> str:
    cells = [[escape(to_text(cell)) for cell in row] for row in table.rows]
    return table_html(table.columns, cells, table.title)


def _sparse(tables: PaperTables) -> Figure:
    title = "Relative error against the number of pings"
    lines = lines_by((LABELS[row.method], row.pings, row.rel_error) for row in tables.sparse)
    axes = Axis("pings", log=True), Axis("RMSE / RMS speed of the truth [1]", log=True)
    caption = (
        "Error on the way through the pings of Table II. Lower is better; at 1 (dotted) an "
        "estimate is no better than no current at all."
    )
    return one_figure("sparse", title, caption, axes, lines, 1.0)


def lines_by(points: Iterable[tuple[str, float, float]]) -> list[Mark]:
    """Return a line per label of points (label, x and y), in order of first occurrence."""
    each = grouped(points, lambda point: point[0]).items()
    values = [
        (label, np.array([point[1:] for point in alike], np.float64)) for label, alike in each
    ]
    return [Mark("joined", at[:, 0], at[:, 1], label) for label, at in values]


def one_figure(
    key: str,
    title: str,
    caption: str,
    axes: tuple[Axis, Axis],
    lines: Sequence[Mark],
    level: float,
) -> Figure:
    """Return a figure of one panel.

    Args:
        key: Unique in the page.
        title: Title.
        caption: Caption as HTML.
        axes: Horizontal and vertical axis.
        lines: Lines with names.
        level: Reference value of y.
    """
    marks = []
    for ordinal, mark in enumerate(lines):
        color, symbol, dash = (each[ordinal % len(each)] for each in (_COLORS, _SYMBOLS, _DASHES))
        marks.append(mark._replace(color=color, symbol=symbol, dash=dash, size=7.0))
    words = f"{title}: {axes[1].label} against {axes[0].label}. {' '.join(map(_in_words, lines))}"
    panels = [Panel(title, *axes, marks, level=level)]
    return Figure(key, title, panels, caption, words)


def _in_words(mark: Mark) -> str:
    """Return the first and the last value of a mark as text."""
    known = [(x, y) for x, y in zip(mark.x, mark.y, strict=True) if np.isfinite(x + y)]
    if not known:
        return f"{mark.name}: no values."
    ends = [f"{to_text(float(y))} at {to_text(float(x))}" for x, y in (known[0], known[-1])]
    return f"{mark.name}: {' to '.join(dict.fromkeys(ends))}."


def misses_figure(key: str, title: str, misses: Mapping[str, Sequence[float]]) -> Figure:
    """Return the distribution of miss distances, one line per planning flow.

    Args:
        key: Unique in the page.
        title: Title.
        misses: Miss distances [m] by label of the flow; those below 1 m are drawn at 1 m.
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
    axes = Axis("miss distance in the truth [m]", log=True), Axis("share of the plans [1]")
    return one_figure(key, title, caption, axes, marks, 0.5)
