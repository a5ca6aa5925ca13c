"""Outcomes of a fleet as a table for CSV, JSON, console and page; and expected memory and time of its missions."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from html import escape
from math import prod
from pathlib import Path
from typing import Any

from rich.console import Console

from replay_kit.core.files.atomic import write_whole
from replay_kit.core.words.text import csv_text
from replay_kit.results.outcome.outcome import outcome_from
from replay_kit.show.page.page import Section, items_html, page_html, table_html
from replay_kit.show.text import print_lines, print_table
from replay_kit.workflows.fleet.run import Outcome
from replay_kit.workflows.replay.inputs.checks import DryRun

TABLE, PAGE = "fleet.csv", "index.html"
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
    each = (answer, *(answer.get("vehicles") or {}).values())
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
        "dives": sum(len(one["by_dive"]) for one in each) if answer else None,
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


def write_page(outcomes: Sequence[Outcome], path: Path) -> None:
    """Write the page, completely or not at all."""
    write_whole(path, fleet_page(outcomes))


def fleet_page(outcomes: Sequence[Outcome]) -> str:
    """Return the page with alarms, the table, and the reasons of failed missions."""
    rows = [row_of(outcome) for outcome in outcomes]
    cells = [list(map(escape, _cells(row))) for row in rows]
    for row, each in zip(rows, cells, strict=True):
        each[0] = each[0] if row["failed"] else f'<a href="{each[0]}.mcap">{each[0]}</a>'
    alarms, failed = (
        items_html([escape(f"{row['mission']}: {row[name]}") for row in rows if row[name]])
        for name in ("plan_alarm", "failed")
    )
    html = f"{alarms}{table_html(_COLUMNS, cells, 'Missions')}{failed}"
    return page_html(f"A fleet of {len(rows)} missions", [Section("table", "Every mission", html)])


def expected_json(found: Mapping[str, DryRun | Outcome], workers: int) -> dict[str, Any]:
    """Return the expected memory and time of missions by name for JSON, or why they cannot be replayed."""
    each = {name: one for name, one in found.items() if isinstance(one, DryRun)}
    failed = [one for one in found.values() if isinstance(one, Outcome)]
    seconds = [one.seconds for one in each.values()]
    return {
        "status": "dry run",
        "exit_code": failed[0].exit_code if failed else 0,
        "workers": workers,
        "seconds": max(sum(seconds) / workers, *seconds, 0.0),
        "memory_mb": workers * max((one.memory_mb for one in each.values()), default=0.0),
        "missions": [{"mission": name, **asdict(one)} for name, one in each.items()],
        "failed": {one.name: one.failed for one in failed},
    }


def print_expected(answer: Mapping[str, Any], console: Console) -> None:
    """Print the expected memory and time of missions from ``expected_json``, or why they cannot be replayed."""
    columns = ("mission", "profiles", "points", "levels", "updates [s]", "memory [MB]")
    rows = [
        (
            one["mission"],
            str(one["profiles"]),
            str(prod(one["grid"])),
            str(len(one["levels"])),
            f"{one['seconds']:.1f}",
            f"{one['memory_mb']:.0f}",
        )
        for one in answer["missions"]
    ]
    print_table(console, "Expected", columns, rows)
    print_lines(console, [f"FAILED: {name}: {why}" for name, why in answer["failed"].items()])
    print_lines(
        console,
        [
            f"{len(rows)} missions on {answer['workers']} workers: about {answer['seconds']:.0f} s of updates; up to "
            f"{answer['memory_mb']:.0f} MB in all. Nothing was written."
        ],
    )
