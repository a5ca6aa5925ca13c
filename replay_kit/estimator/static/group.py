"""Groups of profiles in the static estimator, and the fit of the prior's amplitude while it goes on."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.estimation import GatingConfig
from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_local
from replay_kit.core.grid import Grid
from replay_kit.core.observation import LinearMeasurement, Measurement, usable
from replay_kit.estimator.basis.modes import Basis
from replay_kit.estimator.interface import Stepped
from replay_kit.estimator.prior.amplitude import MeanAmplitude
from replay_kit.estimator.prior.hybrid import Prior
from replay_kit.estimator.static.state import FilterState, SpreadFit
from replay_kit.estimator.update.biases import NAMES
from replay_kit.estimator.update.group_step import (
    GroupColumn,
    GroupedEstimator,
    group_misfit,
    stack_of,
)
from replay_kit.estimator.update.grouping import Grouping, ProfileGroup
from replay_kit.estimator.update.noise import BinNoise, bin_noise, compress, measurement_noise
from replay_kit.estimator.update.observation_space import initial
from replay_kit.estimator.update.posterior import Posterior
from replay_kit.estimator.update.rows import (
    PredictedObservation,
    ProfileRows,
    Rows,
    measurement_rows,
    places_of,
)
from replay_kit.estimator.update.screening import ScreenedGroup, screen_group
from replay_kit.estimator.update.superobservation import (
    Column,
    ColumnUpdate,
    CombinedRows,
    combined,
)


@dataclass(frozen=True, slots=True, eq=False)
class StaticEstimator(GroupedEstimator[FilterState]):
    """A static estimator's problem, and what it sees of measurements.

    Attributes:
        basis: Basis flows.
        prior: Of the weights.
        error_std: Error of every bin [m/s], replacing the bins' own (paper); None adds ``representation_std`` to the bins' own.
        representation_std: shape (Z,) [m/s], representation error of the basis, by level.
        time_ns: Time of the forecast.
        gating: Gate and covariance inflation; None accepts every profile with its stated errors (paper).
        mean_amplitude: Gaussian of the ensemble mean's amplitude before the log, which is then averaged; None where its variance is given.
        spread: Amplitude of the prior's covariance before the log, which is then fitted to it; None leaves the covariance as it is.
        grouping: Which profiles are combined; None combines none.
    """

    basis: Basis
    prior: Prior
    error_std: float | None
    representation_std: Array
    time_ns: int | None
    gating: GatingConfig | None = None
    spread: SpreadFit | None = None
    grouping: Grouping | None = None
    mean_amplitude: MeanAmplitude | None = None

    @property
    def grid(self) -> Grid:
        """The grid of the forecast."""
        return self.basis.grid

    @property
    def adapts_errors(self) -> bool:
        """Whether errors grow where residuals are correlated along a profile: not those of the paper."""
        return self.error_std is None

    @property
    def prior_weights(self) -> Array:
        """Mean of the prior, shape (Z, r)."""
        return self.by_level(self.prior.mean)

    def by_level(self, mean: Array) -> Array:
        """Return weights, shape (Z r,), level by level, shape (Z, r)."""
        return mean.reshape(self.basis.grid.levels.size, -1)

    def rows(self, observation: Measurement, used: NDArray[np.intp]) -> Rows:
        """Return the rows of a measurement's usable bins."""
        linear = observation.linear
        return measurement_rows(linear, used, self.basis, self.noise(linear, used))

    def noise(self, observation: LinearMeasurement, used: NDArray[np.intp]) -> BinNoise:
        """Return the noise of a measurement's usable bins; the paper's error is that of a bin, not of a mean over several places."""
        if self.error_std is None or not observation.at_one_place:
            places = places_of(observation, self.grid.projection)
            return measurement_noise(observation, used, self.basis, self.representation_std, places)
        return bin_noise(
            np.diag(np.full(used.size, self.error_std**2)), observation.reference == "relative"
        )

    def initial_with(self, spread: SpreadFit | None) -> FilterState:
        """Return the prior of an amplitude as a state."""
        no_bias = np.zeros((len(NAMES), *self.prior_weights.shape))
        prior = self.prior if spread is None else spread.scale(self.prior)
        return FilterState(initial(prior, no_bias), spread, self.mean_amplitude)


def fitting_step(
    estimator: StaticEstimator, state: FilterState, item: Measurement | ProfileGroup
) -> list[Stepped[FilterState]]:
    """Return the outcome of a measurement or group, with the amplitude fitted if it is time, and the innovations before that."""
    stepped = _stepped(estimator, state, item)
    state, spread = stepped[-1].after, state.spread
    assert spread is not None
    used = next((each.event for each in stepped if each.innovation.accepted), None)
    place = None
    if used is not None:
        east, north = to_local(estimator.basis.grid.projection, used.longitude, used.latitude)
        place = np.array([np.mean(east), np.mean(north)])
    spread = spread.after(item, place, used)
    if spread.is_due and spread.past is not None:
        known = [_rows_of(estimator, each) for each, _ in spread.apart]
        fitted = spread.fitted(
            estimator.prior, estimator.prior_weights, [rows for rows in known if rows is not None]
        )
        state, spread = _again(estimator, state, spread, fitted), fitted
    return [*stepped[:-1], stepped[-1]._replace(after=replace(state, spread=spread))]


def _again(
    estimator: StaticEstimator, state: FilterState, before: SpreadFit, fitted: SpreadFit
) -> FilterState:
    """Return the state after all measurements so far under another amplitude."""
    assert before.past is not None, "a fit is due"
    if fitted.amplitude == before.amplitude:
        return state
    state = estimator.initial_with(fitted)
    if not any(isinstance(item, ProfileGroup) for item in before.past):
        *_, (state, _) = estimator.alone(
            state, [item for item in before.past if not isinstance(item, ProfileGroup)]
        )
        return state
    for item in before.past:
        state = _stepped(estimator, state, item)[-1].after
    return state


def _stepped(
    estimator: StaticEstimator, state: FilterState, item: Measurement | ProfileGroup
) -> list[Stepped[FilterState]]:
    if isinstance(item, ProfileGroup):
        return GroupedEstimator.step_group(estimator, state, item)
    after, innovation = next(estimator.alone(state, [item]))
    return [Stepped(item, state, after, innovation)]


def group_column(
    estimator: StaticEstimator, state: FilterState, screened: ScreenedGroup
) -> GroupColumn[FilterState]:
    """Return the estimate of the column that the usable profiles of a group see: of the current at the levels."""
    levels, posterior = profiles_of(estimator, screened), state.posterior
    known = posterior.prefetch([levels])[0]
    predicted = posterior.predict(levels, known)

    def update(step: ColumnUpdate) -> Posterior:
        rows = step.rows
        predicted = posterior.predict(combined_rows(levels, rows), known.turned(rows.r))
        return predicted.update(step.lower, step.whitened, 1.0)

    def against(other: FilterState) -> Array:
        return group_misfit(levels.stack, levels.matvec(estimator.by_level(other.mean)))

    column = Column(predicted.means, predicted.cov)
    prior = levels.matvec(estimator.prior_weights)
    return GroupColumn(levels.stack, state, column, prior, update, against)


def own_column(
    estimator: StaticEstimator,
    state: FilterState,
    rows: Rows,
    predicted: PredictedObservation[Posterior],
) -> GroupColumn[FilterState]:
    """Return the estimate of the rows of one measurement, as the column that it sees."""

    def update(step: ColumnUpdate) -> Posterior:
        # R is one over the standard deviation of the noise
        return predicted.update(step.lower, step.whitened, float(1.0 / step.rows.r[0, 0]))

    # the posterior's own prior may be an earlier posterior
    prior = rows.matvec(estimator.prior_weights)
    column = Column(predicted.means, predicted.cov)
    return GroupColumn(rows.stack, state, column, prior, update)


def _rows_of(estimator: StaticEstimator, item: Measurement | ProfileGroup) -> Rows | None:
    """Return the rows of a measurement, or those of the profiles of a group as one, with their stated errors."""
    if not isinstance(item, ProfileGroup):
        return rows_alone(estimator, screen_group((item,), None, estimator.grid))
    levels = profiles_of(estimator, screen_group(item.profiles, None, estimator.grid))
    stack = levels.stack
    whole = combined(stack.of("r"), stack.y[..., None], np.ones(len(stack.y)))
    return combined_rows(levels, whole)


def rows_alone(estimator: StaticEstimator, screened: ScreenedGroup) -> Rows | None:
    """Return the rows of a measurement; None where none of its values can be used."""
    used = np.flatnonzero(usable(screened.flags[0]))
    return estimator.rows(screened.linear[0], used) if used.size else None


def profiles_of(estimator: StaticEstimator, screened: ScreenedGroup) -> ProfileRows:
    """Return the rows of the current at the levels at the middle of the usable profiles, which they measure."""
    basis, n_levels = estimator.basis, estimator.grid.levels.size
    east, north = to_local(basis.grid.projection, *screened.middle)
    offset, modes = basis.at_place(np.array([float(east), float(north)]))

    def factors(
        profile: LinearMeasurement, used: NDArray[np.intp]
    ) -> tuple[BinNoise, Array, Array]:
        noise = estimator.noise(profile, used)
        return noise, *compress(noise, basis.depth_weights(profile.depth[used]))

    stack = stack_of(screened, basis, offset.T, factors)
    return ProfileRows(np.zeros(2 * n_levels), stack, np.eye(n_levels), modes)


def combined_rows(levels: ProfileRows, whole: CombinedRows) -> ProfileRows:
    """Return combined rows of the current at the levels as those of a profile."""
    return replace(levels, y=whole.y[..., 0].ravel(), r=whole.r)
