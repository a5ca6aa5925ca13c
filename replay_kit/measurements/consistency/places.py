"""Positions that no one vehicle can have: of another place or another year, as those of another mission's log among the logs."""

from dataclasses import dataclass

from replay_kit.core.errors import Finding
from replay_kit.core.geodesy import distance
from replay_kit.core.observation import VehicleState
from replay_kit.core.text import place_text, time_text
from replay_kit.measurements.consistency import findings

# m and m/s: positions farther apart than a vehicle or a ship goes in the time between them, and by no small error; s between the
# positions of one mission at most
_FAR, _FASTEST, _LONGEST = 100e3, 10.0, 366 * 86_400.0
# Degrees of latitude and of longitude at any latitude within which two places are certainly not as far apart.
_NEAR = 0.5
# Positions before which a place counts as one: single wrong fixes make none.
_LEAST = 5


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
            "all are used; replay-kit info says where and when each log was recorded, leave out those of other missions",
        )

    @property
    def is_unusable(self) -> bool:
        """Which of the places is the mission's is not known: its pings are used."""
        return False


def _where(vehicle: VehicleState) -> str:
    where, source = place_text(vehicle.longitude, vehicle.latitude), vehicle.source
    return f"{where} at {time_text(vehicle.time_ns)} ({source.topic} of log{source.input})"
