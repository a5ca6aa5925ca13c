"""The study to files and to the console: CSV, JSON, Markdown, figures."""

import csv
import io
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, fields
from importlib.metadata import version
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from replay_kit import __version__
from replay_kit.core.atomic import atomic_file
from replay_kit.studies.paper import findings
from replay_kit.studies.paper.rows import ErrorRow, GlideRow, SparseRow
from replay_kit.studies.paper.run import PaperTables, Shown
from replay_kit.studies.paper.text import markdown, text_tables

_PACKAGES = ("numpy", "scipy", "casadi", "matplotlib")
_TABLES = ("table1", "table2", "table3", "sparse")
FIGURES = {
    "singular_values": "Singular values of the depth slices, over the largest",
    "modes_top": "Basis flows from above, each over its largest speed",
    "modes_3d": "One basis flow in 3D: how far it reaches above and below its level",
    "truth_3d": "The truth, and one ping",
    "truth_top": "The truth from above, and the pings of Table II",
    "sparse": "Relative error against the number of pings",
    "glides_3d": "Glides planned on each flow and flown in the truth",
    "glides_top": "The same from above",
}
FILES = (
    *(f"{name}.csv" for name in _TABLES),
    "paper.json",
    "report.md",
    *(f"{name}.{ending}" for name in FIGURES for ending in ("png", "svg")),
)


def to_json(tables: PaperTables) -> dict[str, Any]:
    """Return the JSON object of ``paper.json`` and ``--json``; undefined figures are null."""
    versions = {"replay-kit": __version__, **{name: version(name) for name in _PACKAGES}}
    answer: dict[str, Any] = _plain({**asdict(tables), "figures": dict(FIGURES), "versions": versions})
    return answer


def print_paper(tables: PaperTables, console: Console) -> None:
    """Print the tables, and where the depth-averaged truth and the paper's estimator stand."""
    for table in text_tables(tables):
        shown = Table(*table.headings, title=table.title, title_justify="left")
        for cells in table.rows:
            shown.add_row(*cells)
        console.print(shown)
    console.print(findings.sparse_logs(tables)[0], soft_wrap=True)


def write_paper(out: Path, tables: PaperTables, shown: Shown) -> None:
    """Write all ``FILES`` into a folder, each whole or not at all; existing ones are replaced.

    Args:
        out: The folder; it exists.
        tables: What was counted.
        shown: What the figures show.
    """
    # matplotlib takes half a second to load, and nothing but this needs it
    from replay_kit.studies.paper.figures import draw

    by_name: dict[str, Sequence[ErrorRow | GlideRow | SparseRow]] = {name: getattr(tables, name) for name in _TABLES}
    for name, rows in by_name.items():
        _write(out / f"{name}.csv", to_csv(rows).encode())
    for name, ending, content in draw(tables, shown):
        _write(out / f"{name}.{ending}", content)
    _write(out / "paper.json", (json.dumps(to_json(tables), indent=1, allow_nan=False) + "\n").encode())
    _write(out / "report.md", report(tables).encode())


def to_csv(rows: Sequence[ErrorRow | GlideRow | SparseRow]) -> str:
    """Return rows as CSV with their fields' names; undefined figures are empty, lists have spaces between their numbers."""
    text = io.StringIO()
    names = [field.name for field in fields(rows[0])]
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    for row in rows:
        values = (_plain(getattr(row, name)) for name in names)
        writer.writerow([" ".join(map(str, value)) if isinstance(value, list) else value for value in values])
    return text.getvalue()


def report(tables: PaperTables) -> str:
    """Return the study as Markdown: conditions, tables, findings, figures."""
    table1, table2, sparse, table3 = (markdown(table) for table in text_tables(tables))
    where, *why = findings.sparse_logs(tables)
    figures = [f"![{caption}]({name}.png)\n\n*{caption}.*" for name, caption in FIGURES.items()]
    parts = [
        "# The paper's study on this ensemble",
        findings.conditions(tables),
        "## Errors",
        table1,
        table2,
        "## Sparse logs: where `paper` falls behind, and why",
        sparse,
        where,
        *why,
        "## Glides",
        table3,
        findings.glides(tables),
        "## Figures",
        *figures,
    ]
    return "\n\n".join(parts) + "\n"


def _write(path: Path, content: bytes) -> None:
    with atomic_file(path) as file:
        file.write(content)


def _plain(value: Any) -> Any:
    """Return a value as JSON has it: numbers that are not finite as None, tuples as lists."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
