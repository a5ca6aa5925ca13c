"""The online estimator: basis from the ensemble, prior, Kalman filter."""

from replay_kit.estimator.basis.modes import embed_member
from replay_kit.estimator.filter import BLOCK, FilterState, ReducedBasisEstimator, build_estimator, means_of
from replay_kit.estimator.interface import Estimator

__all__ = ["BLOCK", "Estimator", "FilterState", "ReducedBasisEstimator", "build_estimator", "embed_member", "means_of"]
