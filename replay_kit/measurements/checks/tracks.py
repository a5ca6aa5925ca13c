"""Tracks of several logs that interleave in time: whether one vehicle can have been on all of them.

The positions of all logs are gone through in the order of their times. Where one is of another log than the one before, the vehicle, if it
is one, came from there to here: two logs of one vehicle are near each other, two vehicles are not, each time anew.
"""

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

from replay_kit.core.arrays import replace
from replay_kit.core.geodesy import metres_per_degree
from replay_kit.core.observation import VehicleState

# m and s; two logs of one vehicle differ by less: by the error of dead reckoning during a dive, and by the way that it goes while one of
# their clocks is late
_ERROR, _CLOCK = 20e3, 3600.0
# m/s: every vehicle may have been as fast as the first, none was faster than the second; between, this many times as fast as its fixes show
_LEAST_SPEED, _MOST_SPEED, _FASTER = 3.0, 10.0, 3.0
# s between two fixes of a log at least, from which its speed is taken
_LEAST_TIME = 600.0
# Passages out of reach before which nothing is said: single wrong fixes make none.
_LEAST = 4


@dataclass(frozen=True, slots=True)
class Passages:
    """How often a position of one log came next after one of another.

    Attributes:
        number: How often.
        beyond: How often it was out of reach.
        example: The two positions of the last one out of reach; None without.
    """

    number: int = 0
    beyond: int = 0
    example: tuple[VehicleState, VehicleState] | None = None

    def after(self, start: VehicleState, end: VehicleState, is_beyond: bool) -> "Passages":
        """Return the passages with one more."""
        return Passages(
            self.number + 1, self.beyond + is_beyond, (start, end) if is_beyond else self.example
        )


@dataclass(frozen=True, slots=True)
class LogTracks:
    """The positions of several logs so far.

    Attributes:
        last: The last one, whatever its log; None before the first.
        fixes: Of each log the measured one from which its speed is taken next.
        speed: The fastest that any log's fixes show [m/s]; 0 before two of one log.
        passages: From log to log, by the numbers of both, the smaller first.
    """

    last: VehicleState | None = None
    fixes: Mapping[int, VehicleState] = field(default_factory=dict)
    speed: float = 0.0
    passages: Mapping[tuple[int, int], Passages] = field(default_factory=dict)

    def after(self, vehicle: VehicleState) -> "LogTracks":
        """Return the tracks after a position; one that a receiver repeats to the last digit says nothing."""
        log, fix = vehicle.source.input, self.fixes.get(vehicle.source.input)
        if fix is not None and (vehicle.longitude, vehicle.latitude) == (
            fix.longitude,
            fix.latitude,
        ):
            return self
        tracks = self if vehicle.dead_reckoned else self._with_fix(fix, vehicle)
        last = self.last
        if last is None or last.source.input == log:
            return replace(tracks, last=vehicle)
        pair = min(log, last.source.input), max(log, last.source.input)
        passages = self.passages.get(pair, Passages()).after(
            last, vehicle, not self._reaches(last, vehicle)
        )
        return replace(tracks, last=vehicle, passages={**self.passages, pair: passages})

    def _with_fix(self, before: VehicleState | None, fix: VehicleState) -> "LogTracks":
        if before is None:
            return replace(self, fixes={**self.fixes, fix.source.input: fix})
        seconds = (fix.time_ns - before.time_ns) * 1e-9
        if seconds < _LEAST_TIME:
            return self
        return replace(
            self,
            fixes={**self.fixes, fix.source.input: fix},
            speed=max(self.speed, apart(before, fix) / seconds),
        )

    def _reaches(self, start: VehicleState, end: VehicleState) -> bool:
        """Return whether one vehicle can have gone from one position to another."""
        fastest = (
            min(max(_FASTER * self.speed, _LEAST_SPEED), _MOST_SPEED) if self.speed else _MOST_SPEED
        )
        error = _ERROR + _CLOCK * min(self.speed, _MOST_SPEED)
        return apart(start, end) <= error + fastest * abs(end.time_ns - start.time_ns) * 1e-9

    @property
    def two_vehicles(self) -> Passages | None:
        """Passages between the two logs that no one vehicle can have made; None where one can have made all.

        Most passages of a log, or of all, must be out of reach: a receiver that is wrong for a time makes few.
        """
        number, beyond = Counter[int](), Counter[int]()
        for pair, passages in self.passages.items():
            # -1 for all logs together: each of many short ones may have few passages
            for log in (*pair, -1):
                number[log] += passages.number
                beyond[log] += passages.beyond
        wrong = {
            log for log, count in beyond.items() if count >= _LEAST and 2 * count > number[log]
        }
        of_wrong = [passages for pair, passages in self.passages.items() if wrong & {*pair, -1}]
        return max(of_wrong, key=lambda passages: passages.beyond, default=None)


def apart(one: VehicleState, other: VehicleState) -> float:
    """Return how far apart two positions are [m], to a few percent: there may be millions of them."""
    east, north = metres_per_degree(0.5 * (one.latitude + other.latitude))
    degrees = (other.longitude - one.longitude + 180.0) % 360.0 - 180.0
    return math.hypot(east * degrees, north * (other.latitude - one.latitude))
