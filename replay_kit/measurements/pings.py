"""Pings in earth coordinates to tested profiles with a place: when each is decided, and what becomes of it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array, Indices, Mask
from replay_kit.core.block import BinTest
from replay_kit.core.observation import Flag
from replay_kit.core.table import Columns, Integers, Table
from replay_kit.measurements.dives import Depths, depth_of
from replay_kit.measurements.earth import Words
from replay_kit.measurements.ledger import Ledger
from replay_kit.measurements.positions import (
    LONG_AGO,
    WINDOW,
    Beside,
    Rows,
    as_of,
    beside,
    chosen,
    placed,
    vessel_velocity,
)
from replay_kit.measurements.qartod import tested

RELATIVE = "velocity relative to the platform, whose motion is unknown"
NO_POSITION = "no position within"
_NO_DEPTH = "ping: instrument depth is not a number, and no earlier message gives the vehicle depth"
_NO_DEPTH_OF_PRESSURE = "ping: the stated pressure [dbar] corresponds to no depth"
_NEVER = np.iinfo(np.int64).max
# a position may be as old as the configuration likes, and ages stay int64
_FOREVER = 2.0**62
# within a message: pings that wait no longer, then those that its position releases, then its own ping
EXPIRED, POSITION, RELEASED, COMPUTED, OWN = range(5)


@dataclass(frozen=True, slots=True, eq=False)
class Way:
    """The positions of a block, and the messages' clock.

    Attributes:
        positions: The last one of the block before, and those of the block.
        new: Number of the first of the block.
        fixes: Latest ones at the surface, and those of the block.
        clock: Places in the stream and times [ns, UTC] of all messages of the block.
        last: Whether the log ends.
    """

    positions: Columns
    new: int
    fixes: Columns
    clock: tuple[Integers, Integers]
    last: bool


def arrived(
    ping: Table,
    way: Way,
    depths: Depths,
    config: MeasurementConfig,
    ledger: Ledger,
) -> Table:
    """Return the pings that can be used, with what is known of the vehicle when they came; the others are noted.

    The columns ``dive``, ``vehicle_depth`` [m], ``in_dive`` and ``until`` are added, when the fixes are there that give the place and the
    platform's velocity [ns, UTC].

    Args:
        ping: As ``earth.to_earth`` returns them, and ``why``, in words why one cannot be turned.
        way: The positions.
        depths: The vehicle's.
        config: Whether pings of unknown motion are used.
        ledger: Of the block.
    """
    depth, under, dive = depths.at(ping.order)
    stated, elsewhere = ping["dive"], np.isfinite(ping["place"][:, 0])
    fixes, absolute = way.fixes, ping["absolute"]
    latest = np.append(fixes["time"], LONG_AGO)[as_of(ping.order, fixes["order"])]
    waits = (ping.time - latest <= WINDOW) & ~(absolute | under | elsewhere)
    why = ping["why"].copy()
    # what is not used needs no turning, which may lack an attitude
    why[~absolute & ~waits & (not config.use_relative)] = RELATIVE
    columns = {
        **ping.columns,
        "dive": np.where(stated >= 0, stated, np.where(elsewhere, 0, dive)),
        "vehicle_depth": np.where(elsewhere, ping["place"][:, 2], depth),
        "in_dive": under & ~elsewhere & (as_of(ping.order, way.positions["order"]) >= 0),
        "until": np.where(waits, ping.time + WINDOW, ping.time),
    }
    good = why == ""
    _note(ping.rows(~good), ping.order[~good], why[~good], ledger)
    return replace(ping, columns=columns).rows(good)


def _note(ping: Table, due: Integers, why: Words, ledger: Ledger) -> None:
    """Note what became of pings, once for each message that made them."""
    times = ping["messages"]
    ledger.add(np.repeat(due, times), ping.topic, np.repeat(why, times))


def decided(
    waiting: Sequence[Table], arrivals: Sequence[Table], way: Way, config: MeasurementConfig
) -> tuple[tuple[Table, ...], list[Table]]:
    """Return the pings that still wait, and those that are decided: when, and by what positions.

    Columns of those: ``due``, place in the stream, ``rank`` within its message, ``released`` as a flag of those that a position releases.
    """
    now, parts = way.clock[1], [part for part in arrivals if len(part)]
    kept, active = list[Table](), [*waiting, *parts]
    calm = not way.last and way.positions["time"].size == way.new
    if waiting and calm:
        first = waiting[0]
        upto = first.time[0] + _wait(first["in_dive"][:1], config)
        if (now[-1:] <= upto).all():
            # nothing that came decides what waits
            kept, active = list(waiting), parts
    if not active:
        return tuple(kept), []
    time, order = (np.concatenate([getattr(p, name) for p in active]) for name in ("time", "order"))
    until, in_dive, place = (
        np.concatenate([p[name] for p in active]) for name in ("until", "in_dive", "place")
    )
    due, rank = _due(time, order, until, np.isfinite(place[:, 0]), way)
    if not kept:
        expired = _expired(time, order, due, _wait(in_dive, config), way)
        due, rank = np.minimum(due, expired), np.where(expired <= due, EXPIRED, rank)
    ready = (due < _NEVER) | way.last
    found, ends = list[Table](), np.cumsum([len(part) for part in active])[:-1]
    for part, at, *when in zip(
        active, *(np.split(column, ends) for column in (ready, due, rank)), strict=True
    ):
        left = part.rows(~at)
        if len(left):
            # the earliest is first, whatever stamp came before
            kept.insert(0 if kept and left.time[0] < kept[0].time[0] else len(kept), left)
        if at.any():
            columns = {**part.columns, "due": when[0], "rank": when[1]}
            found.append(replace(part, columns=columns).rows(at))
    return tuple(kept), found


def _wait(in_dive: Mask, config: MeasurementConfig) -> Integers:
    """Return how long pings wait for a position [ns]; of those in a dive the fix after it may come hours later."""
    longest = max(config.position_max_gap, config.position_max_age)
    seconds = np.where(in_dive, longest, config.position_max_age)
    return np.asarray(1e9 * np.minimum(seconds, _FOREVER / 1e9), np.int64)


def _due(
    time: Integers, order: Integers, until: Integers, elsewhere: Mask, way: Way
) -> tuple[Integers, Integers]:
    """Return the place in the stream of the message that gives pings their place, far away for none, and their rank in it."""
    positions = way.positions
    orders, times = positions["order"][way.new :], positions["time"][way.new :]
    next_one = np.maximum(
        np.searchsorted(orders, order, side="right"), np.searchsorted(times, until, side="left")
    )
    due = np.append(orders, _NEVER)[next_one]
    latest = np.append(positions["time"], LONG_AGO)[as_of(order, positions["order"])]
    own = elsewhere | ((until == time) & (latest == time))
    return np.where(own, order, due), np.where(own, OWN, RELEASED)


def _expired(time: Integers, order: Integers, due: Integers, wait: Integers, way: Way) -> Integers:
    """Return the place in the stream of the message at which pings are let go for which no position came in time; far away for none.

    The first ping that waits decides: while it waits, so do those after it.
    """
    orders, times = way.clock
    orders, last = np.append(orders, _NEVER), np.full(time.size, _NEVER)
    after = np.searchsorted(times, time + wait, side="right")
    late = (orders[after] <= due) & (order < due)
    if not late.any() or (wait == wait[0]).all():
        return np.where(late, orders[after], last)
    in_order = np.lexsort((order, time))
    active, begin = in_order[(order < due)[in_order]].tolist(), 0
    while active:
        first = active[0]
        message = max(int(np.searchsorted(times, time[first] + wait[first], side="right")), begin)
        if orders[message] > due[first] or message >= times.size:
            # a position releases it before; the next one is looked at after that
            active.pop(0)
            if due[first] == _NEVER:
                break
            begin = max(begin, int(np.searchsorted(orders, due[first], side="right")))
            continue
        now = times[message]
        gone = [k for k in active if order[k] < orders[message] and due[k] >= orders[message]]
        gone = [k for k in gone if now > time[k] + wait[k] and now > time[k] + wait[first]]
        last[gone] = orders[message]
        active, begin = [k for k in active if k not in set(gone)], message + 1
    return last


def profiled(
    ping: Table, way: Way, config: MeasurementConfig, ledger: Ledger
) -> tuple[Rows, list[BinTest]] | None:
    """Return the columns of ``Block.ping`` for pings of one layout, with ``due`` and ``rank``, and the tests; None where none has a place.

    Args:
        ping: As ``decided`` returns them.
        way: The positions.
        config: How near positions must be, and the limits.
        ledger: Of the block.
    """
    columns, due, positions = dict(ping.columns), ping["due"], way.positions
    released, moving = ping["rank"] == RELEASED, columns["until"] > ping.time
    # a position decides after the pings that it lets go
    before = as_of(np.where(ping["rank"] == OWN, ping.order, due - 1), positions["order"])
    after = np.where(released & (due < _NEVER), as_of(due, positions["order"]), -1)
    near = [beside(positions, before), beside(positions, after)]
    if moving.any():
        upto = np.searchsorted(way.fixes["order"], due - ~released, side="right")
        near = _with_motion(columns, ping.time, moving, near, way.fixes, upto)
    *place, std = placed(ping.time, columns["in_dive"], near[0], near[1], config)
    elsewhere = np.isfinite(columns["place"][:, 0])
    longitude, latitude = np.where(elsewhere, columns["place"][:, :2].T, place)
    known, words = np.isfinite(longitude), f"{NO_POSITION} {config.position_max_age:g} s"
    why = np.where(known, "", words).astype(object)
    why[moving & ~columns["absolute"] & (not config.use_relative)] = RELATIVE
    columns["transducer_depth"], no_depth = _transducer(columns, ping.fixed, latitude)
    why = np.where(why == "", no_depth, why)
    _note(ping, due, why, ledger)
    columns |= {"longitude": longitude, "latitude": latitude, "position_std": std}
    ping = replace(ping, columns=columns).rows(why == "")
    return _profile(ping, config, ledger) if len(ping) else None


def _with_motion(
    columns: Rows,
    time: Integers,
    moving: Mask,
    near: Sequence[Beside],
    fixes: Columns,
    upto: Indices,
) -> list[Beside]:
    """Make pings absolute that waited for fixes, and return the positions beside them, of which fixes count first."""
    times = np.append(fixes["time"], _NEVER)
    cut = times[np.maximum(upto - 2, 0)] - 2 * WINDOW
    first = np.where(upto >= 2, np.searchsorted(fixes["time"], cut, side="right"), 0)
    motion = np.full((time.size, 3), np.nan)
    motion[moving] = vessel_velocity(time[moving], fixes, first[moving], upto[moving])
    known = moving & np.isfinite(motion[:, 0])
    columns["added"] = np.where(known[:, None], motion, columns["added"])
    columns["absolute"] = columns["absolute"] | known
    velocity = columns["velocity"] = columns["velocity"].copy()
    # of a bin without one component the other counts no more
    whole = np.isfinite(velocity[known, :, :2]).all(axis=2, keepdims=True)
    velocity[known, :, :2] += np.where(whole, motion[known, None, :2], np.nan)
    next_one = np.searchsorted(fixes["time"], time, side="right")
    before = moving & (next_one > first) & (next_one <= upto)
    after = moving & (next_one < upto)
    at = np.where([before, after], [next_one - 1, np.maximum(next_one, first)], -1)
    return [
        [np.where(own >= 0, *pair) for pair in zip(beside(fixes, own), others, strict=True)]
        for own, others in zip(at, near, strict=True)
    ]


def _transducer(
    columns: Mapping[str, NDArray[Any]], fixed: Mapping[str, Any], latitude: Array
) -> tuple[Array, Words]:
    """Return the depths of transducers, shape (n,) [m], and in words why one is not known.

    A transducer is at the depth of the ping's pressure, or at the vehicle's where it has none, plus its own below that; a log that never
    states a depth is a surface vessel's.
    """
    pressure, below = columns["pressure"], columns["transducer_depth"]
    stated, vehicle = np.isfinite(pressure), columns["vehicle_depth"]
    if not fixed["needs_depth"]:
        vehicle = np.where(np.isfinite(vehicle), vehicle, 0.0)
    depth = np.where(stated, depth_of(pressure, latitude), vehicle)
    why = np.where(np.isfinite(depth), "", np.where(stated, _NO_DEPTH_OF_PRESSURE, _NO_DEPTH))
    return depth + np.where(np.isfinite(below), below, 0.0), why.astype(object)


def _profile(ping: Table, config: MeasurementConfig, ledger: Ledger) -> tuple[Rows, list[BinTest]]:
    """Return the columns of profiles and their tests."""
    columns, fixed, n = dict(ping.columns), ping.fixed, len(ping)
    up, beam, absolute = fixed["orientation"] == "up", fixed["frame"] == "beam", columns["absolute"]
    errors = columns["error_velocities"].reshape(n, -1)
    known = np.isfinite(errors)
    with np.errstate(all="ignore"):
        depth = columns["transducer_depth"][:, None] + (-1.0 if up else 1.0) * columns["distance"]
        error = np.where(known, errors, 0.0).sum(axis=1) / known.sum(axis=1)
    columns["depth"] = np.where(np.isfinite(depth), depth, np.nan)
    stated = columns["error_std"]
    columns["error_std"] = np.where(np.isfinite(stated), stated, config.velocity_std)
    tests, flags, reasons = tested(columns, fixed, config)
    added = columns["added"]
    added = np.where((absolute & np.isfinite(added).all(axis=1))[:, None], added, _NOTHING_ADDED)
    stated, own = np.isfinite(columns["pressure"]), fixed["correlation_depth"]
    of_all = {
        "input": ping.input,
        "topic": ledger.topic(ping.topic),
        "bins": depth.shape[1],
        "correlation_depth": own if own >= 0.0 else config.correlation_depth,
        "up": up,
        "components": columns["raw"].shape[2],
        "along_beams": beam,
    }
    return {
        **{name: columns[name] for name in _KEPT},
        **{name: np.full(n, value) for name, value in of_all.items()},
        "time": ping.time,
        "order": ping.order,
        "ordinal": ping.position,
        "velocity": columns["velocity"][..., :2],
        "flags": flags,
        "reasons": reasons,
        "common_std": np.where(absolute, added[:, 2], np.inf),
        "platform": added[:, :2],
        "pressure_depth": np.where(stated, columns["transducer_depth"], np.nan),
        "error_velocity": np.where(beam, error, np.nan),
    }, tests


_NOTHING_ADDED = (np.nan, np.nan, 0.0)
_KEPT = (
    *("due", "rank", "dive", "longitude", "latitude", "position_std", "depth", "error_std"),
    *("transducer_depth", "distance", "vehicle_depth", "heading", "messages", "raw"),
)


def padded(parts: Sequence[NDArray[Any]], missing: Any = None) -> NDArray[Any]:
    """Return rows of arrays of unlike widths as one array; what is missing is NaN, or 0 of what are no fractions, unless stated."""
    if missing is None:
        missing = np.nan if parts[0].dtype.kind == "f" else 0
    widths = np.max([part.shape for part in parts], axis=0)
    whole = []
    for part in parts:
        more = [(0, wide - own) for wide, own in zip(widths[1:], part.shape[1:], strict=True)]
        whole.append(np.pad(part, [(0, 0), *more], constant_values=missing))
    return np.concatenate(whole)


_MISSING = {"flags": np.int8(Flag.MISSING)}
_NOT_MADE = np.int8(Flag.NOT_EVALUATED)


def stacked(parts: Sequence[tuple[Rows, list[BinTest]]]) -> tuple[Rows, tuple[BinTest, ...]]:
    """Return the profiles of several layouts, and their tests, in the order of their events."""
    if not parts:
        return {}, ()
    columns = {
        name: padded([one[name] for one, _ in parts], _MISSING.get(name)) for name in parts[0][0]
    }
    at = np.lexsort([columns[name] for name in ("order", "time", "rank", "due")])
    found = []
    for name, reason in {test.name: test.reason for _, tests in parts for test in tests}.items():
        each = []
        for one, tests in parts:
            shape = one["flags"].shape
            blank = BinTest(name, reason, np.full(shape, _NOT_MADE), np.full(shape[0], None))
            each.append(next((test for test in tests if test.name == name), blank))
        rows = padded([test.flags for test in each], _NOT_MADE)[at]
        found.append(
            BinTest(name, reason, rows, np.concatenate([test.why_not for test in each])[at])
        )
    return chosen(columns, at), tuple(found)
