"""The summary of a replay as JSON, and as the result keeps it."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from replay_kit.core.errors import ReplayKitError, finding_json
from replay_kit.results.alarms import alarms_json
from replay_kit.results.evidence.summary import evidence_json, referee_json
from replay_kit.results.flight_correction import flight_correction_json
from replay_kit.results.losses import loss_json
from replay_kit.results.summary import ReplaySummary
from replay_kit.results.summary_plan import outcomes_json, plan_json
from replay_kit.results.surfacings.summary import surfacings_json
from replay_kit.results.text import coded

_STATUS = {0: "done", 4: "loss", 6: "inconsistent"}


def to_json(summary: ReplaySummary) -> dict[str, Any]:
    """Return the summary as the JSON object of ``--json``; undefined figures are null."""
    plan, found = (
        plan_json(summary.plan, summary.plan_note),
        [finding_json(finding) for finding in summary.findings],
    )
    summary_json: dict[str, Any] = _plain(
        {
            "status": _STATUS[summary.exit_code],
            "exit_code": summary.exit_code,
            "exit_codes": list(summary.exit_codes),
            "alarms": alarms_json({"plan": plan, "consistency": found}),
            "verdict": list(summary.verdict),
            "consistency": found,
            "messages": [asdict(row) | {"reasons": coded(row.reasons)} for row in summary.messages],
            "losses": [{"file": path} | loss_json(loss) for path, loss in summary.losses],
            "late": summary.late,
            "observations": {
                "used": summary.profiles_used,
                "rejected": summary.profiles_rejected,
                "bins_used": summary.bins_used,
                "bins_rejected": dict(summary.bins_rejected),
            },
            "rms_innovation": {
                "before": summary.rms_before,
                "after": summary.rms_after,
                "prior": summary.rms_prior,
            },
            "nis_per_dof": summary.nis_per_dof,
            "by_dive": [asdict(row) for row in summary.by_dive],
            "seconds": dict(summary.seconds),
            "plan": plan,
            "surfacings": outcomes_json(summary.outcomes) if summary.outcomes else None,
            "evidence": None if summary.evidence is None else evidence_json(summary.evidence),
            "referee": _referee(summary),
            "expected_surfacings": surfacings_json(summary.surfacings, summary.next_surfacing)
            if summary.surfacings
            else None,
            "flight_correction": flight_correction_json(summary.flight_correction)
            if summary.flight_correction
            else None,
            "truth": asdict(summary.truth) if summary.truth else None,
            "notes": list(summary.notes),
            "lost_pings": summary.lost_pings,
        }
    )
    return summary_json


def _referee(summary: ReplaySummary) -> dict[str, Any] | None:
    """Return how the forecasts explained the log; None where the run has one alone."""
    return (
        referee_json(summary.ensemble, summary.evidence, summary.rivals)
        if summary.rivals and summary.evidence is not None
        else None
    )


def failure_json(error: ReplayKitError, summary: ReplaySummary | None = None) -> dict[str, Any]:
    """Return what ``--json`` says of a run that ended with an error: its message, all exit codes that apply, the contradictions found.

    Args:
        error: What ended it.
        summary: Of the run until then; None when it had not begun.
    """
    found = [finding_json(finding) for finding in error.findings]
    so_far = {} if summary is None else to_json(replace(summary, findings=error.findings))
    codes = [error.exit_code, *so_far.get("exit_codes", ())]
    return so_far | {
        "status": "failed",
        "error": str(error),
        "exit_code": codes[0],
        "exit_codes": codes,
        "consistency": found,
    }


def to_record(summary: ReplaySummary, inputs: Sequence[Path]) -> dict[str, Any]:
    """Return what a result keeps of its summary: ``to_json`` without wall times and alarms, with inputs' names and not their folders.

    Alarms follow from the rest, and are made of it when a result is read.

    Args:
        summary: Of the run.
        inputs: Logs and files of the ensemble.
    """
    record = {
        key: value for key, value in to_json(summary).items() if key not in ("seconds", "alarms")
    }
    paths = {str(path): path.name for path in inputs}

    def named(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: named(item) for key, item in value.items()}
        if isinstance(value, list):
            return [named(item) for item in value]
        for path, name in paths.items() if isinstance(value, str) else ():
            value = value.replace(path, name)
        return value

    return {key: named(value) for key, value in record.items()}


def _plain(value: Any) -> Any:
    """Return a value with NaN and infinities as None, tuples as lists, NumPy scalars as Python's."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
