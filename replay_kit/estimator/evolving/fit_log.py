"""What the log so far says of settings that nobody can state: errors of its profiles, and what is finer in depth than the forecast.

A setting is judged by the likelihood of the observations so far, each predicted from those before. Settings are tried one at a time, each
at the values of its ladder, the others as they are, until nothing gets better.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace

from replay_kit.config.time import TimeConfig
from replay_kit.core.observation import Measurement, Observation, PathMean
from replay_kit.estimator.evolving.build import layout
from replay_kit.estimator.evolving.dive_error import with_dive_error
from replay_kit.estimator.evolving.extras import oscillations
from replay_kit.estimator.evolving.filter import EvolvingEstimator
from replay_kit.estimator.evolving.likelihood import log_likelihoods

_DAY = 86_400.0
# About a factor of 1.5 to 2 apart: a likelihood does not tell nearer ones apart.
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
_OF_THE_SEA = ("scale",)
_OF_OSCILLATORS = ("oscillator_std", "oscillator_depth_length", "oscillator_scale")
_MOST_ROUNDS = 4
# As ``build`` has it: a mixture of the members' own evolutions holds longer than the current at a place.
_TRAJECTORIES_HOLD = 5.0


@dataclass(frozen=True, slots=True)
class LogSettings:
    """Settings that a log decides.

    Attributes:
        error_factor: On the stated errors of profiles.
        dive_error_std: Of what the profiles of a dive err alike [m/s]; 0 for nothing.
        dive_error_depth_length: Over which that stays alike in depth [m].
        mean_error_std: What a mean along a path holds that does not last until the next one [m/s].
        scale: Over which what the forecast does not say is forgotten [s]; inf never.
        oscillator_std: As ``[time]`` has it.
        oscillator_depth_length: As ``[time]`` has it.
        oscillator_scale: As ``[time]`` has it.
    """

    error_factor: float
    dive_error_std: float
    dive_error_depth_length: float
    mean_error_std: float
    scale: float
    oscillator_std: float
    oscillator_depth_length: float
    oscillator_scale: float


def as_built(estimator: EvolvingEstimator, time: TimeConfig) -> LogSettings:
    """Return the settings of an estimator and its configuration: errors as they are stated, shared by nothing."""
    return LogSettings(
        1.0, 0.0, 30.0, 0.0, estimator.model.sea.local_scale, time.oscillator_std, time.oscillator_depth_length, time.oscillator_scale
    )


def fitted_estimator(estimator: EvolvingEstimator, time: TimeConfig, settings: LogSettings) -> EvolvingEstimator:
    """Return an estimator with other settings.

    Args:
        estimator: Without an error of dives.
        time: What it was built with.
        settings: The new ones.
    """
    model, grid = estimator.model, estimator.basis.grid
    given = {name: value for name, value in asdict(settings).items() if name in _OF_OSCILLATORS}
    changed = time.model_copy(update=given)
    swinging = oscillations(changed, grid.projection.latitude, float(grid.levels[-1]))
    sea = model.sea
    if settings.scale != sea.local_scale:
        sea = replace(sea, local_scale=settings.scale, trajectory_scale=time.trajectory_scale or _TRAJECTORIES_HOLD * settings.scale)
    order = layout(sea, swinging, model.biases, changed)
    new = replace(estimator, model=replace(model, sea=sea, oscillations=swinging), layout=order)
    return with_dive_error(new, settings.dive_error_std, settings.dive_error_depth_length) if settings.dive_error_std > 0.0 else new


def with_errors(observation: Measurement, settings: LogSettings) -> Measurement:
    """Return an observation with the errors that settings give it."""
    if isinstance(observation, Observation):
        return replace(observation, error_std=settings.error_factor * observation.error_std)
    return replace(observation, error_std=math.hypot(observation.error_std, settings.mean_error_std))


def fit_to_log(estimator: EvolvingEstimator, time: TimeConfig, observations: Sequence[Measurement], start: LogSettings) -> LogSettings:
    """Return the settings under which observations are likeliest, as far as single steps lead.

    Args:
        estimator: Without an error of dives; ``likelihood.narrowed`` makes one that is quick.
        time: What it was built with.
        observations: Of the log so far, in order.
        start: Where the search begins.
    """
    tried: dict[LogSettings, float] = {}

    def likelihood(settings: LogSettings) -> float:
        if settings not in tried:
            errors = [with_errors(observation, settings) for observation in observations]
            tried[settings] = sum(log_likelihoods(fitted_estimator(estimator, time, settings), errors))
        return tried[settings]

    has_profiles = any(isinstance(observation, Observation) for observation in observations)
    has_means = any(isinstance(observation, PathMean) for observation in observations)
    asked = ((_OF_PROFILES, has_profiles), (_OF_MEANS, has_means), (_OF_THE_SEA, True), (_OF_OSCILLATORS, bool(time.oscillators)))
    names = [name for of_kind, wanted in asked if wanted for name in of_kind]
    best = start
    for _ in range(_MOST_ROUNDS):
        before = best
        for name in names:
            # the first of equals is the one that was
            best = max([best, *(replace(best, **{name: value}) for value in _LADDERS[name])], key=likelihood)
        if best == before:
            break
    return best
