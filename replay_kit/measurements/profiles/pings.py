"""Pings in earth coordinates to tested profiles with positions: time of decision and outcome."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.observation import Flag
from replay_kit.core.observation.table import BinTest, Integers, Rows, Table, chosen_rows
from replay_kit.measurements.profiles.qartod import tested
from replay_kit.measurements.step import Step
from replay_kit.measurements.track.dives import depth_of
from replay_kit.measurements.track.positions import (
    LONG_AGO,
    NEVER,
    WINDOW,
    appended,
    as_of,
    fixes_of,
    placed_pings,
    vessel_velocity,
)

RELATIVE = "velocity relative to the platform, whose motion is unknown"
NO_POSITION = "no position within"
_NO_DEPTH = "ping: instrument depth is not a number, and no earlier message gives the vehicle depth"
# s; a position may be as old as the configuration likes, and ages stay int64
_FOREVER = 4e9
# within a message: pings that wait no longer, then those that its position releases, then its own ping
EXPIRED, POSITION, RELEASED, COMPUTED, OWN = range(5)
#: The columns of ``Block.ping`` for pings of one layout, with ``due`` and ``rank``, and their tests.
Profiles = tuple[Rows, list[BinTest]]


def arrived_pings(ping: Table, step: Step) -> Table:
    """Return the usable pings with the vehicle's state at their arrival; others are noted.

    Added columns: ``dive``, ``vehicle_depth`` [m], ``in_dive``, ``until``, when fixes for position and platform velocity are available, and
    ``expires``, the end of waiting for a position [ns, UTC], hours later for a dive.

    Args:
        ping: Result of ``earth.to_earth``.
        step: Block.
    """
    config, positions, dived = step.config, step.positions, step.dived(ping.order)
    under, stated, elsewhere = dived["submerged"], ping["dive"], np.isfinite(ping["place"][:, 0])
    fixes, absolute = fixes_of(positions), ping["absolute"]
    latest = np.append(fixes["time"], LONG_AGO)[as_of(ping.order, fixes["order"])]
    waits = (ping.time - latest <= WINDOW) & ~(absolute | under | elsewhere)
    why = ping["why"].copy()
    # what is not used needs no turning, which may lack an attitude
    why[~absolute & ~waits & (not config.use_relative)] = RELATIVE
    in_dive = under & ~elsewhere & (as_of(ping.order, positions["order"]) >= 0)
    longest = np.fmax(config.position_max_age, np.where(in_dive, config.position_max_gap, 0.0))
    columns = {
        **ping.columns,
        "dive": np.where(stated >= 0, stated, np.where(elsewhere, 0, dived["dive"])),
        "vehicle_depth": np.where(elsewhere, ping["place"][:, 2], dived["depth"]),
        "in_dive": in_dive,
        "until": ping.time + WINDOW * waits,
        "expires": ping.time + (1e9 * np.minimum(longest, _FOREVER)).astype(np.int64),
    }
    return step.kept(replace(ping, columns=columns), why)


def decided_pings(
    waiting: Sequence[Table], arrivals: Sequence[Table], step: Step
) -> tuple[tuple[Table, ...], list[Table]]:
    """Return the waiting pings, and the decided ones as one table per layout and topic.

    Columns of decided pings: ``due``, position in the stream of the deciding message, and ``rank`` within it.
    """
    groups: dict[Any, list[Table]] = {}
    for table in (*waiting, *arrivals):
        if len(table):
            groups.setdefault((table.fixed["layout"], table.topic, table.input), []).append(table)
    left, found = list[Table](), list[Table]()
    for parts in groups.values():
        table = parts[0] if len(parts) == 1 else _joined(parts)
        due, rank = _due(table, step)
        waits = (due == NEVER) & (not step.last)
        if waits.all():
            left.append(table)
            continue
        left.append(table.rows(waits))
        found.append(
            replace(table, columns={**table.columns, "due": due, "rank": rank}).rows(~waits)
        )
    return tuple(left), found


def _joined(parts: Sequence[Table]) -> Table:
    """Return joined tables of one layout and topic."""
    first = parts[0]
    time, order, position = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("time", "order", "position")
    )
    columns = appended(*(part.columns for part in parts))
    return replace(first, time=time, order=order, position=position, columns=columns)


def _due(ping: Table, step: Step) -> tuple[Integers, Integers]:
    """Return the position in the stream of the message that decides on pings, far away for none, and their rank in it.

    It gives their position, or ends the waiting for it.
    """
    positions, until = step.positions, ping["until"]
    orders, times = (positions[name][step.new :] for name in ("order", "time"))
    next_one = np.maximum(
        np.searchsorted(orders, ping.order, side="right"), np.searchsorted(times, until)
    )
    due = np.append(orders, NEVER)[next_one]
    latest = np.append(positions["time"], LONG_AGO)[as_of(ping.order, positions["order"])]
    placed = np.isfinite(ping["place"][:, 0]) | ((until == ping.time) & (latest == ping.time))
    orders, times = step.clock
    late = np.append(orders, NEVER)[np.searchsorted(times, ping["expires"], side="right")]
    expired = ~placed & (late <= due)
    due = np.where(placed, ping.order, np.minimum(due, late))
    return due, np.where(placed, OWN, np.where(expired, EXPIRED, RELEASED))


def profiles_of(ping: Table, step: Step) -> list[Profiles]:
    """Return the profiles of decided pings; empty if none has a position."""
    columns, due, positions, config = dict(ping.columns), ping["due"], step.positions, step.config
    moving, expired = columns["until"] > ping.time, columns["rank"] == EXPIRED
    if moving.any():
        fixes = fixes_of(positions)
        upto = np.where(moving, as_of(due, fixes["order"]) + 1, 0)
        motion = vessel_velocity(ping.time, fixes, upto)
        known = np.isfinite(motion[:, 0])
        columns["added"] = np.where(known[:, None], motion, columns["added"])
        columns["absolute"] = columns["absolute"] | known
        velocity = columns["velocity"] = columns["velocity"].copy()
        # of a bin without one component the other counts no more
        whole = np.isfinite(velocity[known, :, :2]).all(axis=2, keepdims=True)
        velocity[known, :, :2] += np.where(whole, motion[known, None, :2], np.nan)
    # a position decides after the pings that it lets go
    upto = as_of(due - expired, positions["order"]) + 1
    *place, std = placed_pings(ping.time, columns["in_dive"], positions, upto, config)
    elsewhere = np.isfinite(columns["place"][:, 0])
    longitude, latitude = np.where(elsewhere, columns["place"][:, :2].T, place)
    pressure, below = columns["pressure"], columns["transducer_depth"]
    stated, vehicle = np.isfinite(pressure), columns["vehicle_depth"]
    if not ping.fixed["needs_depth"]:
        # a log that never states a depth is a surface vessel's
        vehicle = np.where(np.isfinite(vehicle), vehicle, 0.0)
    depth = np.where(stated, depth_of(pressure, latitude), vehicle)
    why = np.full(len(ping), "", object)
    why[~np.isfinite(depth)] = _NO_DEPTH
    why[~np.isfinite(depth) & stated] = "ping: the stated pressure [dbar] corresponds to no depth"
    why[~np.isfinite(longitude)] = f"{NO_POSITION} {config.position_max_age:g} s"
    why[moving & ~columns["absolute"] & (not config.use_relative)] = RELATIVE
    if config.without:
        left_out = [step.left_out("profiles", dive) for dive in columns["dive"].tolist()]
        why = np.where(why == "", left_out, why)
    step.note(ping, why, due)
    columns |= {
        "longitude": longitude,
        "latitude": latitude,
        "position_std": std,
        "transducer_depth": depth + np.where(np.isfinite(below), below, 0.0),
    }
    ping = replace(ping, columns=columns).rows(why == "")
    return [_profile(ping, step)] if len(ping) else []


def _profile(ping: Table, step: Step) -> Profiles:
    """Return the profiles of pings with positions."""
    columns, fixed, n = dict(ping.columns), ping.fixed, len(ping)
    up, config = fixed["orientation"] == "up", step.config
    down = -columns["distance"] if up else columns["distance"]
    depth = columns["transducer_depth"][:, None] + down
    columns["depth"] = np.where(np.isfinite(depth), depth, np.nan)
    error = columns["error_std"]
    columns["error_std"] = np.where(np.isfinite(error), error, config.velocity_std)
    tests, flags, reasons = tested({**fixed, **columns}, config)
    correlation_depth = fixed["correlation_depth"]
    stated = np.isfinite(columns["pressure"])
    of_all = {
        "input": ping.input,
        "topic": step.topic(ping.topic),
        "bins": depth.shape[1],
        "correlation_depth": correlation_depth
        if correlation_depth >= 0.0
        else config.correlation_depth,
        "up": up,
        "components": columns["raw"].shape[2],
        "along_beams": fixed["frame"] == "beam",
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
        "common_std": np.where(columns["absolute"], np.nan_to_num(columns["added"][:, 2]), np.inf),
        "platform": columns["added"][:, :2],
        "pressure_depth": np.where(stated, columns["transducer_depth"], np.nan),
    }, tests


_KEPT = (
    *("due", "rank", "dive", "longitude", "latitude", "position_std", "depth", "error_std"),
    *("transducer_depth", "distance", "vehicle_depth", "heading", "messages", "raw"),
    "error_velocity",
)


def padded(parts: Sequence[NDArray[Any]], missing: Any = 0) -> NDArray[Any]:
    """Return arrays of different widths as one array; padded with NaN, or ``missing`` for integers."""
    if len(parts) == 1:
        return parts[0]
    missing = np.nan if parts[0].dtype.kind == "f" else missing
    widths = np.max([part.shape for part in parts], axis=0)[1:]
    whole = np.full((sum(map(len, parts)), *widths), missing, parts[0].dtype)
    begin = 0
    for part in parts:
        whole[(slice(begin, begin + len(part)), *map(slice, part.shape[1:]))] = part
        begin += len(part)
    return whole


#: What a bin holds that a ping does not have, where it is not 0 or NaN.
MISSING = {"flags": Flag.MISSING}


def stacked_profiles(parts: Sequence[Profiles]) -> tuple[Rows, tuple[BinTest, ...]]:
    """Return the profiles of several layouts and their tests in the order of events."""
    if not parts:
        return {}, ()
    columns = {
        name: padded([bin_test[name] for bin_test, _ in parts], MISSING.get(name, 0))
        for name in parts[0][0]
    }
    at = np.lexsort([columns[name] for name in ("order", "time", "rank", "due")])
    found = []
    for bin_test in {test.name: test for _, tests in parts for test in tests}.values():
        flags, words = [], []
        for rows, tests in parts:
            same_test = [test for test in tests if test.name == bin_test.name]
            blank = np.full(rows["flags"].shape, np.int8(Flag.NOT_EVALUATED))
            flags.append(same_test[0].flags if same_test else blank)
            words.append(same_test[0].why_not if same_test else np.full(len(blank), None))
        both = {"flags": padded(flags, Flag.NOT_EVALUATED), "why_not": np.concatenate(words)}
        found.append(BinTest(bin_test.name, bin_test.reason, **chosen_rows(both, at)))
    return chosen_rows(columns, at), tuple(found)
