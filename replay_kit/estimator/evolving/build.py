"""The estimator through time of a forecast at several times."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.estimation import GatingConfig, TimeConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.evolution import ProcessModel
from replay_kit.core.grid import Ensemble
from replay_kit.estimator.basis.modes import Basis, build_basis, mean_variance
from replay_kit.estimator.basis.slices import correlation_length
from replay_kit.estimator.evolving.filter import EvolvingEstimator
from replay_kit.estimator.evolving.observation_operator import (
    ObservationOperator,
    biases,
    oscillations,
)
from replay_kit.estimator.evolving.state_space import StateSpace
from replay_kit.estimator.prior.fit import Members, choose_settings, members_in_basis
from replay_kit.estimator.prior.hybrid import PriorSettings
from replay_kit.estimator.prior.localised import localised_part
from replay_kit.estimator.update.grouping import Grouping, current_gradient, spread_of

# Share of the largest spread below which the members are equal to rounding.
_LEAST_SPREAD = 1e-3
# Mixtures of the members' own evolutions decorrelate more slowly than the current at a place, by this factor.
_TRAJECTORY_FACTOR = 5.0


def build_evolving(
    forecasts: Sequence[Ensemble],
    config: EstimatorConfig,
    time: TimeConfig,
    gating: GatingConfig | None = None,
) -> EvolvingEstimator:
    """Return the estimator of a forecast at its times.

    Args:
        forecasts: The same members on the same grid, one a time, in order; one alone may have no time.
        config: Basis and prior; the preset is the default.
        time: How the current changes, what oscillates, and the instrument's biases.
        gating: Gate and covariance inflation; None accepts every observation with its stated errors.
    """
    pooled = replace(
        forecasts[0], velocity=np.concatenate([forecast.velocity for forecast in forecasts])
    )
    basis = build_basis(pooled, config.model_copy(update={"preset": "default"}))
    n_times, n_members = len(forecasts), forecasts[0].n_members
    weights = basis.member_weights.reshape(n_times, n_members, *basis.member_weights.shape[1:])
    # fitted at the time in the middle
    middle = forecasts[n_times // 2]
    members = replace(members_in_basis(basis), weights=weights[n_times // 2])
    settings = choose_settings(members, correlation_length(middle), config)
    if isinstance(config.spread, float):
        mean = weights.mean(axis=1, keepdims=True)
        weights = mean + np.sqrt(config.spread) * (weights - mean)
    times_ns = np.array(
        [0 if forecast.time_ns is None else forecast.time_ns for forecast in forecasts],
        dtype=np.int64,
    )
    process = _with_mean_amplitude(
        _process(weights, members, settings, times_ns, time), basis, config
    )
    oscillating = oscillations(time, basis.grid.projection.latitude, float(basis.grid.levels[-1]))
    operator = ObservationOperator(
        basis, process, oscillating, biases(time), basis.representation_std(config)
    )
    # the squared difference of a current that is forgotten over T grows by 2 variances over T
    change = 2.0 * spread_of(forecasts) ** 2 / process.local_scale
    grouping = Grouping(max(current_gradient(each) for each in forecasts), change)
    return EvolvingEstimator(
        operator, state_space(operator, time), gating, forecasts[0].time_ns, grouping
    )


def state_space(operator: ObservationOperator, time: TimeConfig) -> StateSpace:
    """Return the state space of an observation operator: unknowns of the process model, then of the oscillations, then of the biases."""
    process, oscillating, errors = operator.process, operator.oscillations, operator.biases
    n_knots, start = oscillating.knots.size, process.size
    pairs = (
        start + np.arange(oscillating.size).reshape(-1, 2, n_knots)
        if n_knots
        else np.empty((0, 2, 0), dtype=np.intp)
    )
    scales = np.concatenate(
        [
            process.scales,
            np.full(oscillating.size, time.oscillator_scale),
            np.full(errors.size, np.inf),
        ]
    )
    end = start + oscillating.size
    parts = {
        "process": slice(0, start),
        "oscillations": slice(start, end),
        "biases": slice(end, end + errors.size),
    }
    return StateSpace(
        scales,
        pairs[:, 0].ravel(),
        pairs[:, 1].ravel(),
        np.repeat(oscillating.omega, n_knots),
        parts,
    )


def mixture_scale(configured: float | None, local_scale: float) -> float:
    """Return the decorrelation time of mixtures of the members [s]: the configured one, else a multiple of the local one."""
    return configured or _TRAJECTORY_FACTOR * local_scale


def _process(
    weights: Array,
    members: Members,
    settings: PriorSettings,
    times_ns: NDArray[np.int64],
    time: TimeConfig,
) -> ProcessModel:
    """Return the weights' prior through time; ``weights`` of shape (T, E, Z, r)."""
    modes = members.shifted(settings)
    mean = weights.mean(axis=1)
    anomalies = (weights - mean[:, None]) / np.sqrt(weights.shape[1] - 1.0)
    copies = np.stack([modes.copies(of_time) for of_time in anomalies])
    spread = np.sqrt(np.sum(anomalies**2, axis=(1, 2, 3)))
    share = settings.sample_share
    spread_out = _times_with_spread(spread)
    normalised = (
        copies[spread_out] / spread[spread_out, None, None, None] / np.sqrt(spread_out.size)
    )
    local = directions(
        *localised_part(normalised.reshape(-1, *copies.shape[2:]), modes, settings.radius)
    )
    scaled = np.sqrt(1.0 - share) * local
    kept = significant_directions(scaled * spread.max(), members.velocity_modes, time.dropped_std)
    local_scale = (
        decorrelation_time(anomalies, times_ns)
        if time.scale == "auto"
        else np.inf
        if time.scale == "static"
        else time.scale
    )
    scales = mixture_scale(time.trajectory_scale, local_scale), local_scale
    return ProcessModel(times_ns, mean, np.sqrt(share) * copies, spread, scaled[kept], *scales)


def _with_mean_amplitude(
    process: ProcessModel, basis: Basis, config: EstimatorConfig
) -> ProcessModel:
    """Return a process under which the amplitude of the ensemble mean is uncertain too, the same at all times."""
    if basis.mean_weights is None:
        return process
    factor = config.spread if isinstance(config.spread, float) else 1.0
    moved = np.sqrt(factor * mean_variance(config)) * (basis.mean_weights + process.mean)
    return replace(
        process, trajectories=np.concatenate([process.trajectories, moved[:, None]], axis=1)
    )


def directions(vertical: Array, horizontal: Array) -> Array:
    """Return independent directions of a covariance that is independent between vertical functions, shape (q r, Z, r).

    Args:
        vertical: shape (q, Z), orthogonal rows.
        horizontal: shape (g, r, r); functions from the g-th on have the last.
    """
    out, values, vectors = [], *np.linalg.eigh(horizontal)
    for position, function in enumerate(vertical):
        group = min(position, len(horizontal) - 1)
        out.append(
            np.einsum(
                "z,rb->bzr", function, vectors[group] * np.sqrt(np.maximum(values[group], 0.0))
            )
        )
    return np.concatenate(out)


def significant_directions(local: Array, velocity_modes: Array, bound: float) -> Array:
    """Return the directions to keep, so that the others together have a standard deviation of at most a bound everywhere.

    Args:
        local: shape (B, Z, r).
        velocity_modes: shape (2N, r).
        bound: [m/s].
    """
    variance = np.stack(
        [np.max(np.square(direction @ velocity_modes.T), axis=0) for direction in local]
    )  # (B, 2N)
    order = np.argsort(variance.max(axis=1))
    dropped = np.cumsum(variance[order], axis=0).max(axis=1) <= bound**2
    return np.sort(order[~dropped])


def _times_with_spread(spread: Array) -> NDArray[np.intp]:
    """Return the times at which the members differ: they may all start from one analysis."""
    return np.flatnonzero(spread > _LEAST_SPREAD * spread.max())


def decorrelation_time(anomalies: Array, times_ns: NDArray[np.int64]) -> float:
    """Return the decorrelation time of anomalies [s], from their correlation between neighbouring times, pooled; inf for one time.

    Args:
        anomalies: shape (T, E, Z, r).
        times_ns: shape (T,) [ns].
    """
    if len(anomalies) < 2:
        return float("inf")
    spread_out = _times_with_spread(np.linalg.norm(anomalies.reshape(len(anomalies), -1), axis=1))
    if spread_out.size < 2:
        return float("inf")
    flat = anomalies[spread_out].reshape(spread_out.size, -1)
    size = np.linalg.norm(flat, axis=1)
    correlation = np.sum(flat[1:] * flat[:-1], axis=1) / (size[1:] * size[:-1])
    seconds = np.diff(times_ns[spread_out]) / 1e9
    # a correlation of nearly one or of zero gives no rate
    rate = -np.log(np.clip(correlation, 0.01, 1.0 - 1e-9)) / seconds
    return float(1.0 / np.mean(rate))
