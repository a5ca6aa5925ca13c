"""Outcomes of a fleet as a table for CSV, JSON and console."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from replay_kit.core.atomic import write_whole
from replay_kit.core.text import csv_text
from replay_kit.results.outcome.outcome import outcome_from
from replay_kit.show.text import print_lines, print_table
from replay_kit.workflows.fleet.run import Outcome

#: Name of the table in the folder of a fleet.
TABLE = "fleet.csv"
_COLUMNS = (
    "mission",
    "status",
    "verdict",
    "plan",
    "profiles",
    "dives",
    "prior forecast",
    "before",
    "after [cm/s]",
    "NIS/dof",
    "contradictions",
    "s",
)
#: Of several exit codes the first of these counts.
_CODES = (1, 2, 3, 7, 4, 6)


def exit_code(outcomes: Sequence[Outcome]) -> int:
    """Return the most severe exit code of the missions, or 0."""
    codes = {outcome.exit_code for outcome in outcomes}
    return next((code for code in _CODES if code in codes), 0)


def row_of(outcome: Outcome) -> dict[str, Any]:
    """Return the figures of a mission by column; None where undefined."""
    answer = outcome.answer
    found = outcome_from(answer) if answer else None
    bad_plan = None if found is None else found.plan_alarm
    rms, used, truth = (
        answer.get(name) or {} for name in ("rms_innovation", "observations", "truth")
    )
    return {
        "mission": outcome.name,
        "status": answer.get("status", "failed"),
        "verdict": "do not use" if found is None else found.verdict.word,
        "profiles_used": used.get("used"),
        "profiles_rejected": used.get("rejected"),
        "dives": len(answer["by_dive"]) if answer else None,
        "rms_ensemble_m_s": rms.get("prior"),
        "rms_before_m_s": rms.get("before"),
        "rms_after_m_s": rms.get("after"),
        "nis_per_dof": answer.get("nis_per_dof"),
        "truth_rmse_m_s": truth.get("rmse"),
        "truth_ensemble_mean_rmse_m_s": truth.get("ensemble_mean_rmse"),
        "contradictions": " ".join(
            sorted({finding["name"] for finding in answer.get("consistency", ())})
        ),
        "plan": (answer.get("plan") or {}).get("status"),
        "plan_alarm": None if bad_plan is None else bad_plan.text,
        "seconds": answer.get("seconds_in_all"),
        "sha256": outcome.sha256,
        "failed": outcome.failed,
    }


def write_table(outcomes: Sequence[Outcome], path: Path) -> None:
    """Write the table as CSV, completely or not at all; undefined figures are empty."""
    rows = [row_of(outcome) for outcome in outcomes]
    write_whole(path, csv_text(rows, rows[0]))


def fleet_json(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return the table for JSON."""
    failed = [outcome.name for outcome in outcomes if outcome.failed]
    code = exit_code(outcomes)
    return {
        "status": "failed" if failed else "done",
        "exit_code": code,
        "failed": failed,
        "missions": [row_of(each) for each in outcomes],
    }


def print_fleet(outcomes: Sequence[Outcome], console: Console) -> None:
    """Print the table, and below it the reasons of failed missions."""
    rows = [row_of(outcome) for outcome in outcomes]
    print_lines(
        console,
        [f"ALARM: {row['mission']}: {row['plan_alarm']}" for row in rows if row["plan_alarm"]],
    )
    print_table(console, "Missions", _COLUMNS, map(_cells, rows))
    kept, failed = (
        sum(outcome.kept for outcome in outcomes),
        [outcome for outcome in outcomes if outcome.failed],
    )
    ran = len(outcomes) - kept - len(failed)
    print_lines(
        console,
        [
            f"{len(outcomes)} missions: {ran} replayed, {kept} were there already, {len(failed)} failed"
        ],
    )
    print_lines(console, [f"FAILED: {outcome.name}: {outcome.failed}" for outcome in failed])


def _cells(row: Mapping[str, Any]) -> tuple[str, ...]:
    speeds = (_number(row[f"rms_{name}_m_s"], 100.0, 2) for name in ("ensemble", "before", "after"))
    counts = (str("" if row[name] is None else row[name]) for name in ("profiles_used", "dives"))
    return (
        row["mission"],
        row["status"],
        row["verdict"],
        row["plan"] or "",
        *counts,
        *speeds,
        _number(row["nis_per_dof"], 1.0, 2),
        row["contradictions"],
        _number(row["seconds"]),
    )


def _number(value: float | None, factor: float = 1.0, digits: int = 1) -> str:
    return "" if value is None else f"{factor * value:.{digits}f}"
