"""Positions out of the vehicle's reach: single outliers, or a permanent displacement.

A position out of reach waits for later ones. If one of them is within reach again, the waiting ones are outliers and excluded; five
consecutive ones move the vehicle there. A fix is compared with the previous dead-reckoned position, given the accuracy of earlier ones, or
with the previous fix.
"""

import math
from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Mask
from replay_kit.core.errors import Finding
from replay_kit.core.geodesy import metres_per_degree
from replay_kit.core.observation.table import Columns, chosen_rows
from replay_kit.measurements.track.positions import NEVER, appended, no_rows

DISPLACED = "displaced positions"
#: Why messages of positions are not used.
THROWN = "position out of the vehicle's reach"
# s and degrees; from one position to the next of its kind, within which a vehicle always reaches it.
_STEP_TIME, _STEP = 59.0, 0.001
# m, m/s and s: error of two positions, the least and the greatest speed that a vehicle reaches, how many times as fast as its steps so
# far, and the longest time over which it is judged.
_ERROR, _SLOWEST, _FASTEST, _FASTER, _LONGEST = 300.0, 2.0, 30.0, 4.0, 6 * 3600.0
# m; by how much a fix may put right what was dead-reckoned for hours.
_MOVED = 15e3
# Positions in a row that show where the vehicle is, steps and gaps that are remembered, and gaps that show how well positions are reckoned.
_LEAST, _REMEMBERED, _LEAST_GAPS = 5, 32, 3
# Thrown positions that are remembered; ns, by which the time of one that is stated elsewhere may differ.
_KEPT, _SAME_TIME = 8, 60 * 10**9
COLUMNS = ("time", "longitude", "latitude", "dead_reckoned", "input")


class Place(NamedTuple):
    """Position: time [ns, UTC], longitude, latitude [degrees], whether it was dead-reckoned, and log."""

    time_ns: int
    longitude: float
    latitude: float
    reckoned: bool
    log: int

    def seconds(self, other: "Place") -> float:
        """Return the time to another position [s]."""
        return (other.time_ns - self.time_ns) * 1e-9

    def way(self, other: "Place") -> float:
        """Return the distance to another position [m], to a few percent."""
        east, north = metres_per_degree(0.5 * (self.latitude + other.latitude))
        degrees = (other.longitude - self.longitude + 180.0) % 360.0 - 180.0
        return math.hypot(east * degrees, north * (other.latitude - self.latitude))


def places(rows: Columns) -> Callable[[int], Place]:
    """Return a function that returns a position by index."""
    columns = [rows[name].tolist() for name in COLUMNS]
    return lambda k: Place(*[column[k] for column in columns])


def short_steps(rows: Mapping[str, NDArray[Any]]) -> Mask:
    """Return whether the previous position is of the same log and kind, recent and near, shape (n,)."""
    step = {name: np.diff(rows[name], prepend=rows[name][:1]) for name in COLUMNS}
    seconds = step["time"] * 1e-9
    short = (seconds > 0.0) & (seconds < _STEP_TIME)
    short &= (np.abs(step["longitude"]) < _STEP) & (np.abs(step["latitude"]) < _STEP)
    return np.asarray(short & (step["dead_reckoned"] == 0) & (step["input"] == 0))


class Reach(NamedTuple):
    """State of the positions of the vehicle.

    Attributes:
        last: Last position within reach.
        fix: Last measured position.
        speeds: Speeds of the latest steps [m/s].
        gaps: Errors of dead-reckoned positions at the next fixes [m].
        held: Waiting rows.
        number: Number of positions within reach.
        doubted: Excluded and waiting positions: ``time``, ``longitude``, ``latitude``, and the interval of the stream, ``order`` to
            ``until``, in which they do not count.
    """

    last: Place | None = None
    fix: Place | None = None
    speeds: tuple[float, ...] = ()
    gaps: tuple[float, ...] = ()
    held: Columns = no_rows()
    number: int = 0
    doubted: Columns = no_rows() | {"until": np.empty(0, np.int64)}

    def doubts(self, fix: tuple[int, float, float], at: int) -> bool:
        """Return whether a fix, time [ns], longitude and latitude [degrees], is excluded at a position in the stream."""
        doubted, (time_ns, longitude, latitude) = self.doubted, fix
        same = np.abs(doubted["time"] - time_ns) <= _SAME_TIME
        same &= np.hypot(doubted["longitude"] - longitude, doubted["latitude"] - latitude) <= _STEP
        return bool((same & (doubted["order"] <= at) & (at < doubted["until"])).any())

    @property
    def fastest(self) -> float:
        """Greatest speed of the vehicle [m/s], from the upper quartile of its speeds, as a vessel also keeps station."""
        usual = sorted(self.speeds)[3 * len(self.speeds) // 4] if self.speeds else _FASTEST
        return min(max(_FASTER * usual, _SLOWEST), _FASTEST)

    def reaches(self, start: Place, end: Place) -> bool:
        """Return whether the vehicle can move from one position to another in the time between them."""
        error = _ERROR
        if start.reckoned and not end.reckoned:
            if len(self.gaps) < _LEAST_GAPS:
                return self.fix is None or self.reaches(self.fix, end)
            error += _FASTER * sorted(self.gaps)[len(self.gaps) // 2]
        return start.way(end) <= error + self.fastest * abs(start.seconds(end))

    def on(self, here: Place) -> "Reach":
        """Return the state after a position; another log, the past or a pause do not change the speeds."""
        last, speeds, gaps = self.last, self.speeds, self.gaps
        fix, number = None if here.reckoned else here, self.number + 1
        if last is None or last.log != here.log:
            return Reach(here, fix, number=1)
        seconds = last.seconds(here)
        if seconds > _LONGEST:
            return self._replace(last=here, fix=fix, number=number)
        if seconds >= 60.0:
            speeds = (*speeds, last.way(here) / seconds)[-_REMEMBERED:]
        if last.reckoned and not here.reckoned:
            gaps = (*gaps, max(last.way(here) - self.fastest * seconds, 0.0))[-_REMEMBERED:]
        return self._replace(
            last=here, fix=fix or self.fix, speeds=speeds, gaps=gaps, number=number
        )


def within_reach(
    before: Reach, positions: Columns, ends: bool
) -> tuple[Reach, Columns, Mask, list[tuple[int, Finding]]]:
    """Return the state, positions, which of them count, and findings with their positions in the stream.

    ``order`` is the position in the stream of the deciding message.

    Args:
        before: State before the rows.
        positions: Rows in order.
        ends: Whether the log ends with them; a single waiting position, or a distant one, is then excluded.
    """
    rows = appended(before.held, positions)
    every, order, quick = places(rows), rows["order"].copy(), short_steps(rows)
    state, found, use = before, list[tuple[int, Finding]](), np.ones(len(order), np.bool_)
    i = len(before.held["order"])
    held, turns = list(range(i)), np.append(np.flatnonzero(~quick), len(order))
    far_off = [k for k in held if state.last and state.last.way(every(k)) >= _MOVED]

    def settle(used: bool) -> None:
        """Decide on the waiting positions."""
        order[held], use[held] = order[i], used
        held.clear()

    while i < len(order):
        last, here = state.last, every(i)
        if last is not None and quick[i] and not held and last == every(i - 1):
            # the vehicle makes such steps anyway
            i = int(turns[np.searchsorted(turns, i)])
            here = every(i - 1)
            fix = state.fix if here.reckoned else here
            state = state._replace(last=here, fix=fix, number=state.number + 1)
            continue
        if last is None or last.log != here.log or last.seconds(here) > _LONGEST:
            settle(True)
            state = state.on(here)
        elif last.seconds(here) <= 0.0 and last.reckoned != here.reckoned:
            pass
        elif state.reaches(last, here):
            # the vehicle goes on from where it was held, if the track may pass there
            comes_back = bool(held) and not state.reaches(every(held[-1]), here)
            if comes_back:
                far = max(last.way(every(k)) for k in held)
                found.append((int(order[i]), _displaced(every(held[0]), far, len(held))))
            settle(not comes_back)
            state = state.on(here)
        elif state.number < _LEAST:
            # nothing tells yet which of them was wrong
            state = Reach(here, None if here.reckoned else here, number=state.number + 1)
        else:
            before_it = every(held[-1]) if held else here
            if before_it.way(here) > _ERROR + _FASTEST * abs(before_it.seconds(here)):
                settle(False)
            held.append(i)
            if last.way(here) >= _MOVED:
                far_off.append(i)
            if len(held) == _LEAST:
                far = last.way(every(held[0]))
                if far >= _MOVED:
                    found.append((int(order[i]), _displaced(every(held[0]), far, 0)))
                # what it did before says no more how fast it is
                steps = pairwise(map(every, held))
                speeds = tuple(a.way(b) / max(a.seconds(b), 1.0) for a, b in steps)
                settle(True)
                state = Reach(here, None, speeds, state.gaps, number=_LEAST)
        i += 1
    if ends:
        # several that agree are where it came up, if not too far away
        use[[k for k in held if len(held) < 2 or k in far_off]] = False
        held.clear()
    waits = np.isin(np.arange(len(order)), held)
    until = np.where(use & ~waits, order, NEVER)
    # one that may put right what was dead-reckoned for hours is believed while it waits
    near = (use | waits) & ~np.isin(np.arange(len(order)), far_off)
    late, known = (until > rows["order"]) & ~near, before.doubted
    thrown = (known["until"] == NEVER) & ~np.isin(known["order"], before.held["order"])
    held_on = chosen_rows(chosen_rows(known, thrown), slice(-_KEPT, None))
    doubted = appended(held_on, chosen_rows(rows | {"until": until}, late))
    state = state._replace(doubted=doubted)
    rows["order"] = order
    at = np.flatnonzero(~waits)
    at = at[np.argsort(order[at], kind="stable")]
    return state._replace(held=chosen_rows(rows, waits)), chosen_rows(rows, at), use[at], found


def _displaced(first: Place, far: float, thrown: int) -> Finding:
    """Return the finding of excluded outliers or, with none, of a permanent displacement [m]."""
    cause = "a receiver or clock that errs, a wrong datum, or positions of another vehicle"
    evidence = f"the track goes on {far / 1e3:.3g} km away, farther than the vehicle reaches, and does not come back"
    advice = "check the receiver, and give a log with the right positions"
    if not thrown:
        return Finding(DISPLACED, first.time_ns, evidence, cause, advice, "inconsistent")
    evidence = f"{thrown} in a row are up to {far / 1e3:.3g} km out of the vehicle's reach, then it comes back"
    advice = "they are not used; check the receiver"
    return Finding(DISPLACED, first.time_ns, evidence, cause, advice, "warning")
