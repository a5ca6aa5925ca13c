"""Baselines by name, and a flow averaged over depth (2D in the paper)."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from replay_kit.config.estimation import GatingConfig
from replay_kit.config.removed import refuse_value
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import ConfigError
from replay_kit.core.extensions import additions
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.functions import DepthFunctions, depth_weights
from replay_kit.core.grid import Ensemble
from replay_kit.estimator.baselines.columns import HATS
from replay_kit.estimator.baselines.whole_flows import build_naive, build_nearest
from replay_kit.estimator.interface import Estimator, require_estimator
from replay_kit.estimator.static.filter import build_estimator

_STEP = 1.0  # m, between the depths averaged; exact for hat functions, whose corners are among the depths


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


# Any: a state is opaque to its holder, and an estimator is given only states that it made itself.
_BUILDERS: dict[str, Callable[[Ensemble, EstimatorConfig], Estimator[Any]]] = {
    "naive3d": build_naive,
    "nearest": build_nearest,
}
BASELINES = tuple(_BUILDERS)
_OWN = "reduced_basis"


def build_named(
    ensemble: Ensemble,
    config: EstimatorConfig,
    gating: GatingConfig | None = None,
) -> Estimator[Any]:
    """Return the configured estimator: the project's own, or a baseline.

    Args:
        ensemble: The members.
        config: Name, preset and settings.
        gating: Gate and covariance inflation of the project's own; None accepts every profile.

    Raises:
        ConfigError: The name is unknown.
    """
    return (
        build_estimator(ensemble, config, gating)
        if config.name == _OWN
        else build_baseline(config.name, ensemble, config)
    )


def build_baseline(name: str, ensemble: Ensemble, config: EstimatorConfig) -> Estimator[Any]:
    """Return a baseline for an ensemble.

    Args:
        name: One of ``BASELINES``.
        ensemble: The members.
        config: Modes, kernel and error model.

    Raises:
        ConfigError: The name is unknown.
    """
    refuse_value("--estimator", name)
    if name in _BUILDERS:
        return _BUILDERS[name](ensemble, config)
    if name not in (added := additions("estimators", callable, "a function")):
        known = ", ".join((*BASELINES, *added))
        raise ConfigError(f"estimator: expected {_OWN} or one of {known}, got '{name}'")
    return require_estimator(added[name](ensemble, config), f"estimator {name}")
