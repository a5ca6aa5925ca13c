"""Speeds against those of the ensemble: units of the ensemble, and of a log that nothing else contradicts."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from replay_kit.core.arrays import IN_MEMORY, Array, one_by_one

# m/s; no region's currents have an RMS speed outside, and no model resolves much faster ones
_LEAST_RMS, _MOST_RMS, _MOST_SPEED, _PERCENTILE = 0.004, 1.5, 4.0, 99.9
# Pings after which speeds are judged, and the factor beyond which they contradict the ensemble.
_LEAST_PINGS, _ODD = 30, 8.0
# m/s; a slower profile lacks even the noise of an instrument
_LEAST_SPEED = 0.01


def odd_ensemble_speeds(velocity: Array) -> str:
    """Return how the speeds of an ensemble, shape (E, 2, ...) [m/s], cannot be those of currents; empty when they can."""
    # of an ensemble larger than memory some members tell as much
    squared = np.square(velocity[:: max(1, velocity.nbytes // IN_MEMORY)]).sum(axis=1)
    squared = squared[np.isfinite(squared)]
    if not squared.any():
        # without a wet point, or at rest: another matter
        return ""
    rms, fastest = math.sqrt(float(squared.mean())), math.sqrt(float(np.percentile(squared, _PERCENTILE)))
    if _LEAST_RMS <= rms <= _MOST_RMS and fastest <= _MOST_SPEED:
        return ""
    return f"RMS speed {rms:.3g} m/s, {_PERCENTILE:g} % below {fastest:.3g} m/s"


@dataclass(frozen=True, slots=True, eq=False)
class EnsembleSpeeds:
    """How fast the currents of an ensemble are.

    Attributes:
        levels: shape (Z,) [m].
        mean_square: shape (Z,), mean squared speed at the levels [m^2/s^2].
    """

    levels: Array
    mean_square: Array


def ensemble_speeds(levels: Array, velocity: Array) -> EnsembleSpeeds:
    """Return the speeds of an ensemble, shape (E, 2, Z, J, I) [m/s], NaN where dry; a dry level has those of the first one."""
    total, count = np.zeros(levels.size), np.zeros(levels.size, dtype=np.int64)
    for member in one_by_one(velocity):
        squared = np.square(member).sum(axis=0)
        wet = np.isfinite(squared)
        count += wet.sum(axis=(1, 2))
        total += np.where(wet, squared, 0.0).sum(axis=(1, 2))
    mean = total / np.maximum(count, 1)
    return EnsembleSpeeds(levels, np.where(count > 0, mean, mean[0]))


class PingSpeed(NamedTuple):
    """How fast a ping is.

    Attributes:
        measured: The upper median of its bins' squared speeds [m^2/s^2].
        typical: Mean squared speed of the ensemble at their depths [m^2/s^2].
        error_std: Mean error of a component of its bins [m/s].
    """

    measured: float
    typical: float
    error_std: float


@dataclass(frozen=True, slots=True)
class SpeedCounts:
    """Absolute pings so far, by their speed. Each counts by the median of its bins, so that a few outliers change nothing.

    Attributes:
        pings: Number of pings.
        fast: Number of those more than eight times as fast as the ensemble, less their stated errors.
        slow: Number of those less than an eighth as fast, errors included.
        impossible: Number of both that are, besides, faster than any model's currents, or slower than any instrument's noise.
        log_ratio: Sum of the logarithm of how many times as fast as the ensemble each is.
    """

    pings: int = 0
    fast: int = 0
    slow: int = 0
    impossible: int = 0
    log_ratio: float = 0.0

    def after(self, ping: PingSpeed | None) -> "SpeedCounts":
        """Return the counts after a ping; one whose speed is not compared changes nothing."""
        if ping is None or not (ping.measured > 0.0 and ping.typical > 0.0):
            return self
        measured, typical, error = ping.measured, ping.typical, 2.0 * ping.error_std**2
        fast, slow = measured - error > _ODD**2 * typical, measured < typical / _ODD**2
        return SpeedCounts(
            self.pings + 1,
            self.fast + fast,
            self.slow + slow,
            self.impossible + (fast and measured > _MOST_SPEED**2) + (slow and measured < _LEAST_SPEED**2),
            self.log_ratio + 0.5 * math.log(measured / typical),
        )

    @property
    def ratio(self) -> float:
        """How many times as fast as the ensemble the profiles are, the geometric mean; NaN before the first."""
        return math.exp(self.log_ratio / self.pings) if self.pings else math.nan

    @property
    def is_odd(self) -> bool:
        """Whether most pings are faster or slower than any current explains: the ensemble alone convicts nobody."""
        return self.contradict_ensemble and 2 * self.impossible > self.pings

    @property
    def contradict_ensemble(self) -> bool:
        """Whether most pings are faster or slower than those of the ensemble by far."""
        return self.pings >= _LEAST_PINGS and 2 * max(self.fast, self.slow) > self.pings
