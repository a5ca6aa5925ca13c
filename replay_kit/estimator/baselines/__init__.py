"""Baselines: other estimators with the estimator's own interface, to compare with and to replay with."""

from replay_kit.estimator.baselines.builders import (
    BASELINES,
    average_over_depth,
    build_baseline,
    build_named,
)

__all__ = ["BASELINES", "average_over_depth", "build_baseline", "build_named"]
