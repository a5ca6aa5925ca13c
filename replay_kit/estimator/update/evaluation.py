"""The prediction of an observation's rows, and what every state holds beside the estimate."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
import scipy.linalg

from replay_kit.core.arrays import Array
from replay_kit.core.observation import LinearMeasurement
from replay_kit.estimator.update.biases import BiasScore
from replay_kit.estimator.update.gate import ConsistencyMonitor

_NEW_MONITOR, _NO_SCORE = ConsistencyMonitor(), BiasScore()
After = TypeVar("After")


@dataclass(frozen=True, eq=False)
class PredictedObservation(Generic[After]):
    """The prediction of an observation's rows before they are assimilated.

    Attributes:
        means: shape (c k, 1 + b): mean of the rows, and its change for each instrument error of one unit.
        cov: shape (c k, c k), of the rows without their own noise.
        update: Returns the estimate after the rows, given the Cholesky factor of the scaled innovation covariance, the innovation whitened
            by it, and the error scale by which both were divided.
    """

    means: Array
    cov: Array
    update: Callable[[Array, Array, float], After]


def kalman_update(
    means: Array, cov: Array, design: Array, innovation: Array
) -> tuple[Array, Array]:
    """Return means and covariance after rows of unit noise.

    Args:
        means: shape (n, 1 + b): the state's mean, and its sensitivity to each instrument error of one unit.
        cov: shape (n, n).
        design: shape (m, n).
        innovation: shape (m, 1 + b).
    """
    cross = design @ cov
    lower = np.linalg.cholesky(cross @ design.T + np.eye(len(design)))
    both = scipy.linalg.solve_triangular(lower, np.hstack([cross, innovation]), lower=True)
    gain = both[:, : len(cov)]
    return means + gain.T @ both[:, len(cov) :], cov - gain.T @ gain


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Assimilation:
    """What every state holds of the measurements so far, beside the estimate.

    Attributes:
        time_ns: Of the last observation used [ns, UTC]; None before the first.
        monitor: Of the latest gate results.
        last: The last measurement with a usable bin; an equal one that follows is a duplicate.
        bias_score: Of systematic errors of the instrument.
    """

    time_ns: int | None = None
    monitor: ConsistencyMonitor = _NEW_MONITOR
    last: LinearMeasurement | None = None
    bias_score: BiasScore = _NO_SCORE
