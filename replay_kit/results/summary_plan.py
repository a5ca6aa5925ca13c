"""Plans and their predictions of surfacings, as sentences and as JSON."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from replay_kit.core.plan import Plan
from replay_kit.core.surfacing import Outcome


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
        "statistics": dict(plan.statistics),
        "energy_j": _finite(plan.energy),
        "battery_j": _finite(plan.battery),
        "odds": None if plan.odds is None else asdict(plan.odds),
    }


def _finite(number: float) -> float | None:
    return number if np.isfinite(number) else None


def plan_sentence(plan: Plan) -> str:
    """Return a plan as a sentence."""
    if plan.status == "failed" or not np.isfinite(plan.heading_deg):
        return f"{plan.status}: {plan.message}"
    return (
        f"{plan.status}: steer {plan.heading_deg:.1f} degrees true at {plan.speed:.2f} m/s through water, "
        f"{plan.glide_angle_deg:.2f} degrees down; {plan.message}"
    )


def outcomes_json(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Return the figures of some surfacings, one at least, for JSON."""
    return {**_figures(outcomes), "each": [_outcome_json(outcome) for outcome in outcomes]}


def _outcome_json(outcome: Outcome) -> dict[str, Any]:
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


def _figures(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    inside = [outcome.inside for outcome in outcomes if outcome.inside is not None]
    return {
        "count": len(outcomes),
        "distance_median_m": float(np.median([outcome.distance for outcome in outcomes])),
        "delay_median_s": float(np.median([outcome.late for outcome in outcomes])),
        "inside_ellipse": float(np.mean(inside)) if inside else None,
    }


def outcomes_sentence(outcomes: Sequence[Outcome]) -> str:
    """Return the errors of the predictions of some surfacings, one at least, as a sentence."""
    figures = _figures(outcomes)
    share = figures["inside_ellipse"]
    return (
        f"{figures['count']} predicted by the plan before; median distance {figures['distance_median_m']:.0f} m, "
        f"{figures['delay_median_s'] / 60.0:+.0f} min"
        + ("" if share is None else f", {100.0 * share:.0f} % inside the 90 % ellipse")
    )
