"""The checks of positions: one spot to the last digit in dives, fixes out of reach, and places that no one vehicle can join."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from replay_kit.core.arrays import replace
from replay_kit.core.errors import Finding
from replay_kit.core.geodesy import distance
from replay_kit.core.observation import VehicleState
from replay_kit.core.text import place_text, time_text
from replay_kit.measurements.consistency import findings
from replay_kit.measurements.consistency.tracks import apart

# s, m and positions for which an unchanged position is that of a dead receiver
_FROZEN_TIME, _FROZEN_DEPTH, _FROZEN_FIXES = 600.0, 20.0, 4
# m and m/s: positions farther apart than a vehicle or a ship goes in the time between them, and by no small error; s between the
# positions of one mission at most
_FAR, _FASTEST, _LONGEST = 100e3, 10.0, 366 * 86_400.0
# Degrees of latitude and of longitude at any latitude within which two places are certainly not as far apart.
_NEAR = 0.5
# Positions before which a place counts as one: single wrong fixes make none.
_LEAST = 5


# ns and degrees; from one position to the next, within which a vehicle always reaches it
_STEP_NS, _STEP = 59_000_000_000, 0.001


def steady(track: Sequence[VehicleState]) -> bool:
    """Return whether positions are of one log and kind, in order, and so near one another in time and place that each is reached."""
    return all(
        0 < there.time_ns - here.time_ns < _STEP_NS
        and abs(there.latitude - here.latitude) < _STEP
        and abs(there.longitude - here.longitude) < _STEP
        and there.dead_reckoned == here.dead_reckoned
        and there.source.input == here.source.input
        for here, there in pairwise(track)
    )


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
        is_fix: Whether one that was measured came after others at different depths: a vehicle that logs its last fix until the next one
            gives none.
    """

    longitude: float = math.nan
    latitude: float = math.nan
    since_ns: int = 0
    last_ns: int = 0
    fixes: int = 0
    shallowest: float = math.nan
    deepest: float = math.nan
    is_fix: bool = False

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
            self,
            last_ns=vehicle.time_ns,
            fixes=self.fixes + 1,
            shallowest=least,
            deepest=most,
            is_fix=self.is_fix or (most - least > _FROZEN_DEPTH and not vehicle.dead_reckoned),
        )

    def quietly(self, track: Sequence[VehicleState]) -> "PositionRun | None":
        """Return the run after positions, if it was too short to be a dead receiver's, and is."""
        after = self
        for vehicle in track:
            after = after.after(vehicle)
        short = track[-1].time_ns - self.since_ns < _FROZEN_TIME * 1e9
        return after if short or (after.since_ns == self.since_ns and not after.is_unusable) else None  # fmt: skip

    def found(self, vehicle: VehicleState, named: frozenset[str]) -> Finding | None:
        """Return that the receiver repeats its position, if it does."""
        if not self.is_unusable:
            return None
        return Finding(
            findings.FROZEN if self.is_fix else findings.REPEATED,
            self.last_ns,
            f"{self.fixes} positions over {(self.last_ns - self.since_ns) * 1e-9:.0f} s are equal to the last digit "
            f"while the vehicle moved between {self.shallowest:.0f} and {self.deepest:.0f} m",
            "a receiver without a fix that repeats its last one"
            if self.is_fix
            else "a vehicle that does not reckon its way under water, and logs its last fix until the next one",
            "pings at such positions are not used; check the receiver, or give the vehicle's dead-reckoned positions",
            "inconsistent" if self.is_fix else "warning",
        )

    @property
    def is_unusable(self) -> bool:
        """Whether the receiver repeats a position while the vehicle dives, so that pings at it are not to be used."""
        return (
            self.fixes >= _FROZEN_FIXES
            and self.last_ns - self.since_ns >= _FROZEN_TIME * 1e9
            and self.deepest - self.shallowest > _FROZEN_DEPTH
        )


# m, m/s and s: error of two positions, least and greatest speed that a vehicle reaches, how many times as fast as its steps so far, and the
# longest time over which it is judged
_ERROR, _LEAST_SPEED, _FASTER, _LONGEST_STEP = 300.0, 2.0, 4.0, 6 * 3600.0
# m; by how much a fix may put right what was dead-reckoned for hours
_MOVED = 15e3
# Displaced positions before which nothing is said, steps and gaps that are remembered, and gaps that show how well positions are reckoned.
_LEAST_DISPLACED, _REMEMBERED, _LEAST_GAPS = 3, 32, 3


@dataclass(frozen=True, slots=True)
class Displacements:
    """Positions beyond what the vehicle reaches: a few, after which the track goes on, or all from some time on.

    A fix is judged by the dead-reckoned position before it, as far as those before were right, and else by the fix before it.

    Attributes:
        last: Last position that was reached.
        fix: Last measured one.
        beyond: Positions since then that were not reached, oldest first.
        speeds: Of the latest steps [m/s].
        gaps: From dead-reckoned positions to the fixes after them, beyond the way in between [m].
        displaced: Number of times that the track went on after positions beyond reach.
        far: Greatest distance of those [m].
        moved: The first position of those from which the track never came back; None while there is none.
        reached: Number of positions that were reached.
    """

    last: VehicleState | None = None
    fix: VehicleState | None = None
    beyond: tuple[VehicleState, ...] = ()
    speeds: tuple[float, ...] = ()
    gaps: tuple[float, ...] = ()
    displaced: int = 0
    far: float = 0.0
    moved: VehicleState | None = None
    reached: int = 1

    def after(self, vehicle: VehicleState) -> "Displacements":
        """Return what is remembered after a position; logs that alternate are left to ``LogTracks``."""
        last = self.last
        if last is None or last.source.input != vehicle.source.input:
            return Displacements(vehicle, None if vehicle.dead_reckoned else vehicle, moved=self.moved)  # fmt: skip
        seconds = (vehicle.time_ns - last.time_ns) * 1e-9
        if seconds <= 0.0:
            return self
        if seconds > _LONGEST_STEP:
            return replace(self, last=vehicle, fix=None, beyond=())
        way = apart(last, vehicle)
        if self._reaches(last, vehicle, way):
            return self._reached(vehicle, seconds, way)
        away = replace(self, beyond=(*self.beyond, vehicle))
        if len(away.beyond) < _LEAST:
            return away
        if all(self._reaches(*pair, apart(*pair)) for pair in pairwise(away.beyond)):
            # it stays there
            there = replace(self, last=vehicle, fix=None, beyond=(), reached=_LEAST)
            far = apart(last, away.beyond[0])
            if self.reached < _LEAST or far < _MOVED:
                # what came first was wrong fixes, or dead reckoning that a fix put right
                return there
            return replace(there, far=far, moved=self.moved or away.beyond[0])
        return replace(away, beyond=away.beyond[1:])

    def quietly(self, track: Sequence[VehicleState]) -> "Displacements | None":
        """Return what is remembered after positions that go on from the last one."""
        if self.last is None or self.beyond or not steady([self.last, track[0]]):
            return None
        fix = self.fix if track[-1].dead_reckoned else track[-1]
        return replace(self, last=track[-1], fix=fix, reached=self.reached + len(track))

    def _reached(self, vehicle: VehicleState, seconds: float, way: float) -> "Displacements":
        last, speeds, gaps = self.last, self.speeds, self.gaps
        assert last is not None, "it was reached from there"
        far = max([self.far, *(apart(last, one) for one in self.beyond)])
        if seconds >= 60.0:
            speeds = (*speeds, way / seconds)[-_REMEMBERED:]
        if last.dead_reckoned and not vehicle.dead_reckoned:
            gaps = (*gaps, max(way - self._fastest * seconds, 0.0))[-_REMEMBERED:]
        return replace(
            self,
            last=vehicle,
            fix=self.fix if vehicle.dead_reckoned else vehicle,
            beyond=(),
            speeds=speeds,
            gaps=gaps,
            displaced=self.displaced + bool(self.beyond),
            far=far,
            reached=self.reached + 1,
        )

    @property
    def _fastest(self) -> float:
        """The speed that the vehicle reaches [m/s]."""
        typical = sorted(self.speeds)[len(self.speeds) // 2] if self.speeds else _FASTEST
        return min(max(_FASTER * typical, _LEAST_SPEED), _FASTEST)

    def _reaches(self, start: VehicleState, end: VehicleState, way: float) -> bool:
        """Return whether the vehicle can have come from one position to another, so far away [m]."""
        seconds = abs(end.time_ns - start.time_ns) * 1e-9
        error = _ERROR
        if start.dead_reckoned and not end.dead_reckoned:
            if len(self.gaps) < _LEAST_GAPS:
                before = self.fix
                return before is None or self._reaches(before, end, apart(before, end))
            error += _FASTER * sorted(self.gaps)[len(self.gaps) // 2]
        return way <= error + self._fastest * seconds

    def found(self, vehicle: VehicleState, named: frozenset[str]) -> Finding | None:
        """Return that positions are displaced, if they are."""
        if findings.DISPLACED in named or not (self.moved or self.displaced >= _LEAST_DISPLACED):
            return None
        if self.moved is not None:
            evidence = f"the track goes on {self.far / 1e3:.3g} km away, farther than the vehicle reaches, and does not come back"
        else:
            evidence = f"{self.displaced} times positions are out of reach, up to {self.far / 1e3:.3g} km away, and the track comes back"
        return Finding(
            findings.DISPLACED,
            vehicle.time_ns if self.moved is None else self.moved.time_ns,
            f"{evidence} (at most {self._fastest:.1f} m/s)",
            "a receiver that errs, a wrong datum, or positions of another vehicle",
            "pings at positions beyond reach are not used; check the receiver, and give a log with the right positions",
        )

    @property
    def is_unusable(self) -> bool:
        """Whether the last position is beyond what the vehicle reaches, in a log that is known to have such positions.

        Before that is named nothing is left out for it: a log with few positions may only seem to jump.
        """
        return bool(self.beyond) and (self.moved is not None or self.displaced >= _LEAST_DISPLACED)


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

    def quietly(self, track: Sequence[VehicleState]) -> "SeparatePlaces | None":
        """Return the tracks after positions that go on from the last one of the first."""
        first = self.track
        if first is None or self.other is not None or not steady([first.last, track[0]]):
            return None
        return SeparatePlaces(Track(track[-1], first.positions + len(track)))

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
