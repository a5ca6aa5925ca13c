"""Pairs of two measurements of one vector: profiles against mean currents, and against the platform's motion.

* ``current``: the mean along a dive's path of its own profiles, and its mean current. Profiles are averaged in cells of 10 m of depth; a
  dive of which they cover less than three quarters makes no pair: its mean current is of other water.
* ``vehicle``: both relative to the vehicle. Most of that is the vehicle's motion through water, which shows a compass that is wrong where
  the current itself is weak. A dive is one pair: its mean current has one error, however many profiles it has.
* ``blocks``: the same of profiles relative to a platform of unknown velocity, half an hour each, whose velocity dead reckoning limits.
* ``motion``: changes of the relative velocity and of minus the platform's velocity from ping to ping: the current changes less than both.
* ``track``: the platform's velocity as an instrument states it, and as the positions of the pings give it.

What explains the vectors relative to the vehicle (a compass, a mounting) is a rival of what explains the currents themselves (axes, a
scale, an offset). Where heading and current hardly change, several explain the pairs: nothing is then excluded, and the odds of all are
given.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.errors import Finding, Severity
from replay_kit.core.geodesy import metres_per_degree
from replay_kit.measurements.checks.fold import (
    Context,
    Found,
    Memory,
    Rows,
    carried,
    recalled,
    total,
)
from replay_kit.measurements.checks.likelihood import (
    CAUSES,
    KINDS,
    LEAST_GAIN,
    RELATIVE,
    TURNED,
    Complex,
    Explanation,
    causes,
    explanation,
    odds,
    tell_directions,
)
from replay_kit.measurements.checks.profile import SURFACE, UNIT, repairable
from replay_kit.measurements.checks.sensors import CLOCK, DEPTHS

COMPASS = "compass or instrument turned"
CONTRADICTION = "two sources of the current contradict each other"
UNDECIDED = "two sources of the current contradict each other, and the cause is not certain"
SCALE = "scale of the velocities"
OFFSET = "constant offset between two sources of the current"
DRIFT = "drift between two sources of the current"
MEANS = "mean currents"
RECKONED = "mean currents and dead reckoning contradict each other"
#: What two sources of the current may be found to be; while none of them is known to be right, the gate rejects neither.
OF_SOURCES = frozenset({CONTRADICTION, UNDECIDED, SCALE, OFFSET, DRIFT})
#: What explains what mean currents show, or says more.
KNOWN = (OF_SOURCES - {UNDECIDED}) | {COMPASS, MEANS, DEPTHS, CLOCK, SURFACE}
#: Pairs before which nothing is said: of mean currents, of dives relative to the vehicle, of the platform's motion, of a gross unit.
LEAST_MEANS, LEAST_DIVES, LEAST_MOTIONS, _LEAST_UNITS = 3, 2, 4, 2
# m/s, errors expected of a component: of a dive's mean, of its mean relative to the vehicle, of one block and of a change of motion.
_CURRENT_STD, _VEHICLE_STD, _MOTION_STD = 0.02, 0.035, 0.1
CURRENT_FLOOR, VEHICLE_FLOOR, MOTION_FLOOR = (
    2.0 * std**2 for std in (_CURRENT_STD, _VEHICLE_STD, _MOTION_STD)
)
# Log-likelihood ratio of a turn relative to the vehicle, the probability that the named cause has among all, and pairs from which on a
# contradiction is named without a cause, but with the odds of all.
_TURN_GAIN, _LIKELY, _ENOUGH = 7.0, 0.98, 6
# Scale from which no slip but that of a unit explains a ratio; shares below which a cause is not given, and from which rivals are not.
_GROSS, _LEAST_SHARE, _SURE = 8.0, 0.01, 0.99
# Pairs that are remembered: what is correlated over a long log is not more evidence without end. After how many more they are judged.
MOST, _JUDGED_FIRST, _JUDGED_EACH = 128, 4, 16
# Pings that are remembered for the mean currents to come, at least so many s apart; s, of a block of them, between positions that give a
# velocity at most and at least.
_PINGS, _APART, _BLOCK, _LONGEST, _SHORTEST = 1024, 10.0, 1800.0, 3600.0, 60.0
# m from the first bin, in which the water is that about the instrument; from a path within which profiles cover it; of it the share.
_NEAR, _COVERED, _LEAST_COVERED = 100.0, 100.0, 0.75
# Columns of pings that are remembered.
_COLUMNS = ("time", "longitude", "latitude", "near", "moves", "relative", "dive")
# m, and number, of the cells of depth in which a dive's profiles are averaged; dives of which they are remembered.
_CELL, _CELLS, _DIVES = 10.0, 700, 2
_HOUR_NS = 3.6e12
_NAMES = {"offset": OFFSET, "drift": DRIFT}
_OF_VEHICLE = " relative to the vehicle"
OF_MOTION = "changes of the measured velocity follow those of the platform's velocity"
OF_TRACK = "the platform's stated velocity contradicts that of its positions"
OF_MEANS = "relative to the vehicle, profiles contradict the mean currents of dives"
# What measurements.velocity_unit can be.
_STATED = ("knots", "cm/s", "mm/s")


def near_means(pings: Rows) -> Rows:
    """Return pings with a bin that is sound, or may be repaired, reduced to their bins near the instrument.

    Columns more are ``near``, the mean velocity of these, and ``moves``, the velocity of the platform that was added to it, NaN where that
    is not stated, both east + i north, shape (n,) [m/s]; and ``relative``, whether it is relative to a platform of unknown velocity.
    """
    good = repairable(pings)
    at = np.flatnonzero(good.any(axis=1))
    pings, good = pings.take(at), good[at]
    nearest = pings["depth"][np.arange(len(at)), np.argmax(good, axis=1)]
    close = good & (np.abs(pings["depth"] - nearest[:, None]) <= _NEAR)
    mean = total(np.where(close[..., None], pings["velocity"], 0.0)) / close.sum(axis=1)[:, None]
    platform, relative = pings["platform"], ~np.isfinite(pings["common_std"])
    return pings.having(near=_complex(mean), moves=_complex(platform), relative=relative)


def _complex(vectors: Array) -> Complex:
    """Return vectors, shape (n, 2), as numbers."""
    return np.asarray(vectors[:, 0] + 1j * vectors[:, 1])


def ways(start: Rows, end: Rows) -> Complex:
    """Return the velocities over ground from one ping to another each, shape (n,) [m/s]; NaN at one time, or over more than an hour."""
    seconds, latitude = (end["time"] - start["time"]) * 1e-9, start["latitude"]
    scale = np.array([metres_per_degree(one) for one in latitude.tolist()]).reshape(-1, 2)
    degrees = (end["longitude"] - start["longitude"] + 180.0) % 360.0 - 180.0
    known = (seconds > 0.0) & (seconds <= _LONGEST)
    way = scale[:, 0] * degrees + 1j * scale[:, 1] * (end["latitude"] - latitude)
    return np.where(known, way / np.where(known, seconds, 1.0), np.nan)


def pairs_of(a: Complex, b: Complex, weight: float, time: NDArray[np.int64]) -> Array:
    """Return pairs of vectors as rows of shape (n, 6): east and north of both, weight, hours since 1970."""
    columns = [a.real, a.imag, b.real, b.imag, np.full(len(a), weight), time / _HOUR_NS]
    return np.column_stack(columns)


def moved(memory: Memory, pings: Rows, context: Context) -> tuple[Memory, list[Found]]:
    """Return what changes of motion, and the platform's stated velocity beside that of its positions, establish.

    Args:
        memory: The ping from which the next motion is counted, by its columns; ``before`` (2,), relative velocity and the platform's at
            the one before it, NaN without; ``motion`` and ``track`` (up to 128, 6), pairs; ``count`` (2,) of both so far.
        pings: Of one instrument.
        context: Says whether positions under water are dead-reckoned without a current.
    """
    both, at, last_ns = recalled(memory, near_means(pings), *_COLUMNS), list[int](), None
    for i, now in enumerate(both["time"].tolist()):
        # closer positions have too few digits for a velocity
        if last_ns is None or not 0 <= now - last_ns < _SHORTEST * 1e9:
            at.append(i)
            last_ns = now
    chain = both.take(np.array(at, np.intp))
    last = {name: chain[name][-1:] for name in _COLUMNS}
    if len(at) < 2:
        return {**memory, **last}, []
    start, end = chain.take(slice(0, -1)), chain.take(slice(1, None))
    over_ground = ways(start, end)
    known, stated = ~np.isnan(over_ground), ~np.isnan(start["moves"])
    platform = np.where(stated, start["moves"], over_ground)
    is_told = known & ~start["relative"] & (not context.through_water)
    relative = np.where(is_told, start["near"] - platform, np.nan)
    before = memory.get("before", np.full(2, np.nan + 0j))
    changes = np.diff(relative, prepend=before[:1]), -np.diff(platform, prepend=before[1:])
    found, after, count = (
        list[Found](),
        dict(memory),
        memory.get("count", np.zeros(2, np.int64)).copy(),
    )
    judged = list[tuple[int, int, str, Array]]()
    for k, (name, (a, b), told) in enumerate(
        (
            ("motion", changes, ~np.isnan(changes[0])),
            ("track", (platform, over_ground), known & stated),
        )
    ):
        rows = np.flatnonzero(told)
        # neighbouring changes share a ping
        pairs = carried(memory, name, pairs_of(a[rows], b[rows], 0.5, start["time"][rows]), MOST)
        for j, place in enumerate(rows.tolist(), len(pairs) - len(rows) + 1):
            count[k] += 1
            if count[k] % (_JUDGED_FIRST if count[k] <= 2 * _JUDGED_EACH else _JUDGED_EACH) == 0:
                judged.append((place, k, name, pairs[max(j - MOST, 0) : j]))
        after[name] = pairs[-MOST:]
    for place, _, name, latest in sorted(judged, key=lambda one: one[:2]):
        event, said = int(end.event[place]), {each.event for each in found}
        finding = None if event in said else _of_motion(end, place, name, latest, context, found)
        found += [] if finding is None else [finding]
    return {
        **after,
        **last,
        "before": np.array([relative[-1], platform[-1]]),
        "count": count,
    }, found


def _of_motion(
    end: Rows, place: int, name: str, latest: Array, context: Context, found: Sequence[Found]
) -> Found | None:
    """Return what pairs of motion establish with a ping: a turn, or a scale of the stated velocity."""
    named = context.known(end.instrument) | {each.finding.name for each in found}
    event, time_ns = int(end.event[place]), end.time(place)
    turned = None if COMPASS in named else explanation(latest, MOTION_FLOOR, TURNED, LEAST_MOTIONS)
    if turned is not None:
        what = OF_MOTION if name == "motion" else OF_TRACK
        return Found(event, turned_finding(turned, latest, what, time_ns, end.topic))
    if name == "motion" or OF_SOURCES & named or (scale := _scale_of_motion(latest)) is None:
        return None
    return Found(event, _scaled_motion(scale, latest, time_ns, end.topic), OF_SOURCES)


def _scale_of_motion(track: Array) -> Explanation | None:
    """Return the scale of a stated motion beside that of positions, once it is likelier than all else; positions may lack the current."""
    explained = explanation(track, MOTION_FLOOR, ("scale",), LEAST_MOTIONS)
    if explained is None:
        return None
    cause, share = odds(causes(track, MOTION_FLOOR, KINDS, LEAST_MOTIONS))[0]
    return explained if cause == CAUSES["scale"] and share >= _LIKELY else None


def dives_of(memory: Memory, pings: Rows) -> Memory:
    """Return the sums of the sound bins of the latest dives in cells of depth.

    Args:
        memory: ``dives`` (2,), numbers of the latest dives, -1 for none; ``sums`` (2, 700, 4) over the bins of each dive in each cell:
            their number, east, north [m/s] and depth [m].
        pings: Of one topic, in order.
    """
    dives = memory.get("dives", np.full(_DIVES, -1))
    sums = memory.get("sums", np.zeros((_DIVES, _CELLS, 4)))
    absolute = np.isfinite(pings["common_std"]) & (pings["dive"] > 0)
    good = repairable(pings) & absolute[:, None]
    for dive in np.unique(pings["dive"][good.any(axis=1)]).tolist():
        if dive not in dives:
            dives = np.append(dives[1:], dive)
            sums = np.concatenate([sums[1:], np.zeros((1, _CELLS, 4))])
        rows, bins = np.nonzero(good & (pings["dive"] == dive)[:, None])
        depth, velocity = pings["depth"][rows, bins], pings["velocity"][rows, bins]
        cell = np.clip(depth / _CELL, 0, _CELLS - 1).astype(np.int64)
        values = np.column_stack([np.ones(len(cell)), velocity, depth])
        sums = sums.copy()
        # one bin after the other, so that sums do not depend on where blocks end
        np.add.at(sums[int(np.flatnonzero(dives == dive)[0])], cell, values)
    return {"dives": dives, "sums": sums}


def along(memory: Memory, near: Rows, mean: Rows, at: int) -> complex | None:
    """Return the mean of profiles along the path of a mean current [m/s]; None where they cover too little of it.

    Args:
        memory: As of ``dives_of``.
        near: Pings over the time of the path that are not relative.
        mean: Mean currents.
        at: Which of them.
    """
    number = int(mean["points"][at])
    depth, weight = mean["path_depth"][at, :number], mean["weight"][at, :number]
    numbers = near["dive"][near["dive"] > 0]
    if not len(numbers):
        return None
    dive = np.bincount(numbers).argmax()
    sums = memory["sums"][memory["dives"] == dive].reshape(-1, 4)
    sums = sums[sums[:, 0] > 0]
    if not len(sums):
        return None
    east_north, z = sums[:, 1:3] / sums[:, :1], sums[:, 3] / sums[:, 0]
    after = np.clip(np.searchsorted(z, depth), 0, len(z) - 1)
    apart = np.minimum(np.abs(z[after] - depth), np.abs(z[np.maximum(after - 1, 0)] - depth))
    covered = np.where(apart <= _COVERED, weight, 0.0)
    east, north = (np.interp(depth, z, each) for each in east_north.T)
    if (share := float(covered.sum())) < _LEAST_COVERED:
        return None
    return complex(float(east @ covered), float(north @ covered)) / share


def compared(
    memory: Memory, near: Rows, mean: Rows, at: int, through_water: bool
) -> dict[str, Array]:
    """Return the pairs that a mean current makes with the pings before it: ``current``, ``vehicle`` and ``blocks``.

    Args:
        memory: As of ``dives_of``.
        near: The latest pings of one instrument until it came.
        mean: Mean currents.
        at: Which of them.
        through_water: Whether positions under water are dead-reckoned without a current.
    """
    begin, end = mean["path_time"][at, 0], mean["path_time"][at, mean["points"][at] - 1]
    during = near.take((near["time"] >= begin) & (near["time"] <= end))
    absolute, relative = during.take(~during["relative"]), during.take(during["relative"])
    velocity, began = complex(*mean["velocity"][at].tolist()), np.array([begin])
    # without a current in the positions these are the way through water
    more = velocity if through_water else 0.0
    found = {name: np.empty((0, 6)) for name in ("current", "vehicle", "blocks")}
    profile = along(memory, absolute, mean, at)
    if profile is not None:
        found["current"] = pairs_of(np.array([profile]), np.array([velocity]), 1.0, began)
        if moves := _blocks(absolute):
            platform = sum(way + more for _, way in moves) / len(moves)
            own = [
                np.where(np.isnan(each["moves"]), way + more, each["moves"]) for each, way in moves
            ]
            beside = np.array([profile - complex(np.concatenate(own).mean())])
            found["vehicle"] = pairs_of(beside, np.array([velocity - platform]), 1.0, began)
    if moves := _blocks(relative):
        found["blocks"] = pairs_of(
            np.array([complex(block["near"].mean()) for block, _ in moves]),
            np.array([velocity - way - more for _, way in moves]),
            0.5,
            np.array([block.time(0) for block, _ in moves]),
        )
    return found


def _blocks(near: Rows) -> list[tuple[Rows, complex]]:
    """Return pings in blocks of half an hour from the first one, each with the velocity over ground, where that is known."""
    found, start, times = list[tuple[Rows, complex]](), 0, near["time"]
    while start < len(times):
        late = np.flatnonzero(times[start:] - times[start] > _BLOCK * 1e9)
        end = start + int(late[0]) if late.size else len(times)
        block = near.take(slice(start, end))
        (way,) = ways(block.take(slice(0, 1)), block.take(slice(-1, None)))
        found += [] if np.isnan(way) else [(block, complex(way))]
        start = end
    return found


def beside_means(
    memory: Memory, pings: Rows | None, context: Context, absent: tuple[str, str] = ("", "")
) -> tuple[Memory, list[Found]]:
    """Return what mean currents establish beside the profiles of one instrument.

    Args:
        memory: As of ``dives_of``; the latest pings, up to 1024, by their columns; ``current``, ``vehicle`` and ``blocks`` (up to 128, 6),
            pairs.
        pings: Of one instrument; None without.
        context: Has the mean currents.
        absent: Name and topic of the instrument where it has no pings.
    """
    name, topic = absent if pings is None else (pings.instrument, pings.topic)
    means, known = context.means, bool(KNOWN & context.known(name))
    after, start, found = dict(memory), 0, list[Found]()
    near = _apart(memory, none_of(memory) if pings is None else near_means(pings))
    for at in range(len(means)):
        event = int(means.event[at])
        if pings is not None:
            end = int(np.searchsorted(pings.event, event))
            after |= dives_of(after, pings.take(slice(start, end)))
            start = end
        until = near.until(event, _PINGS)
        for kind, new in compared(after, until, means, at, context.through_water).items():
            after[kind] = np.concatenate([after.get(kind, new[:0]), new])[-MOST:]
        finding = None if known else cause_of_pairs(after, means.time(at), topic)
        if finding is not None:
            found.append(Found(event, finding, KNOWN, of_believed=True))
    if pings is not None:
        after |= dives_of(after, pings.take(slice(start, None)))
    return {**after, **{column: near[column][-_PINGS:] for column in _COLUMNS}}, found


def none_of(memory: Memory) -> Rows:
    """Return no pings, with the columns of those that are remembered."""
    none = np.empty(0, np.int64)
    return Rows("", none, none, {name: memory[name][:0] for name in _COLUMNS})


def _apart(memory: Memory, new: Rows) -> Rows:
    """Return pings that are remembered and those of the new ones that are some seconds after the last one."""
    held = memory.get("time", np.empty(0, np.int64))
    chosen, last_ns = list[int](), int(held[-1]) if len(held) else None
    for i, now in enumerate(new["time"].tolist()):
        if last_ns is None or abs(now - last_ns) >= _APART * 1e9:
            chosen.append(i)
            last_ns = now
    return recalled(memory, new.take(np.array(chosen, np.intp)), *_COLUMNS)


def cause_of_pairs(pairs: Memory, mean_time_ns: int, topic: str) -> Finding | None:
    """Return what a mean current established: of all causes the likeliest, once it is likely enough or there are many pairs.

    Args:
        pairs: ``current``, ``vehicle`` and ``blocks``, shapes (up to 128, 6).
        mean_time_ns: Of the mean current [ns, UTC].
        topic: Of the profiles.
    """
    current, vehicle, blocks = (pairs[name] for name in ("current", "vehicle", "blocks"))
    turned = explanation(blocks, MOTION_FLOOR, TURNED, LEAST_MOTIONS)
    if turned is not None:
        return turned_finding(turned, blocks, OF_MEANS, mean_time_ns, topic)
    if not any(
        explanation(each, floor, kinds, least, gain)
        for each, floor, kinds, least, gain in (
            (current, CURRENT_FLOOR, KINDS, _LEAST_UNITS, LEAST_GAIN),
            (vehicle, VEHICLE_FLOOR, RELATIVE, LEAST_DIVES, _TURN_GAIN),
        )
    ):
        return None
    found = causes(current, CURRENT_FLOOR, KINDS, LEAST_MEANS)
    for cause, gain in causes(vehicle, VEHICLE_FLOOR, RELATIVE, LEAST_DIVES).items():
        # a scale is one, whatever it is relative to
        name = cause if cause == CAUSES["scale"] else f"{cause}{_OF_VEHICLE}"
        found[name] = float(np.logaddexp(found.get(name, -math.inf), gain))
    rivals = odds(found)
    if not rivals:
        return None
    cause, share = rivals[0]
    if cause.endswith(_OF_VEHICLE):
        best, of = explanation(vehicle, VEHICLE_FLOOR, TURNED, LEAST_DIVES, _TURN_GAIN), vehicle
        # what excludes an instrument must be certain
        if best is not None and share >= _LIKELY:
            return turned_finding(best, vehicle, OF_MEANS, mean_time_ns, topic)
    else:
        best, of = _best(current, vehicle, cause)
    if best is None:
        return None
    kinds = ("offset", "drift") if best.kind in ("scale", "unit") else ("scale",)
    if best.kind not in TURNED and not best.is_unit:
        # what excludes a scale or an offset must be what the other leaves, not that its size is not known before
        fits = causes(current, CURRENT_FLOOR, kinds, LEAST_MEANS, by_fit=True)
        rivals = odds({one: max(gain, fits.get(one, gain)) for one, gain in found.items()})
        share = dict(rivals)[cause]
    if share < _LIKELY and best.pairs < _ENOUGH:
        return None
    since_ns = _since(best, of, mean_time_ns)
    if share < _LIKELY:
        return _undecided(best, rivals, since_ns, topic)
    return _of_sources(best, rivals, since_ns, topic)


def _best(current: Array, vehicle: Array, cause: str) -> tuple[Explanation | None, Array]:
    """Return the best explanation of a cause, and the pairs that it is of; two pairs tell a gross unit alone."""
    if cause != CAUSES["scale"]:
        kinds = [kind for kind in KINDS if CAUSES[kind] == cause]
        return explanation(current, CURRENT_FLOOR, kinds, LEAST_MEANS), current
    best = explanation(current, CURRENT_FLOOR, ("scale",), _LEAST_UNITS)
    if best is not None and best.pairs < LEAST_MEANS and not best.is_unit:
        best = None
    relative = explanation(vehicle, VEHICLE_FLOOR, ("unit",), LEAST_MEANS)
    if relative is not None and (best is None or relative.gain > best.gain):
        return relative, vehicle
    return best, current


def _since(explained: Explanation, pairs: Array, time_ns: int) -> int:
    """Return since when something explains pairs [ns, UTC], or a time where it explains all."""
    return round(pairs[explained.since, 5] * _HOUR_NS) if explained.since else time_ns


def turned_finding(
    explained: Explanation, pairs: Array, what: str, time_ns: int, topic: str
) -> Finding:
    """Return the finding of an instrument that is turned.

    Args:
        explained: How.
        pairs: Of what.
        what: In words.
        time_ns: With which it was established [ns, UTC].
        topic: Of the pings.
    """
    return Finding(
        COMPASS,
        _since(explained, pairs, time_ns),
        f"{topic}: {what}; relative to the vehicle the profiles look {explained.names} ({explained.strength})",
        "the compass, the sign of the heading or of the declination, the order of the beams, or how the instrument is mounted; "
        "of a DVL its axes, where forward, left and up are taken for forward, starboard and down (measurements.dvl_axes)",
        "its profiles are not used, the estimate is rebuilt without them; correct the instrument's settings and replay again",
        distrusts=True,
    )


def _scaled_motion(explained: Explanation, pairs: Array, time_ns: int, topic: str) -> Finding:
    return Finding(
        SCALE,
        _since(explained, pairs, time_ns),
        f"{topic}: beside that of its positions the platform's stated velocity looks {explained.names} ({explained.strength})",
        "a wrong unit or scale of the platform's velocity, and of the profiles that it is in",
        "state measurements.velocity_unit, or correct the platform's velocity",
    )


def of_reckoning(explained: Explanation, pairs: Array, time_ns: int, topic: str) -> Finding:
    """Return the finding of mean currents with a slip of axes or signs beside those that fixes and dead-reckoned positions give."""
    return Finding(
        RECKONED,
        _since(explained, pairs, time_ns),
        f"{topic}: beside fixes and dead-reckoned positions the mean currents look {explained.names} ({explained.strength})",
        "the axes or signs of the mean currents",
        'check which variable is east; withhold them (--without dac), or compute them (measurements.dead_reckoning = "through_water")',
    )


def _undecided(
    best: Explanation, rivals: Sequence[tuple[str, float]], since_ns: int, topic: str
) -> Finding:
    return Finding(
        UNDECIDED,
        since_ns,
        f"profiles of {topic} and mean currents of dives: {best.pairs} pairs are not of one current (likelihood ratio e^{best.gain:.0f})",
        f"not known yet, as the current and the heading hardly change; {_odds(rivals)}",
        "the gate is relaxed for both; check both, and withhold the wrong one (--without dac, or profiles)",
    )


def _of_sources(
    best: Explanation, rivals: Sequence[tuple[str, float]], since_ns: int, topic: str
) -> Finding:
    """Return the finding of profiles and mean currents, or drifts, of which either may be wrong."""
    severity: Severity = "inconsistent"
    if best.kind in TURNED:
        name, evidence = (
            CONTRADICTION,
            f"profiles of {topic} and mean currents of dives: the profiles look {best.names}",
        )
        cause = "the axes or signs of the profiles, or those of the mean currents of dives"
        advice = "the gate is relaxed for both; check their frames and withhold the wrong one (--without dac, or profiles)"
    elif best.kind in ("scale", "unit"):
        size = abs(best.value)
        gross = size >= _GROSS
        name, severity = (UNIT, "unusable") if gross else (SCALE, severity)
        evidence = f"{topic}: the profiles are {size:.3g} (x/ {math.exp(best.spread):.2f}) times as fast as the mean currents of dives"
        cause = "a wrong unit or scale of the profiles, or of the mean currents of dives"
        units = [unit for unit in (best.slip, *best.alike) if unit]
        if units:
            of = "velocities" if size > 1.0 else "mean currents of dives"
            cause = f"the {of} are in {' or '.join(dict.fromkeys(units))}, taken for m/s"
        stated = f' = "{best.slip}"' if best.slip in _STATED and size > 1.0 else ""
        advice = f"state measurements.velocity_unit{stated}, or check both sources"
    else:
        name, unit = _NAMES[best.kind], "m/s" if best.kind == "offset" else "m/s an hour"
        east, north = best.value.real, best.value.imag
        evidence = f"profiles of {topic} less mean currents of dives: {east:+.3f} east, {north:+.3f} north {unit}"
        cause = "the velocity of the platform that is in the profiles, an instrument's offset, or the flight model behind the mean currents of dives"
        advice = "the gate is relaxed for both; check both, and withhold the wrong one (--without dac, or profiles)"
    if rivals[0][1] < _SURE:
        cause = f"{cause}; {_odds(rivals)}"
    return Finding(name, since_ns, f"{evidence} ({best.strength})", cause, advice, severity)


def _odds(rivals: Sequence[tuple[str, float]]) -> str:
    chances = (f"{one} {100.0 * share:.0f} %" for one, share in rivals if share >= _LEAST_SHARE)
    return f"odds of the causes: {', '.join(chances)}"


def show_directions(memories: Mapping[tuple[str, str], Memory], topic: str) -> bool:
    """Return whether pairs of an instrument would show wrong directions."""
    held = {**memories.get(("means", topic), {}), **memories.get(("motion", topic), {})}
    return any(
        name in held and tell_directions(held[name], floor, least)
        for name, floor, least in (
            ("current", CURRENT_FLOOR, LEAST_MEANS),
            ("vehicle", VEHICLE_FLOOR, LEAST_DIVES),
            ("blocks", MOTION_FLOOR, LEAST_MOTIONS),
            ("motion", MOTION_FLOOR, LEAST_MOTIONS),
            ("track", MOTION_FLOOR, LEAST_MOTIONS),
        )
    )
