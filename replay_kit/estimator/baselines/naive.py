"""The paper's naive 3D basis: singular vectors of whole members, one weight for each, a diagonal prior of variances.

The 2.5D basis cuts members into depth slices and gives every slice its own weight; here a mode is a flow of all levels, so the estimate
never leaves the members' span.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Innovation, Observation
from replay_kit.estimator.baselines.columns import FlowColumns, default_kernel, embed_columns, flow_of_ensemble
from replay_kit.estimator.baselines.profiles import Predictions, UsableBins, error_std, innovation_of, usable_bins
from replay_kit.estimator.basis.modes import ensemble_slices
from replay_kit.estimator.interface import Estimator
from replay_kit.estimator.update.screening import rejected, scatter


@dataclass(frozen=True, slots=True, eq=False)
class WeightState:
    """What is known of the weights at one time.

    Attributes:
        mean: shape (m,).
        cov: shape (m, m).
        time_ns: Of the last observation used [ns, UTC]; None before the first.
    """

    mean: Array
    cov: Array
    time_ns: int | None


@dataclass(frozen=True, slots=True, eq=False)
class Naive3D(Estimator[WeightState]):
    """A Kalman filter on one weight a mode.

    Attributes:
        modes: Basis flows.
        velocity: shape (m, Z, 2N) [m/s], of the modes at the nodes; orthonormal.
        prior_mean: shape (m,), mean of the members' weights.
        prior_variance: shape (m,), their variances.
        config: Error model and number of modes.
        time_ns: Time of the forecast.
    """

    modes: FlowColumns
    velocity: Array
    prior_mean: Array
    prior_variance: Array
    config: EstimatorConfig
    time_ns: int | None

    def initial(self) -> WeightState:
        """Return the prior as a state."""
        return WeightState(self.prior_mean, np.diag(self.prior_variance), None)

    def step(self, state: WeightState, observation: Observation) -> tuple[WeightState, Innovation]:
        """Return the state after an observation, and the innovation."""
        bins = usable_bins(observation, self.modes.grid)
        if bins.used.size == 0:
            return state, rejected(observation, bins.flags, bins.reasons)
        design = self._design(bins)
        std = error_std(observation, bins.used, self.config)[:, None]
        before, prior = design @ state.mean, design @ self.prior_mean
        whitened = (design / std[..., None]).reshape(-1, state.mean.size)
        mean, cov, predicted, nis = update(state.mean, state.cov, whitened, ((bins.values - before) / std).ravel())
        innovation_std = std * np.sqrt(np.diag(predicted).reshape(-1, 2) + 1.0)
        said = innovation_of(observation, bins, Predictions(before, design @ mean, prior, innovation_std), nis)
        return WeightState(mean, cov, observation.time_ns), said

    def misfit(self, state: WeightState, observation: Observation) -> Array:
        """Return measured minus predicted by a state, shape (n, 2) [m/s], local axes; NaN for bins not usable."""
        bins = usable_bins(observation, self.modes.grid)
        return scatter(observation.depth.size, bins.used, bins.values - self._design(bins) @ state.mean)

    def flow(self, state: WeightState) -> FlowEstimate:
        """Return the current estimate that a state stands for."""
        values, vectors = np.linalg.eigh(state.cov)
        anomalies = np.tensordot((vectors * np.sqrt(np.maximum(values, 0.0))).T, self.velocity, axes=1)
        mean = np.tensordot(state.mean, self.velocity, axes=1)
        time_ns = self.time_ns if state.time_ns is None else state.time_ns
        return flow_of_ensemble(self.modes.grid, self.modes.kernel, mean, anomalies, self.config, time_ns)

    def _design(self, bins: UsableBins) -> Array:
        """Return the modes' velocity at the bins, shape (n, 2, m) [m/s]."""
        return np.asarray(np.einsum("nz,czm->ncm", bins.depth_weights, self.modes.at_place(bins.place)))


def update(mean: Array, cov: Array, design: Array, innovation: Array) -> tuple[Array, Array, Array, float]:
    """Return the updated mean and covariance, the rows' predicted covariance without noise, and the rows' NIS.

    Args:
        mean: shape (n,).
        cov: shape (n, n), symmetric.
        design: shape (m, n), of rows with independent noise of unit variance.
        innovation: shape (m,), rows minus their prediction.
    """
    cov_design = cov @ design.T
    predicted = design @ cov_design
    predicted = 0.5 * (predicted + predicted.T)
    lower = np.linalg.cholesky(predicted + np.eye(innovation.size))
    whitened = scipy.linalg.solve_triangular(lower, innovation, lower=True)
    half_gain = scipy.linalg.solve_triangular(lower, cov_design.T, lower=True)
    return mean + half_gain.T @ whitened, cov - half_gain.T @ half_gain, predicted, float(whitened @ whitened)


def build_naive(ensemble: Ensemble, config: EstimatorConfig) -> Naive3D:
    """Return the naive 3D estimator of an ensemble, with ``config.modes`` modes or as many as there are members.

    Velocities and hats in depth take the place of the paper's latents and Gaussians, as in the default preset.
    """
    slices = ensemble_slices(ensemble)
    members = slices.reshape(ensemble.n_members, -1)
    vectors, singular_values, _ = scipy.linalg.svd(members.T, full_matrices=False)
    rank = int(np.sum(singular_values > 1e-12 * singular_values[0]))
    vectors = vectors[:, : min(config.modes or rank, rank)]
    weights = members @ vectors
    velocity = vectors.T.reshape(-1, *slices.shape[1:])
    modes = embed_columns(ensemble.grid, default_kernel(ensemble.grid, config), velocity, config.nugget)
    return Naive3D(modes, velocity, weights.mean(axis=0), weights.var(axis=0, ddof=1), config, ensemble.time_ns)
