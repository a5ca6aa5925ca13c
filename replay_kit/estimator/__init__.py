"""The online estimator: basis from the ensemble, prior, Kalman filter."""

from replay_kit.estimator.filter import FilterState, ReducedBasisEstimator, build_estimator
from replay_kit.estimator.interface import Estimator
from replay_kit.estimator.modes import embed_member

__all__ = ["Estimator", "FilterState", "ReducedBasisEstimator", "build_estimator", "embed_member"]
