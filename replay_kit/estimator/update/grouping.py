"""Which profiles are combined: those near enough in time and place that the current between them hardly differs."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from math import cos, hypot, isfinite, radians

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Measurement, Observation, Source, VehicleState
from replay_kit.estimator.basis.slices import mean_squares

#: Share of the error of a bin's mean that the current's difference within a group may have.
SHARE = 0.25
#: Longest group where the window is chosen by itself [s]: the estimate is to follow the log.
_LONGEST_S = 120.0
_NS, _METRES_A_DEGREE = 1e9, 111_200.0


@dataclass(frozen=True, slots=True, eq=False)
class ProfileGroup:
    """Profiles of one instrument that are assimilated as one, in order of time.

    Attributes:
        profiles: At least one.
    """

    profiles: tuple[Observation, ...]

    @property
    def longitude(self) -> float:
        """Mean [degrees east]."""
        return mean_longitude(np.array([profile.longitude for profile in self.profiles]))

    @property
    def latitude(self) -> float:
        """Mean [degrees north]."""
        return float(np.mean([profile.latitude for profile in self.profiles]))

    @property
    def time_ns(self) -> int:
        """Mean time, for which they count [ns, UTC]."""
        return mean_time(self.profiles)

    @property
    def dive(self) -> int:
        """Number of their dive."""
        return self.profiles[-1].dive

    @property
    def source(self) -> Source:
        """Of the first."""
        return self.profiles[0].source

    @property
    def position_std(self) -> float:
        """Largest standard error of a place [m]."""
        return max(profile.position_std for profile in self.profiles)


def mean_longitude(longitude: Array) -> float:
    """Return the mean of longitudes near one another [degrees east]."""
    return float(longitude[0] + np.mean((longitude - longitude[0] + 180.0) % 360.0 - 180.0))


def mean_time(events: Sequence[Measurement]) -> int:
    """Return the mean time of measurements [ns, UTC]."""
    first_ns = events[0].time_ns
    return first_ns + round(sum(event.time_ns - first_ns for event in events) / len(events))


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

    def fits(self, first: Observation, profile: Observation, number: int = 1) -> bool:
        """Return whether a profile may join a group that begins with another and has some number of profiles."""
        elapsed = (profile.time_ns - first.time_ns) / _NS
        if not 0.0 <= elapsed <= self.seconds or not _are_alike(first, profile):
            return False
        error = _error_of(first)
        north = profile.latitude - first.latitude
        east = ((profile.longitude - first.longitude + 180.0) % 360.0 - 180.0) * cos(
            radians(first.latitude)
        )
        way = _METRES_A_DEGREE * hypot(east, north)
        return hypot(self.gradient * way, (self.change * elapsed) ** 0.5) <= SHARE * error / (
            number**0.5 if self.of_mean else 1.0
        )

    def ends(self, first: Observation, event: VehicleState | Measurement) -> bool:
        """Return whether something else ends a group that begins with a profile: another measurement, or a position too late."""
        return not isinstance(event, VehicleState) or self.is_over(first, event.time_ns)

    def is_over(self, first: VehicleState | Measurement, time_ns: int) -> bool:
        """Return whether no profile of a time [ns, UTC] can join a group that begins with a profile."""
        return not 0.0 <= (time_ns - first.time_ns) / _NS <= self.seconds


@lru_cache(maxsize=4)
def _error_of(first: Observation) -> float:
    """Return the error of a bin of a profile [m/s], which every other of its group is held against."""
    error = float(np.median(first.error_std))
    return hypot(error, first.common_std) if isfinite(first.common_std) else error


def _are_alike(first: Observation, profile: Observation) -> bool:
    """Return whether profiles are of one instrument and dive, have as many bins in nearly the same depths, and lack the same."""
    if first.depth.size < 2 or _kind(first) != _kind(profile):
        return False
    return bool(abs(profile.depth[0] - first.depth[0]) <= abs(first.depth[1] - first.depth[0]))


def _kind(profile: Observation) -> tuple[Hashable, ...]:
    source, lacks = profile.source, profile.platform_velocity is None
    kept = profile.dive, profile.depth.size, profile.correlation_depth, profile.common_std < np.inf
    return source.input, source.topic, lacks, *kept


def current_gradient(ensemble: Ensemble) -> float:
    """Return the RMS difference of an ensemble's currents between neighbouring grid points over their distance [1/s], the larger axis's."""
    return float(np.sqrt(2.0 * mean_squares(ensemble, about_mean=False)[1:].max()))


def spread_of(ensembles: Sequence[Ensemble]) -> float:
    """Return the RMS standard deviation of a component of ensembles' members [m/s]."""
    return float(np.sqrt(np.mean([mean_squares(each)[0] for each in ensembles])))
