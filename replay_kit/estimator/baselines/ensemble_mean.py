"""The ensemble alone: its mean and spread, without assimilation."""

from dataclasses import dataclass, replace

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Innovation, Measurement
from replay_kit.estimator.baselines.etkf import Etkf, TransformState, build_etkf


@dataclass(frozen=True, slots=True, eq=False)
class EnsembleMean(Etkf):
    """Predicts with the members' mean and sample covariance, and does not learn."""

    def step(
        self, state: TransformState, observation: Measurement
    ) -> tuple[TransformState, Innovation]:
        """Return the same state, and the innovation, which is the residual too."""
        _, innovation = Etkf.step(self, state, observation)
        return state, replace(innovation, residual=innovation.innovation)

    def span_residual(self, points: Array, depth: Array, velocity: Array) -> Array | None:
        """Return a velocity minus the ensemble mean, shape (P, 2) [m/s]."""
        return velocity - self.mean_velocity(points, depth)


def build_ensemble_mean(ensemble: Ensemble, config: EstimatorConfig) -> EnsembleMean:
    """Return the ensemble as an estimator that ignores measurements."""
    etkf = build_etkf(ensemble, config)
    return EnsembleMean(etkf.reduced, etkf.anomalies)
