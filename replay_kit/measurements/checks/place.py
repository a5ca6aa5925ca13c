"""Checks of positions: one spot to the last digit in dives, positions out of reach, and places that no one vehicle can join.

A vehicle's steps are nearly all short: those that anything makes are passed over in one comparison of arrays, and the others are looked at
one by one.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.errors import Severity
from replay_kit.core.geodesy import distance
from replay_kit.core.text import place_text, time_text
from replay_kit.measurements.checks.fold import Found, Memory, Rows, first
from replay_kit.measurements.reach import COLUMNS, Place, places, short_steps

FROZEN = "frozen positions"
REPEATED = "the last fix repeated under water"
PLACES = "positions of several missions"
# s, m and positions for which an unchanged position is that of a dead receiver.
_FROZEN_TIME, _FROZEN_DEPTH, _FROZEN_FIXES = 600.0, 20.0, 4
# m and m/s: positions farther apart than a vehicle or a ship goes in the time between them, and by no small error; s between the
# positions of one mission at most; positions before which a place counts as one.
_FAR, _FASTEST, _LONGEST, _LEAST = 100e3, 10.0, 366 * 86_400.0, 5
# Degrees of latitude and of longitude at any latitude within which two places are certainly not so far apart.
_NEAR = 0.5


def frozen(memory: Memory, positions: Rows) -> tuple[Memory, list[Found], NDArray[np.bool_]]:
    """Return that a receiver repeats its position while the vehicle dives, and at which positions pings are not to be used, shape (n,).

    Args:
        memory: ``run`` (7,): longitude, latitude, number of positions, least and greatest depth [m], whether one that was measured came
            after others at other depths, and 0; ``time`` (2,) of the first and the last position of the run [ns, UTC].
        positions: In order.
    """
    n, bad = len(positions), np.zeros(len(positions), np.bool_)
    run, times = memory.get("run", np.full(6, np.nan)), memory.get("time", np.zeros(2, np.int64))
    place = np.column_stack([positions["longitude"], positions["latitude"]])
    before = np.concatenate([run[None, :2], place[:-1]])
    starts = np.flatnonzero((place != before).any(axis=1)).tolist()
    found, named = list[Found](), set[str]()
    for begin, end in zip([0, *starts], [*starts, n], strict=True):
        # shorter runs say nothing, but for what is remembered
        if begin == end or (end - begin < _FROZEN_FIXES and begin > 0 and end < n):
            continue
        at = slice(begin, end)
        if begin in starts:
            run, times = (
                np.array([*place[begin], 0.0, np.nan, np.nan, 0.0]),
                positions["time"][begin] * np.ones(2, np.int64),
            )
        depth = positions["depth"][at]
        with np.errstate(invalid="ignore"):
            least = np.fmin.accumulate(np.concatenate([run[3:4], depth]))[1:]
            most = np.fmax.accumulate(np.concatenate([run[4:5], depth]))[1:]
            moved = most - least > _FROZEN_DEPTH
        number = run[2] + np.arange(1, end - begin + 1)
        fix = moved & ~positions["dead_reckoned"][at].astype(np.bool_) & (number > 1)
        fix = np.logical_or.accumulate(np.concatenate([[run[5] > 0.0], fix]))[1:]
        long = positions["time"][at] - times[0] >= _FROZEN_TIME * 1e9
        bad[at] = moved & long & (number >= _FROZEN_FIXES)
        for name, holds in ((REPEATED, bad[at] & ~fix), (FROZEN, bad[at] & fix)):
            if (k := first(holds)) is not None and name not in named:
                named.add(name)
                span = (positions.time(begin + k) - int(times[0])) * 1e-9
                evidence = (
                    f"{number[k]:.0f} positions over {span:.0f} s are equal to the last digit "
                    f"while the vehicle moved between {least[k]:.0f} and {most[k]:.0f} m"
                )
                is_fix = name == FROZEN
                words = (
                    evidence,
                    "a receiver without a fix that repeats its last one"
                    if is_fix
                    else "a vehicle that does not reckon its way under water, and logs its last fix until the next one",
                    "pings at such positions are not used; check the receiver, or give the vehicle's dead-reckoned positions",
                )
                severity: Severity = "inconsistent" if is_fix else "warning"
                found.append(positions.found(begin + k, name, words, severity))
        run = np.array([*run[:2], number[-1], least[-1], most[-1], float(fix[-1])])
        times = np.array([times[0], positions["time"][end - 1]])
    return {"run": run, "time": times}, found, bad


def remembered(some: Sequence[Place]) -> dict[str, NDArray[Any]]:
    """Return positions as arrays that are remembered; ``places`` gives them back."""
    columns = list(zip(*some, strict=True)) or [()] * len(COLUMNS)
    kinds = (np.int64, np.float64, np.float64, np.bool_, np.int64)
    return {n: np.array(c, kind) for n, c, kind in zip(COLUMNS, columns, kinds, strict=True)}


def separate(memory: Memory, positions: Rows) -> tuple[Memory, list[Found]]:
    """Return that the positions are of two missions, between which no vehicle goes.

    Of positions that the first track does not reach only the latest that belong together are kept.

    Args:
        memory: Last positions of the first track, and of another that it does not reach, as of ``remembered``; ``number`` (2,) of both.
        positions: In order.
    """
    last, number = (
        places(memory) if memory else [],
        memory.get("number", np.zeros(2, np.int64)).tolist(),
    )
    found, short, all_places = (
        list[Found](),
        short_steps(positions.columns).tolist(),
        places(positions.columns),
    )
    for i, (here, quick) in enumerate(zip(all_places, short, strict=True)):
        if not last or (quick and len(last) == 1) or _goes(last[0], here):
            last[:1], number[0] = [here], number[0] + 1
            continue
        goes_on = len(last) > 1 and _goes(last[1], here)
        last[1:], number[1] = [here], number[1] + 1 if goes_on else 1
        if number[0] < _LEAST <= number[1]:
            # what came first was wrong fixes
            last, number = [here], [number[1], 0]
        elif number[1] >= _LEAST and not found:
            one, other = (_where(each) for each in last)
            words = (
                f"one vehicle was not at {one} and at {other}",
                "a log of another mission, place or year among the logs, or a clock or receiver that was wrong for a time",
                "all are used; replay-kit info shows where and when each log was recorded, exclude those of other missions",
            )
            found.append(positions.found(i, PLACES, words))
    return {**remembered(last), "number": np.array(number, np.int64)}, found


def _goes(start: Place, end: Place) -> bool:
    """Return whether any vehicle can have come from one position to another."""
    seconds = abs(start.seconds(end))
    if seconds > _LONGEST:
        return False
    if max(abs(start.latitude - end.latitude), abs(start.longitude - end.longitude)) < _NEAR:
        return True
    far = float(distance(start.longitude, start.latitude, end.longitude, end.latitude))
    return far <= _FAR + _FASTEST * seconds


def _where(place: Place) -> str:
    where = place_text(place.longitude, place.latitude)
    return f"{where} at {time_text(place.time_ns)} (log {place.log})"
