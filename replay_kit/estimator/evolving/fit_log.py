"""Settings fitted to the log so far: errors of its profiles, and structure in depth that is finer than the forecast's.

A setting is measured by the likelihood of the observations so far, each predicted from those before. Settings are tried one at a time, each
at the values of its ladder, the others as they are, until nothing gets better.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

from replay_kit.config.time import TimeConfig
from replay_kit.core.observation import Measurement, Observation, PathMean
from replay_kit.estimator.evolving.build import mixture_scale, state_space
from replay_kit.estimator.evolving.dive_error import with_dive_error
from replay_kit.estimator.evolving.extras import oscillations
from replay_kit.estimator.evolving.filter import EvolvingEstimator
from replay_kit.estimator.evolving.likelihood import log_likelihoods

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
    """Return an observation with the errors of settings."""
    if isinstance(observation, Observation):
        return replace(observation, error_std=settings.error_factor * observation.error_std)
    return replace(
        observation, error_std=math.hypot(observation.error_std, settings.mean_error_std)
    )


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

    has_profiles = any(isinstance(observation, Observation) for observation in observations)
    has_means = any(isinstance(observation, PathMean) for observation in observations)
    groups = (
        (_OF_PROFILES, has_profiles),
        (_OF_MEANS, has_means),
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
