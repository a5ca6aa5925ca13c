"""The ensemble alone: its mean and spread, whatever is measured."""

from dataclasses import dataclass, replace

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Innovation, Observation
from replay_kit.estimator.baselines.etkf import Etkf, TransformState, build_etkf
from replay_kit.estimator.interface import Estimator


@dataclass(frozen=True, slots=True, eq=False)
class EnsembleMean(Estimator[TransformState]):
    """An estimator that does not learn.

    Attributes:
        ensemble: Predicts with the members' mean and sample covariance.
    """

    ensemble: Etkf

    def initial(self) -> TransformState:
        """Return the members as they are."""
        return self.ensemble.initial()

    def step(self, state: TransformState, observation: Observation) -> tuple[TransformState, Innovation]:
        """Return the same state, and the innovation, which is the residual too."""
        _, said = self.ensemble.step(state, observation)
        return state, replace(said, residual=said.innovation)

    def misfit(self, state: TransformState, observation: Observation) -> Array:
        """Return measured minus predicted, shape (n, 2) [m/s], local axes; NaN for bins not usable."""
        return self.ensemble.misfit(state, observation)

    def flow(self, state: TransformState) -> FlowEstimate:
        """Return the ensemble's mean, with its spread."""
        return self.ensemble.flow(state)


def build_ensemble_mean(ensemble: Ensemble, config: EstimatorConfig) -> EnsembleMean:
    """Return the ensemble as an estimator that ignores measurements."""
    return EnsembleMean(build_etkf(ensemble, config))
