"""The outcome of a run that has just ended: its plan, surfacings, log evidence and correction in the values of JSON."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from functools import reduce
from typing import Any

import numpy as np

from replay_kit.core.as_flown import FlightCorrection
from replay_kit.core.errors import ReplayKitError, finding_json
from replay_kit.core.evidence import BlockEvidence, Evidence, compare
from replay_kit.core.observation import Fix
from replay_kit.core.plan import Plan, leg_statistics
from replay_kit.core.surfacing import (
    DiveForecast,
    DiveOutcome,
    Ellipse,
    SurfacingOutcome,
    calibrated,
    held_shares,
)
from replay_kit.results.losses import coded, loss_json
from replay_kit.results.outcome.outcome import Outcome
from replay_kit.results.outcome.run import ReplaySummary, Rival

_KINDS = ("first", "second", "later")


def plan_json(plan: Plan | None, note: str = "") -> dict[str, Any] | None:
    """Return a plan's figures for JSON; without a plan that it failed, with the note why, and None without a note."""
    if plan is None:
        return {"status": "failed", "message": note} if note else None
    return {
        "status": plan.status,
        "closest_approach_m": plan.closest_approach,
        "heading_deg": plan.heading_deg,
        "glide_angle_deg": plan.glide_angle_deg,
        "speed": plan.speed,
        "duration_s": plan.duration,
        "start": [plan.start.longitude, plan.start.latitude, plan.start.depth],
        "goal": [plan.goal.longitude, plan.goal.latitude, plan.goal.depth],
        "message": plan.message,
        "statistics": {**plan.statistics, **leg_statistics(plan.legs)},
        "energy_j": _finite(plan.energy),
        "battery_j": _finite(plan.battery),
        "odds": None if plan.odds is None else asdict(plan.odds),
    }


def _finite(number: float) -> float | None:
    return number if np.isfinite(number) else None


def outcomes_json(outcomes: Sequence[SurfacingOutcome]) -> dict[str, Any]:
    """Return the figures of some surfacings, one at least, for JSON."""
    return {**_outcome_figures(outcomes), "each": [_outcome_json(outcome) for outcome in outcomes]}


def _outcome_json(outcome: SurfacingOutcome) -> dict[str, Any]:
    predicted = outcome.predicted
    return {
        "planned_ns": outcome.planned_ns,
        "predicted_ns": predicted.time_ns,
        "predicted": [predicted.longitude, predicted.latitude],
        "time_ns": outcome.time_ns,
        "actual": [outcome.longitude, outcome.latitude],
        "distance_m": outcome.distance,
        "direction_deg": outcome.direction_deg,
        "delay_s": outcome.late,
        "inside_ellipse": outcome.inside,
    }


def _outcome_figures(outcomes: Sequence[SurfacingOutcome]) -> dict[str, Any]:
    inside = [outcome.inside for outcome in outcomes if outcome.inside is not None]
    return {
        "count": len(outcomes),
        "distance_median_m": float(np.median([outcome.distance for outcome in outcomes])),
        "delay_median_s": float(np.median([outcome.late for outcome in outcomes])),
        "inside_ellipse": float(np.mean(inside)) if inside else None,
    }


def surfacings_json(
    outcomes: Sequence[DiveOutcome], following: DiveForecast | None
) -> dict[str, Any]:
    """Return the figures of expected surfacings for JSON.

    Args:
        outcomes: Dive by dive; at least one.
        following: The coming surfacing; None where it is not expected.
    """
    groups = {kind: [one for one in outcomes if _kind(one) == kind] for kind in _KINDS}
    return {
        **_surfacing_figures(outcomes),
        **{kind: _surfacing_figures(group) if group else None for kind, group in groups.items()},
        "each": [_dive_json(one) for one in outcomes],
        "next": None if following is None else _forecast_json(calibrated(following, outcomes)),
    }


def _kind(outcome: DiveOutcome) -> str:
    return _KINDS[min(outcome.forecast.earlier, 2)]


def _surfacing_figures(outcomes: Sequence[DiveOutcome]) -> dict[str, Any]:
    """Return hits, score and sharpness of surfacings, one at least; figures beside the last dive's current where that has a spread."""
    inner, outer = held_shares(outcomes)
    beside = [one for one in outcomes if math.isfinite(one.persistent_log_score)]
    distances = [one.distance for one in outcomes]
    return {
        "count": len(outcomes),
        "inside_50": inner,
        "inside_90": outer,
        "distance_median_m": float(np.median(distances)),
        "distance_rms_m": float(np.sqrt(np.mean(np.square(distances)))),
        "radius_90_mean_m": float(np.mean([one.forecast.radius for one in outcomes])),
        "log_score": float(np.mean([one.log_score for one in outcomes])),
        "log_score_gain": float(
            np.mean([one.log_score - one.persistent_log_score for one in beside])
        )
        if beside
        else None,
        "radius_ratio": _ratio(
            [one.forecast.radius for one in beside],
            [one.forecast.persistent_radius for one in beside],
        ),
    }


def _ratio(ours: Sequence[float], others: Sequence[float]) -> float | None:
    return float(np.sum(ours) / np.sum(others)) if others and np.sum(others) > 0.0 else None


def _dive_json(outcome: DiveOutcome) -> dict[str, Any]:
    return {
        **_forecast_json(outcome.forecast),
        "actual": _place(outcome.fix),
        "distance_m": outcome.distance,
        "direction_deg": outcome.direction_deg,
        "inside_50": outcome.in_inner,
        "inside_90": outcome.in_outer,
        "log_score": outcome.log_score,
        "persistent_log_score": outcome.persistent_log_score,
        "persistent_distance_m": outcome.persistent_distance,
    }


def _forecast_json(forecast: DiveForecast) -> dict[str, Any]:
    return {
        "dive": forecast.dive,
        "earlier_dives": forecast.earlier,
        "begin_ns": forecast.start.time_ns,
        "time_ns": forecast.time_ns,
        "start": _place(forecast.start),
        "expected": _place(forecast),
        "ellipse_50": _ellipse_json(forecast.inner),
        "ellipse_90": _ellipse_json(forecast.outer),
        "radius_90_m": forecast.radius,
        "persistent_radius_90_m": forecast.persistent_radius,
        # of a log with mean currents nothing needs to be said
        **({} if forecast.basis == "mean_currents" else {"basis": forecast.basis}),
        **({"scored": forecast.scored} if forecast.scored else {}),
        **({"calibration": forecast.factor} if math.isfinite(forecast.factor) else {}),
    }


def _place(place: Fix | DiveForecast) -> list[float]:
    return [place.longitude, place.latitude]


def _ellipse_json(ellipse: Ellipse) -> dict[str, float]:
    return {"major_m": ellipse.major, "minor_m": ellipse.minor, "bearing_deg": ellipse.bearing_deg}


def evidence_json(evidence: Evidence) -> dict[str, Any]:
    """Return the log evidence of a log, with at least one value, for JSON."""
    by_dive = [
        {"dive": dive, **_evidence_figures(block)} for dive, block in evidence.by_dive.items()
    ]
    return {**_evidence_figures(evidence.total), "by_dive": by_dive}


def referee_json(name: str, evidence: Evidence, rivals: Sequence[Rival]) -> dict[str, Any]:
    """Return how forecasts explained a log, the first against each other, for JSON.

    Args:
        name: Of the first forecast's file.
        evidence: Of the log under it.
        rivals: The others, one at least.
    """
    units = "dives" if evidence.by_dive else "hours"
    return {
        "ensemble": name,
        "units": units,
        "against": [_against(evidence, rival) for rival in rivals],
    }


def _against(evidence: Evidence, rival: Rival) -> dict[str, Any]:
    found = compare(evidence, rival.evidence)
    return {
        "ensemble": rival.name,
        "compared": found.blocks,
        "not_compared": found.skipped,
        "gain": found.gain,
        "gain_mean": found.mean,
        "interval_90": list(found.interval),
        "better": found.verdict,
        **{f"other_{key}": value for key, value in _evidence_figures(rival.evidence.total).items()},
    }


def _evidence_figures(block: BlockEvidence) -> dict[str, Any]:
    measured = block.measurements
    return {
        "log_evidence": block.log_evidence,
        "values": block.values,
        "measurements": measured,
        "per_measurement": block.log_evidence / measured if measured else math.nan,
    }


def flight_correction_json(found: FlightCorrection) -> dict[str, Any]:
    """Return the correction of one mean current at least for JSON."""
    figures = asdict(found)
    sizes = figures.pop("sizes")
    rms = math.sqrt(sum(size**2 for size in sizes) / len(sizes))
    return {"corrected": len(sizes), "rms_m_s": rms, "largest_m_s": max(sizes), **figures}


def outcome_of(summary: ReplaySummary) -> Outcome:
    """Return the outcome of a run that has just ended."""
    found: dict[str, Any] = _plain(
        {
            "observations": {
                "used": summary.profiles_used,
                "rejected": summary.profiles_rejected,
                "bins_used": summary.bins_used,
                "mean_currents": summary.mean_currents,
                "bins_rejected": dict(summary.bins_rejected),
                # of a run without any nothing needs to be said
                **(
                    {"sources": [asdict(row) for row in summary.sources]} if summary.sources else {}
                ),
            },
            "rms_innovation": {
                "before": summary.rms_before,
                "after": summary.rms_after,
                "prior": summary.rms_prior,
            },
            "nis_per_dof": summary.nis_per_dof,
            "by_dive": [asdict(row) for row in summary.by_dive],
            "plan": plan_json(summary.plan, summary.plan_note),
            "consistency": [finding_json(one) for one in summary.findings],
            "messages": [asdict(row) | {"reasons": coded(row.reasons)} for row in summary.messages],
            "losses": [{"file": path} | loss_json(loss) for path, loss in summary.losses],
            "late": summary.late,
            "surfacings": outcomes_json(summary.outcomes) if summary.outcomes else None,
            "expected_surfacings": surfacings_json(summary.surfacings, summary.next_surfacing)
            if summary.surfacings
            else None,
            "evidence": None if summary.evidence is None else evidence_json(summary.evidence),
            "referee": referee_json(summary.ensemble, summary.evidence, summary.rivals)
            if summary.rivals and summary.evidence is not None
            else None,
            "flight_correction": flight_correction_json(summary.flight_correction)
            if summary.flight_correction
            else None,
            "notes": summary.notes,
            "lost_pings": summary.lost_pings,
            "doubts": summary.doubts,
            "outside": summary.outside,
            "exit_codes": summary.exit_codes,
            "value": summary.value,
            "unused": summary.unused,
        }
    )
    names = {str(path): path.name for path in summary.inputs}
    return Outcome(
        **_named(found, names),
        seconds=dict(summary.seconds),
        truth=_plain(asdict(summary.truth)) if summary.truth else None,
        vehicles={name: outcome_of(one).to_json() for name, one in summary.vehicles.items()},
    )


def failed(error: ReplayKitError, summary: ReplaySummary | None = None) -> Outcome:
    """Return the outcome of a run that ended with an error.

    Args:
        error: What ended it.
        summary: Of the run until then; None when it had not begun.
    """
    so_far = Outcome() if summary is None else outcome_of(replace(summary, findings=error.findings))
    codes = (error.exit_code, *so_far.exit_codes)
    found = [finding_json(one) for one in error.findings]
    return replace(so_far, exit_codes=codes, error=str(error), consistency=found, complete=False)


def _named(value: Any, names: Mapping[str, str]) -> Any:
    """Return a value with inputs by their names: the folder that they are in changes no byte of a result."""
    if isinstance(value, dict):
        return {key: _named(item, names) for key, item in value.items()}
    if isinstance(value, list):
        return [_named(item, names) for item in value]
    if not isinstance(value, str):
        return value
    return reduce(lambda text, path: text.replace(path, names[path]), names, value)


def _plain(value: Any) -> Any:
    """Return a value with NaN and infinities as None, tuples as lists, NumPy scalars as Python's."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
