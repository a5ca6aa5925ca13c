"""Online estimators of the current: basis from the ensemble, prior, update."""

from replay_kit.estimator.basis.modes import embed_member
from replay_kit.estimator.build import build
from replay_kit.estimator.estimator import ReducedBasisEstimator
from replay_kit.estimator.interface import Estimator, Stepped
from replay_kit.estimator.smoother import smooth
from replay_kit.estimator.state import State

__all__ = [
    "Estimator",
    "ReducedBasisEstimator",
    "State",
    "Stepped",
    "build",
    "embed_member",
    "smooth",
]
