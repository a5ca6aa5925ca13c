"""Groups of profiles in the estimator through time: they count together at their mean time and place."""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.gating import GatingConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.depth import depth_weights
from replay_kit.core.geodesy import to_local
from replay_kit.core.observation import Innovation, Measurement, Observation
from replay_kit.estimator.basis.modes import Basis
from replay_kit.estimator.evolving.observation_operator import ObservationOperator
from replay_kit.estimator.evolving.state_space import EvolvingState, StateSpace
from replay_kit.estimator.update.biases import BiasBins
from replay_kit.estimator.update.evaluation import predict_observation
from replay_kit.estimator.update.group_step import (
    GroupResult,
    ScreenedGroup,
    Stepped,
    results_of,
    screen_group,
    stack_of,
)
from replay_kit.estimator.update.grouping import ProfileGroup
from replay_kit.estimator.update.profile_stack import ProfileStack
from replay_kit.estimator.update.rows import BinNoise, bin_noise
from replay_kit.estimator.update.screening import relative_velocities
from replay_kit.estimator.update.superobservation import Column, evaluate_group

_NS = 1e9


class _Estimator(Protocol):
    """What groups need of the estimator through time; the members are documented there."""

    @property
    def basis(self) -> Basis: ...
    @property
    def operator(self) -> ObservationOperator: ...
    @property
    def state_space(self) -> StateSpace: ...
    @property
    def gating(self) -> GatingConfig | None: ...
    def is_late(self, state: EvolvingState, time_ns: int) -> bool: ...
    def predict(self, state: EvolvingState, time_ns: int) -> EvolvingState: ...
    def step(
        self, state: EvolvingState, observation: Measurement
    ) -> tuple[EvolvingState, Innovation]: ...
    def with_scale_jacobian(self, means: Array, cov: Array, jacobian: float) -> Array: ...


@dataclass(frozen=True, slots=True, eq=False)
class ColumnOperator:
    """The profiles of a group, and the unknowns of the column of water that they see.

    Attributes:
        stack: The profiles.
        design: shape (2 q, n), from the state to the column's unknowns, component after component.
        time_ns: For which they count [ns, UTC].
    """

    stack: ProfileStack
    design: Array
    time_ns: int


def column_operator(operator: ObservationOperator, screened: ScreenedGroup) -> ColumnOperator:
    """Return the usable profiles of a group, at their mean place and time.

    Errors of the instrument that are part of the state act through the profiles' mean motion relative to the platform.
    """
    grid = operator.basis.grid
    middle = ProfileGroup(tuple(screened.profiles[i] for i in screened.used))
    east, north = to_local(grid.projection, middle.longitude, middle.latitude)
    known, unknown = operator.current(float(east), float(north), middle.time_ns)
    (of_levels,) = operator.basis.local_error(
        np.array([[east, north]], dtype=np.float64), operator.representation_std
    )
    functions = operator.basis.depth_functions
    oscillations = operator.oscillations

    def factors(profile: Observation, used: NDArray[np.intp]) -> tuple[Array, BinNoise]:
        depth = profile.depth[used]
        representation = np.interp(depth, grid.levels, of_levels)
        noise = bin_noise(
            depth,
            profile.error_std[used],
            representation,
            profile.common_std,
            profile.correlation_depth,
        )
        of_biases = operator.biases.bins(depth, None).depth
        return np.hstack(
            [depth_weights(functions, depth, grid.levels), oscillations.weights(depth), of_biases]
        ), noise

    stack = stack_of(
        screened, grid, known, lambda depth: depth_weights(functions, depth, grid.levels), factors
    )
    of_biases = _mean_factor(operator, stack)
    n_levels, n_knots, n_functions = (
        grid.levels.size,
        oscillations.knots.size,
        of_biases.factor[0].shape[0],
    )
    start, end = operator.process.size, operator.process.size + oscillations.size
    design = np.zeros((2, n_levels + n_knots + n_functions, end + operator.biases.size))
    for c in range(2):
        design[c, :n_levels, :start] = unknown[:, :, c].T
        design[c, n_levels : n_levels + n_knots, start:end] = oscillations.factor(c)
        design[c, n_levels + n_knots :, end:] = of_biases.factor[c]
    return ColumnOperator(stack, design.reshape(-1, design.shape[2]), middle.time_ns)


def _mean_factor(operator: ObservationOperator, stack: ProfileStack) -> BiasBins:
    """Return the effect of the biases on the mean of the profiles; nothing where the log does not state their motion."""
    relative = relative_velocities(stack.observations, stack.used, operator.basis.grid)
    depth = stack.observations[0].depth[:1]
    return operator.biases.bins(depth, None if relative is None else relative.mean(axis=0)[None])


def step_group(
    estimator: _Estimator, state: EvolvingState, group: ProfileGroup
) -> list[Stepped[EvolvingState]]:
    """Return what became of the profiles of a group."""
    screened = screen_group(group, state.last, estimator.basis.grid)
    if screened.used.size < 2 or estimator.is_late(
        state, min(profile.time_ns for profile in group.profiles)
    ):
        return _one_by_one(estimator, state, group)
    of_group = column_operator(estimator.operator, screened)
    at_time = estimator.predict(state, of_group.time_ns)
    column = Column(
        of_group.design @ at_time.means,
        _symmetric(of_group.design @ at_time.cov @ of_group.design.T),
    )
    update = evaluate_group(
        of_group.stack, column, estimator.gating, True, state.monitor.is_consistent
    )
    monitor, inflation = state.monitor.updated(update.first, estimator.gating)
    after, of_after, score = state, column, state.bias_score
    if update.rows is not None:
        q = column.width
        rows = np.matmul(update.rows.r, of_group.design.reshape(2, q, -1)).reshape(2 * q, -1)
        predicted = predict_observation(at_time.means, at_time.cov, rows)
        innovation = update.rows.y.reshape(2 * q, -1) - np.column_stack(
            [predicted.mean, predicted.bias_sensitivity]
        )
        means, cov = predicted.posterior(innovation, 1.0)
        after = replace(
            at_time, means=estimator.with_scale_jacobian(means, cov, update.scale_jacobian), cov=cov
        )
        of_after = column.updated(update.rows.r, innovation)
        if of_group.stack.relative is not None:
            score = score.updated(
                innovation[:, 1:],
                innovation[:, 0],
                predicted.cov + np.eye(2 * q),
                update.scale_jacobian,
            )
    cov = after.cov if inflation == 1.0 else inflation * after.cov
    seen = screened.profiles[int(screened.used[-1])]
    changed = replace(after, cov=cov, monitor=monitor, bias_score=score, last=seen)
    prior = np.zeros(2 * column.width)
    return results_of(
        GroupResult(screened, update, column, of_after, prior, inflation), (state, changed), state
    )


def group_innovation(estimator: _Estimator, state: EvolvingState, group: ProfileGroup) -> Array:
    """Return measured minus predicted at a group's time, shape (n m, 2) [m/s], local axes, of all profiles; 0 for bins not usable."""
    of_group = column_operator(estimator.operator, screen_group(group, None, estimator.basis.grid))
    seconds = 0.0 if state.time_ns is None else max(of_group.time_ns - state.time_ns, 0) / _NS
    means = of_group.design @ estimator.state_space.predict_mean(state.mean, seconds)
    rows = Column(means[:, None], np.empty((0, 0))).predicted(of_group.stack.of("r"))[..., 0]
    return of_group.stack.misfit(np.broadcast_to(rows, of_group.stack.y.shape)).reshape(-1, 2)


def _one_by_one(
    estimator: _Estimator, state: EvolvingState, group: ProfileGroup
) -> list[Stepped[EvolvingState]]:
    found = []
    for profile in group.profiles:
        after, innovation = estimator.step(state, profile)
        found.append(Stepped(profile, state, after, innovation))
        state = after
    return found


def _symmetric(cov: Array) -> Array:
    return np.asarray(0.5 * (cov + cov.T))
