"""The state of the static estimator."""

from dataclasses import dataclass

from replay_kit.core.arrays import Array
from replay_kit.core.observation import Measurement
from replay_kit.estimator.prior.mean_amplitude import MeanAmplitude
from replay_kit.estimator.static.spread import SpreadFit
from replay_kit.estimator.update.biases import BiasScore
from replay_kit.estimator.update.gate import ConsistencyMonitor
from replay_kit.estimator.update.posterior import Posterior

_NEW_MONITOR, _NO_SCORE = ConsistencyMonitor(), BiasScore()


@dataclass(frozen=True, slots=True, eq=False)
class FilterState:
    """The estimate of the weights at one time.

    Attributes:
        posterior: Of the weights, in the representation that is cheaper at the time.
        time_ns: Of the last observation used [ns, UTC]; None before the first.
        monitor: Of the latest gate results.
        last: The last measurement with a usable bin; an equal one that follows is a duplicate.
        bias_score: Of systematic errors of the instrument.
        spread: Amplitude of the prior's covariance; None as it is given.
        mean_amplitude: Gaussian of the ensemble mean's amplitude, while it is averaged and after; None where its variance is given.
    """

    posterior: Posterior
    time_ns: int | None
    monitor: ConsistencyMonitor = _NEW_MONITOR
    last: Measurement | None = None
    bias_score: BiasScore = _NO_SCORE
    spread: SpreadFit | None = None
    mean_amplitude: MeanAmplitude | None = None

    @property
    def mean(self) -> Array:
        """Mean of the weights, shape (Z r,), level after level; computed when first asked for."""
        return self.posterior.mean
