"""Pairs of two sources: profiles against mean currents and the platform's motion.

* ``current``: a dive's profiles within 100 m of the instrument, averaged along the dive's path as the mean current was, and that current.
  A dive of which the profiles cover less than three quarters makes no pair: its mean current is of other water.
* ``vehicle``: profiles and mean current relative to the vehicle. Most of both is the vehicle's motion through water, which shows a compass
  that is wrong where the current itself is weak. A dive is one pair: its mean current has one error, however many profiles it has.
* ``blocks``: the same of relative profiles, in blocks of half an hour, whose velocity the vehicle's dead reckoning limits.
* ``motion``: changes of the relative velocity and of minus the platform's velocity from ping to ping: the current changes less than both.
* ``track``: the platform's velocity as an instrument states it, and as the positions of the pings give it.

Positions and profiles may repeat; times that do not grow make no pair.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import chain

import numpy as np

from replay_kit.core.arrays import replace
from replay_kit.core.observation import PathMean
from replay_kit.measurements.consistency.pairs import Pair, PairStatistics

# s; the blocks of pairs relative to the vehicle, the longest time over which positions give a velocity
_BLOCK, _LONGEST = 1800.0, 3600.0
# s; positions closer in time than this have too few digits for a velocity
_SHORTEST = 60.0
# m/s, errors expected of a component: of a dive's mean; of one block and of a change from ping to ping
_DIVE_STD, _OTHER_STD = 0.035, 0.1
# m between a point of a dive's path and the nearest ping in time, and the share of the path within that, for which profiles cover a dive
_COVERED, _LEAST_COVERED = 100.0, 0.75
Vector = tuple[float, float]

# Pings remembered for the mean currents to come, and how many are moved at once: moving all with each ping takes as long as a check.
_MOST_PINGS, _TOGETHER = 1024, 32
_SEMI_MAJOR, _ECCENTRICITY_SQUARED = 6378137.0, 0.00669437999014


@dataclass(frozen=True, slots=True)
class NearMean:
    """A ping reduced to its bins near the instrument.

    Attributes:
        time_ns: [ns, UTC].
        longitude: [degrees east].
        latitude: [degrees north].
        depth: Of the bin nearest to the instrument [m].
        velocity: Mean, true east and north [m/s], as logged.
        platform: The platform's velocity that was added to it [m/s]; None when not stated.
        relative: Whether ``velocity`` is relative to a platform whose velocity is not stated.
    """

    time_ns: int
    longitude: float
    latitude: float
    depth: float
    velocity: tuple[float, float]
    platform: tuple[float, float] | None
    relative: bool


def _pairs(floor_std: float) -> PairStatistics:
    return PairStatistics(2.0 * floor_std**2)


def reckoned_pairs() -> PairStatistics:
    """Return the statistics of mean currents beside those by dead reckoning, before the first."""
    return _pairs(_DIVE_STD)


@dataclass(frozen=True, slots=True, eq=False)
class SourceStatistics:
    """What is remembered of the sources.

    Attributes:
        current: Pairs of the profiles and mean currents of dives.
        vehicle: Pairs of both relative to the vehicle, a dive each.
        blocks: The same of relative profiles, half an hour each.
        motion: Pairs of changes of the relative velocity and of the platform's.
        track: Pairs of the platform's stated velocity and that of its positions.
        latest: Latest pings, oldest first.
        earlier: Those before them, by ``_TOGETHER``.
        last: The ping from which the next motion is counted.
        before: Relative velocity and the platform's at the ping before that; None before the second.
        through_water: Whether positions under water are dead-reckoned without a current.
    """

    current: PairStatistics = field(default_factory=lambda: _pairs(_DIVE_STD))
    vehicle: PairStatistics = field(default_factory=lambda: _pairs(_DIVE_STD))
    blocks: PairStatistics = field(default_factory=lambda: _pairs(_OTHER_STD))
    motion: PairStatistics = field(default_factory=lambda: _pairs(_OTHER_STD))
    track: PairStatistics = field(default_factory=lambda: _pairs(_OTHER_STD))
    latest: tuple[NearMean, ...] = ()
    earlier: tuple[tuple[NearMean, ...], ...] = ()
    last: NearMean | None = None
    before: tuple[Vector, Vector] | None = None
    through_water: bool = False

    def after_ping(self, ping: NearMean) -> "SourceStatistics":
        """Return the statistics after a ping, which gives the motion of the platform at the one before it."""
        last, latest, earlier = self.last, (*self.latest, ping), self.earlier
        if len(latest) == _TOGETHER:
            latest, earlier = (), (*earlier[-_MOST_PINGS // _TOGETHER :], latest)
        after = replace(self, latest=latest, earlier=earlier)
        if last is not None and 0 <= ping.time_ns - last.time_ns < _SHORTEST * 1e9:
            return after
        over_ground = None if last is None else track_velocity(last, ping)
        if last is None or over_ground is None:
            return replace(after, last=ping, before=None)
        platform, track, motion = last.platform or over_ground, self.track, self.motion
        if last.platform is not None:
            track = track.with_pair(Pair(*platform, *over_ground, 0.5, last.time_ns))
        if last.relative or self.through_water:
            return replace(after, last=ping, track=track, before=None)
        relative = _difference(last.velocity, platform)
        if self.before is not None:
            # neighbouring changes share a ping
            changes = _difference(relative, self.before[0]), _difference(self.before[1], platform)
            motion = motion.with_pair(Pair(*changes[0], *changes[1], 0.5, last.time_ns))
        return replace(after, last=ping, track=track, motion=motion, before=(relative, platform))

    def after_mean(self, mean: PathMean) -> "SourceStatistics":
        """Return the statistics after a mean current."""
        start_ns, end_ns = int(mean.path_time_ns[0]), int(mean.path_time_ns[-1])
        known = [*chain(*self.earlier), *self.latest][-_MOST_PINGS:]
        pings = [ping for ping in known if start_ns <= ping.time_ns <= end_ns]
        absolute = [ping for ping in pings if not ping.relative]
        current, vehicle, half_hours = self.current, self.vehicle, self.blocks
        began_ns = int(mean.path_time_ns[0])
        if (along := mean_along(absolute, mean)) is not None:
            current = current.with_pair(Pair(*along, *mean.velocity, 1.0, began_ns))
            if ways := self._ways(absolute, mean):
                platform, stated = (
                    _mean([way for _, way in ways]),
                    _mean([ping.platform or way for block, way in ways for ping in block]),
                )
                vehicle = vehicle.with_pair(
                    Pair(
                        *_difference(along, stated),
                        *_difference(mean.velocity, platform),
                        1.0,
                        began_ns,
                    )
                )
        for block, way in self._ways([ping for ping in pings if ping.relative], mean):
            half_hours = half_hours.with_pair(
                Pair(
                    *_mean([ping.velocity for ping in block]),
                    *_difference(mean.velocity, way),
                    0.5,
                    block[0].time_ns,
                )
            )
        return replace(self, current=current, vehicle=vehicle, blocks=half_hours)

    def _ways(
        self, pings: Sequence[NearMean], mean: PathMean
    ) -> list[tuple[list[NearMean], Vector]]:
        """Return pings in blocks, each with the vehicle's velocity over ground."""
        found = [(block, track_velocity(block[0], block[-1])) for block in blocks(pings)]
        # without a current in the positions these are the way through water
        current = mean.velocity if self.through_water else (0.0, 0.0)
        return [
            (block, (way[0] + current[0], way[1] + current[1]))
            for block, way in found
            if way is not None
        ]


def mean_along(pings: Sequence[NearMean], mean: PathMean) -> Vector | None:
    """Return the mean of profiles along the path of a mean current [m/s]; None when they cover too little of it."""
    if not pings:
        return None
    ordered, start_ns = sorted(pings, key=lambda ping: ping.time_ns), int(mean.path_time_ns[0])
    seconds = [(ping.time_ns - start_ns) * 1e-9 for ping in ordered]
    columns = zip(*((ping.depth, *ping.velocity) for ping in ordered), strict=True)
    depth, east, north = (
        np.interp((mean.path_time_ns - start_ns) * 1e-9, seconds, column) for column in columns
    )
    covered = np.where(np.abs(depth - mean.depth) <= _COVERED, mean.weight, 0.0)
    total = float(covered.sum())
    return (
        (float(east @ covered) / total, float(north @ covered) / total)
        if total >= _LEAST_COVERED
        else None
    )


def blocks(pings: Sequence[NearMean]) -> list[list[NearMean]]:
    """Return pings in blocks of half an hour from the first one."""
    found: list[list[NearMean]] = []
    for ping in pings:
        if not found or ping.time_ns - found[-1][0].time_ns > _BLOCK * 1e9:
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
    return sum(east for east, _ in vectors) / len(vectors), sum(
        north for _, north in vectors
    ) / len(vectors)
