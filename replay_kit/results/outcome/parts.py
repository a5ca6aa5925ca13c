"""Parts of an outcome from the values of a run: plan, surfacings, log evidence and flight-model error."""

import math
from collections.abc import Sequence
from dataclasses import asdict
from operator import attrgetter
from typing import Any

import numpy as np

from replay_kit.core.as_flown import FlightCorrection
from replay_kit.core.observation.evidence import BlockEvidence, Evidence, compare
from replay_kit.core.plan import Plan, leg_statistics
from replay_kit.core.surfacing import (
    DiveForecast,
    DiveOutcome,
    SurfacingOutcome,
    calibrated_forecast,
    held_shares,
    prediction_scores,
)
from replay_kit.results.mcap.schemas import attributes

_KINDS = ("first", "second", "later")
# names of figures, and whence they are
_PLAN = "status closest_approach_m=closest_approach heading_deg glide_angle_deg speed duration_s=duration start goal message"
_SURFACED = (
    "planned_ns predicted_ns=predicted.time_ns predicted time_ns actual=longitude distance_m=distance direction_deg delay_s=late "
    "inside_ellipse=inside"
)
_DIVE = (
    "actual=fix distance_m=distance direction_deg inside_50=in_inner inside_90=in_outer log_score persistence_log_score "
    "persistence_distance_m=persistence_distance"
)
_SPREAD = attrgetter(
    *("distance", "forecast.radius", "log_score"),
    *("persistence_log_score", "forecast.persistence_radius"),
)
_ELLIPSE = "major_m=major minor_m=minor bearing_deg"
_AGAINST = (
    "compared=blocks not_compared=skipped gain gain_mean=mean interval_90=interval better=verdict"
)


def plan_part(plan: Plan | None, note: str = "") -> dict[str, Any] | None:
    """Return a plan's figures; without a plan the note of its failure, or None without a note."""
    if plan is None:
        return {"status": "failed", "message": note} if note else None
    return attributes(plan, _PLAN) | {
        "start": [*asdict(plan.start).values()],
        "goal": [*asdict(plan.goal).values()],
        "statistics": {**plan.statistics, **leg_statistics(plan.legs)},
        "energy_j": plan.energy,
        "battery_j": plan.battery,
        "odds": plan.odds,
    }


def surfacings_part(outcomes: Sequence[SurfacingOutcome]) -> dict[str, Any] | None:
    """Return the figures of surfacings predicted by plans; None without any."""
    if not outcomes:
        return None
    inside = [outcome.inside for outcome in outcomes if outcome.inside is not None]
    return {
        "count": len(outcomes),
        "distance_median_m": float(np.median([outcome.distance for outcome in outcomes])),
        "delay_median_s": float(np.median([outcome.late for outcome in outcomes])),
        "inside_ellipse": float(np.mean(inside)) if inside else None,
        "each": [
            attributes(one, _SURFACED) | {"predicted": _place(one.predicted), "actual": _place(one)}
            for one in outcomes
        ],
    }


def expected_part(
    outcomes: Sequence[DiveOutcome],
    following: DiveForecast | None,
    planned: Sequence[SurfacingOutcome] = (),
) -> dict[str, Any] | None:
    """Return the figures of surfacings predicted from earlier dives; None without any.

    Args:
        outcomes: Outcomes by dive.
        following: Prediction of the next surfacing; None without one.
        planned: Surfacings predicted by plans.
    """
    if not outcomes:
        return None
    count, habit, plan = prediction_scores(outcomes, planned)
    groups = {
        kind: [one for one in outcomes if min(one.forecast.earlier, 2) == earlier]
        for earlier, kind in enumerate(_KINDS)
    }
    return {
        **_surfacing_figures(outcomes),
        **{kind: _surfacing_figures(group) if group else None for kind, group in groups.items()},
        "each": [
            _forecast_json(one.forecast) | attributes(one, _DIVE) | {"actual": _place(one.fix)}
            for one in outcomes
        ],
        "record": {
            "shown": "plan" if count and plan > habit else "habit",
            "count": count,
            "habit": habit,
            "plan": plan,
        },
        "next": None
        if following is None
        else _forecast_json(calibrated_forecast(following, outcomes)),
    }


def _surfacing_figures(outcomes: Sequence[DiveOutcome]) -> dict[str, Any]:
    """Return coverage, score and sharpness of at least one surfacing; with those of persistence if it has a spread."""
    inner, outer = held_shares(outcomes)
    rows = np.array([_SPREAD(one) for one in outcomes])
    distance, radius, score, _, _ = rows.T
    beside = rows[np.isfinite(rows[:, 3])]
    _, radii, scores, other_scores, other_radii = beside.T
    gain, others = scores - other_scores, other_radii.sum()
    return {
        "count": len(outcomes),
        "inside_50": inner,
        "inside_90": outer,
        "distance_median_m": np.median(distance),
        "distance_rms_m": np.sqrt(np.mean(distance**2)),
        "radius_90_mean_m": radius.mean(),
        "log_score": score.mean(),
        "log_score_gain": gain.mean() if gain.size else None,
        "radius_ratio": radii.sum() / others if others > 0.0 else None,
    }


def _forecast_json(forecast: DiveForecast) -> dict[str, Any]:
    # of a log with mean currents nothing needs to be said of the basis
    basis = "" if forecast.basis == "mean_currents" else forecast.basis
    calibration = forecast.factor if math.isfinite(forecast.factor) else None
    more = {"basis": basis, "scored": forecast.scored, "calibration": calibration}
    return {
        **attributes(forecast, "dive earlier_dives=earlier begin_ns=start.time_ns time_ns"),
        "start": _place(forecast.start),
        "expected": _place(forecast),
        "ellipse_50": attributes(forecast.inner, _ELLIPSE),
        "ellipse_90": attributes(forecast.outer, _ELLIPSE),
        **attributes(forecast, "radius_90_m=radius persistence_radius_90_m=persistence_radius"),
        **{name: value for name, value in more.items() if value},
    }


def _place(place: Any) -> list[float]:
    return [place.longitude, place.latitude]


def evidence_part(evidence: Evidence | None) -> dict[str, Any] | None:
    """Return the log evidence of a log; None without any."""
    if evidence is None:
        return None
    by_dive = [
        {"dive": dive, **_evidence_figures(block)} for dive, block in evidence.by_dive.items()
    ]
    return {**_evidence_figures(evidence.total), "by_dive": by_dive}


def comparison_part(
    name: str, evidence: Evidence, rivals: Sequence[tuple[str, Evidence]]
) -> dict[str, Any]:
    """Return the comparison of the first forecast with each other one by a log.

    Args:
        name: Name of the first forecast's file.
        evidence: Log evidence of the first forecast.
        rivals: Names and log evidence of the others, at least one.
    """
    against = [
        {
            "ensemble": rival,
            **attributes(compare(evidence, other), _AGAINST),
            **{f"other_{key}": value for key, value in _evidence_figures(other.total).items()},
        }
        for rival, other in rivals
    ]
    return {"ensemble": name, "units": "dives" if evidence.by_dive else "hours", "against": against}


def _evidence_figures(block: BlockEvidence) -> dict[str, Any]:
    each = block.log_evidence / block.measurements if block.measurements else math.nan
    return attributes(block, "log_evidence values measurements") | {"per_measurement": each}


def correction_part(found: FlightCorrection | None) -> dict[str, Any] | None:
    """Return the correction of mean currents for the flight-model error; None without a correction."""
    if found is None:
        return None
    figures = asdict(found)
    sizes = figures.pop("sizes")
    rms = math.sqrt(sum(size**2 for size in sizes) / len(sizes))
    return {"corrected": len(sizes), "rms_m_s": rms, "largest_m_s": max(sizes), **figures}
