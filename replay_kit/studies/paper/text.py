"""Output of tables as CSV, Markdown, JSON and text."""

import json
import math
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from importlib.metadata import version
from typing import Any, TypeVar

from rich.console import Console
from rich.table import Table as ConsoleTable

from replay_kit.core import __version__
from replay_kit.core.words.text import csv_text

NAN = math.nan

Item = TypeVar("Item")
Key = TypeVar("Key", bound=Hashable)
Cell = str | int | float | bool | tuple[float, ...] | None


@dataclass(frozen=True, slots=True)
class Table:
    """Table of rows.

    Attributes:
        name: Name of its CSV file.
        title: Title.
        columns: Column names with units.
        rows: One cell per column; NaN for undefined figures.
    """

    name: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]


def grouped(items: Iterable[Item], key: Callable[[Item], Key]) -> dict[Key, list[Item]]:
    """Return items grouped by key, in order of first occurrence."""
    groups: dict[Key, list[Item]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups


def named_columns(name: str, title: str, rows: Sequence[Mapping[str, Cell]]) -> Table:
    """Return the table of at least one row, given as cells by column name."""
    return Table(name, title, tuple(rows[0]), tuple(tuple(row.values()) for row in rows))


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


def to_csv(table: Table) -> str:
    """Return a table as CSV: undefined figures are empty, lists are joined by spaces, and no text is a formula."""
    rows = (dict(zip(table.columns, plain(row), strict=True)) for row in table.rows)
    return csv_text(rows, table.columns)


def rows_to_csv(kind: type, rows: Sequence[Any]) -> str:
    """Return frozen values of a class as CSV with their fields' names, see ``to_csv``."""
    names = tuple(field.name for field in fields(kind))
    return to_csv(Table("", "", names, tuple(tuple(asdict(row).values()) for row in rows)))


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
