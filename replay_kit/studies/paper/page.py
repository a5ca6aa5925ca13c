"""The study of the paper on the console, as CSV, JSON and Markdown, and as a page with charts."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from replay_kit.show.figures.values import Axis, Chart, Panel
from replay_kit.show.page.section import Section
from replay_kit.studies.paper import findings
from replay_kit.studies.paper.rows import ErrorRow, GlideRow, SparseRow
from replay_kit.studies.paper.run import PaperTables
from replay_kit.studies.reports.page import (
    LABELS,
    PAGE,
    StudyReport,
    chart_figure,
    lines_by,
    misses_chart,
    one_chart,
    study_page,
    tables_html,
    words_html,
)
from replay_kit.studies.reports.tables import (
    Table,
    answer_of,
    markdown,
    named_columns,
    number,
    rows_to_csv,
)

_RUNGS = {"full": "full rank", "members": "one a member"}


def to_json(tables: PaperTables) -> dict[str, Any]:
    """Return the JSON object of ``paper.json`` and ``--json``; undefined figures are null."""
    return answer_of(asdict(tables), "numpy", "scipy", "casadi")


def to_markdown(tables: PaperTables) -> str:
    """Return the study as Markdown: conditions, tables, findings."""
    table1, table2, sparse, table3 = map(markdown, text_tables(tables))
    where, *why = findings.sparse_logs(tables)
    parts = [
        "# The paper's study on this ensemble",
        findings.conditions(tables),
        *("## Errors", table1, table2, findings.errors(tables)),
        *("## Sparse logs: where `paper` has larger errors, and why", sparse, where, *why),
        *("## Glides", table3, findings.glides(tables)),
    ]
    return "\n\n".join(parts) + "\n"


def text_tables(tables: PaperTables) -> tuple[Table, ...]:
    """Return all tables of a study as people read them."""
    pings, several = tables.sparse[-1].pings, tables.truths > 1
    over = f"; medians over {tables.truths} truths" if several else ""
    ideal = f"Table I: each grid point measured once, no noise, R = (0.01 m/s)^2{over}"
    noisy = f"Table II: {pings} random pings of 22 bins, noise {tables.noise:g} m/s{over}"
    glides = f"Table III: closest approach to a target at {tables.target_depth:g} m, planned on each flow, flown in the truth"
    return (
        named_columns("table1", ideal, _error_cells(tables.table1, several)),
        named_columns("table2", noisy, _error_cells(tables.table2, several)),
        named_columns(
            "sparse",
            f"Relative error on the way through the pings of Table II{over}",
            _sparse_cells(tables.sparse),
        ),
        named_columns("table3", glides, [_glide_cells(row) for row in tables.table3]),
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


def report_of(tables: PaperTables) -> StudyReport:
    """Return what the study says so far."""
    csv = {
        f"{name}.csv": rows_to_csv(type(rows[0]), rows)
        for name in _TABLES
        if (rows := getattr(tables, name))
    }

    def pages() -> dict[str, str]:
        return {"report.md": to_markdown(tables), PAGE: paper_page(tables)}

    if tables.unfinished:
        return StudyReport("paper", to_json(tables), (), (), csv, None)
    words = [findings.errors(tables), findings.sparse_logs(tables)[0]]
    beside = "report.md, paper.json, tables as CSV"
    return StudyReport("paper", to_json(tables), text_tables(tables), words, csv, pages, beside)


def paper_page(tables: PaperTables) -> str:
    """Return the page of the finished study."""
    table1, table2, sparse, table3 = text_tables(tables)
    where, *why = findings.sparse_logs(tables)
    misses = {
        LABELS[row.flow]: row.closest_approach for row in tables.table3 if row.closest_approach
    }
    distribution = misses_chart("glides", "Closest approach of the glides to their targets", misses)
    sections = [
        Section(
            "answer",
            "In words",
            words_html([findings.conditions(tables), findings.errors(tables), where]),
        ),
        Section("errors", "Errors", tables_html([table1, table2])),
        Section(
            "few",
            "Sparse logs",
            words_html(why) + tables_html([sparse]),
            [chart_figure(_sparse(tables))],
        ),
        Section(
            "plans",
            "Glides",
            words_html([findings.glides(tables)]) + tables_html([table3]),
            [chart_figure(distribution)],
        ),
    ]
    return study_page("The paper's study on this ensemble", sections, to_json(tables))


def _sparse(tables: PaperTables) -> Chart:
    title = "Relative error against the number of pings"
    lines = lines_by((LABELS[row.method], row.pings, row.rel_error) for row in tables.sparse)
    y = Axis("RMSE / RMS speed of the truth [1]", log=True)
    caption = (
        "Error on the way through the pings of Table II. Lower is better; at 1 (dotted) an "
        "estimate is no better than no current at all."
    )
    panel = Panel(title, y, lines, level=1.0)
    return one_chart("sparse", title, caption, Axis("pings", log=True), panel)
