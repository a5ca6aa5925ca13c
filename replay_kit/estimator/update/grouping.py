"""Which profiles are combined: those near enough in time and place that the current between them hardly differs."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import hypot, isfinite
from typing import Any

import numpy as np

from replay_kit.core.arrays import Mask
from replay_kit.core.grid import Ensemble
from replay_kit.core.table import Columns
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
    """How far apart the profiles of a group may be.

    The difference of the current between the ends of a group, by its own change and by the vehicle's way, is at most ``SHARE`` of the
    error that the mean of a bin over the profiles has: so much of them tells nothing of the current's gradient. All bins keep their own
    depths, but the published mean of a bin needs them to be near one another: they stay within a bin's size.

    Attributes:
        gradient: RMS difference of the current from place to place [1/s].
        change: RMS rate at which its squared difference grows with time [m^2/s^3]; 0 where it does not change.
        seconds: Longest group [s].
        of_mean: Whether the error is that of the mean, or, where the time is set by hand, of one profile.
    """

    gradient: float
    change: float = 0.0
    seconds: float = _LONGEST_S
    of_mean: bool = True

    def by_hand(self, seconds: float) -> "Grouping":
        """Return a grouping with the time stated; the vehicle's way is limited still, as a group has one place."""
        return replace(self, change=0.0, seconds=seconds, of_mean=False)

    def fit(self, pings: Columns, first: int, end: int) -> Mask:
        """Return which profiles may join a group that begins with one and holds all in between, shape (end - first - 1,).

        Args:
            pings: As of ``core.block.Block``.
            first: Row of the one that begins it.
            end: The row up to which it is asked.
        """
        at, bins = slice(first + 1, end), int(pings["bins"][first])
        if bins < 2:
            return np.zeros(end - first - 1, np.bool_)
        error, common = float(np.median(pings["error_std"][first, :bins])), pings["common_std"]
        if isfinite(common[first]):
            error = hypot(error, common[first])
        top, lacks = pings["depth"][:, 0], np.isnan(pings["platform"][:, 0])
        alike = np.abs(top[at] - top[first]) <= abs(pings["depth"][first, 1] - top[first])
        alike &= np.isfinite(common[at]) == isfinite(common[first])
        alike &= lacks[at] == lacks[first]
        for name in _ALIKE:
            alike &= pings[name][at] == pings[name][first]
        elapsed = (pings["time"][at] - pings["time"][first]) / _NS
        latitude, longitude = pings["latitude"], pings["longitude"]
        north = latitude[at] - latitude[first]
        east = (longitude[at] - longitude[first] + 180.0) % 360.0 - 180.0
        way = _METRES_A_DEGREE * np.hypot(east * np.cos(np.radians(latitude[first])), north)
        number = np.arange(1, end - first) if self.of_mean else 1
        change = np.sqrt(self.change * np.maximum(elapsed, 0.0))
        near = np.hypot(self.gradient * way, change) <= SHARE * error / np.sqrt(number)
        return np.asarray(alike & near & self.lasts(elapsed))

    def lasts(self, elapsed: Any) -> Any:
        """Return whether a group still lasts some time [s] after it began."""
        return (elapsed >= 0.0) & (elapsed <= self.seconds)


def current_gradient(ensemble: Ensemble) -> float:
    """Return the RMS difference of an ensemble's currents between neighbouring grid points over their distance [1/s], the larger axis's."""
    return float(np.sqrt(2.0 * mean_squares(ensemble, about_mean=False)[1:].max()))


def spread_of(ensembles: Sequence[Ensemble]) -> float:
    """Return the RMS standard deviation of a component of ensembles' members [m/s]."""
    return float(np.sqrt(np.mean([mean_squares(each)[0] for each in ensembles])))
