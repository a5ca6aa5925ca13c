"""Settings of the small models of dives: none is fitted, all combinations are averaged by the evidence of the dives before."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array

_HOUR = 3600.0
# Factors of 2 and of 4 apart: a few dives do not resolve smaller steps. A velocity over ground holds the way through the water: a dive's
# course is like that of the last, or turned.
_TIME_SCALES = (6.0 * _HOUR, 24.0 * _HOUR, 96.0 * _HOUR)
_WHITES = (0.005, 0.01, 0.02, 0.04)
_FLIGHT_BIASES = (0.05, 0.5)
_CONSTANTS = (0.05, 0.15)
_GROUND_AMPLITUDES = (0.02, 0.04, 0.08, 0.16, 0.32)
_GROUND_CONSTANTS = (0.1, 0.3)
# The same for the flight model's bias alone: fewer, as they are passed through once for each dive that is left out.
_FLIGHT_AMPLITUDES, _FLIGHT_TIME_SCALES, FLIGHT_WHITES = (
    (0.01, 0.04, 0.16),
    (6.0 * _HOUR, 96.0 * _HOUR),
    (0.005, 0.015, 0.04),
)
_FLIGHT_SURFACE_SHARES = (0.0, 2.0)
# m/s; of a current beside the estimate, where there is one
_LOCAL_AMPLITUDES = (0.02, 0.04, 0.08, 0.16)
# s; the wind that drives the surface part changes as fast
_SURFACE_SCALE = 12.0 * _HOUR
#: Number of unknowns: a constant, a part that decorrelates, one trapped at the surface, each east and north; and the flight model's bias.
UNKNOWNS = 8
#: Positions of the flight model's bias among them: along the way through the water and across it.
FLIGHT_BIAS = slice(6, 8)


@dataclass(frozen=True, slots=True, eq=False)
class Settings:
    """Combinations of settings, each a model of its own.

    Attributes:
        white_std: shape (h,) [m/s], part of a mean current that no other one shares.
        variance: shape (h, 8), prior variances of the unknowns [m^2/s^2, and 1 of the flight bias].
        scales: shape (h, 8), their decorrelation times [s]; inf for constants.
        background: shape (h,), which background the current is measured about; 0 for none.
        log_prior: shape (h,), logarithm of the probability of each before the first dive.
    """

    white_std: Array
    variance: Array
    scales: Array
    background: NDArray[np.intp]
    log_prior: Array

    @property
    def size(self) -> int:
        """Number of combinations h."""
        return self.white_std.size

    @property
    def has_flight_bias(self) -> NDArray[np.bool_]:
        """Which combinations have an error of the flight model, shape (h,)."""
        return np.asarray(self.variance[:, FLIGHT_BIAS.start] > 0.0)


def ground_combinations(n_backgrounds: int = 0) -> Settings:
    """Return all combinations of settings of a mean velocity over ground, without a flight model and a part trapped at the surface.

    Args:
        n_backgrounds: Number of currents beside zero that a dive's velocity may be measured about; what is left is the way through the
            water.
    """
    return _of_axes(
        _GROUND_AMPLITUDES,
        _TIME_SCALES,
        _WHITES,
        (0.0,),
        (0.0,),
        _GROUND_CONSTANTS,
        range(n_backgrounds + 1),
    )


def flight_combinations() -> Settings:
    """Return combinations of settings of a mean current that tell whether the flight model errs; half of the probability has no error."""
    biases = (0.0, *_FLIGHT_BIASES)
    axes = (
        _FLIGHT_AMPLITUDES,
        _FLIGHT_TIME_SCALES,
        FLIGHT_WHITES,
        biases,
        _FLIGHT_SURFACE_SHARES,
        _CONSTANTS,
        (0,),
    )
    settings = _of_axes(*axes)
    return _half_without(settings, settings.has_flight_bias)


def local_combinations() -> Settings:
    """Return all combinations of settings of a current beside the estimate; half of the probability has none.

    Errors that no other dive shares are those that the estimate and the measurement state: whatever else changes from dive to dive is a
    current that decorrelates, as ellipses that leave it out would be too small.
    """
    settings = _of_axes(
        (0.0, *_LOCAL_AMPLITUDES), _TIME_SCALES, _WHITES[:1], (0.0,), (0.0,), (0.0,), (0,)
    )
    return _half_without(settings, settings.variance[:, 2] > 0.0)


def _half_without(settings: Settings, has: NDArray[np.bool_]) -> Settings:
    """Return settings of which those that have something, shape (h,), have half of the probability, evenly, and the others the rest."""
    return replace(settings, log_prior=np.log(np.where(has, 0.5 / np.sum(has), 0.5 / np.sum(~has))))


def _of_axes(*axes: Iterable[float]) -> Settings:
    amplitude, scale, white, bias, share, constant, background = np.array(
        list(product(*axes)), dtype=np.float64
    ).T
    surface = share * amplitude
    # the part across the way errs half as much
    std = np.column_stack(
        [constant, constant, amplitude, amplitude, surface, surface, bias, 0.5 * bias]
    )
    scales = np.full((scale.size, UNKNOWNS), np.inf)
    scales[:, 2:4] = scale[:, None]
    scales[:, 4:6] = _SURFACE_SCALE
    return Settings(
        white, std**2, scales, background.astype(np.intp), np.full(white.size, -np.log(white.size))
    )
