"""Checks of positions: frozen positions in dives, positions out of reach, and logs of different vehicles.

Positions of all logs are processed in order of time. At each change of the log a single vehicle must have moved between the two positions:
logs of one vehicle stay near each other, those of two vehicles do not.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import NamedTuple

import numpy as np

from replay_kit.core.arrays import Mask
from replay_kit.core.observation.table import Columns
from replay_kit.core.words.text import place_text, time_text
from replay_kit.measurements.checks.fold import Found, Judged, Memory, Rows
from replay_kit.measurements.track.reach import COLUMNS, Place, places, short_steps

FROZEN = "frozen positions"
REPEATED = "the last fix repeated under water"
PLACES = "positions of several missions"
# s, m and positions for which an unchanged position is that of a dead receiver.
_FROZEN_TIME, _FROZEN_DEPTH, _FROZEN_FIXES = 600.0, 20.0, 4
# m and m/s: positions farther apart than a vehicle or a ship goes in the time between them, and by no small error; s between the
# positions of one mission at most; positions before which a place counts as one.
_FAR, _FASTEST, _LONGEST, _LEAST = 100e3, 10.0, 366 * 86_400.0, 5
# m and s; two logs of one vehicle differ by less: by the error of dead reckoning during a dive, and by the way that it goes while one of
# their clocks is late
_ERROR, _CLOCK = 20e3, 3600.0
# m/s: every vehicle may have been as fast as this, none was faster than a ship; between, this many times as fast as its fixes show
_LEAST_SPEED, _FASTER = 3.0, 3.0
# s between two fixes of a log at least, from which its speed is taken
_LEAST_TIME = 600.0
# Passages out of reach before which nothing is said: single wrong fixes make none.
_LEAST_BEYOND = 4


def frozen(memory: Memory, positions: Rows) -> tuple[Memory, list[Found], Mask]:
    """Check for a receiver that repeats its position during dives; return at which positions pings are unusable.

    The mask has shape (n + 1,), with the last earlier position first.

    Args:
        memory: ``run`` (8,) of equal positions: longitude, latitude, time of the first [ns], number, least and greatest depth [m], whether
            a measured one came after others at other depths, and whether pings are unusable.
        positions: Positions in order.
    """
    run = memory.get("run", np.append(np.full(7, np.nan), 0.0))
    east, north, began, number, least, most, fix, bad = run.tolist()
    names = "longitude", "latitude", "time", "depth", "dead_reckoned"
    runs = [(number, 0.0, least, most, fix, bad)]
    for *place, time, depth, reckoned in np.column_stack([positions[n] for n in names]).tolist():
        if place != [east, north]:
            (east, north), began, number, least, most, fix = place, time, 0, math.inf, -math.inf, 0
        # a depth that is not known changes neither
        number = number + 1
        least = depth if depth < least else least
        most = depth if depth > most else most
        moved = most - least > _FROZEN_DEPTH
        fix = fix or (moved and not reckoned and number > 1)
        bad = moved and time - began >= _FROZEN_TIME * 1e9 and number >= _FROZEN_FIXES
        runs.append((number, (time - began) * 1e-9, least, most, fix, bad))
    *_, fixes, bad_at = np.array(runs, np.float64).T.astype(np.bool_)

    def evidence(k: int) -> str:
        number, seconds, least, most, *_ = runs[k]
        return f"{number:.0f} positions over {seconds:.0f} s are equal to the last digit, from {least:.0f} to {most:.0f} m of depth"

    advice = "pings there are not used; check the receiver, or give dead-reckoned positions"
    found = positions.first(
        bad_at & ~fixes,
        REPEATED,
        evidence,
        "a vehicle without dead reckoning under water, which logs its last fix until the next one",
        advice,
        "warning",
    )
    cause = "a receiver without a fix that repeats its last one"
    found += positions.first(bad_at & fixes, FROZEN, evidence, cause, advice)
    run = np.array([east, north, began, number, least, most, fix, bad], np.float64)
    return {"run": run}, found, bad_at


def separate(memory: Memory, positions: Rows) -> Judged:
    """Check for positions of two missions beyond the reach of one vehicle.

    Only the latest connected positions out of reach of the first track are kept.

    Args:
        memory: ``last`` (1 or 2, 5), last position of the first track and of another out of its reach; ``number`` (2,) of positions in
            both.
        positions: Positions in order.
    """
    last = [Place(*each) for each in memory.get("last", np.empty((0, len(COLUMNS)))).tolist()]
    number, at, words = memory.get("number", np.zeros(2)).tolist(), -1, ""
    short = [*short_steps(positions.columns).tolist(), False]
    every = places(positions.columns)
    for i in range(len(positions)):
        if short[i] and short[i + 1] and len(last) == 1:
            # between short steps nothing is decided
            number[0] += 1
            continue
        here = every(i)
        if not last or (short[i] and len(last) == 1) or _is_reachable(last[0], here):
            last[:1], number[0] = [here], number[0] + 1
            continue
        goes_on = len(last) > 1 and _is_reachable(last[1], here)
        last[1:], number[1] = [here], number[1] + 1 if goes_on else 1
        if number[0] < _LEAST <= number[1]:
            # what came first was wrong fixes
            last, number = [here], [number[1], 0]
        elif number[1] >= _LEAST and at < 0:
            one, other = (
                f"{place_text(each.longitude, each.latitude)} at {time_text(int(each.time_ns))} (log {each.log:.0f})"
                for each in last
            )
            at, words = i, f"one vehicle cannot be at {one} and at {other}"
    found = positions.first(
        np.arange(len(positions)) == at,
        PLACES,
        lambda _: words,
        "a log of another mission, place or year, or a clock or receiver that was wrong for a time",
        "all are used; exclude logs of other missions, which replay-kit info shows",
    )
    return {"last": np.array(last, np.float64), "number": np.array(number)}, found


def _is_reachable(start: Place, end: Place) -> bool:
    """Return whether any vehicle can move from one position to another in the time between them."""
    seconds = abs(start.seconds(end))
    return seconds <= _LONGEST and start.way(end) <= _FAR + _FASTEST * seconds


class Passages(NamedTuple):
    """Passages from positions of one log to those of another.

    Attributes:
        number: Number of passages.
        beyond: Number of passages out of reach.
        example: Both positions of the last one out of reach.
    """

    number: int = 0
    beyond: int = 0
    example: tuple[Place, ...] = ()


@dataclass(frozen=True, slots=True)
class LogTracks:
    """Tracks of several logs so far.

    Attributes:
        last: Last position of any log; None before the first.
        fixes: Fix of each log from which the next speed is computed.
        speed: Greatest speed between fixes of one log [m/s]; 0 before two fixes.
        passages: Passages between logs by both numbers, the smaller first.
    """

    last: Place | None = None
    fixes: Mapping[int, Place] = field(default_factory=dict)
    speed: float = 0.0
    passages: Mapping[tuple[int, int], Passages] = field(default_factory=dict)

    def after(self, positions: Columns) -> "LogTracks":
        """Return the tracks after positions, columns ``COLUMNS``; repeated positions are ignored.

        Only the first, the last and speed-defining positions of a run of one log are used.
        """
        tracks, time, every = self, positions["time"], places(positions)
        ends = np.append(np.flatnonzero(np.diff(positions["input"])) + 1, len(time))
        measured, begin = ~positions["dead_reckoned"], 0
        for end in ends.tolist():
            at: int | None = begin
            while at is not None:
                tracks = tracks._after(every(at))
                fix = tracks.fixes.get(every(begin).log)
                since_ns = time[at] if fix is None else fix.time_ns + _LEAST_TIME * 1e9
                left = slice(at + 1, end)
                due = (measured[left] & (fix is None or time[left] >= since_ns)).nonzero()[0]
                at = int(due[0]) + at + 1 if due.size else None
            tracks, begin = tracks._after(every(end - 1)), end
        return tracks

    def _after(self, here: Place) -> "LogTracks":
        log = here.log
        fix, last, tracks = self.fixes.get(log), self.last, replace(self, last=here)
        if fix and (fix.longitude, fix.latitude) == (here.longitude, here.latitude):
            return self
        if not here.reckoned and (not fix or fix.seconds(here) >= _LEAST_TIME):
            shown = fix.way(here) / fix.seconds(here) if fix else 0.0
            speed = max(self.speed, shown)
            tracks = replace(tracks, fixes={**self.fixes, log: here}, speed=speed)
        if not last or last.log == log:
            return tracks
        pair = min(log, last.log), max(log, last.log)
        number, beyond, example = self.passages.get(pair, Passages())
        if not tracks._is_within_reach(last, here):
            beyond, example = beyond + 1, (last, here)
        passages = {**self.passages, pair: Passages(number + 1, beyond, example)}
        return replace(tracks, passages=passages)

    def _is_within_reach(self, start: Place, end: Place) -> bool:
        """Return whether one vehicle can move from one position to another in the time between them."""
        speed = min(self.speed, _FASTEST)
        fastest = min(max(_FASTER * speed, _LEAST_SPEED), _FASTEST) if speed else _FASTEST
        reached = _ERROR + _CLOCK * speed + fastest * abs(start.seconds(end))
        return start.way(end) <= reached

    @property
    def two_vehicles(self) -> Passages | None:
        """Passages between two logs that one vehicle cannot make; None if it can make all.

        Most passages of a log, or of all, must be out of reach: a temporary error of a receiver makes few.
        """
        found = list[Passages]()
        # -1 for all logs together: each of many short ones may have few passages
        for log in {-1, *chain(*self.passages)}:
            of_log = [each for pair, each in self.passages.items() if log in (*pair, -1)]
            beyond = sum(each.beyond for each in of_log)
            if beyond >= _LEAST_BEYOND and 2 * beyond > sum(each.number for each in of_log):
                found += of_log
        return max(found, key=lambda passages: passages.beyond, default=None)
