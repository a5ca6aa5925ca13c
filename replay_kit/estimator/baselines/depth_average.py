"""The default estimate averaged over depth: one current from the surface to a goal's depth (the paper's 2D baseline)."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import ConfigError
from replay_kit.core.flow.depth import DepthFunctions, depth_weights
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Innovation, Observation
from replay_kit.estimator.baselines.columns import HATS
from replay_kit.estimator.filter import FilterState, ReducedBasisEstimator, build_estimator

_STEP = 1.0  # m, between the depths averaged; exact for hats, whose corners are among the depths


@dataclass(frozen=True, slots=True, eq=False)
class DepthAverage:
    """An estimator whose flow is the same at all depths.

    Attributes:
        full: Does the estimating.
        depth: The average is from the surface down to here [m].
    """

    full: ReducedBasisEstimator
    depth: float

    def initial(self) -> FilterState:
        """Return the full estimator's prior."""
        return self.full.initial()

    def step(self, state: FilterState, observation: Observation) -> tuple[FilterState, Innovation]:
        """Return the state after an observation, and the innovation, both of the full estimator."""
        return self.full.step(state, observation)

    def steps(self, state: FilterState, observations: Iterable[Observation]) -> Iterator[tuple[FilterState, Innovation]]:
        """Yield the state after each observation, and the innovation, both of the full estimator."""
        return self.full.steps(state, observations)

    def misfit(self, state: FilterState, observation: Observation) -> Array:
        """Return measured minus predicted by the full estimator, shape (n, 2) [m/s], local axes; NaN for bins not usable."""
        return self.full.misfit(state, observation)

    def flow(self, state: FilterState) -> FlowEstimate:
        """Return the estimate averaged over depth, at every depth."""
        return average_over_depth(self.full.flow(state), self.depth)


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
    return replace(flow, depth_functions=HATS, latent=latent, covariance=np.kron(np.ones((n_levels, n_levels)), cov))


def mean_depth_weights(functions: DepthFunctions, levels: Array, depth: float) -> Array:
    """Return the mean of each level's depth function from the surface to a depth, shape (Z,), by the trapezoidal rule.

    Args:
        functions: Kind and length.
        levels: shape (Z,) [m].
        depth: [m], positive.
    """
    regular = np.linspace(0.0, depth, max(int(np.ceil(depth / _STEP)), 1) + 1)
    depths = np.union1d(regular, levels[(levels > 0.0) & (levels < depth)])
    return np.asarray(np.trapezoid(depth_weights(functions, depths, levels), depths, axis=0) / depth)


def build_depth_average(ensemble: Ensemble, config: EstimatorConfig, depth: float | None) -> DepthAverage:
    """Return the configured preset's estimator, its flow averaged from the surface to a depth.

    Raises:
        ConfigError: The depth is missing or not positive.
    """
    if depth is None or not depth > 0.0:
        raise ConfigError(f"depth_average: expected a depth > 0 m to average to, got {depth}; give a goal below the surface")
    return DepthAverage(build_estimator(ensemble, config), depth)
