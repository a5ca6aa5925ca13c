"""The estimator of a run, built from its forecast and settings: static, through time, or a baseline."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any, Literal

from replay_kit.config.run import RunConfig
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Ensemble
from replay_kit.core.region import Region
from replay_kit.estimator import Estimator, ReducedBasisEstimator, build_estimator
from replay_kit.estimator.baselines import build_named
from replay_kit.estimator.evolving import build_evolving
from replay_kit.estimator.windows import WindowedEstimator
from replay_kit.workflows.replay.inputs.forecast import Forecasts
from replay_kit.workflows.replay.inputs.region import FoundRegion


def build(forecasts: Forecasts, config: RunConfig, goal_depth: float | None) -> Estimator[Any]:
    """Return the estimator of a run.

    Args:
        forecasts: What it is built from.
        config: The run's settings.
        goal_depth: [m]; ``depth_average`` alone needs it.

    Raises:
        ConfigError: The estimator's name is unknown.
    """
    if forecasts.region is not None and forecasts.read is not None:
        return with_window(
            _windowed(forecasts, forecasts.region, forecasts.read, config), config.time.window
        )
    if forecasts.evolves:
        return with_window(
            build_evolving(forecasts.series, config.estimator, config.time, config.gating),
            config.time.window,
        )
    return with_window(
        build_named(forecasts.ensemble, config.estimator, goal_depth, config.gating),
        config.time.window,
    )


def with_window(estimator: Estimator[Any], window: float | Literal["auto"]) -> Estimator[Any]:
    """Return an estimator that combines profiles within a time [s]; auto leaves it to the estimator, 0 combines none."""
    grouping = estimator.grouping
    if grouping is None or window == "auto":
        return estimator
    # Any: those that have a grouping are dataclasses
    grouped: Any = estimator
    changed: Estimator[Any] = replace(
        grouped, grouping=grouping.by_hand(window) if window > 0.0 else None
    )
    return changed


def _windowed(
    forecasts: Forecasts, found: FoundRegion, read: Callable[[Region], Ensemble], config: RunConfig
) -> WindowedEstimator:
    """Return the estimator of windows that follow the vehicle; the latest two are kept."""

    @lru_cache(maxsize=2)
    def estimator_of(region: Region) -> ReducedBasisEstimator:
        ensemble = forecasts.ensemble if region == found.region else read(region)
        return build_estimator(ensemble, config.estimator, config.gating)

    grouping = estimator_of(found.region).grouping
    return WindowedEstimator(
        found.region, found.margin, found.bounds, estimator_of, config.gating, grouping
    )


def flow_at(estimator: Estimator[Any], state: Any, time_ns: int) -> FlowEstimate:
    """Return the current estimate of a state for a time at or after its last observation [ns, UTC]; a static one is as it was."""
    return estimator.flow(estimator.predict(state, time_ns))
