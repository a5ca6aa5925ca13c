"""One step of an estimator: evaluation, one update, and the innovations to publish, of one measurement or of profiles combined."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from replay_kit.config.estimation import GatingConfig
from replay_kit.core.arrays import Array, replace
from replay_kit.core.grid import Grid
from replay_kit.core.observation import Innovation, Measurement
from replay_kit.estimator.basis.modes import Basis
from replay_kit.estimator.interface import Estimator, Stepped, each_stepped
from replay_kit.estimator.update.grouping import ProfileGroup
from replay_kit.estimator.update.published import GroupResult, column_misfits
from replay_kit.estimator.update.rows import Assimilation
from replay_kit.estimator.update.screening import (
    ScreenedGroup,
    local_values,
    local_velocities,
    relative_velocities,
    screen_group,
)
from replay_kit.estimator.update.stack import Factors, Stack, stack_of_one, stacked
from replay_kit.estimator.update.superobservation import (
    Column,
    ColumnUpdate,
    GroupUpdate,
    Judging,
    evaluate_group,
)

State = TypeVar("State", bound=Assimilation)


def stack_of(screened: ScreenedGroup, basis: Basis, reference: Array, factors: Factors) -> Stack:
    """Return the usable profiles as arrays.

    Args:
        screened: The group after screening.
        basis: Basis flows.
        reference: shape (Z, 2) [m/s], the estimator's reference current at the place.
        factors: See ``stack.Factors``.
    """
    profiles, used = screened.usable_linear, screened.is_used
    if len(profiles) == 1:
        (one,), at = profiles, np.flatnonzero(used[0])
        own, components = local_values(one, at, basis.grid.projection)
        levels = one.at_values(basis.depth_weights(one.depth))[at]
        about = own - levels @ reference @ components.T, components
        return stack_of_one(one, at, about, factors(one, at), basis.grid)
    depth = np.array([each.depth for each in profiles])
    depths, back = np.unique(np.where(used, depth, 0.0), return_inverse=True)
    known = (basis.depth_weights(depths) @ reference)[back.reshape(depth.shape)]
    values = local_velocities(profiles, used, basis.grid) - known
    relative = relative_velocities(profiles, used, basis.grid)
    return stacked(profiles, used, values, relative, factors)


def group_misfit(stack: Stack, means: Array) -> Array:
    """Return ``column_misfits`` of one column, all values one below the other, shape (n m, 2) [m/s]."""
    return column_misfits(stack, means[None]).reshape(-1, 2)


@dataclass(frozen=True, slots=True, eq=False)
class GroupColumn(Generic[State]):
    """Measurements, and the estimate of the column of water that they see.

    Attributes:
        stack: The measurements.
        state: The estimator's state at their time.
        column: The estimate before them.
        prior: shape (c q,), the column's mean before any observation.
        posterior: Returns the estimate after an update of the column.
        against: See ``Stepped``.
    """

    stack: Stack
    state: State
    column: Column
    prior: Array
    posterior: Callable[[ColumnUpdate], Any]
    against: Callable[[State], Array] | None = None


class GroupedEstimator(Estimator[State], Protocol[State]):
    """An estimator that assimilates groups of profiles; measurements between groups are assimilated in blocks.

    Attributes:
        gating: Gate and covariance inflation; None accepts every profile with its stated errors.
    """

    gating: GatingConfig | None

    @property
    def grid(self) -> Grid:
        """The region."""
        ...

    @property
    def adapts_errors(self) -> bool:
        """Whether errors grow where residuals are correlated along a profile."""
        return True

    def group_column(self, state: State, screened: ScreenedGroup) -> GroupColumn[State]:
        """Return the estimate of the column that the usable measurements see."""
        ...

    def group_mean(self, state: State, screened: ScreenedGroup) -> tuple[Stack, Array]:
        """Return the usable measurements, and the mean of their column alone, shape (c q,)."""
        ...

    def with_posterior(self, at: GroupColumn[State], posterior: Any, jacobian: float) -> State:
        """Return the state after a group, given what its update returned and the sum of its scale Jacobians."""
        ...

    def inflated(self, state: State, factor: float) -> State:
        """Return a state whose covariance is multiplied by a factor, usually 1, after a group."""
        ...

    def is_late(self, state: State, time_ns: int) -> bool:
        """Return whether an observation of a time is too old for a state."""
        return False

    def usable(self, observation: Measurement) -> bool:
        """Return whether an observation has a bin that ``step`` would use."""
        return screen_group((observation,), None, self.grid).used.size > 0

    def screened(self, state: State, events: Sequence[Measurement]) -> ScreenedGroup:
        """Return measurements after screening."""
        late = self.is_late(state, min(event.time_ns for event in events))
        return screen_group(events, state.last, self.grid, late)

    def alone(
        self, state: State, measurements: Iterable[Measurement]
    ) -> Iterator[tuple[State, Innovation]]:
        """Yield the state after each measurement of a group that is not combined, and its innovation."""
        return self.steps(state, measurements)

    def group_steps(
        self, state: State, items: Iterable[Measurement | ProfileGroup]
    ) -> Iterator[Stepped[State]]:
        """Yield the outcome of measurements and groups of profiles."""
        waiting: list[Measurement] = []
        for item in items:
            if not isinstance(item, ProfileGroup):
                waiting.append(item)
                continue
            for stepped in each_stepped(state, waiting, self.steps(state, waiting)):
                yield stepped
                state = stepped.after
            waiting = []
            for stepped in self.step_group(state, item):
                yield stepped
                state = stepped.after
        yield from each_stepped(state, waiting, self.steps(state, waiting))

    def step_group(self, state: State, group: ProfileGroup) -> list[Stepped[State]]:
        """Return the outcome of the profiles of a group."""
        screened = self.screened(state, group.profiles)
        if screened.used.size < 2:
            return list(each_stepped(state, group.profiles, self.alone(state, group.profiles)))
        return self.step_screened(state, screened)

    def step_screened(self, state: State, screened: ScreenedGroup) -> list[Stepped[State]]:
        """Return the outcome of measurements after screening, of which at least one is used."""
        at = self.group_column(state, screened)
        return self.assimilated(screened, at, (state, self.evaluated(state, at)))

    def evaluated(self, state: State, at: GroupColumn[State]) -> GroupUpdate:
        """Return the evaluation of measurements against the column that they see."""
        judging = Judging(self.gating, self.adapts_errors, state.monitor.is_consistent)
        return evaluate_group(at.stack, at.column, judging)

    def assimilated(
        self,
        screened: ScreenedGroup,
        at: GroupColumn[State],
        evaluated: tuple[State, GroupUpdate],
    ) -> list[Stepped[State]]:
        """Return the outcome of measurements.

        Args:
            screened: They, after screening.
            at: The column that they see.
            evaluated: The state before them, and their evaluation.
        """
        state, update = evaluated
        monitor, inflation = state.monitor.updated(update.gate, self.gating)
        after, step = state, update.step
        if step is not None:
            after = self.with_posterior(at, at.posterior(step), update.scale_jacobian)
        seen = screened.usable_linear[-1]
        after = replace(after, monitor=monitor, last=seen)
        after = self.inflated(after, inflation)
        result = GroupResult(screened, update, at.column, at.prior, inflation)
        return _outcomes(result, (state, after), at)

    def group_innovation(self, state: State, group: ProfileGroup) -> Array:
        """Return measured minus predicted bins of all profiles of a group, shape (n m, 2) [m/s]; 0 for bins that are not usable."""
        return group_misfit(*self.group_mean(state, screen_group(group.profiles, None, self.grid)))

    def innovation(self, state: State, observation: Measurement) -> Array:
        """Return measured minus predicted values, shape (n, 2) [m/s], local axes; NaN for those that are not usable."""
        screened = screen_group((observation,), None, self.grid)
        out = np.full(screened.unused(0).innovation.shape, np.nan)
        if screened.used.size:
            used = screened.is_used[0]
            out[used] = group_misfit(*self.group_mean(state, screened))[used]
        return out


def _outcomes(
    result: GroupResult, states: tuple[State, State], at: GroupColumn[State]
) -> list[Stepped[State]]:
    """Return the outcome of each measurement of a group, and of the accepted ones together, in the order of the first.

    Args:
        result: The evaluation.
        states: Of the estimator before and after the group.
        at: The measurements, and the column that they see.
    """
    before, after = states
    screened, gate = result.screened, result.update.gate
    accepted = np.flatnonzero(gate.accepted)
    used = screened.used.tolist()
    found: list[Stepped[State]] = [
        Stepped(event, before, before, screened.unused(i))
        for i, event in enumerate(screened.events)
        if i not in used
    ]
    # the last thing of a group leaves the estimator in the state after it
    left = before if accepted.size else after
    for i in np.flatnonzero(~gate.accepted).tolist():
        found.append(Stepped(screened.events[used[i]], before, left, result.rejected(i)))
    if accepted.size:
        events = tuple(screened.events[used[i]] for i in accepted)
        whole = accepted.size == len(used) > 1
        found.append(
            Stepped(
                ProfileGroup(events) if len(events) > 1 else events[0],
                before,
                after,
                result.combined(accepted),
                at.against if whole else None,
            )
        )
    return found
