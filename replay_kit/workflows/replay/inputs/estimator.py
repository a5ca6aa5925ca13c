"""Estimator of a run, built from forecast and settings: static, time-dependent, or a baseline."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any, Literal

from replay_kit.config.run import RunConfig
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Ensemble
from replay_kit.core.region import Region
from replay_kit.estimator import Estimator, ReducedBasisEstimator
from replay_kit.estimator import build as build_reduced
from replay_kit.estimator.baselines import build_named
from replay_kit.estimator.windows.filter import WindowedEstimator
from replay_kit.workflows.replay.inputs.forecast import OWN, Forecasts
from replay_kit.workflows.replay.inputs.region import FoundRegion


def build(forecasts: Forecasts, config: RunConfig, vehicles: int = 1) -> Estimator[Any]:
    """Return the estimator of a run.

    Args:
        forecasts: Forecast to build from.
        config: The run's settings.
        vehicles: Largest number of vehicles that windows follow.

    Raises:
        ConfigError: The estimator's name is unknown.
    """
    made: Estimator[Any]
    if forecasts.region is not None and forecasts.read is not None:
        made = _windowed(forecasts, forecasts.region, forecasts.read, config, vehicles)
    elif config.estimator.name != OWN:
        made = build_named(forecasts.ensemble, config.estimator)
    else:
        series, time = [forecasts.ensemble], None
        if forecasts.evolves:
            series, time = [*forecasts.series], config.time
        made = build_reduced(series, config.estimator, config.gating, time)
    return with_window(made, config.time.window)


def with_window(estimator: Estimator[Any], window: float | Literal["auto"]) -> Estimator[Any]:
    """Return an estimator that combines profiles within a time [s]; auto keeps its own value, 0 combines none."""
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
    forecasts: Forecasts,
    found: FoundRegion,
    read: Callable[[Region], Ensemble],
    config: RunConfig,
    vehicles: int,
) -> WindowedEstimator:
    """Return the estimator of windows that follow vehicles; keeps one window more than vehicles."""

    @lru_cache(maxsize=vehicles + 1)
    def estimator_of(region: Region) -> ReducedBasisEstimator:
        ensemble = forecasts.ensemble if region == found.region else read(region)
        return build_reduced([ensemble], config.estimator, config.gating)

    grouping = estimator_of(found.region).grouping
    return WindowedEstimator(found.region, found.margin, found.bounds, estimator_of, grouping)


def flow_at(estimator: Estimator[Any], state: Any, time_ns: int) -> FlowEstimate:
    """Return the current estimate of a state at or after its last observation [ns, UTC]; a static one is unchanged."""
    return estimator.flow(estimator.predict(state, time_ns))
