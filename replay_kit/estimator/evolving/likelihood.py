"""The likelihood of observations, each predicted from those before it; and an estimator restricted to the subspace they observe.

The logarithm of the density of observations y_1 ... y_n is the sum of those of their innovations: it measures settings by the errors of
their one-step predictions and by their stated uncertainty.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import scipy.linalg

from replay_kit.core.arrays import Array
from replay_kit.core.flow.evolution import ProcessModel
from replay_kit.core.geodesy import to_local
from replay_kit.core.observation import Innovation, Measurement, PathMean
from replay_kit.estimator.evolving.dive_error import by_dive, new_dive
from replay_kit.estimator.evolving.filter import EvolvingEstimator
from replay_kit.estimator.evolving.observation_operator import ObservationOperator
from replay_kit.estimator.evolving.state_space import StateSpace

# Share of the largest singular value below which a direction is not observed.
_UNOBSERVED = 1e-9


def log_likelihoods(
    estimator: EvolvingEstimator, observations: Sequence[Measurement]
) -> Iterator[float]:
    """Yield the logarithm of each observation's density given those before it; 0 for one without a usable bin.

    The constant of 2 pi is left out. Errors are used as stated: without gate or inflation.
    """
    ungated = replace(estimator, gating=None)
    state = ungated.initial()
    for is_new, observation in by_dive(observations):
        state = new_dive(ungated, state) if is_new else state
        candidate = ungated.candidate(state, observation)
        if isinstance(candidate, Innovation):
            yield 0.0
            continue
        yield candidate.evaluated.log_likelihood
        stated = replace(candidate, evaluated=replace(candidate.evaluated, inflation=1.0))
        means, cov = stated.posterior(1.0)
        state = replace(
            candidate.before,
            means=ungated.with_scale_jacobian(means, cov, stated.scale_jacobian),
            cov=cov,
            last=observation,
        )


def observed_subspace_estimator(
    estimator: EvolvingEstimator, observations: Sequence[Measurement]
) -> EvolvingEstimator:
    """Return an estimator that gives the same results for certain observations, with the unknowns of the subspace that they observe.

    Unknowns of one decorrelation time may be rotated into one another: directions that no observation depends on are dropped.
    The result is meaningless except at the observations.
    """
    operator, process = estimator.operator, estimator.operator.process
    columns = [_observed(operator, observation) for observation in observations]
    parts = [np.concatenate([column[k] for column in columns], axis=1) for k in range(2)]
    subspaces = [_span(part) for part in parts]
    small = replace(
        process,
        trajectories=np.einsum("fk,tfzr->tkzr", subspaces[0], process.trajectories, optimize=True),
        local=np.einsum("bk,bzr->kzr", subspaces[1], process.local, optimize=True),
    )
    space = _with_process(estimator.state_space, process.size, small)
    return replace(estimator, operator=replace(operator, process=small), state_space=space)


def _with_process(space: StateSpace, size: int, process: ProcessModel) -> StateSpace:
    """Return a state space whose first unknowns, ``size`` of a process model, are replaced by those of a smaller one."""
    by = process.size - size
    parts = {
        name: slice(part.start + by, part.stop + by)
        for name, part in space.parts.items()
        if name != "process"
    }
    scales = np.concatenate([process.scales, space.scales[size:]])
    parts["process"] = slice(0, process.size)
    return replace(
        space, scales=scales, first=space.first + by, second=space.second + by, parts=parts
    )


def _observed(operator: ObservationOperator, observation: Measurement) -> tuple[Array, Array]:
    """Return the effect of each trajectory and each local direction on an observation, one column for each value: (F, m), (B, m)."""
    process, basis = operator.process, operator.basis
    n_trajectories = process.trajectories.shape[1]
    if isinstance(observation, PathMean):
        rows = operator.path(observation).design[:, : process.size].T
        return rows[:n_trajectories], rows[n_trajectories:]
    place = np.array(
        to_local(basis.grid.projection, observation.longitude, observation.latitude),
        dtype=np.float64,
    )
    modes = basis.at_place(place)[1]
    trajectories = np.concatenate(
        [(of_time @ modes.T).reshape(n_trajectories, -1) for of_time in process.trajectories],
        axis=1,
    )
    return trajectories, (process.local @ modes.T).reshape(len(process.local), -1)


def _span(columns: Array) -> Array:
    """Return an orthonormal basis of the columns' span, shape (n, k)."""
    vectors, size, _ = scipy.linalg.svd(columns, full_matrices=False)
    return np.asarray(vectors[:, size > _UNOBSERVED * size[0]], dtype=np.float64)
