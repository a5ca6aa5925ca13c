"""Outcomes of a fleet as a table for CSV, JSON, console and page; and expected memory and time of its missions."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from html import escape
from pathlib import Path
from typing import Any

from rich.console import Console

from replay_kit.core.files.atomic import write_whole
from replay_kit.core.words.text import csv_text
from replay_kit.results.outcome.outcome import Outcome as Replayed
from replay_kit.results.outcome.outcome import outcome_from
from replay_kit.show.page.page import Section, items_html, page_html, table_html
from replay_kit.show.sentences import COLUMNS, vehicle_rows
from replay_kit.show.text import print_lines, print_table
from replay_kit.workflows.fleet.run import Outcome
from replay_kit.workflows.replay.inputs.checks import DryRun

TABLE, PAGE = "fleet.csv", "index.html"
# The report's table of several vehicles.
_COLUMNS = ("mission", *COLUMNS[1:])
#: Of several exit codes the first of these counts.
_CODES = (1, 2, 3, 7, 4, 6)


def exit_code(outcomes: Sequence[Outcome]) -> int:
    """Return the most severe exit code of the missions, or 0."""
    codes = {outcome.exit_code for outcome in outcomes}
    return next((code for code in _CODES if code in codes), 0)


def row_of(outcome: Outcome) -> dict[str, Any]:
    """Return the figures of a mission by column; None where undefined."""
    answer, found = outcome.answer, _found(outcome)
    each = {"": found, **found.vehicles} if found else {}
    rms, used, truth = (
        answer.get(name) or {} for name in ("rms_innovation", "observations", "truth")
    )
    return {
        "mission": outcome.name,
        "status": answer.get("status", "failed"),
        "verdict": found.verdict.word if found else "do not use",
        "observations_used": used.get("used"),
        "observations_rejected": used.get("rejected"),
        "dives": sum(len(one.by_dive) for one in each.values()) if answer else None,
        "rms_ensemble_m_s": rms.get("prior"),
        "rms_before_m_s": rms.get("before"),
        "rms_after_m_s": rms.get("after"),
        "nis_per_dof": answer.get("nis_per_dof"),
        "truth_rmse_m_s": truth.get("rmse"),
        "truth_ensemble_mean_rmse_m_s": truth.get("ensemble_mean_rmse"),
        "contradictions": " ".join(sorted({one["name"] for one in answer.get("consistency", ())})),
        "plan": _named({name: one.plan["status"] for name, one in each.items() if one.plan}),
        "plan_alarm": _named(
            {name: one.plan_alarm.text for name, one in each.items() if one.plan_alarm}
        ),
        "seconds": answer.get("seconds_in_all"),
        "sha256": outcome.sha256,
        "failed": outcome.failed,
    }


def _named(texts: Mapping[str, str]) -> str | None:
    """Return texts of vehicles with their names, without one for a single vehicle; None without texts."""
    return "; ".join(f"{name}: {text}" if name else text for name, text in texts.items()) or None


def _found(outcome: Outcome) -> Replayed | None:
    """Return the outcome of the replay; None of a mission that failed."""
    return outcome_from(outcome.answer) if outcome.answer else None


def write_table(outcomes: Sequence[Outcome], path: Path) -> None:
    """Write the table as CSV, completely or not at all; undefined figures are empty."""
    rows = [row_of(outcome) for outcome in outcomes]
    write_whole(path, csv_text(rows, rows[0]))


def fleet_json(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return the table for JSON."""
    failed = [outcome.name for outcome in outcomes if outcome.failed]
    return {
        "status": "failed" if failed else "done",
        "exit_code": exit_code(outcomes),
        "failed": failed,
        "missions": [row_of(each) for each in outcomes],
    }


def print_fleet(outcomes: Sequence[Outcome], console: Console) -> None:
    """Print the table, and below it the reasons of failed missions."""
    for row in map(row_of, outcomes):
        if alarm := row["plan_alarm"]:
            print_lines(console, [f"ALARM: {row['mission']}: {alarm}"])
    print_table(console, "Missions", _COLUMNS, _cells(outcomes))
    kept = sum(outcome.kept for outcome in outcomes)
    failed = [f"FAILED: {outcome.name}: {outcome.failed}" for outcome in outcomes if outcome.failed]
    ran = len(outcomes) - kept - len(failed)
    said = (
        f"{len(outcomes)} missions: {ran} replayed, {kept} were there already, {len(failed)} failed"
    )
    print_lines(console, [said, *failed])


def _cells(outcomes: Sequence[Outcome]) -> list[tuple[str, ...]]:
    """Return a row for each mission, as for vehicles of one replay."""
    each = {one.name: found for one in outcomes if (found := _found(one))}
    rows = {row[0]: row for row in vehicle_rows(Replayed(vehicles=each))}
    failed = *[""] * (len(_COLUMNS) - 2), "failed"
    return [rows.get(one.name, (one.name, *failed)) for one in outcomes]


def write_page(outcomes: Sequence[Outcome], path: Path) -> None:
    """Write the page, completely or not at all."""
    write_whole(path, fleet_page(outcomes))


def fleet_page(outcomes: Sequence[Outcome]) -> str:
    """Return the page with alarms, the table, and the reasons of failed missions."""
    rows, cells = [row_of(outcome) for outcome in outcomes], list[list[str]]()
    for row, (name, *others) in zip(rows, _cells(outcomes), strict=True):
        shown = escape(name)
        link = shown if row["failed"] else f'<a href="{shown}.mcap">{shown}</a>'
        cells.append([link, *map(escape, others)])
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


def print_expected(found: Mapping[str, DryRun | Outcome], workers: int, console: Console) -> None:
    """Print the expected memory and time of missions by name, or why they cannot be replayed."""
    answer, each = expected_json(found, workers), list[str]()
    for name, one in found.items():
        each += [f"{name}: {one}" if isinstance(one, DryRun) else f"FAILED: {name}: {one.failed}"]
    said = (
        f"{len(answer['missions'])} missions on {workers} workers: about {answer['seconds']:.0f} s of updates; up to "
        f"{answer['memory_mb']:.0f} MB in all. Nothing was written."
    )
    print_lines(console, [*each, said])
