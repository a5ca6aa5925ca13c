"""Estimators by name."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from replay_kit.config.estimation import GatingConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import ConfigError
from replay_kit.core.extensions import additions
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Innovation, Measurement
from replay_kit.estimator import Estimator, build_estimator
from replay_kit.estimator.baselines.depth_average import build_depth_average
from replay_kit.estimator.baselines.etkf import Etkf, TransformState, build_etkf, build_letkf
from replay_kit.estimator.baselines.gp import build_gp
from replay_kit.estimator.baselines.whole_flows import build_naive, build_nearest
from replay_kit.estimator.interface import require_estimator


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


# Any: a state is opaque to its holder, and an estimator is given only states that it made itself.
_BUILDERS: dict[str, Callable[[Ensemble, EstimatorConfig], Estimator[Any]]] = {
    "naive3d": build_naive,
    "nearest": build_nearest,
    "ensemble_mean": build_ensemble_mean,
    "etkf": build_etkf,
    "letkf": build_letkf,
    "gp": build_gp,
}
BASELINES = (*_BUILDERS, "depth_average")
_OWN = "reduced_basis"


def build_named(
    ensemble: Ensemble,
    config: EstimatorConfig,
    depth: float | None = None,
    gating: GatingConfig | None = None,
) -> Estimator[Any]:
    """Return the configured estimator: the project's own, or a baseline.

    Args:
        ensemble: The members.
        config: Name, preset and settings.
        depth: Of the goal [m]; ``depth_average`` alone needs it.
        gating: Gate and covariance inflation of the project's own; None accepts every profile.

    Raises:
        ConfigError: The name is unknown, or the depth is missing.
    """
    return (
        build_estimator(ensemble, config, gating)
        if config.name == _OWN
        else build_baseline(config.name, ensemble, config, depth)
    )


def build_baseline(
    name: str, ensemble: Ensemble, config: EstimatorConfig, depth: float | None = None
) -> Estimator[Any]:
    """Return a baseline for an ensemble.

    Args:
        name: One of ``BASELINES``.
        ensemble: The members.
        config: Modes, kernel and error model.
        depth: Of the goal [m]; ``depth_average`` alone needs it.

    Raises:
        ConfigError: The name is unknown, or the depth is missing.
    """
    if name == "depth_average":
        return build_depth_average(ensemble, config, depth)
    if name in _BUILDERS:
        return _BUILDERS[name](ensemble, config)
    if name not in (added := additions("estimators", callable, "a function")):
        known = ", ".join((*BASELINES, *added))
        raise ConfigError(f"estimator: expected {_OWN} or one of {known}, got '{name}'")
    return require_estimator(added[name](ensemble, config), f"estimator {name}")
