"""The studies to the console, to CSV and to JSON."""

from dataclasses import asdict, fields
from typing import Any

from rich.console import Console

from replay_kit.studies.missions.rows import MissionRow
from replay_kit.studies.missions.run import MissionResult
from replay_kit.studies.reports.tables import Table
from replay_kit.studies.reports.write import answer_of, limits_text, met_text, print_tables
from replay_kit.studies.reports.write import to_csv as table_to_csv


def to_json(result: MissionResult) -> dict[str, Any]:
    """Return the JSON object of ``--json``; undefined figures are null."""
    return answer_of(asdict(result), "numpy", "scipy")


def to_csv(result: MissionResult) -> str:
    """Return the rows as CSV with their fields' names; undefined figures are empty, lists have spaces between their numbers."""
    columns = tuple(field.name for field in fields(MissionRow))
    return table_to_csv(
        Table(
            "missions",
            "All figures",
            columns,
            tuple(tuple(asdict(row).values()) for row in result.rows),
        )
    )


def print_missions(result: MissionResult, console: Console) -> None:
    """Print a table for each study."""
    print_tables(console, [study_table(result, study) for study in result.job.studies])
    for why in result.lost:
        console.print(f"left out: {why}")


def study_table(result: MissionResult, study: str) -> Table:
    """Return the figures of one study as people read them."""
    times = f" of {result.times} times" if result.times > 1 else ""
    missions = f"{result.job.seeds} missions each, {result.job.pings} pings of {result.job.noise:g} m/s noise"
    rows = tuple(
        (
            row.method,
            row.figure,
            row.value,
            limits_text(row.at_least, row.at_most),
            met_text(row.met),
            row.by_mission,
        )
        for row in result.rows
        if row.study == study
    )
    title = f"{study}: {len(result.members)} truths{times}, {missions}"
    return Table(study, title, ("method", "figure", "value", "required", "", "by mission"), rows)
