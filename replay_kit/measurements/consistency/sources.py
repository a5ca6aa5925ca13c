"""Pairs of two sources: profiles against mean currents, drifts and the platform's motion.

* ``current``: the mean of a dive's profiles within 100 m of the instrument, and the dive's mean current.
* ``drift``: the same of the profiles about a drift at the surface.
* ``vehicle``: the same profiles relative to the vehicle, in blocks of half an hour, and the mean current relative to it. Most of both is
  the vehicle's motion through water, which shows a compass that is wrong where the current itself is weak, and also in relative profiles.
* ``motion``: changes of the relative velocity and of minus the platform's velocity from ping to ping: the current changes less than both.
* ``track``: the platform's velocity as an instrument states it, and as the positions of the pings give it.

Positions and profiles may repeat; times that do not grow make no pair.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from replay_kit.core.observation import Observation, PathMean, Reason
from replay_kit.measurements.consistency.pairs import Pair, PairStatistics

# m from the first bin; what is farther is less like the water at the vehicle
_NEAR = 100.0
# s; the blocks of pairs relative to the vehicle, the pings about a drift, the longest time over which positions give a velocity
_BLOCK, _ABOUT_DRIFT, _LONGEST = 1800.0, 1800.0, 3600.0
# s; positions closer in time than this have too few digits for a velocity
_SHORTEST = 60.0
# m/s, errors expected of a component: of a dive's mean; of a drift, of one block and of a change from ping to ping
_DIVE_STD, _OTHER_STD = 0.05, 0.1
Vector = tuple[float, float]

# Pings remembered for the mean currents to come.
_MOST_PINGS = 1024
_SEMI_MAJOR, _ECCENTRICITY_SQUARED = 6378137.0, 0.00669437999014
# Bins bad only in a way that a wrong unit or axis could have made them.
REPAIRABLE = Reason.GROSS_RANGE | Reason.HIGH_SPEED | Reason.OUTLIER


@dataclass(frozen=True, slots=True)
class NearMean:
    """A ping reduced to its bins near the instrument.

    Attributes:
        time_ns: [ns, UTC].
        longitude: [degrees east].
        latitude: [degrees north].
        velocity: Mean, true east and north [m/s], as logged.
        platform: The platform's velocity that was added to it [m/s]; None when not stated.
        relative: Whether ``velocity`` is relative to a platform whose velocity is not stated.
    """

    time_ns: int
    longitude: float
    latitude: float
    velocity: tuple[float, float]
    platform: tuple[float, float] | None
    relative: bool


def near_mean(observation: Observation) -> NearMean | None:
    """Return a ping reduced to its bins near the instrument; None without a bin there."""
    good = ((observation.reasons & ~np.int32(REPAIRABLE)) == 0) & np.isfinite(observation.velocity[:, 0] + observation.velocity[:, 1])
    depth = observation.depth[good]
    if not depth.size:
        return None
    near = np.abs(depth - depth[0]) <= _NEAR
    east, north = observation.velocity[good][near].mean(axis=0).tolist()
    relative = not math.isfinite(observation.common_std)
    return NearMean(
        observation.time_ns, observation.longitude, observation.latitude, (east, north), observation.platform_velocity, relative
    )


def _pairs(floor_std: float) -> PairStatistics:
    return PairStatistics(2.0 * floor_std**2)


@dataclass(frozen=True, slots=True, eq=False)
class SourceStatistics:
    """What is remembered of the sources.

    Attributes:
        current: Pairs of the profiles and mean currents of dives.
        drift: Pairs of profiles and drifts.
        vehicle: Pairs of both relative to the vehicle.
        motion: Pairs of changes of the relative velocity and of the platform's.
        track: Pairs of the platform's stated velocity and that of its positions.
        pings: Latest pings, oldest first.
        last: The ping from which the next motion is counted.
        before: Relative velocity and the platform's at the ping before that; None before the second.
        through_water: Whether positions under water are dead-reckoned without a current.
    """

    current: PairStatistics = field(default_factory=lambda: _pairs(_DIVE_STD))
    drift: PairStatistics = field(default_factory=lambda: _pairs(_OTHER_STD))
    vehicle: PairStatistics = field(default_factory=lambda: _pairs(_OTHER_STD))
    motion: PairStatistics = field(default_factory=lambda: _pairs(_OTHER_STD))
    track: PairStatistics = field(default_factory=lambda: _pairs(_OTHER_STD))
    pings: tuple[NearMean, ...] = ()
    last: NearMean | None = None
    before: tuple[Vector, Vector] | None = None
    through_water: bool = False

    def after_ping(self, ping: NearMean) -> "SourceStatistics":
        """Return the statistics after a ping, which gives the motion of the platform at the one before it."""
        last, pings = self.last, (*self.pings[-_MOST_PINGS + 1 :], ping)
        if last is not None and 0 <= ping.time_ns - last.time_ns < _SHORTEST * 1e9:
            return replace(self, pings=pings)
        over_ground = None if last is None else track_velocity(last, ping)
        if last is None or over_ground is None:
            return replace(self, pings=pings, last=ping, before=None)
        platform, track, motion = last.platform or over_ground, self.track, self.motion
        if last.platform is not None:
            track = track.with_pair(Pair(*platform, *over_ground, 0.5))
        if last.relative or self.through_water:
            return replace(self, pings=pings, last=ping, track=track, before=None)
        relative = _difference(last.velocity, platform)
        if self.before is not None:
            # neighbouring changes share a ping
            changes = _difference(relative, self.before[0]), _difference(self.before[1], platform)
            motion = motion.with_pair(Pair(*changes[0], *changes[1], 0.5))
        return replace(self, pings=pings, last=ping, track=track, motion=motion, before=(relative, platform))

    def after_mean(self, mean: PathMean) -> "SourceStatistics":
        """Return the statistics after a mean current or a drift."""
        about_ns = int(_ABOUT_DRIFT * 1e9) if mean.kind == "drift" else 0
        start_ns, end_ns = int(mean.path_time_ns[0]) - about_ns, int(mean.path_time_ns[-1]) + about_ns
        pings = [ping for ping in self.pings if start_ns <= ping.time_ns <= end_ns]
        absolute = [ping.velocity for ping in pings if not ping.relative]
        profiles = _mean(absolute) if absolute else None
        if mean.kind == "drift":
            return self if profiles is None else replace(self, drift=self.drift.with_pair(Pair(*profiles, *mean.velocity, 0.5)))
        current = self.current if profiles is None else self.current.with_pair(Pair(*profiles, *mean.velocity))
        vehicle = self.vehicle
        for block in blocks(pings):
            over_ground = track_velocity(block[0], block[-1])
            if over_ground is not None:
                # without a current in the positions these are the way through water
                platform = _difference(over_ground, (-mean.velocity[0], -mean.velocity[1])) if self.through_water else over_ground
                relative = [ping.velocity if ping.relative else _difference(ping.velocity, ping.platform or platform) for ping in block]
                vehicle = vehicle.with_pair(Pair(*_mean(relative), *_difference(mean.velocity, platform), 0.5))
        return replace(self, current=current, vehicle=vehicle)


def blocks(pings: Sequence[NearMean]) -> list[list[NearMean]]:
    """Return pings in blocks of half an hour from the first one; relative ones and absolute ones are not mixed."""
    found: list[list[NearMean]] = []
    for ping in pings:
        if not found or ping.time_ns - found[-1][0].time_ns > _BLOCK * 1e9 or ping.relative != found[-1][0].relative:
            found.append([])
        found[-1].append(ping)
    return found


def track_velocity(first: NearMean, last: NearMean) -> Vector | None:
    """Return the velocity over ground from one ping to another [m/s]; None when they are at one time, or far from each other in time."""
    seconds = (last.time_ns - first.time_ns) * 1e-9
    if not 0.0 < seconds <= _LONGEST:
        return None
    east, north = metres_per_degree(first.latitude)
    degrees = (last.longitude - first.longitude + 180.0) % 360.0 - 180.0
    return east * degrees / seconds, north * (last.latitude - first.latitude) / seconds


def metres_per_degree(latitude: float) -> Vector:
    """Return the lengths of a degree of longitude and of latitude on WGS84 [m]: exact enough for a velocity."""
    squared = 1.0 - _ECCENTRICITY_SQUARED * math.sin(math.radians(latitude)) ** 2
    across = _SEMI_MAJOR / math.sqrt(squared)
    along = across * (1.0 - _ECCENTRICITY_SQUARED) / squared
    return math.radians(across) * math.cos(math.radians(latitude)), math.radians(along)


def _difference(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1]


def _mean(vectors: Sequence[Vector]) -> Vector:
    return sum(east for east, _ in vectors) / len(vectors), sum(north for _, north in vectors) / len(vectors)
