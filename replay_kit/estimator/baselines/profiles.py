"""The part common to baselines that assimilate profiles: usable bins, their local velocity and error, and the published innovation."""

from dataclasses import dataclass, replace
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import EstimatorError
from replay_kit.core.evidence import normalised_square
from replay_kit.core.flow.functions import depth_weights
from replay_kit.core.grid import Grid
from replay_kit.core.observation import Innovation, LinearMeasurement, Measurement, usable
from replay_kit.estimator.baselines.columns import HATS, FlowColumns
from replay_kit.estimator.interface import Estimator
from replay_kit.estimator.update.rows import places_of
from replay_kit.estimator.update.screening import ScreenedGroup, local_values, screen_group

State = TypeVar("State")


@dataclass(frozen=True, slots=True, eq=False)
class ProfileBins:
    """The usable bins of a profile.

    Attributes:
        observation: The profile.
        screened: The same after screening.
        place: shape (2,) [m], local east and north.
        depth_weights: shape (n, Z), of the levels at each bin.
        values: shape (n, 2) [m/s], measured, local east and north.
    """

    observation: LinearMeasurement
    screened: ScreenedGroup
    place: Array
    depth_weights: Array
    values: Array

    @property
    def used(self) -> NDArray[np.intp]:
        """Their positions among all bins, shape (n,)."""
        return np.flatnonzero(usable(self.screened.flags[0]))

    def scatter(self, values: Array) -> Array:
        """Return values of the usable bins, shape (n, 2), at their positions among all bins; NaN for the others."""
        out = np.full((self.screened.flags.shape[1], 2), np.nan)
        out[self.used] = values
        return out

    def error_std(self, config: EstimatorConfig | None = None) -> Array:
        """Return the error of each bin, shape (n,) [m/s]: its own, the common one and the representation error; or the paper's."""
        used = self.used
        if config is not None and config.preset == "paper":
            return np.full(used.size, config.paper_error_std)
        representation = 0.0 if config is None else config.representation_error_std or 0.0
        return np.hypot(
            np.hypot(self.observation.error_std[used], self.observation.common_std), representation
        )


@dataclass(frozen=True, slots=True, eq=False)
class Predictions:
    """Predictions of the usable bins, each of shape (n, 2) [m/s], and the fit of the measured values.

    Attributes:
        before: From the state before the update.
        after: From the state after it.
        prior: From the state before any observation.
        innovation_std: Predicted standard deviation of the innovation; NaN when the estimator has none.
        nis: Normalised innovation squared; NaN likewise.
        log_likelihood: Without the constant of 2 pi; NaN likewise.
    """

    before: Array
    after: Array
    prior: Array
    innovation_std: Array
    nis: float = float("nan")
    log_likelihood: float = float("nan")


class ProfileBaseline(Estimator[State], Protocol[State]):
    """An estimator that assimilates absolute profiles alone, on a grid with hat functions of depth."""

    @property
    def grid(self) -> Grid:
        """The grid of the forecast."""
        ...

    def assimilate(self, state: State, bins: ProfileBins) -> tuple[State, Predictions]:
        """Return the state after a profile with at least one usable bin, and the predictions of its bins."""
        ...

    def predict_bins(self, state: State, bins: ProfileBins) -> Array:
        """Return the velocity predicted at the bins, shape (n, 2) [m/s], local axes."""
        ...

    def step(self, state: State, observation: Measurement) -> tuple[State, Innovation]:
        """Return the state after a profile, and the innovation.

        Raises:
            EstimatorError: The observation is a mean along a path.
        """
        bins = profile_bins(observation, self.grid)
        if bins.used.size == 0:
            return state, bins.screened.unused(0)
        after, predictions = self.assimilate(state, bins)
        return after, innovation_of(bins, predictions)

    def innovation(self, state: State, observation: Measurement) -> Array:
        """Return measured minus predicted by a state, shape (n, 2) [m/s], local axes; NaN for bins not usable."""
        bins = profile_bins(observation, self.grid)
        return bins.scatter(
            bins.values - self.predict_bins(state, bins) if bins.used.size else bins.values
        )

    def usable(self, observation: Measurement) -> bool:
        """Return whether a profile has a bin that ``step`` would use."""
        return profile_bins(observation, self.grid).used.size > 0


@dataclass(frozen=True, slots=True, eq=False)
class ColumnBaseline(ProfileBaseline[State]):
    """A baseline whose estimate is a combination of whole flows.

    Attributes:
        columns: The flows.
        time_ns: Time of the forecast.
    """

    columns: FlowColumns
    time_ns: int | None

    @property
    def grid(self) -> Grid:
        """The grid of the forecast."""
        return self.columns.grid

    def at_bins(self, bins: ProfileBins) -> Array:
        """Return the columns' velocity at the bins of a profile, shape (n, 2, m) [m/s]."""
        return np.asarray(
            np.einsum("nz,czm->ncm", bins.depth_weights, self.columns.at_place(bins.place))
        )

    def time_of(self, last_ns: int | None) -> int | None:
        """Return the time of an estimate whose last observation is of a time: the forecast's before the first [ns, UTC]."""
        return self.time_ns if last_ns is None else last_ns


def profile_bins(observation: Measurement, grid: Grid) -> ProfileBins:
    """Return the bins of a profile that an estimate on a grid can be compared with.

    Raises:
        EstimatorError: The observation is a mean along a path.
    """
    linear = observation.linear
    if not linear.at_one_place or len(linear.components) < 2 or linear.weights is not None:
        raise EstimatorError(
            "a baseline assimilates profiles only, but got a mean along a path or a single component; "
            "filter observations by Estimator.supports_path_means"
        )
    screened = screen_group((linear,), None, grid, relative=False)
    used = np.flatnonzero(usable(screened.flags[0]))
    (place,) = places_of(linear, grid.projection)
    weights = depth_weights(HATS, linear.depth[used], grid.levels)
    local, _ = local_values(linear, used, grid.projection)
    return ProfileBins(linear, screened, place, weights, local)


def fit_of(innovation: Array, std: Array, cov: Array) -> tuple[Array, float, float]:
    """Return innovation standard deviations, shape (n, 2) [m/s], the normalised innovation squared and the log-likelihood.

    Args:
        innovation: shape (n, 2), over the bins' errors.
        std: shape (n,) [m/s], the bins' errors.
        cov: shape (2 n, 2 n), predicted covariance of the innovation over the bins' errors, both components of a bin together.
    """
    nis, half_log_det = normalised_square(innovation.ravel(), cov)
    log_likelihood = -0.5 * nis - half_log_det - 2.0 * float(np.log(std).sum())
    return std[:, None] * np.sqrt(np.diag(cov)).reshape(-1, 2), nis, log_likelihood


def innovation_of(bins: ProfileBins, predictions: Predictions) -> Innovation:
    """Return the innovation of a profile with at least one usable bin."""
    scatter = bins.scatter
    return replace(
        bins.screened.unused(0),
        innovation=scatter(bins.values - predictions.before),
        innovation_std=scatter(predictions.innovation_std),
        residual=scatter(bins.values - predictions.after),
        prior_innovation=scatter(bins.values - predictions.prior),
        nis=predictions.nis,
        dof=2 * bins.used.size,
        accepted=True,
        log_likelihood=predictions.log_likelihood,
    )
