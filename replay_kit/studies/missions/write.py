"""The studies to the console, to CSV and to JSON."""

import csv
import io
import json
import math
from dataclasses import asdict, fields
from importlib.metadata import version
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from replay_kit import __version__
from replay_kit.core.atomic import atomic_file
from replay_kit.studies.missions.rows import MissionRow
from replay_kit.studies.missions.run import MissionResult

FILES = ("missions.csv", "missions.json")


def to_json(result: MissionResult) -> dict[str, Any]:
    """Return the JSON object of ``--json``; undefined figures are null."""
    return {
        "rows": [{name: _plain(value) for name, value in asdict(row).items()} for row in result.rows],
        "ensemble": result.ensemble,
        "members": list(result.members),
        "times": result.times,
        "lost": list(result.lost),
        "job": {name: _plain(value) for name, value in asdict(result.job).items()},
        "versions": {"replay-kit": __version__, "numpy": version("numpy"), "scipy": version("scipy")},
    }


def to_csv(result: MissionResult) -> str:
    """Return the rows as CSV with their fields' names; undefined figures are empty, lists have spaces between their numbers."""
    text = io.StringIO()
    names = [field.name for field in fields(MissionRow)]
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    for row in result.rows:
        values = [_plain(getattr(row, name)) for name in names]
        writer.writerow([" ".join(map(str, value)) if isinstance(value, list) else value for value in values])
    return text.getvalue()


def write_missions(out: Path, result: MissionResult) -> None:
    """Write ``FILES`` into a folder that exists, each whole or not at all; existing ones are replaced."""
    for name, content in zip(FILES, (to_csv(result), json.dumps(to_json(result), indent=1, allow_nan=False) + "\n"), strict=True):
        with atomic_file(out / name) as file:
            file.write(content.encode())


def print_missions(result: MissionResult, console: Console) -> None:
    """Print a table for each study."""
    for study in result.job.studies:
        table = Table("method", "figure", "value", "asked", "", "by mission", title=f"{study}: {_words(result)}", title_justify="left")
        for row in result.rows:
            if row.study == study:
                met = "" if row.met is None else "met" if row.met else "NOT MET"
                by_mission = " ".join(_number(value) for value in row.by_mission)
                table.add_row(row.method, row.figure, _number(row.value), _asked(row), met, by_mission)
        console.print(table)
    for why in result.lost:
        console.print(f"left out: {why}")


def _words(result: MissionResult) -> str:
    truths = f"{len(result.members)} truths of {result.times} times" if result.times > 1 else f"{len(result.members)} truths"
    return f"{truths}, {result.job.seeds} missions each, {result.job.pings} pings of {result.job.noise:g} m/s noise"


def _asked(row: MissionRow) -> str:
    low, high = math.isfinite(row.at_least), math.isfinite(row.at_most)
    if low and high:
        return f"{_number(row.at_least)} to {_number(row.at_most)}"
    return f">= {_number(row.at_least)}" if low else f"<= {_number(row.at_most)}" if high else ""


def _number(value: float) -> str:
    return f"{value:.4g}" if math.isfinite(value) else "-"


def _plain(value: Any) -> Any:
    """Return a value as JSON has it: numbers that are not finite as None, tuples as lists."""
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
