"""The ensemble transform Kalman filter (Bishop et al. 2001, Mon. Wea. Rev. 129, 420-436), in the weights of the default basis.

The weights are w = w_0 + A' c with A the members' anomalies over sqrt(E - 1) and c one coefficient a member, so that the prior is
c ~ N(0, I). The update keeps a square root T of the coefficients' covariance: with Y = H A' T and whitened rows,

    I + Y'Y = U L U',    c <- c + T U L^-1 U' Y' d,    T <- T U L^-1/2 U',

the symmetric square root, which keeps the mean of the anomalies at zero. It equals the Kalman filter with the sample covariance.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Innovation, Observation
from replay_kit.estimator.baselines.columns import FlowColumns
from replay_kit.estimator.baselines.profiles import Predictions, innovation_of, usable_bins
from replay_kit.estimator.filter import ReducedBasisEstimator, build_estimator
from replay_kit.estimator.interface import Estimator
from replay_kit.estimator.update.screening import rejected


@dataclass(frozen=True, slots=True, eq=False)
class TransformState:
    """What is known of the members' coefficients.

    Attributes:
        mean: shape (E,), c.
        transform: shape (E, E), T; the covariance of c is T T'.
        time_ns: Of the last observation used [ns, UTC]; None before the first.
    """

    mean: Array
    transform: Array
    time_ns: int | None


@dataclass(frozen=True, slots=True, eq=False)
class Etkf(Estimator[TransformState]):
    """Ensemble transform in weight space.

    Attributes:
        reduced: The default estimator, for the basis, the prior mean and the rows of a profile.
        anomalies: shape (E, Z r), of the members' weights over sqrt(E - 1).
    """

    reduced: ReducedBasisEstimator
    anomalies: Array

    def initial(self) -> TransformState:
        """Return the members as they are."""
        n_members = self.anomalies.shape[0]
        return TransformState(np.zeros(n_members), np.eye(n_members), None)

    def step(self, state: TransformState, observation: Observation) -> tuple[TransformState, Innovation]:
        """Return the state after an observation, and the innovation."""
        bins = usable_bins(observation, self.reduced.basis.grid)
        if bins.used.size == 0:
            return state, rejected(observation, bins.flags, bins.reasons)
        rows, about_offset = self.reduced.rows(observation, bins.used)
        design = rows.design()
        of_member = design @ self.anomalies.T
        prior_rows = design @ self.reduced.prior.mean
        innovation = rows.misfit(about_offset, prior_rows + of_member @ state.mean)
        compressed, left_out = rows.compress(innovation)
        spread = of_member @ state.transform
        mean, transform = transform_update(state.mean, state.transform, spread, compressed)
        predicted = spread @ spread.T
        lower = np.linalg.cholesky(predicted + np.eye(compressed.size))
        whitened = scipy.linalg.solve_triangular(lower, compressed, lower=True)
        predictions = Predictions(
            bins.values - innovation,
            bins.values - rows.misfit(about_offset, prior_rows + of_member @ mean),
            bins.values - rows.misfit(about_offset, prior_rows),
            np.sqrt(rows.expand_variance(predicted) + rows.noise.std[:, None] ** 2),
        )
        said = innovation_of(observation, bins, predictions, float(whitened @ whitened) + left_out)
        return TransformState(mean, transform, observation.time_ns), said

    def misfit(self, state: TransformState, observation: Observation) -> Array:
        """Return measured minus predicted by a state, shape (n, 2) [m/s], local axes; NaN for bins not usable."""
        mean = self.reduced.prior.mean + self.anomalies.T @ state.mean
        return self.reduced.misfit_of(mean, observation)

    def flow(self, state: TransformState) -> FlowEstimate:
        """Return the current estimate that a state stands for."""
        factor = (self.anomalies.T @ state.transform).reshape(self.reduced.basis.grid.levels.size, -1, len(state.transform))

        def covariance(levels: tuple[int, ...] | None) -> Array:
            rows = factor[slice(None) if levels is None else list(levels)].reshape(-1, factor.shape[2])
            return np.asarray(rows @ rows.T)

        mean = self.reduced.prior.mean + self.anomalies.T @ state.mean
        return self.reduced.flow_of(mean, covariance, state.time_ns)

    def columns(self) -> FlowColumns:
        """Return the anomalies as flows: what the estimate can differ from the ensemble's mean by."""
        basis = self.reduced.basis
        by_level = self.anomalies.reshape(self.anomalies.shape[0], basis.grid.levels.size, -1)
        return FlowColumns(basis.grid, basis.kernel, by_level @ basis.modes.T)


def transform_update(mean: Array, transform: Array, spread: Array, innovation: Array) -> tuple[Array, Array]:
    """Return the coefficients' mean and transform after rows with independent noise of unit variance.

    Args:
        mean: shape (E,).
        transform: shape (E, E).
        spread: shape (m, E), Y.
        innovation: shape (m,), d.
    """
    values, vectors = np.linalg.eigh(np.eye(mean.size) + spread.T @ spread)
    turned = transform @ vectors
    return mean + turned @ ((vectors.T @ (spread.T @ innovation)) / values), (turned / np.sqrt(values)) @ vectors.T


def build_etkf(ensemble: Ensemble, config: EstimatorConfig) -> Etkf:
    """Return the ensemble transform filter of an ensemble, in the default preset's basis and error model."""
    reduced = build_estimator(ensemble, config.model_copy(update={"preset": "default", "sample_share": 1.0, "shift_distance": 0.0}))
    weights = reduced.basis.member_weights
    stacked = weights.reshape(weights.shape[0], -1)
    return Etkf(reduced, (stacked - stacked.mean(axis=0)) / np.sqrt(weights.shape[0] - 1.0))
