"""The least error that an estimator could reach: the least-squares fit of the truth within its span, at the scored points."""

from typing import Any

from replay_kit.estimator import Estimator
from replay_kit.workflows.replay.scoring import ScoredPoints, rms_length


def bound(estimator: Estimator[Any], at: ScoredPoints) -> float:
    """Return the least RMSE [m/s] of any flow that an estimator can represent; NaN for one whose flows have no fixed span."""
    residual = estimator.span_residual(at.points, at.depth, at.velocity)
    return float("nan") if residual is None else rms_length(residual)
