"""Settings fitted to the log so far: errors of its profiles, and structure in depth that is finer than the forecast's.

A setting is measured by the likelihood of the observations so far, each predicted from those before. Settings are tried one at a time, each
at the values of its ladder, the others as they are, until nothing gets better

The logarithm of the density of observations y_1 ... y_n is the sum of those of their innovations: it measures settings by the errors of
their one-step predictions and by their stated uncertainty. An estimator restricted to the subspace that the observations depend on gives it
in less time.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import scipy.linalg

from replay_kit.config.time import TimeConfig
from replay_kit.core.arrays import Array
from replay_kit.core.flow.evolution import ProcessModel
from replay_kit.core.observation import Innovation, Measurement
from replay_kit.estimator.evolving.build import mixture_scale, state_space
from replay_kit.estimator.evolving.dive_error import by_dive, new_dive, with_dive_error
from replay_kit.estimator.evolving.filter import EvolvingEstimator
from replay_kit.estimator.evolving.observation_operator import oscillations
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
            last=candidate.screened.observation,
        )


def observed_subspace_estimator(
    estimator: EvolvingEstimator, observations: Sequence[Measurement]
) -> EvolvingEstimator:
    """Return an estimator that gives the same results for certain observations, with the unknowns of the subspace that they observe.

    Unknowns of one decorrelation time may be rotated into one another: directions that no observation depends on are dropped.
    The result is meaningless except at the observations.
    """
    operator, process = estimator.operator, estimator.operator.process
    columns = list(_observed(estimator, observations))
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


def _observed(
    estimator: EvolvingEstimator, observations: Sequence[Measurement]
) -> Iterator[tuple[Array, Array]]:
    """Yield the effect of each trajectory and each local direction on each observation, one column for each row: (F, m), (B, m)."""
    process = estimator.operator.process
    n_trajectories = process.trajectories.shape[1]
    for observation in observations:
        rows = estimator.linearised(observation)[1]
        design = np.empty((0, process.size)) if rows is None else rows.design[:, : process.size]
        yield design.T[:n_trajectories], design.T[n_trajectories:]


def _span(columns: Array) -> Array:
    """Return an orthonormal basis of the columns' span, shape (n, k)."""
    vectors, size, _ = scipy.linalg.svd(columns, full_matrices=False)
    return np.asarray(vectors[:, size > _UNOBSERVED * size[0]], dtype=np.float64)


_DAY = 86_400.0
# About a factor of 1.5 to 2 apart: a likelihood does not resolve smaller steps.
_LADDERS: Mapping[str, tuple[float, ...]] = {
    "error_factor": (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0),
    "dive_error_std": (0.0, 0.05, 0.1, 0.15, 0.2),
    "dive_error_depth_length": (15.0, 30.0, 60.0, 120.0),
    "oscillator_std": (0.05, 0.1, 0.15, 0.2, 0.3),
    "oscillator_depth_length": (20.0, 30.0, 50.0, 100.0),
    "mean_error_std": (0.0, 0.01, 0.02, 0.05, 0.1),
    "scale": (0.25 * _DAY, 1.0 * _DAY, 3.0 * _DAY, 10.0 * _DAY, 30.0 * _DAY),
    "oscillator_scale": (1.0 * _DAY, 3.0 * _DAY, 10.0 * _DAY, 30.0 * _DAY),
}
_OF_PROFILES = ("error_factor", "dive_error_std", "dive_error_depth_length")
_OF_MEANS = ("mean_error_std",)
_OF_THE_PROCESS = ("scale",)
_OF_OSCILLATORS = ("oscillator_std", "oscillator_depth_length", "oscillator_scale")
_MOST_ROUNDS = 4


@dataclass(frozen=True, slots=True)
class LogSettings:
    """Settings that are fitted to a log.

    Attributes:
        error_factor: Factor on the stated errors of profiles.
        dive_error_std: Of the error shared by the profiles of a dive [m/s]; 0 for none.
        dive_error_depth_length: Its correlation length in depth [m].
        mean_error_std: Part of a mean along a path that does not persist until the next one [m/s].
        scale: Decorrelation time of local corrections to the forecast [s]; inf for constants.
        oscillator_std: As in ``[time]``.
        oscillator_depth_length: As in ``[time]``.
        oscillator_scale: As in ``[time]``.
    """

    error_factor: float
    dive_error_std: float
    dive_error_depth_length: float
    mean_error_std: float
    scale: float
    oscillator_std: float
    oscillator_depth_length: float
    oscillator_scale: float


def initial_settings(estimator: EvolvingEstimator, time: TimeConfig) -> LogSettings:
    """Return the settings of an estimator and its configuration: errors as stated, without shared ones."""
    process = estimator.operator.process
    return LogSettings(
        1.0,
        0.0,
        30.0,
        0.0,
        process.local_scale,
        time.oscillator_std,
        time.oscillator_depth_length,
        time.oscillator_scale,
    )


def fitted_estimator(
    estimator: EvolvingEstimator, time: TimeConfig, settings: LogSettings
) -> EvolvingEstimator:
    """Return an estimator with other settings.

    Args:
        estimator: Without an error of dives.
        time: The settings it was built with.
        settings: The new ones.
    """
    grid, process = estimator.basis.grid, estimator.operator.process
    changed = time.model_copy(update={name: getattr(settings, name) for name in _OF_OSCILLATORS})
    oscillating = oscillations(changed, grid.projection.latitude, float(grid.levels[-1]))
    if settings.scale != process.local_scale:
        process = replace(
            process,
            local_scale=settings.scale,
            trajectory_scale=mixture_scale(time.trajectory_scale, settings.scale),
        )
    operator = replace(estimator.operator, process=process, oscillations=oscillating)
    new = replace(estimator, operator=operator, state_space=state_space(operator, changed))
    return (
        with_dive_error(new, settings.dive_error_std, settings.dive_error_depth_length)
        if settings.dive_error_std > 0.0
        else new
    )


def with_errors(observation: Measurement, settings: LogSettings) -> Measurement:
    """Return an observation with the errors of settings: those of one place are profiles, others means along a path."""
    linear = observation.linear
    if linear.at_one_place:
        return replace(linear, error_std=settings.error_factor * linear.error_std)
    return replace(linear, error_std=np.hypot(linear.error_std, settings.mean_error_std))


def fit_to_log(
    estimator: EvolvingEstimator,
    time: TimeConfig,
    observations: Sequence[Measurement],
    start: LogSettings,
) -> LogSettings:
    """Return the settings that maximise the likelihood of observations, by coordinate search.

    Args:
        estimator: Without an error of dives; ``likelihood.observed_subspace_estimator`` makes a fast one.
        time: The settings it was built with.
        observations: Of the log so far, in order.
        start: Where the search begins.
    """

    @cache
    def likelihood(settings: LogSettings) -> float:
        errors = [with_errors(observation, settings) for observation in observations]
        return sum(log_likelihoods(fitted_estimator(estimator, time, settings), errors))

    at_one_place = [observation.linear.at_one_place for observation in observations]
    groups = (
        (_OF_PROFILES, any(at_one_place)),
        (_OF_MEANS, not all(at_one_place)),
        (_OF_THE_PROCESS, True),
        (_OF_OSCILLATORS, bool(time.oscillators)),
    )
    names = [name for of_kind, wanted in groups if wanted for name in of_kind]
    best = start
    for _ in range(_MOST_ROUNDS):
        before = best
        for name in names:
            # among equals the current setting comes first
            best = max(
                [best, *(replace(best, **{name: value}) for value in _LADDERS[name])],
                key=likelihood,
            )
        if best == before:
            break
    return best
