"""One step of an estimator with a group of profiles: screening, evaluation, one update, and the innovations to publish."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.gating import GatingConfig
from replay_kit.core.arrays import Array
from replay_kit.core.grid import Grid
from replay_kit.core.observation import (
    Flag,
    GroupTotals,
    Innovation,
    LinearMeasurement,
    Measurement,
    Observation,
    Reason,
    reasons_of,
    usable,
)
from replay_kit.estimator.basis.modes import Basis
from replay_kit.estimator.interface import Estimator, Stepped, each_stepped
from replay_kit.estimator.update.biases import unit_bias_rows
from replay_kit.estimator.update.evaluation import (
    After,
    Assimilation,
    ObservationUpdate,
    PredictedObservation,
    evaluate_observation,
)
from replay_kit.estimator.update.gate import SOFTENED
from replay_kit.estimator.update.grouping import ProfileGroup
from replay_kit.estimator.update.profile_stack import Factors, ProfileStack, stacked
from replay_kit.estimator.update.rows import Bins
from replay_kit.estimator.update.screening import (
    Screened,
    is_duplicate,
    local_velocities,
    relative_velocities,
    screen,
    screen_measurement,
    unused_innovation,
)
from replay_kit.estimator.update.superobservation import (
    Column,
    CombinedRows,
    GroupUpdate,
    evaluate_group,
)

State = TypeVar("State", bound=Assimilation)


@dataclass(frozen=True, slots=True, eq=False)
class ScreenedGroup:
    """The profiles of a group after screening.

    Attributes:
        profiles: In order.
        linear: The same as estimators see them.
        flags: shape (n, m).
        reasons: shape (n, m).
        used: Positions of those with a usable bin that are no duplicates.
        last: The last measurement with a usable bin.
    """

    profiles: tuple[Observation, ...]
    linear: tuple[LinearMeasurement, ...]
    flags: NDArray[np.int8]
    reasons: NDArray[np.int32]
    used: NDArray[np.intp]
    duplicates: frozenset[int]

    @property
    def usable(self) -> ProfileGroup:
        """The usable profiles."""
        return ProfileGroup(tuple(self.profiles[i] for i in self.used))

    @property
    def usable_linear(self) -> tuple[LinearMeasurement, ...]:
        """The same as estimators see them."""
        return tuple(self.linear[i] for i in self.used)

    @property
    def is_used(self) -> NDArray[np.bool_]:
        """Which of their bins are used, shape (n, m)."""
        return usable(self.flags[self.used])

    def relative(self, grid: Grid) -> Array | None:
        """Return their mean velocity relative to the platform; see ``relative_velocities``."""
        return relative_velocities(self.usable_linear, self.is_used, grid)

    def unused(self, i: int) -> Innovation:
        """Return the innovation of a profile that is not used."""
        blank = unused_innovation(self.linear[i], self.flags[i], self.reasons[i])
        if i not in self.duplicates:
            return blank
        none = np.empty(0, np.intp)
        return Screened(self.linear[i], none, blank).rejected(Reason.DUPLICATE)


def screen_group(group: ProfileGroup, last: LinearMeasurement | None, grid: Grid) -> ScreenedGroup:
    """Return a group after screening.

    Args:
        group: The group.
        last: The last measurement with a usable bin before it; an equal one that follows is a duplicate.
        grid: The region.
    """
    linear = tuple(profile.linear for profile in group.profiles)
    flags, reasons = screen(linear, grid)
    used, duplicates = [], set()
    for i in np.flatnonzero(usable(flags).any(axis=1)).tolist():
        if is_duplicate(last, linear[i]):
            duplicates.add(i)
            continue
        used.append(i)
        last = linear[i]
    return ScreenedGroup(
        group.profiles, linear, flags, reasons, np.array(used, np.intp), frozenset(duplicates)
    )


def stack_of(
    screened: ScreenedGroup, basis: Basis, reference: Array, factors: Factors
) -> ProfileStack:
    """Return the usable profiles as arrays.

    Args:
        screened: The group after screening.
        basis: Basis flows.
        reference: shape (Z, 2) [m/s], the estimator's reference current at the place.
        factors: See ``profile_stack.Factors``.
    """
    profiles, used = screened.usable_linear, screened.is_used
    depth = np.stack([each.depth for each in profiles])
    at, back = np.unique(np.where(used, depth, 0.0), return_inverse=True)
    known = (basis.depth_weights(at) @ reference)[back.reshape(depth.shape)]
    values = local_velocities(profiles, used, basis.grid) - known
    return stacked(profiles, used, values, screened.relative(basis.grid), factors)


@dataclass(frozen=True, slots=True, eq=False)
class GroupResult:
    """A group's evaluation, its update's effect, and what is published of them.

    Attributes:
        screened: The group after screening.
        update: Its evaluation.
        before: The column before it.
        after: The column after it.
        prior: shape (2 q,), the column's mean before any observation.
        prior_inflation: Factor on the estimate's covariance after it.
    """

    screened: ScreenedGroup
    update: GroupUpdate
    before: Column
    after: Column
    prior: Array
    prior_inflation: float

    def rejected(self, i: int) -> Innovation:
        """Return the innovation of one of the usable profiles, which the gate rejected."""
        update, gate, at = self.update, self.update.gate, int(self.screened.used[i])
        one = update.stack.part(np.array([i], np.intp))
        result = gate.result(i)
        (before,), (prior,) = (
            _shown(one, update.before[i : i + 1]),
            _shown(one, column_misfit(one, self.prior)),
        )
        return replace(
            unused_innovation(
                self.screened.linear[at], self.screened.flags[at], self.screened.reasons[at]
            ),
            innovation=before,
            innovation_std=_shown(one, self._std(one))[0],
            residual=before,
            prior_innovation=prior,
            nis=float(update.nis[i]),
            dof=int(one.layouts[0].dof),
            error_inflation=result.inflation,
            decision="rejected",
            gate_statistic=result.statistic,
            gate=result.threshold,
            signal_dof=0.0,
        )

    def combined(self, accepted: NDArray[np.intp]) -> Innovation:
        """Return the innovation of the accepted ones together."""
        update, gate, screened = self.update, self.update.gate, self.screened
        stack, at = update.stack.part(accepted), screened.used[accepted]
        misfits = {
            "innovation": column_misfit(stack, self.before.means[:, 0]),
            "residual": column_misfit(stack, self.after.means[:, 0]),
        }
        misfits["prior_innovation"] = column_misfit(stack, self.prior)
        squares = {name: float(np.sum(values**2)) for name, values in misfits.items()}
        assert update.rows is not None
        nis, dof = (
            float(update.nis[accepted].sum()),
            int(np.broadcast_to(stack.of("dof"), accepted.size).sum()),
        )
        softened = int(np.count_nonzero(gate.decision[accepted] == SOFTENED))
        first, flags = (
            update.first,
            np.where(stack.used.any(axis=0), Flag.GOOD, screened.flags[at[0]]).astype(np.int8),
        )
        values = np.linalg.eigvalsh(self.before.predicted_cov(update.rows.r[None])[0])
        depth = np.mean([each.depth for each in stack.observations], axis=0)
        members = ProfileGroup(tuple(screened.profiles[i] for i in at))
        return replace(
            unused_innovation(stack.observations[0], flags, screened.reasons[at[0]]),
            time_ns=members.time_ns,
            depth=depth,
            innovation=_mean_of(stack, misfits["innovation"]),
            residual=_mean_of(stack, misfits["residual"]),
            prior_innovation=_mean_of(stack, misfits["prior_innovation"]),
            innovation_std=_mean_std(stack, self._std(stack)),
            nis=nis,
            dof=dof,
            accepted=True,
            error_inflation=float(accepted.size / np.sum(1.0 / gate.inflation[accepted])),
            decision="softened" if softened else "accepted",
            gate_statistic=first.statistic,
            gate=first.threshold,
            signal_dof=float(np.sum(values / (values + 1.0))),
            prior_inflation=self.prior_inflation,
            log_likelihood=self._log_likelihood(stack, accepted),
            profiles=accepted.size,
            totals=GroupTotals(
                softened,
                dof // 2,
                float(np.sum(update.before[accepted] ** 2)),
                squares["residual"],
                squares["prior_innovation"],
                tuple(reasons_of(screened.reasons[at], screened.flags[at])),
            ),
        )

    def _std(self, stack: ProfileStack) -> Array:
        """Return the variances that the estimate and the stated errors give a bin, shape (n, m, 2) and (n, m, 2), stacked."""
        cov, q = self.before.predicted_cov(stack.of("r")), self.before.width
        bins = np.matmul(stack.of("unwhiten"), stack.of("q"))
        blocks = [cov[:, c * q : (c + 1) * q, c * q : (c + 1) * q] for c in range(2)]
        of_estimate = np.stack(
            [np.einsum("snk,skl,snl->sn", bins, block, bins) for block in blocks], axis=-1
        )
        return np.asarray(np.sqrt(np.maximum(of_estimate, 0.0) + stack.of("std")[..., None] ** 2))

    def _log_likelihood(self, stack: ProfileStack, accepted: NDArray[np.intp]) -> float:
        """Return the logarithm of the density of all values under the column before the group, with the errors of the update."""
        rows, inflation = self.update.rows, self.update.gate.inflation[accepted]
        assert rows is not None
        cov = self.before.predicted_cov(rows.r[None])[0] + np.eye(rows.y[..., 0].size)
        innovation = (rows.y[..., 0] - self.before.predicted(rows.r[None])[0, ..., 0]).ravel()
        square = (
            float(innovation @ np.linalg.solve(cov, innovation))
            + rows.residual
            + float(np.sum(stack.residual_square / inflation))
        )
        half_log_det, dof = (
            np.broadcast_to(stack.of(name), accepted.size) for name in ("half_log_det", "dof")
        )
        noise = 2.0 * half_log_det + 0.5 * dof * np.log(inflation)
        return float(-0.5 * square - 0.5 * np.linalg.slogdet(cov)[1] - np.sum(noise))


def column_misfit(stack: ProfileStack, means: Array) -> Array:
    """Return measured minus predicted bins, shape (n, m, 2) [m/s], 0 where not used; ``means``, shape (2 q,), are those of a column."""
    rows = Column(means[:, None], np.empty((0, 0))).predicted(stack.of("r"))[..., 0]
    return stack.misfit(np.broadcast_to(rows, stack.y.shape))


def group_misfit(stack: ProfileStack, means: Array) -> Array:
    """Return ``column_misfit`` of all bins one below the other, shape (n m, 2) [m/s]."""
    return column_misfit(stack, means).reshape(-1, 2)


def _shown(stack: ProfileStack, values: Array) -> Array:
    """Return values of bins, shape (n, m, 2), NaN where not used."""
    return np.where(stack.used[..., None], values, np.nan)


def _mean_of(stack: ProfileStack, values: Array) -> Array:
    """Return the mean over the profiles that use a bin, shape (m, 2); NaN where none does."""
    counts = stack.used.sum(axis=0)[:, None]
    total = np.sum(np.where(stack.used[..., None], values, 0.0), axis=0)
    return np.asarray(np.divide(total, counts, out=np.full(total.shape, np.nan), where=counts > 0))


def _mean_std(stack: ProfileStack, std: Array) -> Array:
    """Return the standard deviation of the mean innovation of bins, shape (m, 2): the estimate's error is shared, the noise is not."""
    counts = stack.used.sum(axis=0)[:, None]
    noise = np.where(stack.used, stack.of("std"), 0.0)[..., None] ** 2
    of_estimate = _mean_of(stack, np.broadcast_to(std**2, (*stack.used.shape, 2)) - noise)
    of_noise = np.divide(
        noise.sum(axis=0), counts**2, out=np.full((len(counts), 1), np.nan), where=counts > 0
    )
    return np.asarray(np.sqrt(np.maximum(of_estimate, 0.0) + of_noise))


def results_of(
    result: GroupResult, states: tuple[State, State], at: "GroupColumn[State]"
) -> list[Stepped[State]]:
    """Return the outcome of each profile of a group, and of the accepted ones together, in the order of the first.

    Args:
        result: The evaluation.
        states: Of the estimator before and after the group.
        at: The profiles, and the column that they see.
    """
    before, after = states
    screened, gate = result.screened, result.update.gate
    accepted = np.flatnonzero(gate.accepted)
    used = set(screened.used.tolist())
    found: list[Stepped[State]] = [
        Stepped(profile, before, before, screened.unused(i))
        for i, profile in enumerate(screened.profiles)
        if i not in used
    ]
    # the last thing of a group leaves the estimator in the state after it
    left = before if accepted.size else after
    for i in np.flatnonzero(~gate.accepted).tolist():
        found.append(
            Stepped(screened.profiles[int(screened.used[i])], before, left, result.rejected(i))
        )
    if accepted.size:
        group = ProfileGroup(tuple(screened.profiles[i] for i in screened.used[accepted]))
        found.append(
            Stepped(
                group if accepted.size > 1 else group.profiles[0],
                before,
                after,
                result.combined(accepted),
                at.against if accepted.size == screened.used.size > 1 else None,
            )
        )
    return found


@dataclass(frozen=True, slots=True, eq=False)
class GroupColumn(Generic[State]):
    """The profiles of a group, and the estimate of the column of water that they see.

    Attributes:
        stack: The profiles.
        state: The estimator's state at their time.
        column: The estimate before them.
        prior: shape (2 q,), the column's mean before any observation.
        predict: Returns the prediction of the rows of some profiles as one.
        against: See ``Stepped``.
    """

    stack: ProfileStack
    state: State
    column: Column
    prior: Array
    predict: Callable[[CombinedRows], PredictedObservation[Any]]
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
        """Return the estimate of the column that the usable profiles see."""
        ...

    def group_mean(self, state: State, screened: ScreenedGroup) -> tuple[ProfileStack, Array]:
        """Return the usable profiles, and the mean of their column alone, shape (2 q,)."""
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
        return screen_measurement(observation, self.grid).used.size > 0

    def evaluated(
        self, state: State, screened: Screened, rows: Bins, predicted: PredictedObservation[After]
    ) -> tuple[ObservationUpdate[After], Array | None]:
        """Return the evaluation of one measurement, and the effect of instrument errors of one unit on its rows."""
        update = evaluate_observation(
            rows, predicted, self.gating, self.adapts_errors, state.monitor.is_consistent
        )
        return update, unit_bias_rows(screened, self.grid, rows, rows.residual(predicted.mean))

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
        screened = screen_group(group, state.last, self.grid)
        if screened.used.size < 2 or self.is_late(state, min(p.time_ns for p in group.profiles)):
            return list(each_stepped(state, group.profiles, self.alone(state, group.profiles)))
        at = self.group_column(state, screened)
        update = evaluate_group(
            at.stack, at.column, self.gating, self.adapts_errors, state.monitor.is_consistent
        )
        monitor, inflation = state.monitor.updated(update.first, self.gating)
        after, column, score = state, at.column, state.bias_score
        if update.rows is not None:
            predicted = at.predict(update.rows)
            size = predicted.mean.size
            innovation = update.rows.y.reshape(size, -1) - np.column_stack(
                [predicted.mean, predicted.bias_sensitivity]
            )
            posterior = predicted.posterior(innovation, 1.0)
            after = self.with_posterior(at, posterior, update.scale_jacobian)
            column = at.column.updated(update.rows.r, innovation)
            if at.stack.relative is not None:
                cov = predicted.cov + np.eye(size)
                jacobian = update.scale_jacobian
                score = score.updated(innovation[:, 1:], innovation[:, 0], cov, jacobian)
        seen = screened.usable_linear[-1]
        changed = replace(after, monitor=monitor, bias_score=score, last=seen)
        changed = self.inflated(changed, inflation)
        result = GroupResult(screened, update, at.column, column, at.prior, inflation)
        return results_of(result, (state, changed), at)

    def group_innovation(self, state: State, group: ProfileGroup) -> Array:
        """Return measured minus predicted bins of all profiles of a group, shape (n m, 2) [m/s]; 0 for bins that are not usable."""
        return group_misfit(*self.group_mean(state, screen_group(group, None, self.grid)))
