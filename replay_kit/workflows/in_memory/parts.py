"""An estimator, a prior or a planner that a script gives in place of the settings' own."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Protocol

from replay_kit.config.planner import PlannerConfig
from replay_kit.config.run import EstimatorConfig, RunConfig
from replay_kit.core.errors import ConfigError
from replay_kit.core.grid import Ensemble, Grid
from replay_kit.estimator import Estimator, ReducedBasisEstimator
from replay_kit.estimator.basis.modes import Basis
from replay_kit.estimator.interface import require_estimator
from replay_kit.estimator.prior.hybrid import Prior
from replay_kit.workflows.planning import planner_of
from replay_kit.workflows.replay.inputs.estimator import build, with_window
from replay_kit.workflows.replay.inputs.forecast import Forecasts
from replay_kit.workflows.replay.stages.planner import Planner, PlannerFactory


class EstimatorBuilder(Protocol):
    """Makes an estimator."""

    def __call__(self, ensemble: Ensemble, config: EstimatorConfig, /) -> Estimator[Any]:
        """Return the estimator of an ensemble."""
        ...


class PriorBuilder(Protocol):
    """Makes a prior."""

    def __call__(self, basis: Basis, usual: Prior, /) -> Prior:
        """Return the prior of the weights of a basis, given the one that is usual."""
        ...


def given(
    estimator: EstimatorBuilder | Estimator[Any] | None, prior: PriorBuilder | None
) -> Callable[[Forecasts, RunConfig], Estimator[Any]]:
    """Return what makes the estimator of a run.

    Args:
        estimator: The estimator, or what makes it; None for that of the settings.
        prior: What makes its prior; None for its own.
    """

    def make(forecasts: Forecasts, config: RunConfig) -> Estimator[Any]:
        if estimator is None:
            made = build(forecasts, config, None)
        else:
            # an estimator is not callable
            value = (
                estimator(forecasts.ensemble, config.estimator)
                if callable(estimator)
                else estimator
            )
            made = with_window(require_estimator(value, "estimator"), config.time.window)
        return made if prior is None else _with_prior(made, prior)

    return make


def _with_prior(estimator: Estimator[Any], prior: PriorBuilder) -> Estimator[Any]:
    if not isinstance(estimator, ReducedBasisEstimator):
        raise ConfigError(
            f"prior: expected the static estimator reduced_basis, whose weights have a prior, got {type(estimator).__name__}; "
            "set time.scale to static, or leave the prior out"
        )
    made = prior(estimator.basis, estimator.prior)
    lacking = [name for name in ("mean", "covariance") if not hasattr(made, name)]
    if lacking or made.mean.shape != estimator.prior.mean.shape:
        raise ConfigError(
            f"prior: expected a Prior of {estimator.prior.mean.size} weights with mean and covariance, got {type(made).__name__}"
        )
    # its amplitudes are those of the usual prior
    return replace(estimator, prior=made, spread=None, mean_amplitude=None)


def planner_factory(planner: PlannerFactory | Planner | None) -> PlannerFactory:
    """Return what makes the planner of a run.

    Raises:
        ConfigError: What is given is no planner.
    """
    if planner is None:
        return planner_of
    if callable(planner):
        return planner
    lacking = [
        name
        for name in ("plan", "check", "with_odds", "closest_approach", "seabed")
        if not hasattr(planner, name)
    ]
    if lacking:
        raise ConfigError(
            f"planner: expected a Planner, got {type(planner).__name__} without {', '.join(lacking)}"
        )
    own = planner

    def make(config: PlannerConfig, grid: Grid) -> Planner:
        return own

    return make
