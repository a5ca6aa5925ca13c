"""Grouping of profiles near in time and position, between which the current hardly differs."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from replay_kit.core.arrays import Array, Indices, Mask
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation.table import Columns
from replay_kit.estimator.basis.slices import mean_squares

#: Share of the error of a bin's mean that the current's difference within a group may have.
SHARE = 0.25
#: Longest group where the window is chosen by itself [s]: the estimate is to follow the log.
_LONGEST_S = 120.0
_NS, _METRES_A_DEGREE = 1e9, 111_200.0
# What is the same of the profiles of a group.
_ALIKE = "input", "topic", "dive", "bins", "correlation_depth"


@dataclass(frozen=True, slots=True)
class Grouping:
    """Limits of the distance of profiles in a group.

    The difference of the current between the ends of a group, by its change and by the vehicle's motion, is at most ``SHARE`` of the error
    of a bin's mean over the profiles. Bins keep their depths, which differ by at most a bin in a group.

    Attributes:
        gradient: RMS gradient of the current [1/s].
        change: RMS growth rate of its squared difference in time [m^2/s^3]; 0 if constant.
        seconds: Longest group [s].
        of_mean: Whether the error is that of the mean or, with a time set by the user, of one profile.
    """

    gradient: float
    change: float = 0.0
    seconds: float = _LONGEST_S
    of_mean: bool = True

    def by_hand(self, seconds: float) -> "Grouping":
        """Return a grouping with a stated time; the vehicle's motion remains limited, as a group has one position."""
        return replace(self, change=0.0, seconds=seconds, of_mean=False)

    def fit(self, pings: Columns, first: Indices, other: Indices, number: Array) -> Mask:
        """Return the mask of profiles that may join a group, shape (n,).

        Args:
            pings: Pings as in ``core.observation.table.Block``.
            first: shape (n,) or (1,), rows of the first profiles of groups.
            other: shape (n,), rows of candidates.
            number: shape (n,), number of profiles in each group so far.
        """
        bins, top, common = pings["bins"], pings["depth"][:, 0], pings["common_std"]
        lacks, finite = np.isnan(pings["platform"][:, 0]), np.isfinite(common)
        second = pings["depth"][first, np.minimum(bins[first] - 1, 1)]
        alike = np.abs(top[other] - top[first]) <= np.abs(second - top[first])
        alike &= (bins[first] > 1) & (finite[other] == finite[first])
        alike &= lacks[other] == lacks[first]
        for name in _ALIKE:
            alike &= pings[name][other] == pings[name][first]
        elapsed = (pings["time"][other] - pings["time"][first]) / _NS
        latitude, longitude = pings["latitude"], pings["longitude"]
        north = latitude[other] - latitude[first]
        east = (longitude[other] - longitude[first] + 180.0) % 360.0 - 180.0
        way = _METRES_A_DEGREE * np.hypot(east * np.cos(np.radians(latitude[first])), north)
        change = np.sqrt(self.change * np.maximum(elapsed, 0.0))
        most = SHARE * _errors(pings, first) / (np.sqrt(number) if self.of_mean else 1.0)
        near = np.hypot(self.gradient * way, change) <= most
        return np.asarray(alike & near & self.lasts(elapsed))

    def lasts(self, elapsed: Any) -> Any:
        """Return whether a group may still grow after some time [s]."""
        return (elapsed >= 0.0) & (elapsed <= self.seconds)


def _errors(pings: Columns, at: Indices) -> Array:
    """Return the error of a bin of some profiles, shape (n,) [m/s], as reference for their groups."""
    bins, error, common = pings["bins"][at], np.empty(at.size), pings["common_std"][at]
    for number in np.unique(bins):
        alike = bins == number
        error[alike] = np.median(pings["error_std"][at[alike], :number], axis=1)
    return np.hypot(error, np.where(np.isfinite(common), common, 0.0))


def current_gradient(ensemble: Ensemble) -> float:
    """Return the RMS gradient of an ensemble's currents between neighbouring grid points [1/s], along the axis with the larger one."""
    return float(np.sqrt(2.0 * mean_squares(ensemble, about_mean=False)[1:].max()))


def spread_of(ensembles: Sequence[Ensemble]) -> float:
    """Return the RMS standard deviation of a component over members [m/s]."""
    return float(np.sqrt(np.mean([mean_squares(each)[0] for each in ensembles])))
