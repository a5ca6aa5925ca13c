"""How fast the currents of an ensemble are, and whether an ocean's can be."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from replay_kit.core.arrays import IN_MEMORY, Array, one_by_one

# m/s; no region's currents have an RMS speed outside
_LEAST_RMS, _MOST_RMS, _PERCENTILE = 0.004, 1.5, 99.9
#: m/s; no model resolves much faster currents.
MOST_SPEED = 4.0


def odd_ensemble_speeds(velocity: Array) -> str:
    """Return how the speeds of an ensemble, shape (E, 2, ...) [m/s], cannot be those of currents; empty when they can."""
    # of an ensemble larger than memory some members tell as much
    squared = np.square(velocity[:: max(1, velocity.nbytes // IN_MEMORY)]).sum(axis=1)
    squared = squared[np.isfinite(squared)]
    if not squared.any():
        # without a wet point, or at rest: another matter
        return ""
    rms, fastest = (
        math.sqrt(float(squared.mean())),
        math.sqrt(float(np.percentile(squared, _PERCENTILE))),
    )
    if _LEAST_RMS <= rms <= _MOST_RMS and fastest <= MOST_SPEED:
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
