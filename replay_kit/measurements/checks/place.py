"""Checks of positions: one spot to the last digit in dives, positions out of reach, and places that no one vehicle can join."""

import math

import numpy as np

from replay_kit.core.arrays import Mask
from replay_kit.core.geodesy import distance
from replay_kit.core.text import place_text, time_text
from replay_kit.measurements.checks.fold import Found, Judged, Memory, Rows
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


def frozen(memory: Memory, positions: Rows) -> tuple[Memory, list[Found], Mask]:
    """Return that a receiver repeats its position while the vehicle dives, and at which positions pings are not to be used.

    The latter has shape (n + 1,), that of the last position before the first.

    Args:
        memory: ``run`` (8,) of equal positions: longitude, latitude, time of the first [ns], their number, least and greatest depth [m],
            whether one that was measured came after others at other depths, and whether pings are not to be used.
        positions: In order.
    """
    run = memory.get("run", np.append(np.full(7, np.nan), 0.0))
    east, north, began, number, least, most, fix, bad = run.tolist()
    names = "longitude", "latitude", "time", "depth", "dead_reckoned"
    runs = [(number, 0.0, least, most, fix, bad)]
    for *place, time, depth, reckoned in np.column_stack([positions[n] for n in names]).tolist():
        if place != [east, north]:
            (east, north), began, number, least, most, fix = place, time, 0, math.inf, -math.inf, 0
        # a depth that is not known changes neither
        number, least, most = number + 1, min(least, depth), max(most, depth)
        moved = most - least > _FROZEN_DEPTH
        fix = fix or (moved and not reckoned and number > 1)
        bad = moved and time - began >= _FROZEN_TIME * 1e9 and number >= _FROZEN_FIXES
        runs.append((number, (time - began) * 1e-9, least, most, fix, bad))
    *_, fixes, bad_at = np.array(runs, np.float64).T.astype(np.bool_)

    def evidence(k: int) -> str:
        number, seconds, least, most, *_ = runs[k]
        return f"{number:.0f} positions over {seconds:.0f} s are equal to the last digit while the vehicle moved between {least:.0f} and {most:.0f} m"

    advice = "pings at such positions are not used; check the receiver, or give the vehicle's dead-reckoned positions"
    found = positions.first(
        bad_at & ~fixes,
        REPEATED,
        evidence,
        "a vehicle that does not reckon its way under water, and logs its last fix until the next one",
        advice,
        "warning",
    )
    cause = "a receiver without a fix that repeats its last one"
    found += positions.first(bad_at & fixes, FROZEN, evidence, cause, advice)
    run = np.array([east, north, began, number, least, most, fix, bad], np.float64)
    return {"run": run}, found, bad_at


def separate(memory: Memory, positions: Rows) -> Judged:
    """Return that the positions are of two missions, between which no vehicle goes.

    Of positions that the first track does not reach only the latest that belong together are kept.

    Args:
        memory: ``last`` (1 or 2, 5), last position of the first track, and of another that it does not reach; ``number`` (2,) of both.
        positions: In order.
    """
    last = [Place(*each) for each in memory.get("last", np.empty((0, len(COLUMNS)))).tolist()]
    number, at, words = memory.get("number", np.zeros(2)).tolist(), -1, ""
    short = short_steps(positions.columns).tolist()
    for i, here in enumerate(places(positions.columns)):
        if not last or (short[i] and len(last) == 1) or _goes(last[0], here):
            last[:1], number[0] = [here], number[0] + 1
            continue
        goes_on = len(last) > 1 and _goes(last[1], here)
        last[1:], number[1] = [here], number[1] + 1 if goes_on else 1
        if number[0] < _LEAST <= number[1]:
            # what came first was wrong fixes
            last, number = [here], [number[1], 0]
        elif number[1] >= _LEAST and at < 0:
            one, other = (
                f"{place_text(each.longitude, each.latitude)} at {time_text(int(each.time_ns))} (log {each.log:.0f})"
                for each in last
            )
            at, words = i, f"one vehicle was not at {one} and at {other}"
    found = positions.first(
        np.arange(len(positions)) == at,
        PLACES,
        lambda _: words,
        "a log of another mission, place or year among the logs, or a clock or receiver that was wrong for a time",
        "all are used; replay-kit info shows where and when each log was recorded, exclude those of other missions",
    )
    return {"last": np.array(last, np.float64), "number": np.array(number)}, found


def _goes(start: Place, end: Place) -> bool:
    """Return whether any vehicle can have come from one position to another."""
    seconds = abs(start.seconds(end))
    if seconds > _LONGEST:
        return False
    if max(abs(start.latitude - end.latitude), abs(start.longitude - end.longitude)) < _NEAR:
        return True
    far = float(distance(start.longitude, start.latitude, end.longitude, end.latitude))
    return far <= _FAR + _FASTEST * seconds
