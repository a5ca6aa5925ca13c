"""Groups of profiles in the estimator through time: they count together at their mean time and place."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.observation import Observation
from replay_kit.estimator.evolving.observation_operator import ObservationOperator
from replay_kit.estimator.update.group_step import (
    ScreenedGroup,
    stack_of,
)
from replay_kit.estimator.update.profile_stack import ProfileStack
from replay_kit.estimator.update.rows import BinNoise, profile_noise

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
    basis, middle = operator.basis, screened.usable
    relative = screened.relative(basis.grid)
    known, design = operator.column(middle, None if relative is None else relative.mean(axis=0))

    def factors(profile: Observation, used: NDArray[np.intp]) -> tuple[Array, BinNoise]:
        noise = profile_noise(profile, used, basis, operator.representation_std, middle)
        return operator.joint(profile.depth[used]), noise

    stack = stack_of(screened, basis, known, factors)
    return ColumnOperator(stack, design.reshape(-1, design.shape[2]), middle.time_ns)
