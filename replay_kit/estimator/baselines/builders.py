"""Baselines by name, and the plain ones: the ensemble's mean, and the default estimate averaged over depth (2D in the paper)."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from replay_kit.config.estimation import GatingConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import ConfigError
from replay_kit.core.extensions import additions
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.functions import DepthFunctions, depth_weights
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Innovation, Measurement
from replay_kit.estimator.baselines.columns import HATS
from replay_kit.estimator.baselines.etkf import Etkf, TransformState, build_etkf, build_letkf
from replay_kit.estimator.baselines.gp import build_gp
from replay_kit.estimator.baselines.whole_flows import build_naive, build_nearest
from replay_kit.estimator.interface import Estimator, require_estimator
from replay_kit.estimator.static.filter import ReducedBasisEstimator, build_estimator
from replay_kit.estimator.static.state import FilterState

_STEP = 1.0  # m, between the depths averaged; exact for hat functions, whose corners are among the depths


@dataclass(frozen=True, slots=True, eq=False)
class DepthAverage(ReducedBasisEstimator):
    """The default estimator with a flow that is the same at all depths.

    Attributes:
        depth: The average is from the surface down to here [m].
    """

    depth: float = 0.0

    supports_path_means = False

    def flow(self, state: FilterState) -> FlowEstimate:
        """Return the estimate averaged over depth, at every depth."""
        return average_over_depth(ReducedBasisEstimator.flow(self, state), self.depth)

    @property
    def basis_size(self) -> tuple[int | None, int | None]:
        """No size: the basis of the average is not that of the estimate."""
        return None, None

    # the flow is no longer a combination of the basis at each depth
    span_residual = Estimator.span_residual
    notes = Estimator.notes


def average_over_depth(flow: FlowEstimate, depth: float) -> FlowEstimate:
    """Return a flow, the same at all depths, that is the thickness-weighted mean of another from the surface to a depth.

    Args:
        flow: The flow averaged, with its uncertainty if it has one.
        depth: [m].
    """
    weights = mean_depth_weights(flow.depth_functions, flow.levels, depth)
    n_levels, r = flow.levels.size, flow.n_modes
    latent = np.repeat((flow.latent @ weights)[:, None], n_levels, axis=1)
    blocks = flow.weight_cov.reshape(n_levels, r, n_levels, r)
    cov = np.einsum("z,zrys,y->rs", weights, blocks, weights, optimize=True)
    return replace(
        flow,
        depth_functions=HATS,
        latent=latent,
        covariance=np.kron(np.ones((n_levels, n_levels)), cov),
    )


def mean_depth_weights(functions: DepthFunctions, levels: Array, depth: float) -> Array:
    """Return the mean of each level's depth function from the surface to a depth, shape (Z,), by the trapezoidal rule.

    Args:
        functions: Kind and length.
        levels: shape (Z,) [m].
        depth: [m], positive.
    """
    regular = np.linspace(0.0, depth, max(int(np.ceil(depth / _STEP)), 1) + 1)
    depths = np.union1d(regular, levels[(levels > 0.0) & (levels < depth)])
    return np.asarray(
        np.trapezoid(depth_weights(functions, depths, levels), depths, axis=0) / depth
    )


def build_depth_average(
    ensemble: Ensemble, config: EstimatorConfig, depth: float | None
) -> DepthAverage:
    """Return the configured preset's estimator, its flow averaged from the surface to a depth.

    Raises:
        ConfigError: The depth is missing or not positive.
    """
    if depth is None or not depth > 0.0:
        raise ConfigError(
            f"depth_average: expected a depth > 0 m to average to, got {depth}; give a goal below the surface"
        )
    full = build_estimator(ensemble, config)
    return DepthAverage(
        full.basis,
        full.prior,
        full.error_std,
        full.representation_std,
        full.time_ns,
        mean_amplitude=full.mean_amplitude,
        depth=depth,
    )


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
