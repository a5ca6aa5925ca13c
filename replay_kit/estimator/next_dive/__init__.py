"""The mean current of a vehicle's next dive, and so where it surfaces, from the dives before it."""

from replay_kit.estimator.next_dive.filter import DiveMean, DiveModel, DiveState
from replay_kit.estimator.next_dive.mixtures import Mixture, Persistence
from replay_kit.estimator.next_dive.process import MeanCurrentProcess, ProcessState

__all__ = [
    "DiveMean",
    "DiveModel",
    "DiveState",
    "MeanCurrentProcess",
    "Mixture",
    "Persistence",
    "ProcessState",
]
