"""Windows that follow the vehicle: each is an estimator of its own, and hands over its information to the next."""

from replay_kit.estimator.windows.filter import WindowedEstimator, WindowedState

__all__ = ["WindowedEstimator", "WindowedState"]
