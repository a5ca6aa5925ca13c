"""The estimate through time: a forecast's own evolution, forgetting, oscillations and biases of the instrument."""

from replay_kit.estimator.evolving.build import build_evolving
from replay_kit.estimator.evolving.filter import EvolvingEstimator
from replay_kit.estimator.evolving.state_space import EvolvingState

__all__ = ["EvolvingEstimator", "EvolvingState", "build_evolving"]
