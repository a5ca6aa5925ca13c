"""Baselines of whole three-dimensional flows: the paper's naive 3D basis, and its nearest member.

The naive basis has the singular vectors of whole members, one weight for each, and a diagonal prior of variances. The 2.5D basis divides
members into depth slices with separate weights; here a mode is a flow of all levels, so the estimate never leaves the members' span.

The nearest member has the least sum of squared differences from the measurements so far.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Ensemble
from replay_kit.estimator.baselines.columns import (
    deterministic_flow,
    embed_columns,
    flow_of_ensemble,
)
from replay_kit.estimator.baselines.profiles import ColumnBaseline, Predictions, ProfileBins, fit_of
from replay_kit.estimator.basis.slices import ensemble_slices
from replay_kit.estimator.update.rows import kalman_update


@dataclass(frozen=True, slots=True, eq=False)
class WeightState:
    """The estimate of the weights at one time.

    Attributes:
        mean: shape (m,).
        cov: shape (m, m).
        time_ns: Of the last observation used [ns, UTC]; None before the first.
    """

    mean: Array
    cov: Array
    time_ns: int | None


@dataclass(frozen=True, slots=True, eq=False)
class Naive3D(ColumnBaseline[WeightState]):
    """A Kalman filter with one weight for each mode.

    Attributes:
        columns: Basis flows.
        time_ns: Time of the forecast.
        velocity: shape (m, Z, 2N) [m/s], of the modes at the nodes; orthonormal.
        prior_mean: shape (m,), mean of the members' weights.
        prior_variance: shape (m,), their variances.
        config: Error model and number of modes.
    """

    velocity: Array
    prior_mean: Array
    prior_variance: Array
    config: EstimatorConfig

    @property
    def state_size(self) -> int:
        """Number of weights m."""
        return self.prior_mean.size

    def initial(self) -> WeightState:
        """Return the prior as a state."""
        return WeightState(self.prior_mean, np.diag(self.prior_variance), None)

    def assimilate(self, state: WeightState, bins: ProfileBins) -> tuple[WeightState, Predictions]:
        """Return the state after a profile, and the predictions of its bins."""
        design, std = self.at_bins(bins), bins.error_std(self.config)
        before, prior = design @ state.mean, design @ self.prior_mean
        whitened = (design / std[:, None, None]).reshape(-1, state.mean.size)
        innovation = (bins.values - before) / std[:, None]
        given = state.mean[:, None], state.cov, whitened, innovation.reshape(-1, 1)
        means, cov = kalman_update(*given)
        of_rows = whitened @ state.cov @ whitened.T
        fit = fit_of(innovation, std, 0.5 * (of_rows + of_rows.T) + np.eye(innovation.size))
        predictions = Predictions(before, design @ means[:, 0], prior, *fit)
        return WeightState(means[:, 0], cov, bins.observation.time_ns), predictions

    def predict_bins(self, state: WeightState, bins: ProfileBins) -> Array:
        """Return the velocity predicted at the bins, shape (n, 2) [m/s], local axes."""
        return np.asarray(self.at_bins(bins) @ state.mean)

    def flow(self, state: WeightState) -> FlowEstimate:
        """Return the current estimate of a state."""
        values, vectors = np.linalg.eigh(state.cov)
        anomalies = np.tensordot(
            (vectors * np.sqrt(np.maximum(values, 0.0))).T, self.velocity, axes=1
        )
        mean = np.tensordot(state.mean, self.velocity, axes=1)
        return flow_of_ensemble(
            self.columns, mean, anomalies, self.config, self.time_of(state.time_ns)
        )

    @property
    def basis_size(self) -> tuple[int | None, int | None]:
        """Number of modes, and of elements of the basis."""
        return len(self.velocity), self.velocity.size

    def span_residual(self, points: Array, depth: Array, velocity: Array) -> Array | None:
        """Return a velocity minus its least-squares fit by the modes, shape (P, 2) [m/s]."""
        return self.columns.span_residual(points, depth, velocity)


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
    modes = embed_columns(ensemble.grid, velocity, config)
    return Naive3D(
        modes, ensemble.time_ns, velocity, weights.mean(axis=0), weights.var(axis=0, ddof=1), config
    )


@dataclass(frozen=True, slots=True, eq=False)
class MemberErrors:
    """The distance of each member from the measurements so far.

    Attributes:
        sum_of_squares: shape (E,), of measured minus member over the bins' errors.
        time_ns: Of the last observation used [ns, UTC]; None before the first.
    """

    sum_of_squares: Array
    time_ns: int | None


@dataclass(frozen=True, slots=True, eq=False)
class NearestMember(ColumnBaseline[MemberErrors]):
    """Chooses among the members; without a measurement, the one nearest to their mean.

    Attributes:
        columns: The members as flows; compared with the measurements at their places.
        time_ns: Time of the forecast.
        distance: shape (E,), of each member from the mean, for the choice before any measurement and between equals.
    """

    distance: Array

    @property
    def state_size(self) -> int:
        """Number of members E."""
        return self.distance.size

    def initial(self) -> MemberErrors:
        """Return the state before any observation."""
        return MemberErrors(np.zeros(self.distance.size), None)

    def chosen(self, state: MemberErrors) -> int:
        """Return the position of the nearest member of a state."""
        return int(np.lexsort((self.distance, state.sum_of_squares))[0])

    def assimilate(
        self, state: MemberErrors, bins: ProfileBins
    ) -> tuple[MemberErrors, Predictions]:
        """Return the state after a profile, and the predictions of its bins, without a standard deviation."""
        by_member = np.moveaxis(self.at_bins(bins), -1, 0)
        errors = (bins.values - by_member) / bins.error_std()[:, None]
        after = MemberErrors(
            state.sum_of_squares + np.sum(errors**2, axis=(1, 2)), bins.observation.time_ns
        )
        before, now, prior = (by_member[self.chosen(s)] for s in (state, after, self.initial()))
        return after, Predictions(before, now, prior, np.full_like(before, np.nan))

    def predict_bins(self, state: MemberErrors, bins: ProfileBins) -> Array:
        """Return the velocity predicted at the bins, shape (n, 2) [m/s], local axes."""
        return self.at_bins(bins)[..., self.chosen(state)]

    def flow(self, state: MemberErrors) -> FlowEstimate:
        """Return the chosen member."""
        return deterministic_flow(
            self.columns,
            np.eye(self.distance.size)[self.chosen(state)],
            self.time_of(state.time_ns),
        )

    def span_residual(self, points: Array, depth: Array, velocity: Array) -> Array | None:
        """Return a velocity minus that of the member with the least root mean square difference, shape (P, 2) [m/s]."""
        residual = velocity[..., None] - self.columns.velocity(points, depth)
        return np.asarray(residual[..., np.argmin(np.sum(residual**2, axis=(0, 1)))])


def build_nearest(ensemble: Ensemble, config: EstimatorConfig) -> NearestMember:
    """Return the nearest-member baseline of an ensemble."""
    slices = ensemble_slices(ensemble)
    members = embed_columns(ensemble.grid, slices, config)
    distance = np.sum((slices - slices.mean(axis=0)) ** 2, axis=(1, 2))
    return NearestMember(members, ensemble.time_ns, distance)
