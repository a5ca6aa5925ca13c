"""The study's tables as text: the same cells for the console and for Markdown."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from replay_kit.studies.paper.rows import ErrorRow, GlideRow, SparseRow
from replay_kit.studies.paper.run import PaperTables

LABELS = {
    "truth": "truth",
    "depth_averaged_truth": "depth-averaged truth",
    "naive3d": "naive 3D basis",
    "paper": "2.5D paper, l = 10 km",
    "paper_cells": "2.5D paper, l = 1.16 cells",
    "default": "2.5D default",
    "nearest": "nearest member",
    "ensemble_mean": "ensemble mean",
}
_RUNGS = {"full": "full rank", "members": "one a member"}


@dataclass(frozen=True, slots=True)
class TextTable:
    """A table of words.

    Attributes:
        title: What it shows.
        headings: Of the columns.
        rows: Cells.
    """

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def text_tables(tables: PaperTables) -> tuple[TextTable, ...]:
    """Return all tables of a study."""
    pings = tables.sparse[-1].pings
    return (
        _error_table("Table I: each grid point measured once, no noise, R = (0.01 m/s)^2", tables.table1, tables.truths),
        _error_table(f"Table II: {pings} random pings of 22 bins, noise {tables.noise:g} m/s", tables.table2, tables.truths),
        _sparse_table(tables.sparse, tables.truths),
        _glide_table(tables.table3, tables.target_depth),
    )


def markdown(table: TextTable) -> str:
    """Return a table in Markdown, its title above it."""
    lines = [table.headings, tuple("---" for _ in table.headings), *table.rows]
    return "\n".join([f"**{table.title}**", "", *("| " + " | ".join(cells) + " |" for cells in lines)])


def number(value: float, digits: int = 3) -> str:
    """Return a number with so many decimals; a dash for one that is not finite."""
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"


def _error_table(title: str, rows: Sequence[ErrorRow], truths: int) -> TextTable:
    several = truths > 1
    worst = ("worst rel. error", "worst RMSE [m/s]") if several else ()
    noted = any(row.note for row in rows)
    headings = ("estimator", "modes", "elements in H", "rel. error", "RMSE [m/s]", "bound [m/s]", *worst, "time [s]")
    out = []
    for row in rows:
        modes = "-" if row.modes is None else f"{row.modes}" + (f" ({_RUNGS[row.rung]})" if row.rung in _RUNGS else "")
        elements = "-" if row.elements is None else f"{row.elements}"
        worst = (number(row.rel_error_worst), number(row.rmse_worst, 4)) if several else ()
        figures = (number(row.rel_error), number(row.rmse, 4), number(row.bound, 4), *worst, number(row.seconds, 1))
        out.append((LABELS[row.method], modes, elements, *figures, *((row.note,) if noted else ())))
    title = f"{title}; medians over {truths} truths" if several else title
    return TextTable(title, (*headings, *(("note",) if noted else ())), tuple(out))


def _sparse_table(rows: Sequence[SparseRow], truths: int) -> TextTable:
    methods = tuple(dict.fromkeys((row.method, row.modes) for row in rows))
    by_key = {(row.pings, row.method): row for row in rows}
    counts = tuple(dict.fromkeys(row.pings for row in rows))
    headings = ("pings", *(LABELS[method] + ("" if modes is None else f", {modes} modes") for method, modes in methods))
    cells = tuple((f"{n}", *(number(by_key[n, method].rel_error) for method, _ in methods)) for n in counts)
    title = "Relative error on the way through the pings of Table II"
    return TextTable(f"{title}; medians over {truths} truths" if truths > 1 else title, headings, cells)


def _glide_table(rows: Sequence[GlideRow], depth: float) -> TextTable:
    headings = ("planned on", "median [m]", "quartiles [m]", "90 % interval of the median [m]", "within 250 m", "time [s]")
    out = []
    for row in rows:
        quartiles = f"{number(row.lower_quartile, 0)} to {number(row.upper_quartile, 0)}"
        interval = f"{number(row.median_low, 0)} to {number(row.median_high, 0)}"
        # the paper's column of digits ends at the metre, and the truth's own plans pass closer than that
        median = number(row.median, 0 if row.median >= 10.0 else 2)
        share = f"{row.within_250} of {row.pairs}" if not row.note else row.note
        out.append((LABELS[row.flow], median, quartiles, interval, share, number(row.seconds, 1)))
    return TextTable(
        f"Table III: closest approach to a target at {depth:g} m, planned on each flow, flown in the truth", headings, tuple(out)
    )
