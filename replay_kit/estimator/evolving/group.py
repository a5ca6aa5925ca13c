"""Groups of profiles in the estimator through time: they count together at their mean time and place."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.flow.depth import depth_weights
from replay_kit.core.geodesy import to_local
from replay_kit.core.observation import Observation
from replay_kit.estimator.evolving.observation_operator import ObservationOperator
from replay_kit.estimator.update.biases import BiasBins
from replay_kit.estimator.update.group_step import (
    ScreenedGroup,
    stack_of,
)
from replay_kit.estimator.update.grouping import ProfileGroup
from replay_kit.estimator.update.profile_stack import ProfileStack
from replay_kit.estimator.update.rows import BinNoise, profile_noise
from replay_kit.estimator.update.screening import relative_velocities

_NS = 1e9


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
        noise = profile_noise(profile, used, grid.levels, of_levels)
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
    return operator.biases.bins(depth, None if relative is None else relative.mean(axis=0))
