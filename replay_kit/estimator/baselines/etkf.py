"""The ensemble transform Kalman filter (Bishop et al. 2001, Mon. Wea. Rev. 129, 420-436), in the weights of the default basis.

The weights are w = w_0 + A' c with A the members' anomalies over sqrt(E - 1) and c one coefficient a member, so that the prior is
c ~ N(0, I). The update keeps a square root T of the coefficients' covariance: with Y = H A' T and whitened rows,

    I + Y'Y = U L U',    c <- c + T U L^-1 U' Y' d,    T <- T U L^-1/2 U',

the symmetric square root, which keeps the mean of the anomalies at zero. It equals the Kalman filter with the sample covariance.
"""

from dataclasses import dataclass

import numpy as np

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.gaussian import normalised_square
from replay_kit.core.grid import Ensemble, Grid
from replay_kit.estimator.baselines.columns import FlowColumns
from replay_kit.estimator.baselines.profiles import Predictions, ProfileBaseline, ProfileBins
from replay_kit.estimator.static.filter import ReducedBasisEstimator, build_estimator


@dataclass(frozen=True, slots=True, eq=False)
class TransformState:
    """The estimate of the members' coefficients.

    Attributes:
        mean: shape (E,), c.
        transform: shape (E, E), T; the covariance of c is T T'.
        time_ns: Of the last observation used [ns, UTC]; None before the first.
    """

    mean: Array
    transform: Array
    time_ns: int | None


@dataclass(frozen=True, slots=True, eq=False)
class Etkf(ProfileBaseline[TransformState]):
    """Ensemble transform in weight space.

    Attributes:
        reduced: The default estimator, for the basis, the prior mean and the rows of a profile.
        anomalies: shape (E, Z r), of the members' weights over sqrt(E - 1).
    """

    reduced: ReducedBasisEstimator
    anomalies: Array

    @property
    def grid(self) -> Grid:
        """The grid of the forecast."""
        return self.reduced.basis.grid

    @property
    def state_size(self) -> int:
        """Number of coefficients E."""
        return len(self.anomalies)

    def initial(self) -> TransformState:
        """Return the state whose ensemble is the members."""
        return TransformState(np.zeros(self.state_size), np.eye(self.state_size), None)

    def assimilate(
        self, state: TransformState, bins: ProfileBins
    ) -> tuple[TransformState, Predictions]:
        """Return the state after a profile, and the predictions of its bins."""
        rows = self.reduced.rows(bins.observation, bins.screened.used)
        design = rows.design()
        of_member, prior = design @ self.anomalies.T, design @ self.reduced.prior.mean
        before = prior + of_member @ state.mean
        compressed, residual = rows.compress(rows.values)
        half_cov = of_member @ state.transform
        mean, transform = transform_update(
            state.mean, state.transform, half_cov, compressed - before
        )
        cov = half_cov @ half_cov.T
        square, half_log_det = normalised_square(compressed - before, cov + np.eye(compressed.size))
        predictions = Predictions(
            bins.values - rows.residual(before),
            bins.values - rows.residual(prior + of_member @ mean),
            bins.values - rows.residual(prior),
            np.sqrt(rows.expand_variance(cov) + rows.noise.std[:, None] ** 2),
            square + residual,
            -0.5 * (square + residual) - half_log_det - 2.0 * rows.noise.half_log_det,
        )
        return TransformState(mean, transform, bins.observation.time_ns), predictions

    def predict_bins(self, state: TransformState, bins: ProfileBins) -> Array:
        """Return the velocity predicted at the bins, shape (n, 2) [m/s], local axes."""
        rows = self.reduced.rows(bins.observation, bins.screened.used)
        return bins.values - rows.residual(rows.design() @ self._weights(state))

    def _weights(self, state: TransformState) -> Array:
        """Return the mean of the weights, shape (Z r,)."""
        return self.reduced.prior.mean + self.anomalies.T @ state.mean

    def flow(self, state: TransformState) -> FlowEstimate:
        """Return the current estimate of a state."""
        factor = (self.anomalies.T @ state.transform).reshape(
            self.reduced.basis.grid.levels.size, -1, len(state.transform)
        )

        def covariance(levels: tuple[int, ...] | None) -> Array:
            rows = factor[slice(None) if levels is None else list(levels)].reshape(
                -1, factor.shape[2]
            )
            return np.asarray(rows @ rows.T)

        return self.reduced.flow_of(self._weights(state), covariance, state.time_ns)

    def span_residual(self, points: Array, depth: Array, velocity: Array) -> Array | None:
        """Return a velocity minus the ensemble mean and the least-squares fit by the anomalies, shape (P, 2) [m/s]."""
        return self._columns().span_residual(
            points, depth, velocity - self.mean_velocity(points, depth)
        )

    def mean_velocity(self, points: Array, depth: Array) -> Array:
        """Return the velocity of the ensemble mean, shape (P, 2) [m/s]; the places are those of ``span_residual``."""
        return self.flow(self.initial()).velocity(points[:, 0], points[:, 1], depth)

    def _columns(self) -> FlowColumns:
        """Return the anomalies as flows, which span the estimate's departures from the ensemble mean."""
        basis = self.reduced.basis
        by_level = self.anomalies.reshape(self.anomalies.shape[0], basis.grid.levels.size, -1)
        return FlowColumns(basis.grid, basis.horizontal, by_level @ basis.modes.T)


def transform_update(
    mean: Array, transform: Array, half_cov: Array, innovation: Array
) -> tuple[Array, Array]:
    """Return the coefficients' mean and transform after rows with independent noise of unit variance.

    Args:
        mean: shape (E,).
        transform: shape (E, E).
        half_cov: shape (m, E), Y.
        innovation: shape (m,), d.
    """
    values, vectors = np.linalg.eigh(np.eye(mean.size) + half_cov.T @ half_cov)
    rotated = transform @ vectors
    return mean + rotated @ ((vectors.T @ (half_cov.T @ innovation)) / values), (
        rotated / np.sqrt(values)
    ) @ vectors.T


def build_etkf(ensemble: Ensemble, config: EstimatorConfig) -> Etkf:
    """Return the ensemble transform filter of an ensemble, in the default preset's basis and error model."""
    settings = {
        "preset": "default",
        "sample_share": 1.0,
        "shift_distance": 0.0,
        "mean_variance": 0.0,
        "spread": "as_given",
    }
    reduced = build_estimator(ensemble, config.model_copy(update=settings))
    weights = reduced.basis.member_weights
    stacked = weights.reshape(weights.shape[0], -1)
    return Etkf(reduced, (stacked - stacked.mean(axis=0)) / np.sqrt(weights.shape[0] - 1.0))
