"""The comparison of methods on the console, as CSV and JSON, and as a page: which method errs least, and which states its errors right."""

from collections.abc import Sequence
from dataclasses import asdict, fields
from html import escape
from typing import Any

from replay_kit.show.page import Section
from replay_kit.studies.accuracy.run import FIGURES, AccuracyResult, AccuracyRow
from replay_kit.studies.reports.charts import LABELS, Axis, Chart, Series, chart_figure, series_by
from replay_kit.studies.reports.page import (
    PAGE,
    StudyReport,
    list_html,
    study_page,
    tables_html,
    words_html,
)
from replay_kit.studies.reports.tables import (
    Cell,
    Table,
    answer_of,
    number,
    rows_to_csv,
)

_COLUMNS = (
    "truth",
    "method",
    "pings",
    "rel. error",
    "RMSE",
    "bound",
    "NIS/dof",
    "cov. 50",
    "cov. 90",
    "CRPS",
)


def to_json(result: AccuracyResult) -> dict[str, Any]:
    """Return the JSON object of ``--json``; undefined figures are null."""
    figures = {
        field.name: getattr(result, field.name) for field in fields(result) if field.name != "rows"
    }
    return answer_of(
        {
            "unfinished": result.unfinished,
            "results": [_row_json(row) for row in result.rows],
            **figures,
        },
        "numpy",
        "scipy",
    )


def row_table(result: AccuracyResult) -> Table:
    """Return the rows as people read them."""
    rows: tuple[tuple[Cell, ...], ...] = tuple(
        (
            result.truth if row.truth is None else str(row.truth),
            row.method,
            row.pings,
            *(number(getattr(row, name)) for name in FIGURES),
        )
        for row in result.rows
    )
    return Table("accuracy", "Methods against the number of pings", _COLUMNS, rows)


def _row_json(row: AccuracyRow) -> dict[str, Any]:
    left_out = {
        name
        for name, absent in (
            ("truth", row.truth is None),
            ("failed", not row.failed),
        )
        if absent
    }
    return {name: value for name, value in asdict(row).items() if name not in left_out}


FILES = ("accuracy.csv", "accuracy.json", PAGE)
_PINGS = Axis("pings", log=True)
#: Key, title, field of the rows, vertical axis, value to compare with, and what to see.
_CHARTS = (
    (
        "error",
        "Error of each method against the number of pings",
        "rel_error",
        Axis("RMSE / RMS speed of the truth [1]", log=True),
        1.0,
        "Lower is better. At 1 (dotted) a method is no better than no current at all. Lines that fall fast learn much from few pings.",
    ),
    (
        "coverage",
        "Coverage of the 90 % intervals",
        "coverage90",
        Axis("share inside [1]"),
        0.9,
        "Share of components inside; 0.9 (dotted) is right, below it the stated errors are too small. Some methods state none.",
    ),
    (
        "nis",
        "Consistency of the innovations",
        "nis_per_dof",
        Axis("NIS per degree of freedom [1]", log=True),
        1.0,
        "Each ping is predicted before it is used. 1 (dotted) is consistent; above it the stated errors are too small, below it too large.",
    ),
)


def report_of(result: AccuracyResult) -> StudyReport:
    """Return what the comparison says so far, and why methods failed."""
    failed = [
        f"{row.method} after {row.pings} pings: {row.failed}" for row in result.rows if row.failed
    ]
    return StudyReport(
        "accuracy",
        to_json(result),
        [row_table(result)],
        failed,
        {"accuracy.csv": rows_to_csv(AccuracyRow, result.rows)},
        None if result.unfinished else lambda: {PAGE: accuracy_page(result)},
    )


def accuracy_page(result: AccuracyResult) -> str:
    """Return the page of a finished study; of truths in turn it shows the means over them."""
    rows = [row for row in result.rows if row.truth in (None, "mean")]
    charts = [
        Chart(key, title, caption, (_PINGS, axis), series, level)
        for key, title, field, axis, level, caption in _CHARTS
        if (series := _series(rows, field))
    ]
    lost = [
        f"{row.method} after {row.pings} pings has no figures: {row.failed}."
        for row in rows
        if row.failed
    ]
    answer = words_html([_conditions(result, rows)]) + list_html(
        [_best(rows, pings) for pings in _counts(rows)]
    )
    sections = [
        Section("answer", "In words", answer, missing=lost),
        Section(
            "errors", "Errors and calibration", figures=[chart_figure(chart) for chart in charts]
        ),
        Section("table", "Every figure", tables_html([row_table(result)])),
    ]
    return study_page("Estimation methods compared", sections, to_json(result))


def _series(rows: Sequence[AccuracyRow], field: str) -> tuple[Series, ...]:
    figures = [(row, getattr(row, field)) for row in rows]
    # NaN is unequal to itself: methods without such a figure have no line
    return series_by(
        (LABELS.get(row.method, row.method), row.pings, value)
        for row, value in figures
        if value == value
    )


def _conditions(result: AccuracyResult, rows: Sequence[AccuracyRow]) -> str:
    methods, seeds = (
        len({row.method for row in rows}),
        max((len(row.rel_error_by_seed) for row in rows), default=0),
    )
    truth = "each member in turn" if result.truth == "all" else f"`{result.truth}`"
    return (
        f"{methods} methods estimate a truth, {truth}, from the same pings at random places with {result.noise:g} m/s of noise. Errors are "
        f"over all wet grid points of the truth; figures are means over {seeds} surveys{' of each truth' if result.truth == 'all' else ''}."
    )


def _counts(rows: Sequence[AccuracyRow]) -> list[int]:
    return sorted({row.pings for row in rows})


def _best(rows: Sequence[AccuracyRow], pings: int) -> str:
    measured = sorted(
        (row for row in rows if row.pings == pings and not row.failed),
        key=lambda row: row.rel_error,
    )
    if not measured:
        return f"After {pings} pings no method has an estimate."
    best, mean = measured[0], next((row for row in measured if row.method == "ensemble_mean"), None)
    beside = (
        f"; the ensemble mean, which uses no ping: {number(mean.rel_error)}"
        if mean is not None and mean is not best
        else ""
    )
    return (
        f"After {pings} pings *{escape(LABELS.get(best.method, best.method))}* errs least: {number(best.rel_error)} of the truth's RMS "
        f"speed, {number(100.0 * best.rmse, 1)} cm/s{beside}."
    )
