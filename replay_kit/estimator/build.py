"""Construction of the estimator of a forecast, for constant and changing currents."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.estimation import GatingConfig, TimeConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.process import Process
from replay_kit.core.grid import Ensemble
from replay_kit.estimator.basis.modes import build_basis, mean_variance
from replay_kit.estimator.basis.shifts import ShiftedModes
from replay_kit.estimator.basis.slices import correlation_length
from replay_kit.estimator.estimator import ReducedBasisEstimator
from replay_kit.estimator.prior.extras import extras_of
from replay_kit.estimator.prior.factor import process_of, times_with_spread
from replay_kit.estimator.prior.fit import Members, choose_settings
from replay_kit.estimator.update.columns import Observer
from replay_kit.estimator.update.grouping import Grouping, current_gradient, spread_of
from replay_kit.estimator.update.revision import Evidence

# Of a forecast of one time [s]. Where the current does change, a time of 10 to 40 days serves as well, and none at all is far off.
_DECORRELATION = 20.0 * 86_400.0
# Mixtures of the members' own evolutions decorrelate more slowly than the current at a place, by this factor.
_TRAJECTORY_FACTOR = 5.0


def build(
    forecasts: Sequence[Ensemble],
    config: EstimatorConfig,
    gating: GatingConfig | None = None,
    time: TimeConfig | None = None,
) -> ReducedBasisEstimator:
    """Return the estimator of a forecast.

    Args:
        forecasts: Ensembles of equal members and grid, one per time, in order; a single one may have no time.
        config: Settings of preset, basis and prior.
        gating: Settings of the gate; None accepts every observation with its stated errors.
        time: Settings of the change in time; None for a constant current.
    """
    if config.preset == "paper":
        return _paper(forecasts[0], config)
    n_times, n_members = len(forecasts), forecasts[0].n_members
    length = correlation_length(forecasts[n_times // 2])
    basis = build_basis(forecasts, config, length if n_times == 1 else None)
    weights = basis.member_weights.reshape(n_times, n_members, *basis.member_weights.shape[1:])
    # fitted at the time in the middle
    middle, at_nodes = n_times // 2, basis.at_nodes
    few = Members.leading(weights[middle], at_nodes, basis.grid.nodes)
    settings = choose_settings(few, length, config)
    if isinstance(config.spread, float):
        mean = weights.mean(axis=1, keepdims=True)
        weights = mean + np.sqrt(config.spread) * (weights - mean)
    process, parts, dropped = process_of(
        weights,
        ShiftedModes.by(at_nodes, basis.grid.nodes, settings.shift),
        settings,
        basis.mean_weights,
        mean_variance(config),
        config.dropped_std,
    )
    times_ns = np.array([each.time_ns or 0 for each in forecasts], np.int64)
    process = replace(process, times_ns=times_ns)
    grouping = Grouping(max(current_gradient(each) for each in forecasts))
    evidence, extras = None, None
    if time is not None:
        scales = scales_of(weights, times_ns, time)
        of_members = np.arange(process.size) < process.moving.shape[1]
        process = replace(process, tau=np.where(of_members, *scales))
        # the squared difference of a current that is forgotten over T grows by 2 variances over T
        grouping = replace(grouping, change=2.0 * spread_of(forecasts) ** 2 / scales[1])
        if time.oscillators or time.biases:
            grid = basis.grid
            place = grid.projection.latitude, float(grid.levels[-1])
            extras = extras_of(time, *place, int(times_ns[0]))
    if n_times == 1 and extras is None and config.spread in (None, "fit"):
        made = config.spread == "fit" or bool(forecasts[0].made_from)
        evidence = Evidence(
            parts, few, settings, config.dropped_std, made, config.mean_variance is None
        )
    observer = Observer(basis, process, dropped, extras=extras)
    probability = None if gating is None or gating.gate == "off" else gating.gate_probability
    notes = f"prior: {settings}", f"through time: {process}"
    return ReducedBasisEstimator(
        observer, evidence, probability, forecasts[0].time_ns, grouping, notes
    )


def _paper(ensemble: Ensemble, config: EstimatorConfig) -> ReducedBasisEstimator:
    """Return the paper's estimator: independent weights about their mean, one depth function per level, one error for all bins."""
    basis = build_basis([ensemble], config)
    mean, variance = basis.member_weights.mean(axis=0), basis.member_weights.var(axis=0, ddof=1)
    factor = config.spread if isinstance(config.spread, float) else 1.0
    fixed = np.diag(np.sqrt(factor * variance).ravel()).reshape(-1, *mean.shape)
    process = independent_process(ensemble.time_ns, mean, fixed)
    observer = Observer(basis, process, basis.representation, stated_std=config.paper_error_std)
    return ReducedBasisEstimator(observer, None, None, ensemble.time_ns)


def independent_process(time_ns: int | None, mean: Array, patterns: Array) -> Process:
    """Return the process of constant unknowns with one depth function per level.

    Args:
        time_ns: Time of the forecast [ns, UTC].
        mean: shape (Z, r), weights for zero unknowns.
        patterns: shape (k, Z, r), patterns of the unknowns.
    """
    return Process(
        np.array([time_ns or 0], np.int64),
        mean[None],
        np.empty((1, 0, *mean.shape)),
        patterns,
        np.ones(1),
        np.eye(len(mean)),
        np.full(len(patterns), np.inf),
    )


def scales_of(weights: Array, times_ns: NDArray[np.int64], time: TimeConfig) -> tuple[float, float]:
    """Return the decorrelation times of member mixtures and of local directions [s]; equal for one forecast time, inf for constants.

    Args:
        weights: shape (T, E, Z, r), weights of the members.
        times_ns: shape (T,) [ns], forecast times.
        time: Settings, which may state them.
    """
    local = np.inf if time.scale == "static" else time.scale
    if local == "auto":
        local = decorrelation_time(weights - weights.mean(axis=1, keepdims=True), times_ns)
    return (_TRAJECTORY_FACTOR if times_ns.size > 1 else 1.0) * float(local), float(local)


def decorrelation_time(anomalies: Array, times_ns: NDArray[np.int64]) -> float:
    """Return the decorrelation time of anomalies [s], from the pooled correlation of neighbouring times; a usual one without any.

    Args:
        anomalies: shape (T, E, Z, r), anomalies of the weights.
        times_ns: shape (T,) [ns], forecast times.
    """
    size = np.linalg.norm(anomalies.reshape(len(anomalies), -1), axis=1)
    apart = times_with_spread(size)
    if apart.size < 2:
        return _DECORRELATION
    flat, size = anomalies[apart].reshape(apart.size, -1), size[apart]
    correlation = np.sum(flat[1:] * flat[:-1], axis=1) / (size[1:] * size[:-1])
    seconds = np.diff(times_ns[apart]) / 1e9
    # a correlation of nearly one or of zero gives no rate
    rate = -np.log(np.clip(correlation, 0.01, 1.0 - 1e-9)) / seconds
    return float(1.0 / np.mean(rate))
