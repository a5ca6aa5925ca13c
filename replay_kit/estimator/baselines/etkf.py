"""The ensemble transform Kalman filter, global and local.

**Global** (Bishop et al. 2001, Mon. Wea. Rev. 129, 420-436), in the weights of the default basis. The weights are w = w_0 + A' c with A the
members' anomalies over sqrt(E - 1) and c one coefficient a member, so that the prior is c ~ N(0, I). The update keeps a square root T of
the coefficients' covariance: with Y = H A' T and whitened rows,

    I + Y'Y = U L U',    c <- c + T U L^-1 U' Y' d,    T <- T U L^-1/2 U',

the symmetric square root, which keeps the mean of the anomalies at zero. It equals the Kalman filter with the sample covariance.

**Local** (Hunt, Kostelich, Szunyogh 2007, Physica D 230, 112-126). Each horizontal column of the grid has an analysis of its own, in which
a profile's precision R^-1 is tapered with its horizontal distance (Gaspari and Cohn 1999, Q. J. R. Meteorol. Soc. 125, eq. 4.10). With A
the members' anomalies over sqrt(E - 1), each profile p gives the information G_p = Y'R^-1 Y and g_p = Y'R^-1 d on the members'
coefficients; a column at distances d_p then has

    C^-1 = I + sum_p rho(d_p) G_p,    c = C sum_p rho(d_p) g_p,    anomalies A C^1/2.

All profiles so far enter at once, so their order does not matter.
"""

from dataclasses import dataclass

import numpy as np

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.evidence import normalised_square
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Ensemble, Grid
from replay_kit.estimator.baselines.columns import FlowColumns, embed_columns, flow_of_ensemble
from replay_kit.estimator.baselines.profiles import (
    ColumnBaseline,
    Predictions,
    ProfileBaseline,
    ProfileBins,
    fit_of,
)
from replay_kit.estimator.basis.slices import cell_size, ensemble_slices
from replay_kit.estimator.prior.localised import gaspari_cohn
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
        rows = self.reduced.rows(bins.observation, bins.used)
        design = rows.design()
        of_member, prior = design @ self.anomalies.T, design @ self.reduced.prior.mean
        before = prior + of_member @ state.mean
        half_cov = of_member @ state.transform
        mean, transform = transform_update(state.mean, state.transform, half_cov, rows.y - before)
        cov, layout = half_cov @ half_cov.T, rows.stack.layouts[0]
        square, half_log_det = normalised_square(rows.y - before, cov + np.eye(rows.y.size))
        square += float(rows.stack.residual_square[0])
        of_members, errors = rows.stack.variances(cov[None])
        predictions = Predictions(
            bins.values - rows.misfit(before),
            bins.values - rows.misfit(prior + of_member @ mean),
            bins.values - rows.misfit(prior),
            np.sqrt((of_members + errors)[rows.stack.used]),
            square,
            -0.5 * square - half_log_det - 2.0 * layout.half_log_det,
        )
        return TransformState(mean, transform, bins.observation.time_ns), predictions

    def predict_bins(self, state: TransformState, bins: ProfileBins) -> Array:
        """Return the velocity predicted at the bins, shape (n, 2) [m/s], local axes."""
        rows = self.reduced.rows(bins.observation, bins.used)
        return bins.values - rows.misfit(rows.design() @ self._weights(state))

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


# Where the taper reaches zero. Shorter leaves gaps between sparse pings, longer lets sampling noise through: of 6, 10, 16 and 24 cells the
# best falls with the number of pings on eddying flows of 80 to 95 members, and no one radius is best at all of them.
RADIUS_IN_CELLS = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class LocalState:
    """The information of each profile so far on the members' coefficients; one entry for each profile.

    Attributes:
        places: Each of shape (2,) [m], local east and north.
        information: Each of shape (E, E), G_p.
        score: Each of shape (E,), g_p.
        time_ns: Of the last observation used [ns, UTC]; None before the first.
    """

    places: tuple[Array, ...]
    information: tuple[Array, ...]
    score: tuple[Array, ...]
    time_ns: int | None


@dataclass(frozen=True, slots=True, eq=False)
class Letkf(ColumnBaseline[LocalState]):
    """Local analyses, one for each column of the grid.

    Attributes:
        columns: The members' mean, then their anomalies over sqrt(E - 1), as flows: m = 1 + E.
        time_ns: Time of the forecast.
        velocity: shape (1 + E, Z, 2N) [m/s], of the same at the nodes.
        radius: Distance at which the influence of a profile ends [m].
        config: Error model, and number of modes of a flow's covariance.
    """

    velocity: Array
    radius: float
    config: EstimatorConfig

    @property
    def state_size(self) -> int:
        """Number of members E."""
        return len(self.velocity) - 1

    def initial(self) -> LocalState:
        """Return the state before any observation."""
        return LocalState((), (), (), None)

    def assimilate(self, state: LocalState, bins: ProfileBins) -> tuple[LocalState, Predictions]:
        """Return the state after a profile, and the predictions of its bins by the analysis at the profile's own place."""
        prior, anomalies = self._at_bins(bins)
        std = bins.error_std(self.config)
        y = (anomalies / std[:, None, None]).reshape(-1, anomalies.shape[-1])
        mean, root = self._analysis(state, bins.place)
        before = prior + anomalies @ mean
        after = LocalState(
            (*state.places, bins.place),
            (*state.information, y.T @ y),
            (*state.score, y.T @ ((bins.values - prior) / std[:, None]).ravel()),
            bins.observation.time_ns,
        )
        now = prior + anomalies @ self._analysis(after, bins.place)[0]
        half_cov = y @ root
        fit = fit_of(
            (bins.values - before) / std[:, None], std, np.eye(len(y)) + half_cov @ half_cov.T
        )
        return after, Predictions(before, now, prior, *fit)

    def predict_bins(self, state: LocalState, bins: ProfileBins) -> Array:
        """Return the velocity predicted at the bins, shape (n, 2) [m/s], local axes."""
        prior, anomalies = self._at_bins(bins)
        return np.asarray(prior + anomalies @ self._analysis(state, bins.place)[0])

    def flow(self, state: LocalState) -> FlowEstimate:
        """Return the columns' analyses, joined by the kernel's interpolation."""
        n_nodes = self.columns.grid.nodes.shape[0]
        mean, anomalies = self.velocity[0].copy(), self.velocity[1:].copy()
        for node, place in enumerate(self.columns.grid.nodes):
            coefficients, root = self._analysis(state, place)
            both = np.array([node, node + n_nodes])
            prior = self.velocity[1:, :, both]
            mean[:, both] += np.tensordot(coefficients, prior, axes=1)
            anomalies[:, :, both] = np.tensordot(root, prior, axes=1)
        return flow_of_ensemble(
            self.columns, mean, anomalies, self.config, self.time_of(state.time_ns)
        )

    def _at_bins(self, bins: ProfileBins) -> tuple[Array, Array]:
        """Return the mean, shape (n, 2), and the anomalies, shape (n, 2, E), at the bins [m/s]."""
        both = self.at_bins(bins)
        return both[..., 0], both[..., 1:]

    def _analysis(self, state: LocalState, place: Array) -> tuple[Array, Array]:
        """Return the coefficients' mean, shape (E,), and the symmetric root of their covariance, shape (E, E), at a place."""
        n_members = self.state_size
        distance = np.array([np.hypot(*(place - other)) for other in state.places])
        near = np.flatnonzero(distance < self.radius)
        taper = gaspari_cohn(distance[near], self.radius)
        precision, score = np.eye(n_members), np.zeros(n_members)
        for p, rho in zip(near, taper, strict=True):
            precision += rho * state.information[p]
            score += rho * state.score[p]
        values, vectors = np.linalg.eigh(precision)
        return vectors @ ((vectors.T @ score) / values), (vectors / np.sqrt(values)) @ vectors.T


def build_letkf(ensemble: Ensemble, config: EstimatorConfig, radius: float | None = None) -> Letkf:
    """Return the localised ensemble transform filter of an ensemble.

    Args:
        ensemble: The members.
        config: Error model, nugget and kernel length.
        radius: Where the taper reaches zero [m]; None for ``RADIUS_IN_CELLS`` cells of the geometric mean size.
    """
    slices = ensemble_slices(ensemble)
    mean = slices.mean(axis=0)
    velocity = np.concatenate([mean[None], (slices - mean) / np.sqrt(ensemble.n_members - 1.0)])
    columns = embed_columns(ensemble.grid, velocity, config)
    if radius is None:
        radius = RADIUS_IN_CELLS * float(np.sqrt(np.prod(cell_size(ensemble.grid))))
    return Letkf(columns, ensemble.time_ns, velocity, radius, config)
