"""Expected surfacings beside the actual ones as JSON: hits, score and sharpness.

The first dive is expected without any dive before it, and the second after one alone, from which no change is known; both have figures of
their own.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from replay_kit.core.observation import Fix
from replay_kit.core.surfacing import DiveForecast, DiveOutcome, Ellipse, held_shares

_KINDS = ("first", "second", "later")


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
        **_figures(outcomes),
        **{kind: _figures(group) if group else None for kind, group in groups.items()},
        "each": [_outcome_json(one) for one in outcomes],
        "next": None if following is None else _forecast_json(following),
    }


def _kind(outcome: DiveOutcome) -> str:
    return _KINDS[min(outcome.forecast.earlier, 2)]


def _figures(outcomes: Sequence[DiveOutcome]) -> dict[str, Any]:
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


def _outcome_json(outcome: DiveOutcome) -> dict[str, Any]:
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
    }


def _place(place: Fix | DiveForecast) -> list[float]:
    return [place.longitude, place.latitude]


def _ellipse_json(ellipse: Ellipse) -> dict[str, float]:
    return {"major_m": ellipse.major, "minor_m": ellipse.minor, "bearing_deg": ellipse.bearing_deg}
