"""A forecast at several times to the estimator of them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.gating import TrustConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.config.time import TimeConfig
from replay_kit.core.arrays import Array
from replay_kit.core.grid import Ensemble
from replay_kit.estimator.basis.modes import build_basis, correlation_length
from replay_kit.estimator.evolving.extras import Oscillations, biases, oscillations
from replay_kit.estimator.evolving.filter import EvolvingEstimator
from replay_kit.estimator.evolving.sea import Sea
from replay_kit.estimator.evolving.seen import Model
from replay_kit.estimator.evolving.state import Layout
from replay_kit.estimator.prior.fit import choose_settings, members_in
from replay_kit.estimator.prior.hybrid import PriorSettings, localised_part, shifted_in_modes
from replay_kit.estimator.update.biases import Biases

# A mixture of the members' own evolutions holds longer than the current at a place.
_TRAJECTORIES_HOLD = 5.0
# Of the largest spread, below which members are the same but for rounding.
_SPREAD = 1e-3


def build_evolving(
    forecasts: Sequence[Ensemble], config: EstimatorConfig, time: TimeConfig, trust: TrustConfig | None = None
) -> EvolvingEstimator:
    """Return the estimator of a forecast at its times.

    Args:
        forecasts: The same members on the same grid, one a time, in order; one alone may have no time.
        config: Basis and prior; the preset is the default.
        time: How the current changes, what oscillates, and the instrument's biases.
        trust: Gate and watch; None believes every observation.
    """
    pooled = replace(forecasts[0], velocity=np.concatenate([forecast.velocity for forecast in forecasts]))
    basis = build_basis(pooled, config.model_copy(update={"preset": "default"}))
    n_times, n_members = len(forecasts), forecasts[0].n_members
    weights = basis.member_weights.reshape(n_times, n_members, *basis.member_weights.shape[1:])
    # the time in the middle decides what is fitted
    middle = forecasts[n_times // 2]
    members = replace(members_in(basis), weights=weights[n_times // 2])
    settings = choose_settings(members, correlation_length(middle), config)
    times_ns = np.array([0 if forecast.time_ns is None else forecast.time_ns for forecast in forecasts], dtype=np.int64)
    sea = _sea(weights, members.velocity_modes, members.nodes, settings, times_ns, time)
    representation = basis.truncation_std
    if config.representation_error_std is not None:
        representation = np.full_like(representation, config.representation_error_std)
    swinging = oscillations(time, basis.grid.projection.latitude, float(basis.grid.levels[-1]))
    errors = biases(time)
    model = Model(basis, sea, swinging, errors, representation)
    return EvolvingEstimator(model, layout(sea, swinging, errors, time), trust, forecasts[0].time_ns, time.window)


def layout(sea: Sea, swinging: Oscillations, errors: Biases, time: TimeConfig) -> Layout:
    """Return the order of the unknowns: the sea's, the oscillations', the biases'."""
    n_knots, start = swinging.knots.size, sea.size
    pairs = start + np.arange(swinging.size).reshape(-1, 2, n_knots) if n_knots else np.empty((0, 2, 0), dtype=np.intp)
    scales = np.concatenate([sea.scales, np.full(swinging.size, time.oscillator_scale), np.full(errors.size, np.inf)])
    end = start + swinging.size
    parts = {"sea": slice(0, start), "oscillations": slice(start, end), "biases": slice(end, end + errors.size)}
    return Layout(scales, pairs[:, 0].ravel(), pairs[:, 1].ravel(), np.repeat(swinging.omega, n_knots), parts)


def _sea(
    weights: Array, velocity_modes: Array, nodes: Array, settings: PriorSettings, times_ns: NDArray[np.int64], time: TimeConfig
) -> Sea:
    """Return the weights' prior through time; ``weights`` of shape (T, E, Z, r)."""
    mean = weights.mean(axis=1)
    anomalies = (weights - mean[:, None]) / np.sqrt(weights.shape[1] - 1.0)
    projector = np.asarray(np.linalg.pinv(velocity_modes), dtype=np.float64)
    copies = np.stack([shifted_in_modes(of_time, velocity_modes, projector, nodes, settings.shift) for of_time in anomalies])
    spread = np.sqrt(np.sum(anomalies**2, axis=(1, 2, 3)))
    share = settings.sample_share
    told = _with_spread(spread)
    alike = copies[told] / spread[told, None, None, None] / np.sqrt(told.size)
    local = directions(*localised_part(alike.reshape(-1, *copies.shape[2:]), velocity_modes, projector, nodes, settings.radius))
    scaled = np.sqrt(1.0 - share) * local
    kept = beyond(scaled * spread.max(), velocity_modes, time.dropped_std)
    local_scale = forgetting_scale(anomalies, times_ns) if time.scale == "auto" else np.inf if time.scale == "static" else time.scale
    trajectory_scale = time.trajectory_scale or _TRAJECTORIES_HOLD * local_scale
    return Sea(times_ns, mean, np.sqrt(share) * copies, spread, scaled[kept], trajectory_scale, local_scale)


def directions(vertical: Array, horizontal: Array) -> Array:
    """Return independent directions of a covariance that is independent between vertical functions, shape (q r, Z, r).

    Args:
        vertical: shape (q, Z), orthonormal rows.
        horizontal: shape (q, r, r).
    """
    out = []
    for function, of_modes in zip(vertical, horizontal, strict=True):
        values, vectors = np.linalg.eigh(of_modes)
        out.append(np.einsum("z,rb->bzr", function, vectors * np.sqrt(np.maximum(values, 0.0))))
    return np.concatenate(out)


def beyond(local: Array, velocity_modes: Array, bound: float) -> Array:
    """Return which directions are needed, so that the others together nowhere have a standard deviation above a bound.

    Args:
        local: shape (B, Z, r).
        velocity_modes: shape (2N, r).
        bound: [m/s].
    """
    variance = np.stack([np.max(np.square(direction @ velocity_modes.T), axis=0) for direction in local])  # (B, 2N)
    order = np.argsort(variance.max(axis=1))
    dropped = np.cumsum(variance[order], axis=0).max(axis=1) <= bound**2
    return np.sort(order[~dropped])


def _with_spread(spread: Array) -> NDArray[np.intp]:
    """Return the times at which the members differ: they may all begin from one analysis."""
    return np.flatnonzero(spread > _SPREAD * spread.max())


def forgetting_scale(anomalies: Array, times_ns: NDArray[np.int64]) -> float:
    """Return how long anomalies stay as they are [s]: from their correlation between neighbouring times, pooled over all; inf for one time.

    Args:
        anomalies: shape (T, E, Z, r).
        times_ns: shape (T,) [ns].
    """
    if len(anomalies) < 2:
        return float("inf")
    told = _with_spread(np.linalg.norm(anomalies.reshape(len(anomalies), -1), axis=1))
    if told.size < 2:
        return float("inf")
    flat = anomalies[told].reshape(told.size, -1)
    size = np.linalg.norm(flat, axis=1)
    alike = np.sum(flat[1:] * flat[:-1], axis=1) / (size[1:] * size[:-1])
    seconds = np.diff(times_ns[told]) / 1e9
    # a correlation of nearly one or of nothing tells no rate
    rate = -np.log(np.clip(alike, 0.01, 1.0 - 1e-9)) / seconds
    return float(1.0 / np.mean(rate))
