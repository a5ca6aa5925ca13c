"""The outcomes of a fleet as one table, for CSV, JSON and the console, and as a page."""

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from replay_kit.core.atomic import write_whole
from replay_kit.core.colors import LINES
from replay_kit.core.text import csv_text
from replay_kit.results.outcome.outcome import outcome_from
from replay_kit.show.figures.figure import Axis, Figure, Mark, Panel
from replay_kit.show.page.page import Section, items_html, page_html, table_html
from replay_kit.show.text import print_lines, print_table
from replay_kit.workflows.fleet.run import Outcome

TABLE, PAGE = "fleet.csv", "index.html"
#: Of several exit codes the first of these counts.
_CODES = (1, 2, 3, 7, 4, 6)


def exit_code(outcomes: Sequence[Outcome]) -> int:
    """Return the exit code of a fleet: of its missions' codes the gravest, 0 where all are."""
    codes = {outcome.exit_code for outcome in outcomes}
    return next((code for code in _CODES if code in codes), 0)


def row_of(outcome: Outcome) -> dict[str, Any]:
    """Return the figures of a mission by their columns; those that it has not are None."""
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
    """Write the table as CSV, whole or not at all; undefined figures are empty."""
    rows = [row_of(outcome) for outcome in outcomes]
    write_whole(path, csv_text(rows, rows[0]))


def fleet_json(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return the JSON object of ``--json``."""
    failed = [outcome.name for outcome in outcomes if outcome.failed]
    code = exit_code(outcomes)
    return {
        "status": "failed" if failed else "done",
        "exit_code": code,
        "failed": failed,
        "missions": [row_of(each) for each in outcomes],
    }


def print_fleet(outcomes: Sequence[Outcome], console: Console) -> None:
    """Print the table, and below it why missions failed."""
    rows = [row_of(outcome) for outcome in outcomes]
    print_lines(
        console,
        [f"ALARM: {row['mission']}: {row['plan_alarm']}" for row in rows if row["plan_alarm"]],
    )
    columns = (
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
    print_table(console, "Missions", columns, map(_cells, rows))
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


_COLORS, _SYMBOLS = ("#8C8C8C", LINES[0], LINES[2]), ("diamond", "circle", "square")
_ERRORS = {
    "prior forecast": "rms_ensemble_m_s",
    "before each update": "rms_before_m_s",
    "after each update": "rms_after_m_s",
}
_CAPTIONS = {
    "errors": "Lower is better: where the estimate before each update lies below the prior forecast, it predicts what comes next.",
    "truth": "Lower is better: where the estimate lies below the ensemble mean, the measurements helped.",
    "nis": "Near 1 the stated errors fit; above it they are too small.",
}
_TRUTH = {"ensemble mean": "truth_ensemble_mean_rmse_m_s", "estimate": "truth_rmse_m_s"}
# Normalised innovations squared per degree of freedom between which stated errors are taken for right, as in the verdict of a replay.
_SOUND = (0.5, 2.0)


def write_page(outcomes: Sequence[Outcome], path: Path) -> None:
    """Write the page, whole or not at all."""
    write_whole(path, fleet_page(outcomes))


def fleet_page(outcomes: Sequence[Outcome]) -> str:
    """Return the page."""
    rows = [row_of(outcome) for outcome in outcomes]
    done = [row for row in rows if not row["failed"]]
    figures = [
        _figure(
            "errors",
            "Difference to the measurements, mission by mission",
            "RMS difference [cm/s]",
            done,
            _ERRORS,
        ),
        _figure("truth", "Error against the known truth", "RMSE [cm/s]", done, _TRUTH),
        _figure(
            "nis",
            "Errors of predictions over their stated size",
            "NIS per degree of freedom [1]",
            done,
            {"NIS": "nis_per_dof"},
        ),
    ]
    sections = [
        Section(
            "answer", "In words", items_html([escape(text) for text in _sentences(rows, done)])
        ),
        Section(
            "consistency",
            "Errors and consistency",
            figures=[figure for figure in figures if figure is not None],
        ),
        Section("table", "Every mission", _table(rows)),
    ]
    return page_html(f"A fleet of {len(rows)} missions", sections)


def _sentences(rows: Sequence[Mapping[str, Any]], done: Sequence[Mapping[str, Any]]) -> list[str]:
    known = [row for row in done if row["rms_ensemble_m_s"] is not None]
    helped = [row for row in known if row["rms_before_m_s"] < row["rms_ensemble_m_s"]]
    odd = [
        row["mission"]
        for row in done
        if row["nis_per_dof"] is not None and not _SOUND[0] <= row["nis_per_dof"] <= _SOUND[1]
    ]
    contradicted = [
        f"{row['mission']} ({row['contradictions']})" for row in done if row["contradictions"]
    ]
    lines = [
        *(f"{row['mission']}: {row['plan_alarm']}." for row in rows if row["plan_alarm"]),
        f"{len(done)} of {len(rows)} missions were replayed, {sum(row['dives'] for row in done)} dives and "
        f"{sum(row['profiles_used'] for row in done)} profiles.",
        f"In {len(helped)} of {len(known)} missions the estimate predicts the next measurement better than the prior forecast.",
    ]
    if odd:
        lines.append(
            f"Stated errors do not fit (NIS outside {_SOUND[0]:g} to {_SOUND[1]:g}) in: {', '.join(odd)}."
        )
    if contradicted:
        lines.append(f"Inputs contradict themselves or each other in: {', '.join(contradicted)}.")
    return [*lines, *(f"{row['mission']} failed: {row['failed']}" for row in rows if row["failed"])]


def _figure(
    key: str, title: str, axis: str, rows: Sequence[Mapping[str, Any]], series: Mapping[str, str]
) -> Figure | None:
    """Return series over the missions as a figure; None where no mission has them."""
    factor = 100.0 if "cm/s" in axis else 1.0
    known = [row for row in rows if all(row[name] is not None for name in series.values())]
    if not known:
        return None
    names = tuple(row["mission"] for row in known)
    values = {
        label: np.array([factor * row[name] for row in known]) for label, name in series.items()
    }
    marks = [
        Mark("points", np.arange(len(known)), f"values.{label}", label, color, symbol, size=8.0)
        for label, color, symbol in zip(values, _COLORS, _SYMBOLS, strict=False)
    ]
    spans = "; ".join(
        f"{label} {min(each):.4g} to {max(each):.4g}" for label, each in values.items()
    )
    words = f"{title}: {axis} of {len(known)} missions; {spans}."
    panel = Panel(title, Axis("mission", labels=names), Axis(axis), marks)
    tables = {"values": {"mission": names, **values}}
    return Figure(key, title, [panel], tables, _CAPTIONS[key], words)


def _table(rows: Sequence[Mapping[str, Any]]) -> str:
    heads = [name for name in rows[0] if name not in ("sha256", "failed")]
    return table_html(
        [name.replace("_", " ") for name in heads],
        [[_cell(row, name) for name in heads] for row in rows],
        "Missions",
    )


def _cell(row: Mapping[str, Any], name: str) -> str:
    value = row[name]
    if name == "mission" and not row["failed"]:
        return f'<a href="{escape(value)}.mcap">{escape(value)}</a>'
    return (
        "-" if value is None else escape(f"{value:.4g}" if isinstance(value, float) else str(value))
    )
