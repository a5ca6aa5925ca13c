"""The checks of positions: a vehicle that dives and stays on one spot to the last digit, and places that no one vehicle can join."""

import math
from dataclasses import dataclass, replace

from replay_kit.core.errors import Finding
from replay_kit.core.geodesy import distance
from replay_kit.core.observation import VehicleState
from replay_kit.core.text import place_text, time_text
from replay_kit.measurements.consistency import findings

# s, m and positions for which an unchanged position is that of a dead receiver
_FROZEN_TIME, _FROZEN_DEPTH, _FROZEN_FIXES = 600.0, 20.0, 4
# m and m/s: positions farther apart than a vehicle or a ship goes in the time between them, and by no small error; s between the
# positions of one mission at most
_FAR, _FASTEST, _LONGEST = 100e3, 10.0, 366 * 86_400.0
# Degrees of latitude and of longitude at any latitude within which two places are certainly not as far apart.
_NEAR = 0.5
# Positions before which a place counts as one: single wrong fixes make none.
_LEAST = 5


@dataclass(frozen=True, slots=True)
class PositionRun:
    """The positions since the last one that differed.

    Attributes:
        longitude: Of all of them [degrees]; NaN before the first.
        latitude: Of all of them [degrees].
        since_ns: Time of the first [ns, UTC].
        last_ns: Time of the last [ns, UTC].
        fixes: Number.
        shallowest: Least depth [m]; NaN when none was known.
        deepest: Greatest depth [m].
    """

    longitude: float = math.nan
    latitude: float = math.nan
    since_ns: int = 0
    last_ns: int = 0
    fixes: int = 0
    shallowest: float = math.nan
    deepest: float = math.nan

    def after(self, vehicle: VehicleState) -> "PositionRun":
        """Return the run after a position."""
        depth = vehicle.depth
        if vehicle.longitude != self.longitude or vehicle.latitude != self.latitude:
            return PositionRun(
                vehicle.longitude,
                vehicle.latitude,
                vehicle.time_ns,
                vehicle.time_ns,
                1,
                depth,
                depth,
            )
        # a depth that is not known changes neither bound
        least = depth if not self.shallowest <= depth and math.isfinite(depth) else self.shallowest
        most = depth if not self.deepest >= depth and math.isfinite(depth) else self.deepest
        return replace(
            self, last_ns=vehicle.time_ns, fixes=self.fixes + 1, shallowest=least, deepest=most
        )

    def found(self, vehicle: VehicleState, named: frozenset[str]) -> Finding | None:
        """Return that the receiver repeats its position, if it does."""
        if not self.is_unusable:
            return None
        return Finding(
            findings.FROZEN,
            self.last_ns,
            f"{self.fixes} positions over {(self.last_ns - self.since_ns) * 1e-9:.0f} s are equal to the last digit "
            f"while the vehicle moved between {self.shallowest:.0f} and {self.deepest:.0f} m",
            "a receiver without a fix that repeats its last one",
            "pings at such positions are not used; check the receiver, or give the vehicle's dead-reckoned positions",
        )

    @property
    def is_unusable(self) -> bool:
        """Whether the receiver repeats a position while the vehicle dives, so that pings at it are not to be used."""
        return (
            self.fixes >= _FROZEN_FIXES
            and self.last_ns - self.since_ns >= _FROZEN_TIME * 1e9
            and self.deepest - self.shallowest > _FROZEN_DEPTH
        )


@dataclass(frozen=True, slots=True)
class Track:
    """Positions that can be those of one vehicle.

    Attributes:
        last: The last one.
        positions: Their number.
    """

    last: VehicleState
    positions: int = 1

    def to(self, vehicle: VehicleState) -> "Track":
        """Return the track with one more position."""
        return Track(vehicle, self.positions + 1)

    def reaches(self, vehicle: VehicleState) -> bool:
        """Return whether the vehicle can have come from the last position to another one."""
        last = self.last
        seconds = abs(vehicle.time_ns - last.time_ns) * 1e-9
        if seconds > _LONGEST:
            return False
        if (
            abs(vehicle.latitude - last.latitude) < _NEAR
            and abs(vehicle.longitude - last.longitude) < _NEAR
        ):
            return True
        apart = float(distance(last.longitude, last.latitude, vehicle.longitude, vehicle.latitude))
        return apart <= _FAR + _FASTEST * seconds


@dataclass(frozen=True, slots=True)
class SeparatePlaces:
    """The positions so far, as tracks between which no vehicle goes; of positions that belong to none of two only the latest are kept.

    Attributes:
        track: The first one.
        other: Positions that it does not reach; None without.
    """

    track: Track | None = None
    other: Track | None = None

    def after(self, vehicle: VehicleState) -> "SeparatePlaces":
        """Return the tracks after a position."""
        if self.track is None:
            return SeparatePlaces(Track(vehicle))
        if self.track.reaches(vehicle):
            return SeparatePlaces(self.track.to(vehicle), self.other)
        if self.other is None or not self.other.reaches(vehicle):
            return SeparatePlaces(self.track, Track(vehicle))
        other = self.other.to(vehicle)
        # what came first was wrong fixes
        wrong = self.track.positions < _LEAST <= other.positions
        return SeparatePlaces(other) if wrong else SeparatePlaces(self.track, other)

    def found(self, vehicle: VehicleState, named: frozenset[str]) -> Finding | None:
        """Return that the positions are of two missions, if they are."""
        if (
            self.track is None
            or self.other is None
            or self.other.positions < _LEAST
            or findings.PLACES in named
        ):
            return None
        one, other = _where(self.track.last), _where(self.other.last)
        return Finding(
            findings.PLACES,
            self.other.last.time_ns,
            f"one vehicle was not at {one} and at {other}",
            "a log of another mission, place or year among the logs, or a clock or receiver that was wrong for a time",
            "all are used; replay-kit info shows where and when each log was recorded, exclude those of other missions",
        )

    @property
    def is_unusable(self) -> bool:
        """Which of the places is the mission's is not known: its pings are used."""
        return False


def _where(vehicle: VehicleState) -> str:
    where, source = place_text(vehicle.longitude, vehicle.latitude), vehicle.source
    return f"{where} at {time_text(vehicle.time_ns)} ({source.topic} of log{source.input})"
