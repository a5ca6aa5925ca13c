"""The local ensemble transform Kalman filter (Hunt, Kostelich, Szunyogh 2007, Physica D 230, 112-126).

Each horizontal column of the grid has an analysis of its own, in which a profile's precision R^-1 is tapered with its horizontal
distance (Gaspari and Cohn 1999, Q. J. R. Meteorol. Soc. 125, eq. 4.10). With A the members' anomalies over sqrt(E - 1), each profile p
gives the information G_p = Y'R^-1 Y and g_p = Y'R^-1 d on the members' coefficients; a column at distances d_p then has

    C^-1 = I + sum_p rho(d_p) G_p,    c = C sum_p rho(d_p) g_p,    anomalies A C^1/2.

All profiles so far enter at once, so their order does not matter.
"""

from dataclasses import dataclass

import numpy as np

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Ensemble
from replay_kit.estimator.baselines.columns import embed_columns, flow_of_ensemble
from replay_kit.estimator.baselines.profiles import ColumnBaseline, Predictions, ProfileBins, fit_of
from replay_kit.estimator.basis.slices import cell_size, ensemble_slices
from replay_kit.estimator.prior.localised import gaspari_cohn

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
