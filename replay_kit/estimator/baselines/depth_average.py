"""The default estimate averaged over depth: one current from the surface to a goal's depth (the paper's 2D baseline)."""

from dataclasses import dataclass, replace

import numpy as np

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import ConfigError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.functions import DepthFunctions, depth_weights
from replay_kit.core.grid import Ensemble
from replay_kit.estimator.baselines.columns import HATS
from replay_kit.estimator.interface import Estimator
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
