"""The comparison of methods to JSON, CSV and the console."""

from dataclasses import asdict, fields
from typing import Any

from rich.console import Console

from replay_kit.studies.accuracy.run import FIGURES, AccuracyResult, AccuracyRow
from replay_kit.studies.reports.tables import Cell, Table, named_columns
from replay_kit.studies.reports.write import answer_of, number, print_tables
from replay_kit.studies.reports.write import to_csv as table_to_csv

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


def to_csv(result: AccuracyResult) -> str:
    """Return the rows as CSV with their fields' names; undefined figures are empty, lists have spaces between their numbers."""
    return table_to_csv(
        named_columns("accuracy", "All figures", [asdict(row) for row in result.rows])
    )


def row_table(result: AccuracyResult) -> Table:
    """Return the rows as people read them."""
    made = any(row.members for row in result.rows)
    rows: tuple[tuple[Cell, ...], ...] = tuple(
        (
            result.truth if row.truth is None else str(row.truth),
            *((row.members,) if made else ()),
            row.method,
            row.pings,
            *(number(getattr(row, name)) for name in FIGURES),
        )
        for row in result.rows
    )
    columns = (_COLUMNS[0], "members", *_COLUMNS[1:]) if made else _COLUMNS
    return Table("accuracy", "Methods against the number of pings", columns, rows)


def print_accuracy(result: AccuracyResult, console: Console) -> None:
    """Print the rows as a table, and below it why methods failed."""
    print_tables(console, [row_table(result)])
    for row in result.rows:
        if row.failed:
            console.print(
                f"{row.method} after {row.pings} pings: {row.failed}", soft_wrap=True, markup=False
            )


def _row_json(row: AccuracyRow) -> dict[str, Any]:
    left_out = {
        name
        for name, absent in (
            ("truth", row.truth is None),
            ("members", not row.members),
            ("failed", not row.failed),
        )
        if absent
    }
    return {name: value for name, value in asdict(row).items() if name not in left_out}
