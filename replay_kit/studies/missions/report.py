"""The studies to the console, to CSV and to JSON."""

from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from rich.console import Console

from replay_kit.studies.missions.rows import MissionRow
from replay_kit.studies.missions.run import MissionResult
from replay_kit.studies.reports.tables import Table
from replay_kit.studies.reports.write import answer_of, json_text, limits_text, met_text, print_tables, write_files
from replay_kit.studies.reports.write import to_csv as table_to_csv

FILES = ("missions.csv", "missions.json")


def to_json(result: MissionResult) -> dict[str, Any]:
    """Return the JSON object of ``--json``; undefined figures are null."""
    return answer_of(asdict(result), "numpy", "scipy")


def to_csv(result: MissionResult) -> str:
    """Return the rows as CSV with their fields' names; undefined figures are empty, lists have spaces between their numbers."""
    columns = tuple(field.name for field in fields(MissionRow))
    return table_to_csv(Table("missions", "All figures", columns, tuple(tuple(asdict(row).values()) for row in result.rows)))


def write_missions(out: Path, result: MissionResult) -> None:
    """Write ``FILES`` into a folder that exists, each whole or not at all; existing ones are replaced."""
    write_files(out, dict(zip(FILES, (to_csv(result), json_text(to_json(result))), strict=True)))


def print_missions(result: MissionResult, console: Console) -> None:
    """Print a table for each study."""
    print_tables(console, [_table(result, study) for study in result.job.studies])
    for why in result.lost:
        console.print(f"left out: {why}")


def _table(result: MissionResult, study: str) -> Table:
    times = f" of {result.times} times" if result.times > 1 else ""
    missions = f"{result.job.seeds} missions each, {result.job.pings} pings of {result.job.noise:g} m/s noise"
    rows = tuple(
        (row.method, row.figure, row.value, limits_text(row.at_least, row.at_most), met_text(row.met), row.by_mission)
        for row in result.rows
        if row.study == study
    )
    title = f"{study}: {len(result.members)} truths{times}, {missions}"
    return Table(study, title, ("method", "figure", "value", "required", "", "by mission"), rows)
