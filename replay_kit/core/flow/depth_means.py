"""The uncertainty of a flow's means over depth, as a Gaussian process of few unknowns.

A mean over depth with weights a_j of the levels is h(x) y, with h the modes at a place and y = sum_j a_j w_j: of the weights w of all
levels only r numbers count for each such mean. Of a static estimate y has the covariance A P A' at all times. Of an estimate through time
the coefficients of the trajectories count each on its own, as they move the field, and the local corrections by y alone: both are
Ornstein-Uhlenbeck processes with one time scale each, so that the reduced unknowns are of the same kind and nothing is approximated.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.errors import EstimatorError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.evolution import Evolution
from replay_kit.core.flow.factors import FactoredCovariance


@dataclass(frozen=True, slots=True, eq=False)
class Relaxing:
    """Unknowns that lose their memory at one rate.

    Attributes:
        which: Their positions.
        scale: Decorrelation time [s].
        root: shape (m, k), of the covariance that they return to, root root'.
    """

    which: slice
    scale: float
    root: Array


@dataclass(frozen=True, slots=True, eq=False)
class DepthMeans:
    """The errors of a flow's means over depth.

    Attributes:
        flow: The flow at the time from which it is known.
        weights: shape (D, Z), of each level in each mean.
        root: shape (n, k), of the unknowns' covariance at that time.
        time_ns: That time [ns, UTC]; 0 where it does not matter.
        relaxing: What changes with time; none of a static estimate.
        loading: Returns the effect of the unknowns on the means' modes at a time [ns, UTC], shape (n, D, r).
    """

    flow: FlowEstimate
    weights: Array
    root: Array
    time_ns: int
    relaxing: tuple[Relaxing, ...]
    loading: Callable[[int], Array]

    @property
    def changes(self) -> bool:
        """Whether the uncertainty is that of a current that changes."""
        return bool(self.relaxing)

    def memory(self, time_ns: int) -> Array:
        """Return the share of each unknown's value that is left at a time [ns, UTC], shape (n,)."""
        left = np.ones(len(self.root))
        for part in self.relaxing:
            left[part.which] = np.exp(-max(time_ns - self.time_ns, 0) / 1e9 / part.scale)
        return left

    def latent(self, time_ns: int) -> Array:
        """Return the latent values of the means of the flow itself at a time [ns, UTC], shape (M, D)."""
        flow = self.flow.at(time_ns) if self.changes else self.flow
        return np.asarray(flow.latent @ self.weights.T)

    def modes(self, points: Array) -> Array:
        """Return the modes' velocities at points, shape (P, 2) [m]: shape (P, 2, r)."""
        return np.ascontiguousarray(
            self.flow.horizontal.velocity(points, self.flow.modes).swapaxes(0, 1)
        )


def depth_means(flow: FlowEstimate, weights: Array) -> DepthMeans:
    """Return the errors of a flow's means over depth.

    Args:
        flow: With its uncertainty.
        weights: shape (D, Z), of each level in each mean.

    Raises:
        EstimatorError: The flow carries no uncertainty.
    """
    if flow.n_modes == 0:
        raise EstimatorError(
            "expected an estimate with its uncertainty, got a flow without (a truth, a member, a sample or a mean)"
        )
    later = flow.later
    if isinstance(later, Evolution) and np.isfinite(later.process.scales).any():
        return _through_time(flow, later, weights)
    size = len(weights) * flow.n_modes
    unchanged = np.eye(size).reshape(size, len(weights), flow.n_modes)
    return DepthMeans(
        flow,
        weights,
        root_of(_reduced(flow, weights)),
        flow.time_ns or 0,
        (),
        lambda time_ns: unchanged,
    )


def _reduced(flow: FlowEstimate, weights: Array) -> Array:
    """Return the covariance of the means' modes, shape (D r, D r)."""
    design = weights[:, None, :, None] * np.eye(flow.n_modes)[None, :, None, :]
    design = design.reshape(-1, flow.levels.size, flow.n_modes)
    if isinstance(flow.covariance, FactoredCovariance) and "weight_cov" not in vars(flow):
        return flow.covariance.of_combinations(design)
    by_level = flow.weight_cov.reshape(
        flow.levels.size, flow.n_modes, flow.levels.size, flow.n_modes
    )
    half = np.einsum("dz,zrys->drys", weights, by_level, optimize=True)
    return np.asarray(
        np.einsum("drys,ey->dres", half, weights, optimize=True).reshape(len(design), len(design))
    )


def _through_time(flow: FlowEstimate, evolution: Evolution, weights: Array) -> DepthMeans:
    """Return the errors of an estimate through time from its own time on."""
    time_ns = max(
        (time for time in (flow.time_ns, evolution.time_ns) if time is not None), default=None
    )
    now, process = evolution.unknowns_at(time_ns or 0), evolution.process
    n_moving, n_means, n_modes = process.trajectories.shape[1], len(weights), flow.n_modes
    local = np.einsum("dz,bzr->bdr", weights, process.local, optimize=True).reshape(
        len(process.local), n_means * n_modes
    )
    mix = np.zeros((process.size, n_moving + n_means * n_modes))
    mix[:n_moving, :n_moving] = np.eye(n_moving)
    mix[n_moving:, n_moving:] = local
    moving, still = slice(0, n_moving), slice(n_moving, mix.shape[1])
    relaxing = (
        Relaxing(moving, process.trajectory_scale, np.eye(n_moving)),
        Relaxing(still, process.local_scale, root_of(local.T @ local)),
    )
    unmoved = np.eye(n_means * n_modes).reshape(-1, n_means, n_modes)

    def loading(at_ns: int) -> Array:
        moved = np.einsum("dz,fzr->fdr", weights, process.trajectories_at(at_ns), optimize=True)
        return np.concatenate([moved, process.spread_at(at_ns) * unmoved])

    return DepthMeans(
        flow, weights, root_of(mix.T @ now.covariance() @ mix), time_ns or 0, relaxing, loading
    )


def root_of(covariance: Array) -> Array:
    """Return a factor of a covariance that may lack its full rank, shape (n, k), without directions of 1e-12 of the largest variance."""
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    kept: NDArray[np.bool_] = (
        values > 1e-12 * max(float(values[-1]), 0.0) if values.size else np.zeros(0, dtype=bool)
    )
    return np.asarray(vectors[:, kept] * np.sqrt(values[kept]))
