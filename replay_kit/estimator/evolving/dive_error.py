"""An error shared by all profiles of one dive: those of an inversion, which solves for a dive's pings together.

The legs of a dive agree with each other better than with the dives before and after, independent of the current. Attributed to the
current, that would look like a change within hours; attributed to each profile alone, the second leg would count as independent data. So
it is a part of the state: a function of depth, common to a dive's profiles, that is reset at each dive.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from replay_kit.config.time import TimeConfig
from replay_kit.core.observation import Measurement
from replay_kit.estimator.evolving.filter import EvolvingEstimator
from replay_kit.estimator.evolving.observation_operator import (
    oscillations,
)
from replay_kit.estimator.evolving.state_space import EvolvingState

_PART = "dive_error"


def with_dive_error(
    estimator: EvolvingEstimator, std: float, depth_length: float
) -> EvolvingEstimator:
    """Return an estimator with an error shared by the profiles of a dive; ``new_dive`` resets it at each new dive.

    Args:
        estimator: Without such an error.
        std: Standard deviation of each component [m/s].
        depth_length: Its correlation length in depth [m].
    """
    operator, space = estimator.operator, estimator.state_space
    shape = TimeConfig(
        oscillators=("steady",), oscillator_std=std, oscillator_depth_length=depth_length
    )
    error = oscillations(shape, 0.0, float(operator.basis.grid.levels[-1]))
    whole = replace(operator, dive_error=error)
    parts = {**space.parts, _PART: slice(space.size, space.size + error.size)}
    scales = np.concatenate([space.scales, np.full(error.size, np.inf)])
    return replace(
        estimator, operator=whole, state_space=replace(space, scales=scales, parts=parts)
    )


def new_dive(estimator: EvolvingEstimator, state: EvolvingState) -> EvolvingState:
    """Return the state at the beginning of a dive, with that dive's own error unknown; unchanged for an estimator without such an error."""
    part = estimator.state_space.parts.get(_PART)
    if part is None:
        return state
    means, cov = state.means.copy(), state.cov.copy()
    means[part] = 0.0
    cov[part], cov[:, part] = 0.0, 0.0
    cov[part, part] = np.eye(part.stop - part.start)
    return replace(state, means=means, cov=cov)


def by_dive(observations: Sequence[Measurement]) -> Iterator[tuple[bool, Measurement]]:
    """Yield observations, each with whether it is the first of its dive."""
    for k, observation in enumerate(observations):
        yield k > 0 and observation.dive != observations[k - 1].dive, observation
