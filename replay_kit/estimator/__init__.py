"""The online estimator: basis from the ensemble, prior, Kalman filter."""

from replay_kit.estimator.filter import BLOCK, FilterState, ReducedBasisEstimator, build_estimator, means_of
from replay_kit.estimator.interface import Estimator
from replay_kit.estimator.modes import embed_member

__all__ = ["BLOCK", "Estimator", "FilterState", "ReducedBasisEstimator", "build_estimator", "embed_member", "means_of"]
