"""Pings in earth coordinates to tested profiles with a place: when each is decided, and what becomes of it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array
from replay_kit.core.block import BinTest
from replay_kit.core.observation import Flag
from replay_kit.core.table import Columns, Integers, Table
from replay_kit.measurements.dives import Depths, depth_of
from replay_kit.measurements.ledger import Ledger
from replay_kit.measurements.positions import WINDOW, as_of, beside, placed, vessel_velocity
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
    why: NDArray[np.object_],
    way: Way,
    depths: Depths,
    config: MeasurementConfig,
    ledger: Ledger,
) -> Table:
    """Return the pings that can be used, with what is known of the vehicle when they came; the others are noted.

    The columns ``dive``, ``vehicle_depth`` [m], ``in_dive`` and ``until`` are added, when the fixes are there that give the place and the
    platform's velocity [ns, UTC].

    Args:
        ping: As ``earth.to_earth`` returns them.
        why: Why they cannot be turned.
        way: The positions.
        depths: The vehicle's.
        config: Whether pings of unknown motion are used.
        ledger: Of the block.
    """
    depth, under, dive = depths.at(ping.order)
    stated, elsewhere = ping["dive"], np.isfinite(ping["place"][:, 0])
    fixes, absolute = way.fixes, ping["absolute"]
    at = as_of(ping.order, fixes["order"])
    recent = np.zeros(len(ping), np.bool_)
    if fixes["time"].size:
        recent = (at >= 0) & (ping.time - fixes["time"][at] <= WINDOW)
    waits = recent & ~(absolute | under | elsewhere)
    why = why.copy()
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
    _refuse(ping, ~good, ping.order, why, ledger)
    return replace(ping, columns=columns).rows(good)


def _refuse(
    ping: Table,
    at: NDArray[np.bool_],
    due: Integers,
    why: NDArray[np.object_] | str,
    ledger: Ledger,
) -> None:
    """Note pings that are not used, once for each message that made them."""
    if at.any():
        times = ping["messages"][at]
        words = why if isinstance(why, str) else np.repeat(why[at], times)
        ledger.add(np.repeat(due[at], times), ping.topic, words)


def decided(
    waiting: Sequence[Table], arrivals: Sequence[Table], way: Way, config: MeasurementConfig
) -> tuple[tuple[Table, ...], list[tuple[Table, Columns]]]:
    """Return the pings that still wait, and those that are decided: when, and by what positions.

    Columns of those: ``due``, place in the stream, ``rank`` within its message, ``released`` as a flag of those that a position releases.
    """
    parts = [part for part in arrivals if len(part)]
    old = list(waiting)
    now, first = way.clock[1][-1:], old[0] if old else None
    calm = not way.last and way.positions["time"].size == way.new
    if calm and (
        first is None
        or not now.size
        or now[0] <= first.time[0] + _wait(first["in_dive"][:1], config)[0]
    ):
        # nothing that came decides what waits
        kept, active = old, parts
    else:
        kept, active = [], old + parts
    if not active:
        return tuple(kept), []
    time, order = (np.concatenate([getattr(p, name) for p in active]) for name in ("time", "order"))
    until, in_dive, elsewhere = (
        np.concatenate(columns)
        for columns in zip(
            *((p["until"], p["in_dive"], np.isfinite(p["place"][:, 0])) for p in active),
            strict=True,
        )
    )
    due, rank = _due(time, order, until, elsewhere, way)
    expired = np.full(time.size, _NEVER)
    if not kept:
        expired = _expired(time, order, due, _wait(in_dive, config), way)
    due, rank = np.minimum(due, expired), np.where(expired <= due, EXPIRED, rank)
    ready = (due < _NEVER) | way.last
    found, begin = list[tuple[Table, Columns]](), 0
    for part in active:
        own = slice(begin, begin + len(part))
        begin += len(part)
        if not ready[own].all():
            left = part.rows(~ready[own])
            # the earliest is first, whatever stamp came before
            kept.insert(0 if kept and left.time[0] < kept[0].time[0] else len(kept), left)
        if ready[own].any():
            at = ready[own]
            found.append((part.rows(at), {"due": due[own][at], "rank": rank[own][at]}))
    return tuple(kept), found


def _wait(in_dive: NDArray[np.bool_], config: MeasurementConfig) -> Integers:
    """Return how long pings wait for a position [ns]; of those in a dive the fix after it may come hours later."""
    longest = max(config.position_max_gap, config.position_max_age)
    seconds = np.where(in_dive, longest, config.position_max_age)
    return np.asarray(1e9 * np.minimum(seconds, _FOREVER / 1e9), np.int64)


def _due(
    time: Integers, order: Integers, until: Integers, elsewhere: NDArray[np.bool_], way: Way
) -> tuple[Integers, Integers]:
    """Return the place in the stream of the message that gives pings their place, far away for none, and their rank in it."""
    positions = way.positions
    orders, times = positions["order"][way.new :], positions["time"][way.new :]
    next_one = np.maximum(
        np.searchsorted(orders, order, side="right"), np.searchsorted(times, until, side="left")
    )
    due = np.append(orders, _NEVER)[next_one]
    before = as_of(order, positions["order"])
    own = elsewhere.copy()
    if positions["time"].size:
        own |= (until == time) & (before >= 0) & (positions["time"][before] == time)
    return np.where(own, order, due), np.where(own, OWN, RELEASED)


def _expired(time: Integers, order: Integers, due: Integers, wait: Integers, way: Way) -> Integers:
    """Return the place in the stream of the message at which pings are let go for which no position came in time; far away for none.

    The first ping that waits decides: while it waits, so do those after it.
    """
    orders, times = way.clock
    orders, last = np.append(orders, _NEVER), np.full(time.size, _NEVER)
    after = np.searchsorted(times, time + wait, side="right")
    late = orders[after] <= due
    late &= order < due
    if not late.any():
        return last
    if (wait == wait[0]).all():
        return np.where(late, orders[after], last)
    in_order = np.lexsort((order, time))
    active, begin = in_order[late[in_order] | (order < due)[in_order]].tolist(), 0
    while active:
        first = active[0]
        message = max(int(np.searchsorted(times, time[first] + wait[first], side="right")), begin)
        if orders[message] > due[first] or message >= times.size:
            # a position releases it before; the next one is looked at after that
            active.pop(0)
            if due[first] < _NEVER:
                begin = max(begin, int(np.searchsorted(orders, due[first], side="right")))
            elif message >= times.size:
                break
            continue
        now = times[message]
        gone = [k for k in active if order[k] < orders[message] and due[k] >= orders[message]]
        gone = [k for k in gone if now > time[k] + wait[k] and now > time[k] + wait[first]]
        last[gone] = orders[message]
        active, begin = [k for k in active if k not in set(gone)], message + 1
    return last


def profiled(
    ping: Table, when: Columns, way: Way, config: MeasurementConfig, ledger: Ledger
) -> tuple[dict[str, NDArray[Any]], list[BinTest]] | None:
    """Return the columns of ``Block.ping`` for pings of one layout, with ``due`` and ``rank``, and the tests; None where none has a place.

    Args:
        ping: As ``decided`` returns them.
        when: Its columns.
        way: The positions.
        config: How near positions must be, and the limits.
        ledger: Of the block.
    """
    columns, longitude, latitude, std, moving = _placed(ping, when, way, config)
    why = np.where(
        np.isfinite(longitude), "", f"{NO_POSITION} {config.position_max_age:g} s"
    ).astype(object)
    why[moving & ~columns["absolute"] & (not config.use_relative)] = RELATIVE
    columns["transducer_depth"], no_depth = _transducer(columns, ping.fixed, latitude)
    why = np.where(why == "", no_depth, why)
    good = why == ""
    _refuse(ping, ~good, when["due"], why, ledger)
    if not good.any():
        return None
    ledger.add(np.repeat(when["due"][good], ping["messages"][good]), ping.topic)
    columns |= {"longitude": longitude, "latitude": latitude, "position_std": std, **when}
    ping = replace(ping, columns=columns).rows(good)
    return _profile(ping, config, ledger)


def _placed(
    ping: Table, when: Columns, way: Way, config: MeasurementConfig
) -> tuple[dict[str, NDArray[Any]], Array, Array, Array, NDArray[np.bool_]]:
    """Return columns with the platform's velocity by fixes, longitude, latitude, the place's error, and whether a ping waited for fixes."""
    positions, due, columns = way.positions, when["due"], dict(ping.columns)
    released = when["rank"] == RELEASED
    moving = columns["until"] > ping.time
    # a position decides after the pings that it lets go
    before = as_of(np.where(when["rank"] == OWN, ping.order, due - 1), positions["order"])
    after = np.where(released & (due < _NEVER), as_of(due, positions["order"]), -1)
    near = beside(positions, before), beside(positions, after)
    if moving.any():
        upto = np.searchsorted(way.fixes["order"], due - ~released, side="right")
        columns, near = _with_motion(columns, ping.time, moving, near, (way.fixes, upto))
    place = placed(ping.time, columns["in_dive"], *near, config)
    elsewhere = np.isfinite(columns["place"][:, 0])
    longitude, latitude = (np.where(elsewhere, columns["place"][:, k], place[k]) for k in (0, 1))
    return columns, longitude, latitude, place[2], moving


def _with_motion(
    columns: dict[str, NDArray[Any]],
    time: Integers,
    moving: NDArray[np.bool_],
    near: tuple[Any, Any],
    track: tuple[Columns, NDArray[np.intp]],
) -> tuple[dict[str, NDArray[Any]], tuple[Any, Any]]:
    """Return columns of pings that waited for fixes, made absolute, and the positions beside them, of which fixes count first."""
    fixes, upto = track
    times = np.append(fixes["time"], _NEVER)
    cut = times[np.maximum(upto - 2, 0)] - 2 * WINDOW
    first = np.where(upto >= 2, np.searchsorted(fixes["time"], cut, side="right"), 0)
    motion = np.full((time.size, 3), np.nan)
    motion[moving] = vessel_velocity(time[moving], fixes, first[moving], upto[moving])
    known = moving & np.isfinite(motion[:, 0])
    columns["added"] = np.where(known[:, None], motion, columns["added"])
    columns["absolute"] = columns["absolute"] | known
    velocity = columns["velocity"].copy()
    whole = np.isfinite(velocity[..., :2]).all(axis=2)[..., None]
    together = np.where(whole, velocity[..., :2] + motion[:, None, :2], np.nan)
    velocity[..., :2] = np.where(known[:, None, None], together, velocity[..., :2])
    columns["velocity"] = velocity
    next_one = np.searchsorted(fixes["time"], time, side="right")
    at = (
        np.where(moving & (next_one > first) & (next_one <= upto), next_one - 1, -1),
        np.where(moving & (next_one < upto), np.maximum(next_one, first), -1),
    )
    return columns, tuple(
        tuple(
            np.where(own >= 0, one, other)
            for one, other in zip(beside(fixes, own), others, strict=True)
        )
        for own, others in zip(at, near, strict=True)
    )  # type: ignore[return-value]


def _transducer(
    columns: Mapping[str, NDArray[Any]], fixed: Mapping[str, Any], latitude: Array
) -> tuple[Array, NDArray[np.object_]]:
    """Return the depths of transducers, shape (n,) [m], and in words why one is not known.

    A transducer is at the depth of the ping's pressure, or at the vehicle's where it has none, plus its own below that; a log that never
    states a depth is a surface vessel's.
    """
    pressure, vehicle, below = (
        columns[name] for name in ("pressure", "vehicle_depth", "transducer_depth")
    )
    stated = np.isfinite(pressure)
    vehicle = vehicle if fixed["needs_depth"] else np.where(np.isfinite(vehicle), vehicle, 0.0)
    depth = np.where(stated, depth_of(pressure, latitude), vehicle)
    why = np.where(np.isfinite(depth), "", np.where(stated, _NO_DEPTH_OF_PRESSURE, _NO_DEPTH))
    return depth + np.where(np.isfinite(below), below, 0.0), why.astype(object)


def _profile(
    ping: Table, config: MeasurementConfig, ledger: Ledger
) -> tuple[dict[str, NDArray[Any]], list[BinTest]]:
    """Return the columns of profiles and their tests."""
    columns, fixed, n = dict(ping.columns), ping.fixed, len(ping)
    up, absolute = fixed["orientation"] == "up", columns["absolute"]
    with np.errstate(over="ignore", invalid="ignore"):
        depth = columns["transducer_depth"][:, None] + (-1.0 if up else 1.0) * columns["distance"]
    columns["depth"] = np.where(np.isfinite(depth), depth, np.nan)
    stated = columns["error_std"]
    columns["error_std"] = np.where(np.isfinite(stated), stated, config.velocity_std)
    tests, flags, reasons = tested(columns, fixed, config)
    added, errors = columns["added"], columns["error_velocities"].reshape(n, -1)
    known = np.isfinite(errors)
    with np.errstate(over="ignore", invalid="ignore"):
        error = np.where(known, errors, 0.0).sum(axis=1) / known.sum(axis=1)
    own, beam = fixed["correlation_depth"], fixed["frame"] == "beam"
    kept = (
        "longitude",
        "latitude",
        "position_std",
        "depth",
        "error_std",
        "transducer_depth",
        "distance",
    )
    return {
        name: columns[name] for name in (*kept, "vehicle_depth", "heading", "messages", "raw")
    } | {
        "due": columns["due"],
        "rank": columns["rank"],
        "time": ping.time,
        "order": ping.order,
        "dive": columns["dive"],
        "input": np.full(n, ping.input),
        "topic": np.full(n, ledger.topic(ping.topic)),
        "ordinal": ping.position,
        "bins": np.full(n, depth.shape[1]),
        "velocity": columns["velocity"][..., :2],
        "flags": flags,
        "reasons": reasons,
        "common_std": np.where(
            absolute, np.where(np.isfinite(added).all(axis=1), added[:, 2], 0.0), np.inf
        ),
        "correlation_depth": np.full(n, own if own >= 0.0 else config.correlation_depth),
        "platform": np.where(
            (absolute & np.isfinite(added).all(axis=1))[:, None], added[:, :2], np.nan
        ),
        "up": np.full(n, up),
        "pressure_depth": np.where(
            np.isfinite(columns["pressure"]), columns["transducer_depth"], np.nan
        ),
        "error_velocity": error if beam else np.full(n, np.nan),
        "components": np.full(n, columns["raw"].shape[2]),
        "along_beams": np.full(n, beam),
    }, tests


def padded(parts: Sequence[NDArray[Any]], missing: Any) -> NDArray[Any]:
    """Return rows of arrays of unlike widths as one array."""
    widths = tuple(map(max, zip(*(part.shape[1:] for part in parts), strict=True)))
    whole = [
        np.pad(
            part,
            [(0, 0), *((0, w - have) for w, have in zip(widths, part.shape[1:], strict=True))],
            constant_values=missing,
        )
        if part.shape[1:] != widths
        else part
        for part in parts
    ]
    return np.concatenate(whole)


_MISSING: Mapping[str, Any] = {"flags": np.int8(Flag.MISSING), "reasons": 0}


def stacked(
    parts: Sequence[tuple[dict[str, NDArray[Any]], list[BinTest]]],
) -> tuple[dict[str, NDArray[Any]], tuple[BinTest, ...]]:
    """Return the profiles of several layouts, and their tests, in the order of their events."""
    if not parts:
        return {}, ()
    columns = {
        name: padded(
            [one[name] for one, _ in parts],
            _MISSING.get(name, np.nan if parts[0][0][name].dtype.kind == "f" else 0),
        )
        for name in parts[0][0]
    }
    at = np.lexsort((columns["order"], columns["time"], columns["rank"], columns["due"]))
    known = {test.name: test for _, tests in parts for test in tests}
    found = []
    for name, test in known.items():
        flags, why = [], []
        for one, tests in parts:
            own = next((each for each in tests if each.name == name), None)
            blank = np.full(one["flags"].shape, np.int8(Flag.NOT_EVALUATED))
            flags.append(blank if own is None else own.flags)
            why.append(np.full(len(blank), None) if own is None else own.why_not)
        rows = padded(flags, np.int8(Flag.NOT_EVALUATED))[at]
        found.append(BinTest(name, test.reason, rows, np.concatenate(why)[at]))
    return {name: column[at] for name, column in columns.items()}, tuple(found)
