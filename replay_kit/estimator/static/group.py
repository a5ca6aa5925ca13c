"""Groups of profiles in the static estimator, and the fit of the prior's amplitude while it goes on."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.geodesy import to_local
from replay_kit.core.observation import (
    BOTH_COMPONENTS,
    Innovation,
    LinearMeasurement,
    Measurement,
)
from replay_kit.estimator.basis.modes import Basis
from replay_kit.estimator.interface import Stepped
from replay_kit.estimator.prior.hybrid import Prior
from replay_kit.estimator.static.state import FilterState, SpreadFit
from replay_kit.estimator.update.evaluation import PredictedObservation
from replay_kit.estimator.update.group_step import (
    GroupColumn,
    GroupedEstimator,
    ScreenedGroup,
    group_misfit,
    screen_group,
    stack_of,
)
from replay_kit.estimator.update.grouping import ProfileGroup
from replay_kit.estimator.update.posterior import Posterior
from replay_kit.estimator.update.profile_stack import ProfileStack
from replay_kit.estimator.update.rows import BinNoise, ProfileRows, Rows
from replay_kit.estimator.update.screening import Screened
from replay_kit.estimator.update.superobservation import (
    Column,
    CombinedRows,
    combined,
)


class StaticEstimator(GroupedEstimator[FilterState], Protocol):
    """What a static estimator gives to its groups: see ``ReducedBasisEstimator``, which has them."""

    basis: Basis
    prior: Prior

    @property
    def prior_weights(self) -> Array:
        """Mean of the prior, shape (Z, r)."""
        ...

    def by_level(self, mean: Array) -> Array:
        """Return weights, shape (Z, r)."""
        ...

    def initial_with(self, spread: SpreadFit | None) -> FilterState:
        """Return the prior of an amplitude as a state."""
        ...

    def alone(
        self, state: FilterState, measurements: Iterable[Measurement]
    ) -> Iterator[tuple[FilterState, Innovation]]:
        """Yield the state after each observation, and its innovation."""
        ...

    def linearised(self, observation: Measurement) -> tuple[Screened, Rows | None]:
        """Return a measurement after screening, and its rows."""
        ...

    def noise(self, observation: LinearMeasurement, used: NDArray[np.intp]) -> BinNoise:
        """Return the noise of a measurement's usable bins."""
        ...


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
    basis, stack = profiles_of(estimator, screened)
    identity = column_rows(basis, np.eye(estimator.grid.levels.size))
    posterior = state.posterior
    known = posterior.prefetch([identity])[0]
    predicted = posterior.predict(identity, known)
    column = Column(np.column_stack([predicted.mean, predicted.bias_sensitivity]), predicted.cov)

    def predict(rows: CombinedRows) -> PredictedObservation[Posterior]:
        return posterior.predict(column_rows(basis, rows.r, rows), known.turned(rows.r))

    def against(other: FilterState) -> Array:
        return group_misfit(stack, identity.matvec(estimator.by_level(other.mean)))

    prior = identity.matvec(estimator.prior_weights)
    return GroupColumn(stack, state, column, prior, predict, against)


def _rows_of(estimator: StaticEstimator, item: Measurement | ProfileGroup) -> Rows | None:
    """Return the rows of a measurement, or those of the profiles of a group as one, with their stated errors."""
    if not isinstance(item, ProfileGroup):
        return estimator.linearised(item)[1]
    basis, stack = profiles_of(estimator, screen_group(item, None, estimator.basis.grid))
    whole = combined(stack.of("r"), stack.y[..., None], np.ones(len(stack.y)))
    return column_rows(basis, whole.r, whole)


def profiles_of(estimator: StaticEstimator, screened: ScreenedGroup) -> tuple[Array, ProfileStack]:
    """Return the modes' velocity at the middle of the usable profiles, shape (2, r), and these as arrays."""
    basis, middle = estimator.basis, screened.usable
    east, north = to_local(basis.grid.projection, middle.longitude, middle.latitude)
    offset, modes = basis.at_place(np.array([float(east), float(north)]))

    def factors(profile: LinearMeasurement, used: NDArray[np.intp]) -> tuple[Array, BinNoise]:
        return basis.depth_weights(profile.depth[used]), estimator.noise(profile, used)

    return modes, stack_of(screened, basis, offset.T, factors)


def column_rows(basis: Array, r: Array, whole: CombinedRows | None = None) -> ProfileRows:
    """Return rows of unit noise as those of a profile."""
    size = len(r)
    noise = BinNoise(np.eye(size), np.eye(size), 0.0)
    values = np.zeros((size, 2)) if whole is None else whole.y[..., 0].T
    return ProfileRows(np.eye(size), noise, values, BOTH_COMPONENTS, r, basis)
