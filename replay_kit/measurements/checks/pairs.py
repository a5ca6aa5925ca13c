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
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.errors import Finding, Severity
from replay_kit.core.geodesy import metres_per_degree
from replay_kit.measurements.checks.fold import Context, Found, Memory, Rows, carried, total
from replay_kit.measurements.checks.likelihood import (
    CAUSES,
    KINDS,
    LEAST_GAIN,
    RELATIVE,
    TURNED,
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


class Near(NamedTuple):
    """Pings, each reduced to its bins near the instrument.

    Attributes:
        time: shape (n,) [ns, UTC].
        event: shape (n,), place of each in ``Block.events``; -1 of those that are remembered.
        value: shape (n, 9): longitude, latitude [degrees], depth of the bin nearest to the instrument [m], mean velocity east and north
            [m/s], that of the platform that was added to it, NaN where it is not stated, whether the mean is relative to a platform whose
            velocity is not stated, and the dive.
    """

    time: NDArray[np.int64]
    event: NDArray[np.int64]
    value: Array

    def take(self, at: NDArray[np.generic] | slice) -> "Near":
        """Return some of them."""
        return Near(self.time[at], self.event[at], self.value[at])

    @property
    def velocity(self) -> NDArray[np.complex128]:
        """Mean velocity, east + i north, shape (n,) [m/s]."""
        return self.value[:, 3] + 1j * self.value[:, 4]

    @property
    def platform(self) -> NDArray[np.complex128]:
        """The platform's stated velocity, shape (n,) [m/s]; NaN where it is not stated."""
        return self.value[:, 5] + 1j * self.value[:, 6]

    @property
    def relative(self) -> NDArray[np.bool_]:
        """Whether each is relative to a platform whose velocity is not stated, shape (n,)."""
        return self.value[:, 7] > 0.0


def near_means(pings: Rows) -> Near:
    """Return pings of one topic with a bin that is sound, or may be repaired, reduced to their bins near the instrument."""
    good, depth = repairable(pings), pings["depth"]
    at = np.flatnonzero(good.any(axis=1))
    good, depth = good[at], depth[at]
    nearest = depth[np.arange(len(at)), np.argmax(good, axis=1)]
    near = good & (np.abs(depth - nearest[:, None]) <= _NEAR)
    mean = total(np.where(near[..., None], pings["velocity"][at], 0.0)) / near.sum(axis=1)[:, None]
    value = np.column_stack(
        [
            pings["longitude"][at],
            pings["latitude"][at],
            nearest,
            mean,
            pings["platform"][at],
            ~np.isfinite(pings["common_std"][at]),
            pings["dive"][at],
        ]
    )
    return Near(pings["time"][at], pings.event[at], value)


def ways(start: Near, end: Near) -> NDArray[np.complex128]:
    """Return the velocities over ground from one ping to another each, shape (n,) [m/s]; NaN at one time, or over more than an hour."""
    seconds = (end.time - start.time) * 1e-9
    scale = np.array([metres_per_degree(one) for one in start.value[:, 1].tolist()]).reshape(-1, 2)
    degrees = (end.value[:, 0] - start.value[:, 0] + 180.0) % 360.0 - 180.0
    known = (seconds > 0.0) & (seconds <= _LONGEST)
    way = scale[:, 0] * degrees + 1j * scale[:, 1] * (end.value[:, 1] - start.value[:, 1])
    return np.where(known, way / np.where(known, seconds, 1.0), np.nan)


def pairs_of(
    a: NDArray[np.complex128], b: NDArray[np.complex128], weight: float, time: NDArray[np.int64]
) -> Array:
    """Return pairs of vectors as rows of shape (n, 6): east and north of both, weight, hours since 1970."""
    columns = [a.real, a.imag, b.real, b.imag, np.full(len(a), weight), time / _HOUR_NS]
    return np.column_stack(columns)


def moved(memory: Memory, pings: Rows, context: Context) -> tuple[Memory, list[Found]]:
    """Return what changes of motion, and the platform's stated velocity beside that of its positions, establish.

    Args:
        memory: ``time`` (1,) and ``value`` (1, 9), the ping from which the next motion is counted, ``before`` (2,), relative velocity
            and the platform's at the one before it, NaN without; ``motion`` and ``track`` (up to 128, 6), pairs; ``number`` (2,) of both
            so far.
        pings: Of one instrument.
        context: Says whether positions under water are dead-reckoned without a current.
    """
    near, topic, named = near_means(pings), pings.topic, context.known(pings.instrument)
    if not len(near.time):
        return memory, []
    old = Near(
        memory.get("time", near.time[:0]),
        np.full(len(memory.get("time", ())), -1),
        memory.get("value", near.value[:0]),
    )
    both = Near(*(np.concatenate(each) for each in zip(old, near, strict=True)))
    at, last_ns = list[int](), None
    for i, now in enumerate(both.time.tolist()):
        # closer positions have too few digits for a velocity
        if last_ns is None or not 0 <= now - last_ns < _SHORTEST * 1e9:
            at.append(i)
            last_ns = now
    chain = both.take(np.array(at, np.intp))
    if len(at) < 2:
        return {**memory, "time": chain.time, "value": chain.value}, []
    start, over_ground = (
        chain.take(slice(0, -1)),
        ways(chain.take(slice(0, -1)), chain.take(slice(1, None))),
    )
    known, stated = ~np.isnan(over_ground), ~np.isnan(start.platform)
    platform = np.where(stated, start.platform, over_ground)
    of_track = np.flatnonzero(known & stated)
    relative = np.where(
        known & ~start.relative & (not context.through_water), start.velocity - platform, np.nan
    )
    before = memory.get("before", np.full(2, np.nan + 0j))
    earlier = (
        np.concatenate([[before[0]], relative[:-1]]),
        np.concatenate([[before[1]], platform[:-1]]),
    )
    changes = relative - earlier[0], earlier[1] - platform
    of_motion = np.flatnonzero(~np.isnan(changes[0]))
    # neighbouring changes share a ping
    new = {
        "motion": (
            pairs_of(changes[0][of_motion], changes[1][of_motion], 0.5, start.time[of_motion]),
            of_motion,
        ),
        "track": (
            pairs_of(platform[of_track], over_ground[of_track], 0.5, start.time[of_track]),
            of_track,
        ),
    }
    found, number = list[Found](), memory.get("number", np.zeros(2, np.int64))
    pairs = {name: carried(memory, name, rows, MOST) for name, (rows, _) in new.items()}
    events, judged = chain.event[1:], list[tuple[int, int, str, Array]]()
    for k, (name, (rows, where)) in enumerate(new.items()):
        held = len(pairs[name]) - len(rows)
        for j, place in enumerate(where.tolist()):
            count = int(number[k]) + j + 1
            if count % (_JUDGED_FIRST if count <= 2 * _JUDGED_EACH else _JUDGED_EACH) == 0:
                latest = pairs[name][max(held + j + 1 - MOST, 0) : held + j + 1]
                judged.append((int(events[place]), k, name, latest))
    for event, _, name, latest in sorted(judged, key=lambda one: one[:2]):
        names = named | {each.finding.name for each in found}
        if any(each.event == event for each in found):
            continue
        what = OF_MOTION if name == "motion" else OF_TRACK
        time_ns = int(chain.time[1:][events == event][0])
        if COMPASS not in names and (
            turned := explanation(latest, MOTION_FLOOR, TURNED, LEAST_MOTIONS)
        ):
            found.append(Found(event, turned_finding(turned, latest, what, time_ns, topic)))
        elif name == "track" and not OF_SOURCES & names and (scale := _scale_of_motion(latest)):
            found.append(Found(event, _scaled_motion(scale, latest, time_ns, topic), OF_SOURCES))
    counted = number + [len(rows) for rows, _ in new.values()]
    after = {name: rows[-MOST:] for name, rows in pairs.items()}
    last = {"time": chain.time[-1:], "value": chain.value[-1:]}
    return {
        **after,
        **last,
        "before": np.array([relative[-1], platform[-1]]),
        "number": counted,
    }, found


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


def along(memory: Memory, near: Near, mean: Rows, at: int) -> complex | None:
    """Return the mean of profiles along the path of a mean current [m/s]; None where they cover too little of it.

    Args:
        memory: As of ``dives_of``.
        near: Pings over the time of the path that are not relative.
        mean: Mean currents.
        at: Which of them.
    """
    number = int(mean["points"][at])
    depth, weight = mean["path_depth"][at, :number], mean["weight"][at, :number]
    numbers = near.value[near.value[:, 8] > 0, 8]
    if not len(numbers):
        return None
    dive = np.bincount(numbers.astype(np.int64)).argmax()
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
    memory: Memory, near: Near, mean: Rows, at: int, through_water: bool
) -> dict[str, Array]:
    """Return the pairs that a mean current makes with the pings before it: ``current``, ``vehicle`` and ``blocks``.

    Args:
        memory: As of ``dives_of``.
        near: The latest pings of one topic until it came.
        mean: Mean currents.
        at: Which of them.
        through_water: Whether positions under water are dead-reckoned without a current.
    """
    begin, end = mean["path_time"][at, 0], mean["path_time"][at, mean["points"][at] - 1]
    during = near.take((near.time >= begin) & (near.time <= end))
    absolute, relative = during.take(~during.relative), during.take(during.relative)
    velocity = complex(*mean["velocity"][at].tolist())
    # without a current in the positions these are the way through water
    more = velocity if through_water else 0.0
    began = np.array([begin])
    found = {name: np.empty((0, 6)) for name in ("current", "vehicle", "blocks")}
    profile = along(memory, absolute, mean, at)
    if profile is not None:
        found["current"] = pairs_of(np.array([profile]), np.array([velocity]), 1.0, began)
        moves = [(block, way + more) for block, way in _blocks(absolute)]
        if moves:
            platform = sum(way for _, way in moves) / len(moves)
            own = [np.where(np.isnan(each.platform), way, each.platform) for each, way in moves]
            stated = complex(np.concatenate(own).mean())
            found["vehicle"] = pairs_of(
                np.array([profile - stated]), np.array([velocity - platform]), 1.0, began
            )
    if len(relative.time) and (moves := _blocks(relative)):
        found["blocks"] = pairs_of(
            np.array([complex(block.velocity.mean()) for block, _ in moves]),
            np.array([velocity - way - more for _, way in moves]),
            0.5,
            np.array([block.time[0] for block, _ in moves]),
        )
    return found


def _blocks(near: Near) -> list[tuple[Near, complex]]:
    """Return pings in blocks of half an hour from the first one, each with the velocity over ground, where that is known."""
    found, start, times = list[tuple[Near, complex]](), 0, near.time
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
        memory: As of ``dives_of``; ``time`` (up to 1024,) and ``value`` (up to 1024, 9), the latest pings, as of ``Near``; ``current``,
            ``vehicle`` and ``blocks`` (up to 128, 6), pairs.
        pings: Of one instrument; None without.
        context: Has the mean currents.
        absent: Name and topic of the instrument where it has no pings.
    """
    name, topic = absent if pings is None else (pings.instrument, pings.topic)
    means, known = context.means, bool(KNOWN & context.known(name))
    times = memory.get("time", np.empty(0, np.int64))
    near = Near(times, np.full(len(times), -1), memory.get("value", np.empty((0, 9))))
    if pings is not None:
        near = _apart(near, near_means(pings))
    after, start, found = dict(memory), 0, list[Found]()
    for at in range(len(means)):
        event, time_ns = int(means.event[at]), means.time(at)
        if pings is not None:
            end = int(np.searchsorted(pings.event, event))
            after |= dives_of(after, pings.take(slice(start, end)))
            start = end
        until = near.take(slice(0, int(np.searchsorted(near.event, event)))).take(
            slice(-_PINGS, None)
        )
        for name, new in compared(after, until, means, at, context.through_water).items():
            after[name] = np.concatenate([after.get(name, new[:0]), new])[-MOST:]
        finding = None if known else cause_of_pairs(after, time_ns, topic)
        if finding is not None:
            found.append(Found(event, finding, KNOWN, of_believed=True))
    if pings is not None:
        after |= dives_of(after, pings.take(slice(start, None)))
    return {**after, "time": near.time[-_PINGS:], "value": near.value[-_PINGS:]}, found


def _apart(near: Near, new: Near) -> Near:
    """Return pings that are remembered and those of the new ones that are some seconds after the last one."""
    chosen, last_ns = list[int](), int(near.time[-1]) if len(near.time) else None
    for i, now in enumerate(new.time.tolist()):
        if last_ns is None or abs(now - last_ns) >= _APART * 1e9:
            chosen.append(i)
            last_ns = now
    return Near(
        *(
            np.concatenate(each)
            for each in zip(near, new.take(np.array(chosen, np.intp)), strict=True)
        )
    )


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
