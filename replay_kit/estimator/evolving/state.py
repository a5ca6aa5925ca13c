"""The state of the estimate through time."""

from dataclasses import dataclass

from replay_kit.core.arrays import Array
from replay_kit.core.observation import Measurement
from replay_kit.estimator.update.biases import BiasScore
from replay_kit.estimator.update.gate import ConsistencyMonitor

_NO_SCORE = BiasScore()


@dataclass(frozen=True, slots=True, eq=False)
class EvolvingState:
    """The estimate at one time.

    Attributes:
        means: shape (n, 4): mean of the unknowns, and its sensitivity to heading, scale and shear errors of one unit outside the state.
        cov: shape (n, n), covariance of the unknowns.
        time_ns: Of the last observation used; of a group of profiles their mean time [ns, UTC]; None before the first.
        monitor: Of the latest gate results.
        last: The last measurement offered.
        bias_score: Of systematic errors of the instrument.
    """

    means: Array
    cov: Array
    time_ns: int | None
    monitor: ConsistencyMonitor
    last: Measurement | None = None
    bias_score: BiasScore = _NO_SCORE

    @property
    def mean(self) -> Array:
        """Mean of the unknowns, shape (n,)."""
        return self.means[:, 0]
