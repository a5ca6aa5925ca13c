"""Rows and tables of the study as frozen values, and as CSV, Markdown, JSON and text."""

import json
import math
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from importlib.metadata import version
from itertools import chain
from typing import Any, TypeVar

import numpy as np
from rich.console import Console
from rich.table import Table as ConsoleTable

from replay_kit.core import __version__
from replay_kit.core.words.text import csv_text

NAN = math.nan

Item = TypeVar("Item")
Key = TypeVar("Key", bound=Hashable)
Cell = str | int | float | bool | tuple[float, ...] | None

TRUTH, AVERAGED = "truth", "depth_averaged_truth"
#: Names of methods and flows in tables and legends.
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


@dataclass(frozen=True, slots=True)
class ErrorRow:
    """One estimator in Table I or II; over several truths the median and the worst.

    Attributes:
        method: ``naive3d``, ``paper``, ``paper_cells``, ``default``, ``nearest`` or ``ensemble_mean``.
        rung: Number of modes: ``full``, ``members`` or a number; empty without a choice.
        modes: Number r of basis flows per level, or of whole basis flows of ``naive3d``; None without a basis.
        elements: Number of elements of the basis, the paper's "elements in H"; None without a basis.
        rel_error: RMSE over the truth's RMS speed.
        rmse: RMS length of the error vector over the truth's wet grid points [m/s].
        bound: Least RMSE of any flow in the method's span [m/s].
        rel_error_worst: Relative error of the worst truth.
        rmse_worst: RMSE of the worst truth [m/s].
        rel_error_by_truth: Relative error of each truth.
        seconds: Wall time to build the estimator and assimilate all profiles [s], mean over truths.
        note: Reason for missing figures.
    """

    method: str
    rung: str
    modes: int | None
    elements: int | None
    rel_error: float
    rmse: float
    bound: float
    rel_error_worst: float
    rmse_worst: float
    rel_error_by_truth: tuple[float, ...]
    seconds: float
    note: str


@dataclass(frozen=True, slots=True)
class SparseRow:
    """Estimate after some profiles of Table II; over several truths the median and the worst.

    Attributes:
        pings: Number of profiles so far.
        method: As in ``ErrorRow``.
        modes: Basis flows per level; None without a basis.
        rel_error: RMSE over the truth's RMS speed.
        rel_error_worst: Relative error of the worst truth.
        rel_error_by_truth: Relative error of each truth.
    """

    pings: int
    method: str
    modes: int | None
    rel_error: float
    rel_error_worst: float
    rel_error_by_truth: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class GlideRow:
    """Plans made on one flow and flown in the truth (Table III).

    Attributes:
        flow: ``truth``, ``depth_averaged_truth`` or a method.
        pairs: Number of starts and targets.
        median: Median closest approach to the target [m].
        lower_quartile: Lower quartile [m].
        upper_quartile: Upper quartile [m].
        median_low: Lower end of the bootstrap 90 % interval of the median [m].
        median_high: Upper end [m].
        within_250: Number of pairs within 250 m.
        seconds: Wall time of all plans and flights [s].
        closest_approach: By pair [m].
        note: Reason for missing figures.
    """

    flow: str
    pairs: int = 0
    median: float = NAN
    lower_quartile: float = NAN
    upper_quartile: float = NAN
    median_low: float = NAN
    median_high: float = NAN
    within_250: int = 0
    seconds: float = 0.0
    closest_approach: tuple[float, ...] = ()
    note: str = ""


def over_truths(tables: Sequence[Sequence[ErrorRow]]) -> tuple[ErrorRow, ...]:
    """Return medians and worst over truths of rows of equal method and number of modes.

    Failed truths are excluded from the figures and counted in the note.

    Args:
        tables: One table per truth.
    """
    return tuple(
        _over_truths(alike)
        for alike in grouped(
            chain.from_iterable(tables), lambda row: (row.method, row.rung)
        ).values()
    )


def sparse_over_truths(tables: Sequence[Sequence[SparseRow]]) -> tuple[SparseRow, ...]:
    """Return medians and worst over truths of rows of equal method and number of pings.

    Args:
        tables: One table per truth.
    """
    return tuple(
        replace(
            alike[0],
            rel_error=float(np.median([row.rel_error for row in alike])),
            rel_error_worst=max(row.rel_error_worst for row in alike),
            rel_error_by_truth=tuple(value for row in alike for value in row.rel_error_by_truth),
        )
        for alike in grouped(
            chain.from_iterable(tables), lambda row: (row.pings, row.method)
        ).values()
    )


def _over_truths(alike: Sequence[ErrorRow]) -> ErrorRow:
    if len(alike) == 1:
        return alike[0]
    failed = [row.note for row in alike if row.note]
    measured = [row for row in alike if not row.note] or alike
    medians: dict[str, Any] = {
        name: float(np.median([getattr(row, name) for row in measured]))
        for name in ("rel_error", "rmse", "bound")
    }
    return replace(
        alike[0],
        **medians,
        modes=max((row.modes for row in alike if row.modes is not None), default=None),
        elements=max((row.elements for row in alike if row.elements is not None), default=None),
        rel_error_worst=max(row.rel_error_worst for row in measured),
        rmse_worst=max(row.rmse_worst for row in measured),
        rel_error_by_truth=tuple(value for row in alike for value in row.rel_error_by_truth),
        seconds=float(np.mean([row.seconds for row in alike])),
        note=f"{len(failed)} of {len(alike)} truths: {failed[0]}" if failed else "",
    )


@dataclass(frozen=True, slots=True)
class Table:
    """Table of rows.

    Attributes:
        title: Title.
        columns: Column names with units.
        rows: One cell per column; NaN for undefined figures.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]


def grouped(items: Iterable[Item], key: Callable[[Item], Key]) -> dict[Key, list[Item]]:
    """Return items grouped by key, in order of first occurrence."""
    groups: dict[Key, list[Item]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups


def named_columns(title: str, rows: Sequence[Mapping[str, Cell]]) -> Table:
    """Return the table of at least one row, given as cells by column name."""
    return Table(title, tuple(rows[0]), tuple(tuple(row.values()) for row in rows))


def plain(value: Any) -> Any:
    """Return a value for JSON: nested mappings and lists, undefined and infinite numbers as None."""
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def answer_of(figures: Mapping[str, Any], *packages: str) -> dict[str, Any]:
    """Return figures for JSON with the versions of this and other packages; a false ``unfinished`` is omitted."""
    versions = {"replay-kit": __version__, **{name: version(name) for name in packages}}
    return {
        name: plain(value)
        for name, value in {**figures, "versions": versions}.items()
        if name != "unfinished" or value
    }


def json_text(answer: Mapping[str, Any]) -> str:
    """Return the text of a JSON file."""
    return json.dumps(answer, indent=1, allow_nan=False) + "\n"


def rows_to_csv(rows: Sequence[Any]) -> str:
    """Return frozen values of one class as CSV: undefined figures are empty, and lists are joined by spaces."""
    return csv_text((plain(asdict(row)) for row in rows), [each.name for each in fields(rows[0])])


def markdown(table: Table) -> str:
    """Return a table in Markdown below its title."""
    lines = (
        table.columns,
        ["---"] * len(table.columns),
        *(map(to_text, row) for row in table.rows),
    )
    return "\n".join(
        [f"**{table.title}**", "", *("| " + " | ".join(cells) + " |" for cells in lines)]
    )


def print_tables(console: Console, tables: Sequence[Table]) -> None:
    """Print tables that have rows."""
    for table in tables:
        if table.rows:
            printed = ConsoleTable(*table.columns, title=table.title, title_justify="left")
            for row in table.rows:
                printed.add_row(*map(to_text, row))
            console.print(printed)


def to_text(cell: Cell) -> str:
    """Return a cell as text: four digits of a number, integers from 1000 on, a dash if undefined."""
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    if isinstance(cell, tuple):
        return " ".join(map(to_text, cell))
    if isinstance(cell, float):
        return (
            number(cell, 0) if abs(cell) >= 1e3 else f"{cell:.4g}" if math.isfinite(cell) else "-"
        )
    return "-" if cell is None else str(cell)


def number(value: float, digits: int = 3) -> str:
    """Return a number with fixed decimals; a dash if undefined or infinite."""
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"
