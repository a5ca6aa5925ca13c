"""Tables as CSV, Markdown, JSON and text."""

import json
import math
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from importlib.metadata import version
from typing import Any, TypeVar

from rich.console import Console
from rich.table import Table as ConsoleTable

from replay_kit.core.text import csv_text
from replay_kit.core.version import __version__

NAN = math.nan

Item = TypeVar("Item")
Key = TypeVar("Key", bound=Hashable)
Cell = str | int | float | bool | tuple[float, ...] | None


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of the same columns.

    Attributes:
        name: Of its CSV.
        title: What it shows.
        columns: Names with units.
        rows: A cell for each column; NaN where a figure is undefined.
    """

    name: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]


def grouped(items: Iterable[Item], key: Callable[[Item], Key]) -> dict[Key, list[Item]]:
    """Return items by a key of each, in the order in which keys first come."""
    groups: dict[Key, list[Item]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups


def named_columns(name: str, title: str, rows: Sequence[Mapping[str, Cell]]) -> Table:
    """Return the table of at least one row, each a cell for each column by its name."""
    return Table(name, title, tuple(rows[0]), tuple(tuple(row.values()) for row in rows))


def plain(value: Any) -> Any:
    """Return a value for JSON: mappings and sequences all through, undefined and infinite numbers as None."""
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def answer_of(figures: Mapping[str, Any], *packages: str) -> dict[str, Any]:
    """Return figures for JSON, with the versions of this package and of others; ``unfinished`` is left out where it does not hold."""
    versions = {"replay-kit": __version__, **{name: version(name) for name in packages}}
    return {
        name: plain(value)
        for name, value in {**figures, "versions": versions}.items()
        if name != "unfinished" or value
    }


def json_text(answer: Mapping[str, Any]) -> str:
    """Return a result as the text of a JSON file."""
    return json.dumps(answer, indent=1, allow_nan=False) + "\n"


def to_csv(table: Table) -> str:
    """Return a table as CSV: undefined figures are empty, the numbers of a list have spaces between them, and no text is a formula."""
    rows = (dict(zip(table.columns, plain(row), strict=True)) for row in table.rows)
    return csv_text(rows, table.columns)


def rows_to_csv(kind: type, rows: Sequence[Any]) -> str:
    """Return frozen values of a kind as CSV with their fields' names, see ``to_csv``."""
    names = tuple(field.name for field in fields(kind))
    return to_csv(Table("", "", names, tuple(tuple(asdict(row).values()) for row in rows)))


def markdown(table: Table) -> str:
    """Return a table in Markdown, its title above it."""
    lines = (
        table.columns,
        ["---"] * len(table.columns),
        *(map(to_text, row) for row in table.rows),
    )
    return "\n".join(
        [f"**{table.title}**", "", *("| " + " | ".join(cells) + " |" for cells in lines)]
    )


def print_tables(console: Console, tables: Sequence[Table]) -> None:
    """Print those tables that have rows."""
    for table in tables:
        if table.rows:
            printed = ConsoleTable(*table.columns, title=table.title, title_justify="left")
            for row in table.rows:
                printed.add_row(*map(to_text, row))
            console.print(printed)


def to_text(cell: Cell) -> str:
    """Return a cell for people: four digits of a number, whole numbers from 1000 on, a dash for an undefined one."""
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
    """Return a number with so many decimals; a dash for an undefined or infinite one."""
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"
