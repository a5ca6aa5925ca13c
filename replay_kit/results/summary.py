"""What a replay found, as one frozen value, as JSON and as the table a person reads at the end of a run."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from replay_kit.core.arrays import Array
from replay_kit.core.message import Loss
from replay_kit.core.plan import Plan
from replay_kit.core.surfacing import Outcome
from replay_kit.logs.losses import loss_json, loss_words
from replay_kit.results.summary_plan import outcomes_in_words, outcomes_json, plan_in_words, plan_json


@dataclass(frozen=True, slots=True)
class TopicRow:
    """How one topic's messages fared.

    Attributes:
        topic: Its name.
        read: Messages met.
        used: Messages that an observation or a position was made of.
        skipped: The others.
        reasons: Reason to count, of those skipped.
    """

    topic: str
    read: int
    used: int
    skipped: int
    reasons: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class DiveRow:
    """How one dive's profiles compared with their predictions.

    Attributes:
        dive: The dive's number.
        profiles: Profiles used.
        bins: Bins used.
        rms_predicted: RMS component of measured minus predicted from all dives before [m/s].
        rms_prior: RMS component of measured minus predicted from the ensemble alone [m/s].
        nis_per_dof: Normalised innovation squared per degree of freedom, as updated profile by profile.
    """

    dive: int
    profiles: int
    bins: int
    rms_predicted: float
    rms_prior: float
    nis_per_dof: float


@dataclass(frozen=True, slots=True)
class TruthScore:
    """The estimate against a known truth.

    Attributes:
        rmse: RMS length of the error vector over the wet grid points scored [m/s].
        rel_error: ``rmse`` over the truth's RMS speed there.
        ensemble_mean_rmse: The same as ``rmse`` for the ensemble's mean [m/s].
        points: Grid points scored.
        closest_approach_m: Of the plan, flown in the truth; NaN without a goal.
        ensemble_mean_closest_approach_m: Of the plan made on the ensemble's mean, flown in the truth.
    """

    rmse: float
    rel_error: float
    ensemble_mean_rmse: float
    points: int
    closest_approach_m: float
    ensemble_mean_closest_approach_m: float


@dataclass(frozen=True, slots=True)
class ReplaySummary:
    """Everything a replay has to say, apart from its output file.

    Attributes:
        messages: A row a topic.
        losses: Damage met in the logs, with the log's path.
        late: Messages that came later than the reorder window allows.
        profiles_used: Profiles the estimate was updated with.
        profiles_rejected: Profiles without a usable bin.
        bins_used: Bins used.
        bins_rejected: Reason to count of bins, by name; a bin can have several.
        rms_before: RMS component of the innovations [m/s].
        rms_after: RMS component of the residuals after each update [m/s].
        rms_prior: RMS component of measured minus predicted from the ensemble alone [m/s].
        nis_per_dof: Mean normalised innovation squared per degree of freedom.
        by_dive: A row a dive; empty for a surface vessel.
        seconds: Wall time of each stage.
        plan: The last plan.
        plan_note: Why there is no plan although a goal was given; empty otherwise.
        outcomes: Surfacings that plans said would be next, beside the vehicle's.
        truth: Score against a truth, if one was given.
        notes: What the user should know.
    """

    messages: tuple[TopicRow, ...]
    losses: tuple[tuple[str, Loss], ...]
    late: int
    profiles_used: int
    profiles_rejected: int
    bins_used: int
    bins_rejected: Mapping[str, int]
    rms_before: float
    rms_after: float
    rms_prior: float
    nis_per_dof: float
    by_dive: tuple[DiveRow, ...]
    seconds: Mapping[str, float] = field(default_factory=dict)
    plan: Plan | None = None
    plan_note: str = ""
    outcomes: tuple[Outcome, ...] = ()
    truth: TruthScore | None = None
    notes: tuple[str, ...] = ()

    @property
    def exit_code(self) -> int:
        """4 when bytes, frames or late messages were lost, else 0."""
        return 4 if self.losses or self.late else 0


def rms(values: Array) -> float:
    """Return the root mean square of the finite values; NaN when there is none."""
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if finite.size else math.nan


def to_json(summary: ReplaySummary) -> dict[str, Any]:
    """Return the summary as the JSON object of ``--json``; undefined figures are null."""
    answer: dict[str, Any] = _plain(
        {
            "status": "loss" if summary.exit_code == 4 else "done",
            "exit_code": summary.exit_code,
            "messages": [
                {"topic": row.topic, "read": row.read, "used": row.used, "skipped": row.skipped, "reasons": dict(row.reasons)}
                for row in summary.messages
            ],
            "losses": [{"file": path} | loss_json(loss) for path, loss in summary.losses],
            "late": summary.late,
            "observations": {
                "used": summary.profiles_used,
                "rejected": summary.profiles_rejected,
                "bins_used": summary.bins_used,
                "bins_rejected": dict(summary.bins_rejected),
            },
            "rms_innovation": {"before": summary.rms_before, "after": summary.rms_after, "prior": summary.rms_prior},
            "nis_per_dof": summary.nis_per_dof,
            "by_dive": [
                {
                    "dive": row.dive,
                    "profiles": row.profiles,
                    "bins": row.bins,
                    "rms_innovation_predicted": row.rms_predicted,
                    "rms_innovation_prior": row.rms_prior,
                    "nis_per_dof": row.nis_per_dof,
                }
                for row in summary.by_dive
            ],
            "seconds": dict(summary.seconds),
            "plan": plan_json(summary.plan)
            if summary.plan
            else ({"status": "failed", "message": summary.plan_note} if summary.plan_note else None),
            "surfacings": outcomes_json(summary.outcomes) if summary.outcomes else None,
            "truth": _truth_json(summary.truth) if summary.truth else None,
            "notes": list(summary.notes),
        }
    )
    return answer


def _truth_json(truth: TruthScore) -> dict[str, Any]:
    return {name: getattr(truth, name) for name in TruthScore.__dataclass_fields__}


def _plain(value: Any) -> Any:
    """Return a value with NaN and infinities as None, arrays as lists."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.integer):
        return int(value)
    return value


def print_summary(summary: ReplaySummary, console: Console) -> None:
    """Print the tables and sentences a person reads at the end of a replay."""
    table = Table("topic", "read", "used", "skipped", "why", title="Messages", title_justify="left")
    for row in summary.messages:
        why = "; ".join(f"{count} x {reason}" for reason, count in sorted(row.reasons.items()))
        table.add_row(row.topic, str(row.read), str(row.used), str(row.skipped), why)
    console.print(table)
    _print_estimate(summary, console)
    if summary.by_dive:
        console.print(_dive_table(summary))
    if summary.plan is not None:
        _say(console, f"Plan: {plan_in_words(summary.plan)}")
    elif summary.plan_note:
        _say(console, f"Plan: none; {summary.plan_note}")
    if summary.outcomes:
        _say(console, f"Surfacings: {outcomes_in_words(summary.outcomes)}")
    if summary.truth is not None:
        _print_truth(summary.truth, console)
    _say(console, "Time: " + ", ".join(f"{stage} {seconds:.2f} s" for stage, seconds in summary.seconds.items()))
    for note in summary.notes:
        _say(console, f"Note: {note}")
    for path, loss in summary.losses:
        _say(console, f"LOST: {path}: {loss_words(loss)}")
    if summary.late:
        _say(console, f"LOST: {summary.late} messages came later than the reorder window allows; widen logs.reorder_window")


def _print_estimate(summary: ReplaySummary, console: Console) -> None:
    rejected = ", ".join(f"{count} {name}" for name, count in summary.bins_rejected.items()) or "none"
    _say(
        console,
        f"Observations: {summary.profiles_used} profiles used ({summary.bins_used} bins), "
        f"{summary.profiles_rejected} rejected; bins not used: {rejected}",
    )
    _say(
        console,
        f"RMS innovation: {_cm(summary.rms_before)} before each update, {_cm(summary.rms_after)} after it, "
        f"{_cm(summary.rms_prior)} against the ensemble alone; NIS per degree of freedom {summary.nis_per_dof:.2f}",
    )


def _dive_table(summary: ReplaySummary) -> Table:
    table = Table(
        "dive",
        "profiles",
        "bins",
        "predicted from dives before",
        "from the ensemble alone",
        "NIS/dof",
        title="RMS innovation by dive",
        title_justify="left",
    )
    for row in summary.by_dive:
        table.add_row(str(row.dive), str(row.profiles), str(row.bins), _cm(row.rms_predicted), _cm(row.rms_prior), f"{row.nis_per_dof:.2f}")
    return table


def _print_truth(truth: TruthScore, console: Console) -> None:
    _say(
        console,
        f"Against the truth over {truth.points} grid points: RMSE {_cm(truth.rmse)} (relative error {truth.rel_error:.3f}); "
        f"ensemble mean {_cm(truth.ensemble_mean_rmse)}",
    )
    if math.isfinite(truth.closest_approach_m):
        _say(
            console,
            f"Flown in the truth, the plan passes {truth.closest_approach_m:.0f} m from the goal; "
            f"the ensemble mean's plan {truth.ensemble_mean_closest_approach_m:.0f} m",
        )


def _say(console: Console, sentence: str) -> None:
    # a sentence stays one line in a pipe
    console.print(sentence, soft_wrap=True)


def _cm(value: float) -> str:
    return f"{100.0 * value:.2f} cm/s"
