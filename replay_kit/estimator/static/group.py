"""Groups of profiles in the static estimator, and the fit of the prior's amplitude while it goes on."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.gating import GatingConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.depth import depth_weights
from replay_kit.core.geodesy import to_local
from replay_kit.core.observation import Innovation, Measurement, Observation
from replay_kit.estimator.basis.modes import Basis
from replay_kit.estimator.prior.hybrid import Prior
from replay_kit.estimator.static.state import FilterState, SpreadFit, with_mean_averaged
from replay_kit.estimator.update.group_step import (
    GroupResult,
    ScreenedGroup,
    Stepped,
    results_of,
    screen_group,
    stack_of,
)
from replay_kit.estimator.update.grouping import ProfileGroup
from replay_kit.estimator.update.posterior import PriorCrossCovariance
from replay_kit.estimator.update.profile_stack import ProfileStack
from replay_kit.estimator.update.representation import inflated, select_representation
from replay_kit.estimator.update.rows import BinNoise, PathRows, ProfileRows
from replay_kit.estimator.update.screening import Screened
from replay_kit.estimator.update.superobservation import (
    Column,
    CombinedRows,
    combined,
    evaluate_group,
)


class _Estimator(Protocol):
    """What groups need of the static estimator; the members are documented there."""

    @property
    def basis(self) -> Basis: ...
    @property
    def prior(self) -> Prior: ...
    @property
    def prior_weights(self) -> Array: ...
    @property
    def error_std(self) -> float | None: ...
    @property
    def gating(self) -> GatingConfig | None: ...
    def initial_with(self, spread: SpreadFit | None) -> FilterState: ...
    def steps(
        self, state: FilterState, observations: Iterable[Measurement]
    ) -> Iterator[tuple[FilterState, Innovation]]: ...
    def assimilated(
        self, state: FilterState, source: Iterable[Measurement]
    ) -> Iterator[tuple[FilterState, Innovation]]: ...
    def linearised(
        self, observation: Measurement
    ) -> tuple[Screened, ProfileRows | PathRows | None]: ...
    def noise(self, observation: Observation, used: NDArray[np.intp]) -> BinNoise: ...
    def by_level(self, mean: Array) -> Array: ...


def group_steps(
    estimator: _Estimator, state: FilterState, items: Iterable[Measurement | ProfileGroup]
) -> Iterator[Stepped[FilterState]]:
    """Yield what became of measurements and groups of profiles; measurements between groups are assimilated in blocks."""
    waiting: list[Measurement] = []

    def alone() -> Iterator[Stepped[FilterState]]:
        nonlocal state
        for measurement, (after, innovation) in zip(
            waiting, estimator.steps(state, waiting), strict=True
        ):
            yield Stepped(measurement, state, after, innovation)
            state = after
        waiting.clear()

    for item in items:
        if not isinstance(item, ProfileGroup):
            waiting.append(item)
            continue
        yield from alone()
        fitting = state.spread is not None and state.spread.past is not None
        for stepped in (
            fitting_step(estimator, state, item) if fitting else step_group(estimator, state, item)
        ):
            yield stepped
            state = stepped.after
    yield from alone()


def fitting_step(
    estimator: _Estimator, state: FilterState, item: Measurement | ProfileGroup
) -> list[Stepped[FilterState]]:
    """Return what became of a measurement or group, with the amplitude fitted if it is time, and the innovations before that."""
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
    estimator: _Estimator, state: FilterState, before: SpreadFit, fitted: SpreadFit
) -> FilterState:
    """Return the state after all measurements so far under another amplitude."""
    assert before.past is not None, "a fit is due"
    if fitted.amplitude == before.amplitude:
        return state
    state = estimator.initial_with(fitted)
    if not any(isinstance(item, ProfileGroup) for item in before.past):
        *_, (state, _) = estimator.assimilated(
            state, [item for item in before.past if not isinstance(item, ProfileGroup)]
        )
        return state
    for item in before.past:
        state = _stepped(estimator, state, item)[-1].after
    return state


def _stepped(
    estimator: _Estimator, state: FilterState, item: Measurement | ProfileGroup
) -> list[Stepped[FilterState]]:
    if isinstance(item, ProfileGroup):
        return step_group(estimator, state, item)
    after, innovation = next(estimator.assimilated(state, [item]))
    return [Stepped(item, state, after, innovation)]


def step_group(
    estimator: _Estimator, state: FilterState, group: ProfileGroup
) -> list[Stepped[FilterState]]:
    """Return what became of the profiles of a group, with the prior's amplitude as it is."""
    screened = screen_group(group, state.last, estimator.basis.grid)
    if screened.used.size < 2:
        return _one_by_one(estimator, state, group)
    basis, stack = _stack(estimator, screened)
    identity = _rows(basis, np.eye(estimator.basis.grid.levels.size))
    posterior = state.posterior
    known = posterior.prefetch([identity])[0]
    predicted = posterior.predict(identity, known)
    before = Column(np.column_stack([predicted.mean, predicted.bias_sensitivity]), predicted.cov)
    update = evaluate_group(
        stack, before, estimator.gating, estimator.error_std is None, state.monitor.is_consistent
    )
    monitor, inflation = state.monitor.updated(update.first, estimator.gating)
    after, score, time_ns = before, state.bias_score, state.time_ns
    if update.rows is not None:
        rows = _rows(basis, update.rows.r, update.rows)
        of_rows = posterior.predict(rows, _turned(known, update.rows.r))
        innovation = update.rows.y.reshape(rows.dof, -1) - np.column_stack(
            [of_rows.mean, of_rows.bias_sensitivity]
        )
        posterior = select_representation(of_rows.posterior(innovation, 1.0))
        after, time_ns = before.updated(update.rows.r, innovation), stack.observations[-1].time_ns
        if stack.relative is not None:
            cov = of_rows.cov + np.eye(rows.dof)
            score = score.updated(innovation[:, 1:], innovation[:, 0], cov, update.scale_jacobian)
    if inflation > 1.0:
        posterior = inflated(posterior, inflation)
    seen = replace(state, last=screened.profiles[int(screened.used[-1])])
    changed = replace(seen, posterior=posterior, time_ns=time_ns, monitor=monitor, bias_score=score)
    changed = with_mean_averaged(changed, estimator.basis.mean_weights)
    prior = identity.matvec(estimator.prior_weights)
    return results_of(
        GroupResult(screened, update, before, after, prior, inflation), (state, changed), state
    )


def group_innovation(estimator: _Estimator, state: FilterState, group: ProfileGroup) -> Array:
    """Return measured minus predicted by a state, shape (n m, 2) [m/s], local axes, of all profiles; 0 for bins not usable."""
    basis, stack = _stack(estimator, screen_group(group, None, estimator.basis.grid))
    column = _rows(basis, np.eye(estimator.basis.grid.levels.size)).matvec(
        estimator.by_level(state.mean)
    )
    rows = Column(column[:, None], np.empty((0, 0))).predicted(stack.of("r"))[..., 0]
    return stack.misfit(np.broadcast_to(rows, stack.y.shape)).reshape(-1, 2)


def _one_by_one(
    estimator: _Estimator, state: FilterState, group: ProfileGroup
) -> list[Stepped[FilterState]]:
    found = []
    for profile, (after, innovation) in zip(
        group.profiles, estimator.assimilated(state, group.profiles), strict=True
    ):
        found.append(Stepped(profile, state, after, innovation))
        state = after
    return found


def _rows_of(
    estimator: _Estimator, item: Measurement | ProfileGroup
) -> ProfileRows | PathRows | None:
    """Return the rows of a measurement, or those of the profiles of a group as one, with their stated errors."""
    if not isinstance(item, ProfileGroup):
        return estimator.linearised(item)[1]
    basis, stack = _stack(estimator, screen_group(item, None, estimator.basis.grid))
    whole = combined(stack.of("r"), stack.y[..., None], np.ones(len(stack.y)))
    return _rows(basis, whole.r, whole)


def _stack(estimator: _Estimator, screened: ScreenedGroup) -> tuple[Array, ProfileStack]:
    """Return the modes' velocity at the middle of the usable profiles, shape (2, r), and these as arrays."""
    grid, functions = estimator.basis.grid, estimator.basis.depth_functions
    middle = ProfileGroup(tuple(screened.profiles[i] for i in screened.used))
    east, north = to_local(grid.projection, middle.longitude, middle.latitude)
    offset, modes = estimator.basis.at_place(np.array([float(east), float(north)]))
    stack = stack_of(
        screened,
        grid,
        offset.T,
        lambda depth: depth_weights(functions, depth, grid.levels),
        lambda profile, used: (
            depth_weights(functions, profile.depth[used], grid.levels),
            estimator.noise(profile, used),
        ),
    )
    return modes, stack


def _rows(basis: Array, r: Array, whole: CombinedRows | None = None) -> ProfileRows:
    """Return rows of unit noise as those of a profile."""
    size = len(r)
    noise = BinNoise(np.eye(size), np.eye(size), 0.0)
    return ProfileRows(
        np.eye(size), noise, np.zeros((size, 2)) if whole is None else whole.y[..., 0].T, r, basis
    )


def _turned(known: PriorCrossCovariance, r: Array) -> PriorCrossCovariance:
    """Return what was computed of the unknowns of a column for rows of them."""
    size = len(r)
    cross = np.concatenate([np.tensordot(r, part, axes=1) for part in np.split(known.cross, 2)])
    solved = known.solved
    if solved.size:
        solved = np.hstack([solved[:, :size] @ r.T, solved[:, size:] @ r.T])
    return PriorCrossCovariance(cross, solved, known.n_solved)
