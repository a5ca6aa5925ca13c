"""The outcome of a run that has just ended: its plan, surfacings, log evidence and correction in the values of JSON."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from functools import reduce
from types import MappingProxyType
from typing import Any

import numpy as np

from replay_kit.core.as_flown import FlightCorrection
from replay_kit.core.errors import ReplayKitError, finding_json
from replay_kit.core.evidence import BlockEvidence, Evidence, compare
from replay_kit.core.plan import Plan, leg_statistics
from replay_kit.core.surfacing import (
    DiveForecast,
    DiveOutcome,
    SurfacingOutcome,
    calibrated,
    held_shares,
    records,
)
from replay_kit.results.losses import coded, loss_json
from replay_kit.results.outcome.outcome import Outcome
from replay_kit.results.outcome.run import ReplaySummary, Rival
from replay_kit.results.schemas import attributes

_KINDS = ("first", "second", "later")
# names of figures, and whence they are
_PLAN = "status closest_approach_m=closest_approach heading_deg glide_angle_deg speed duration_s=duration start goal message"
_SURFACED = (
    "planned_ns predicted_ns=predicted.time_ns predicted time_ns actual=longitude distance_m=distance direction_deg delay_s=late "
    "inside_ellipse=inside"
)
_DIVE = (
    "actual=fix distance_m=distance direction_deg inside_50=in_inner inside_90=in_outer log_score persistent_log_score "
    "persistent_distance_m=persistent_distance"
)
_ELLIPSE = "major_m=major minor_m=minor bearing_deg"
_AGAINST = (
    "compared=blocks not_compared=skipped gain gain_mean=mean interval_90=interval better=verdict"
)
_OBSERVATIONS = (
    "used=profiles_used rejected=profiles_rejected bins_used mean_currents bins_rejected"
)
_SAME = "nis_per_dof late notes lost_pings doubts outside exit_codes value unused"


def plan_json(plan: Plan | None, note: str = "") -> dict[str, Any] | None:
    """Return a plan's figures for JSON; without a plan that it failed, with the note why, and None without a note."""
    if plan is None:
        return {"status": "failed", "message": note} if note else None
    return attributes(plan, _PLAN) | {
        "start": [*asdict(plan.start).values()],
        "goal": [*asdict(plan.goal).values()],
        "statistics": {**plan.statistics, **leg_statistics(plan.legs)},
        "energy_j": plan.energy,
        "battery_j": plan.battery,
        "odds": None if plan.odds is None else asdict(plan.odds),
    }


def outcomes_json(outcomes: Sequence[SurfacingOutcome]) -> dict[str, Any]:
    """Return the figures of some surfacings, one at least, for JSON."""
    return {**_outcome_figures(outcomes), "each": [_outcome_json(outcome) for outcome in outcomes]}


def _outcome_json(outcome: SurfacingOutcome) -> dict[str, Any]:
    predicted, actual = _place(outcome.predicted), _place(outcome)
    return attributes(outcome, _SURFACED) | {"predicted": predicted, "actual": actual}


def _outcome_figures(outcomes: Sequence[SurfacingOutcome]) -> dict[str, Any]:
    inside = [outcome.inside for outcome in outcomes if outcome.inside is not None]
    return {
        "count": len(outcomes),
        "distance_median_m": float(np.median([outcome.distance for outcome in outcomes])),
        "delay_median_s": float(np.median([outcome.late for outcome in outcomes])),
        "inside_ellipse": float(np.mean(inside)) if inside else None,
    }


def surfacings_json(
    outcomes: Sequence[DiveOutcome],
    following: DiveForecast | None,
    planned: Sequence[SurfacingOutcome] = (),
) -> dict[str, Any]:
    """Return the figures of expected surfacings for JSON.

    Args:
        outcomes: Dive by dive; at least one.
        following: The coming surfacing; None where it is not expected.
        planned: Those that plans predicted.
    """
    count, habit, plan = records(outcomes, planned)
    groups = {kind: [one for one in outcomes if _kind(one) == kind] for kind in _KINDS}
    return {
        **_surfacing_figures(outcomes),
        **{kind: _surfacing_figures(group) if group else None for kind, group in groups.items()},
        "each": [_dive_json(one) for one in outcomes],
        "record": {
            "shown": "plan" if count and plan > habit else "habit",
            "count": count,
            "habit": habit,
            "plan": plan,
        },
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
    return (
        _forecast_json(outcome.forecast)
        | attributes(outcome, _DIVE)
        | {"actual": _place(outcome.fix)}
    )


def _forecast_json(forecast: DiveForecast) -> dict[str, Any]:
    return {
        **attributes(forecast, "dive earlier_dives=earlier begin_ns=start.time_ns time_ns"),
        "start": _place(forecast.start),
        "expected": _place(forecast),
        "ellipse_50": attributes(forecast.inner, _ELLIPSE),
        "ellipse_90": attributes(forecast.outer, _ELLIPSE),
        **attributes(forecast, "radius_90_m=radius persistent_radius_90_m=persistent_radius"),
        # of a log with mean currents nothing needs to be said
        **({} if forecast.basis == "mean_currents" else {"basis": forecast.basis}),
        **({"scored": forecast.scored} if forecast.scored else {}),
        **({"calibration": forecast.factor} if math.isfinite(forecast.factor) else {}),
    }


def _place(place: Any) -> list[float]:
    return [place.longitude, place.latitude]


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
    found, figures = compare(evidence, rival.evidence), _evidence_figures(rival.evidence.total)
    return {
        "ensemble": rival.name,
        **attributes(found, _AGAINST),
        **{f"other_{key}": value for key, value in figures.items()},
    }


def _evidence_figures(block: BlockEvidence) -> dict[str, Any]:
    each = block.log_evidence / block.measurements if block.measurements else math.nan
    return attributes(block, "log_evidence values measurements") | {"per_measurement": each}


def flight_correction_json(found: FlightCorrection) -> dict[str, Any]:
    """Return the correction of one mean current at least for JSON."""
    figures = asdict(found)
    sizes = figures.pop("sizes")
    rms = math.sqrt(sum(size**2 for size in sizes) / len(sizes))
    return {"corrected": len(sizes), "rms_m_s": rms, "largest_m_s": max(sizes), **figures}


def outcome_of(summary: ReplaySummary) -> Outcome:
    """Return the outcome of a run that has just ended."""
    observations = attributes(summary, _OBSERVATIONS)
    if summary.sources:
        # of a run without any nothing needs to be said
        observations["sources"] = [asdict(row) for row in summary.sources]
    found = attributes(summary, _SAME) | {
        "observations": observations,
        "rms_innovation": attributes(summary, "before=rms_before after=rms_after prior=rms_prior"),
        "by_dive": [asdict(row) for row in summary.by_dive],
        "plan": plan_json(summary.plan, summary.plan_note),
        "consistency": [finding_json(one) for one in summary.findings],
        "messages": [asdict(row) | {"reasons": coded(row.reasons)} for row in summary.messages],
        "losses": [{"file": path} | loss_json(loss) for path, loss in summary.losses],
        "surfacings": outcomes_json(summary.outcomes) if summary.outcomes else None,
        "expected_surfacings": surfacings_json(
            summary.surfacings, summary.next_surfacing, summary.outcomes
        )
        if summary.surfacings
        else None,
        "evidence": None if summary.evidence is None else evidence_json(summary.evidence),
        "referee": referee_json(summary.ensemble, summary.evidence, summary.rivals)
        if summary.rivals and summary.evidence is not None
        else None,
        "flight_correction": flight_correction_json(summary.flight_correction)
        if summary.flight_correction
        else None,
    }
    return Outcome(
        **_plain(found, {str(path): path.name for path in summary.inputs}),
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


def _plain(value: Any, names: Mapping[str, str] = MappingProxyType({})) -> Any:
    """Return a value with NaN and infinities as None, tuples as lists, NumPy scalars as Python's.

    Args:
        value: The value.
        names: Of inputs, by their paths: the folder that they are in changes no byte of a result.
    """
    if isinstance(value, Mapping):
        return {str(key): _plain(item, names) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item, names) for item in value]
    if isinstance(value, str):
        return reduce(lambda text, path: text.replace(path, names[path]), names, value)
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
