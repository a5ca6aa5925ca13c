"""Online estimators of the current: basis from the ensemble, prior, Kalman update."""

from replay_kit.estimator.basis.modes import embed_member
from replay_kit.estimator.interface import Estimator
from replay_kit.estimator.static.filter import ReducedBasisEstimator, build_estimator
from replay_kit.estimator.static.state import FilterState

__all__ = ["Estimator", "FilterState", "ReducedBasisEstimator", "build_estimator", "embed_member"]
