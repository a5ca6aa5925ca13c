"""The comparison of methods to JSON and to the console."""

import math
from importlib.metadata import version
from typing import Any

from rich.console import Console
from rich.table import Table

from replay_kit import __version__
from replay_kit.studies.accuracy import FIGURES, AccuracyResult, AccuracyRow


def to_json(result: AccuracyResult) -> dict[str, Any]:
    """Return the JSON object of ``--json``; undefined figures are null."""
    return {
        **({"unfinished": True} if result.unfinished else {}),
        "results": [_row_json(row) for row in result.rows],
        "ensemble": result.ensemble,
        "truth": result.truth,
        "modes": result.modes,
        "noise": result.noise,
        "versions": {"replay-kit": __version__, "numpy": version("numpy"), "scipy": version("scipy")},
    }


def print_accuracy(result: AccuracyResult, console: Console) -> None:
    """Print the rows as a table."""
    table = Table("truth", "method", "pings", "rel. error", "RMSE", "bound", "NIS/dof", "cov. 50", "cov. 90", "CRPS")
    for row in result.rows:
        figures = [getattr(row, name) for name in FIGURES]
        truth = result.truth if row.truth is None else str(row.truth)
        table.add_row(truth, row.method, str(row.pings), *(f"{value:.3f}" if math.isfinite(value) else "-" for value in figures))
    console.print(table)
    for row in result.rows:
        if row.failed:
            console.print(f"{row.method} after {row.pings} pings: {row.failed}", soft_wrap=True, markup=False)


def _row_json(row: AccuracyRow) -> dict[str, Any]:
    values = {name: getattr(row, name) for name in AccuracyRow.__dataclass_fields__}
    answer = {name: None if isinstance(value, float) and not math.isfinite(value) else value for name, value in values.items()}
    answer["rel_error_by_seed"] = list(row.rel_error_by_seed)
    if row.truth is None:
        del answer["truth"]
    if not row.failed:
        del answer["failed"]
    return answer
