"""The measurement step in columns: memory and tables of a block of messages in; memory, and what the block measured, out.

Every event has a ``due``, the place in the stream of the message that completes it. Sorted by it, events are in the order in which one
message at a time gives them, so that nothing depends on how the stream is cut into blocks; online is a block of one message.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from replay_kit.config.quality import rules_for
from replay_kit.config.run import MeasurementConfig
from replay_kit.core.arrays import Array
from replay_kit.core.block import LINEAR, PING, POSITION, Block
from replay_kit.core.observation import LinearMeasurement
from replay_kit.core.table import Columns, Integers, Table
from replay_kit.measurements import pings, surface
from replay_kit.measurements.dives import Depths, Diving, depth_of
from replay_kit.measurements.dvl import attitudes_of, motions_of
from replay_kit.measurements.earth import no_triples, to_earth
from replay_kit.measurements.ledger import Ledger, left_out_reason
from replay_kit.measurements.means import Ways, means_of
from replay_kit.measurements.navigation import Depth, Sender, located, of_sender
from replay_kit.measurements.pings import COMPUTED, OWN, Way, padded
from replay_kit.measurements.positions import (
    Places,
    Rows,
    as_of,
    beside,
    chosen,
    fixes_after,
    joined,
    kept_fixes,
)
from replay_kit.measurements.reach import THROWN, Reach, within_reach

if TYPE_CHECKING:
    from replay_kit.measurements.ctd.lines import SectionLine

_NONE = np.empty(0, np.int64)
_NEVER = np.iinfo(np.int64).max


@dataclass(frozen=True, slots=True, eq=False)
class Memory:
    """What is carried from block to block.

    Attributes:
        topics: Names by number.
        sender: Numbers of the MAVLink system and component whose position and depth count: those asked for, or the first that state a
            position.
        diving: The vehicle's depth and dive.
        places: Its last positions.
        reach: What its positions so far say of those that it can reach.
        attitudes: Its last attitude, of at most one row.
        motions: Its last velocity by a DVL, of at most one row.
        waiting: Pings that wait for a position, in the order of their times.
        ways: The way since the last fixes.
        line: Of the CTD; None before its first sample.
        drifters: By name, the fix from which each drifter's displacement is counted.
    """

    topics: tuple[str, ...] = ()
    sender: Sender = (None, None)
    diving: Diving = field(default_factory=Diving)
    places: Places = field(default_factory=Places)
    reach: Reach = field(default_factory=Reach)
    attitudes: Columns = field(default_factory=no_triples)
    motions: Columns = field(default_factory=no_triples)
    waiting: tuple[Table, ...] = ()
    ways: Ways = field(default_factory=Ways)
    line: "SectionLine | None" = None
    drifters: Mapping[str, surface.DrifterFix] = field(default_factory=dict)


def measure(
    memory: Memory,
    tables: Sequence[Table],
    clock: tuple[Integers, Integers],
    config: MeasurementConfig,
    last: bool = False,
) -> tuple[Memory, Block]:
    """Return what is remembered after a block of messages, and what they measured.

    Args:
        memory: What was remembered before.
        tables: Of the messages, as ``logs.tables`` returns them.
        clock: Places in the stream and times [ns, UTC] of all messages of the block, those of no table among them.
        config: How messages become measurements.
        last: Whether the log ends with the block, and nothing waits any longer.
    """
    tables = sorted((one for one in tables if len(one)), key=lambda one: int(one.order[0]))
    ledger = Ledger(memory.topics)
    for one in tables:
        ledger.topic(one.topic)
    sender, tables = of_sender(memory.sender, tables, ledger)
    of: dict[str, list[Table]] = {}
    for one in tables:
        of.setdefault(one.kind, []).append(one)
    for one in of.get("unused", ()):
        ledger.add(one.order, one.topic, one["reason"])
    places, positions, stated = located(memory.places, of, config, ledger)
    reach, reached, thrown, findings = within_reach(memory.reach, positions, last)
    for rows, reason in ((reached, ""), (thrown, THROWN)):
        for number, topic in enumerate(ledger.topics):
            own = rows["own"] & (rows["topic"] == number)
            ledger.add(rows["order"][own], topic, reason)
    attitudes = attitudes_of(memory.attitudes, tables, ledger)
    motions, water = motions_of(memory.motions, of.get("dvl", ()), attitudes, config, ledger)
    arrivals = []
    for one in (*of.get("ping", ()), *water):
        columns, why = to_earth(one, attitudes, motions, config)
        arrivals.append(replace(one, columns={**columns, "why": why}))
    depths = _depths(memory, reached, stated, of.get("depth", ()), arrivals, config, ledger)
    depth, under, dive = depths.at(reached["order"])
    positions = {**reached, "depth": depth, "submerged": under, "dive": dive}
    known = memory.places
    fixes = fixes_after(known.fixes, positions)
    way = Way(joined(known.last, positions), len(known.last["time"]), fixes, clock, last)
    came = [pings.arrived(one, way, depths, config, ledger) for one in arrivals]
    waiting, decided = pings.decided(memory.waiting, came, way, config)
    found = [pings.profiled(one, way, config, ledger) for one in _alike(decided)]
    profiles, tests = pings.stacked([one for one in found if one is not None])
    ways, means = _means(memory.ways, positions, depths, of.get("mean", ()), config, ledger)
    line, drifters, linear = _linear(memory, of, way, depths, config, ledger)
    after = Memory(
        ledger.topics,
        sender,
        depths.end,
        replace(places, last=chosen(way.positions, slice(-1, None)), fixes=kept_fixes(fixes)),
        reach,
        chosen(attitudes, slice(-1, None)),
        chosen(motions, slice(-1, None)),
        waiting,
        ways,
        line,
        drifters,
    )
    events = _events(positions, profiles, means, [order for order, _ in linear])
    block = Block(
        events,
        positions,
        profiles,
        means,
        [one for _, one in linear],
        ledger.topics,
        ledger.outcomes(),
        ledger.reasons,
        tests,
        tuple(findings),
    )
    return after, without(block, config.without) if config.without else block


def _linear(
    memory: Memory,
    of: Mapping[str, Sequence[Table]],
    way: Way,
    depths: Depths,
    config: MeasurementConfig,
    ledger: Ledger,
) -> tuple["SectionLine | None", Mapping[str, surface.DrifterFix], surface.Found]:
    """Return the CTD's line, drifters' fixes and the measurements of other sources after a block, in order."""
    line, found = memory.line, surface.Found()
    if line is not None or "ctd" in of:
        # loads scipy, which most logs need not
        from replay_kit.measurements.ctd.lines import Sampled

        sampled = Sampled(line, way, depths, config, ledger)
        sampled.take(of.get("ctd", ()), _surfacings(of.get("position", ()), way))
        line, found = sampled.line, sampled.found
    drifted = of.get("drifter", ())
    drifters, means = surface.of_drifters(memory.drifters, drifted, depths, config, ledger)
    found = found + means
    for one in of.get("radar", ()):
        found += surface.of_radar(one, depths, config, ledger)
    for one in of.get("sensor", ()):
        found += surface.of_sensor(one, depths, ledger)
    return line, drifters, sorted(found, key=lambda pair: pair[0])


def _depths(
    memory: Memory,
    positions: Columns,
    stated: Sequence[Depth],
    tables: Sequence[Table],
    arrivals: Sequence[Table],
    config: MeasurementConfig,
    ledger: Ledger,
) -> Depths:
    """Return the vehicle's depths; a log whose only depth is the pressure of its pings still has dives."""
    rows = [(*one, True) for one in stated]
    positions = joined(memory.places.last, positions)

    def below(one: Table, pressure: Array) -> Array:
        return depth_of(pressure, beside(positions, as_of(one.order, positions["order"]))[2])

    for one in tables:
        by = one.fixed["by"]
        depth = below(one, one[by]) if by == "pressure" else one[by]
        known, words = np.isfinite(depth), f"{by} is not a number"
        ledger.add(one.order, one.topic, np.where(known, "", words).astype(object))
        rows.append((one.order, depth, True))
    known_since = [order[np.isfinite(depth)].min(initial=_NEVER) for order, depth, _ in rows]
    first = -1 if np.isfinite(memory.diving.depth) else min(known_since, default=_NEVER)
    for one in arrivals:
        counts = (one.order < first) & (one["why"] == "") & np.isnan(one["place"][:, 0])
        counts &= one["absolute"] | config.use_relative
        rows.append((one.order[counts], below(one, one["pressure"])[counts], False))
    return Depths.of(memory.diving, rows, config.surface_depth)


def _alike(decided: Sequence[Table]) -> list[Table]:
    """Return decided pings of one layout and topic as one table each."""
    groups: dict[tuple[str, str, int], list[Table]] = {}
    for one in decided:
        groups.setdefault((one.fixed["layout"], one.topic, one.input), []).append(one)
    found = []
    for parts in groups.values():
        places: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in ("time", "order", "position")
        }
        columns = joined(*(part.columns for part in parts))
        found.append(replace(parts[0], columns=columns, **places))
    return found


def _means(
    ways: Ways,
    positions: Columns,
    depths: Depths,
    tables: Sequence[Table],
    config: MeasurementConfig,
    ledger: Ledger,
) -> tuple[Ways, Rows]:
    """Return the way after a block, and the columns of its mean currents, with ``due``, place in the stream, and ``rank`` of each."""
    single = [one.rows(slice(k, k + 1)) for one in tables for k in range(len(one))]
    single.sort(key=lambda one: int(one.order[0]))
    stated = [{"order": one.order[0], **chosen(one.columns, 0)} for one in single]
    ways, computed, found = means_of(ways, positions, (depths.order, depths.depth), stated, config)
    made: list[dict[str, Any]] = []
    for due, row, mean in computed:
        assert not isinstance(mean, str), "it was computed"
        own = {name: positions[name][row] for name in _SOURCE}
        time = mean["end_time"]
        own |= {"time": time, "source_time": time, "beside_profiles": False, "rank": COMPUTED}
        made.append({**mean, **own, "due": due})
    for one, state, (due, _, mean) in zip(single, stated, found, strict=True):
        ledger.add(one.order, one.topic, mean if isinstance(mean, str) else "")
        if not isinstance(mean, str):
            own = {
                "input": one.input,
                "topic": ledger.topic(one.topic),
                "ordinal": one.position[0],
                "order": due,
                "dive": state["dive"] if state["dive"] >= 0 else depths.at(one.order)[2][0],
                "time": max(mean["end_time"], one.time[0]),
                "source_time": one.time[0],
                "beside_profiles": bool(state["inverted"]) and config.use_inverted,
            }
            made.append({**mean, **own, "due": due, "rank": OWN})
    made.sort(key=lambda one: (one["due"], one["rank"]))
    columns = {
        name: padded([np.asarray(row[name])[None] for row in made], 0 if name == "weight" else None)
        for name in (made[0] if made else ())
    }
    if made:
        columns["points"] = np.array([len(row["weight"]) for row in made])
    return ways, columns


_SOURCE = ("input", "topic", "ordinal", "order", "dive")


def _surfacings(tables: Sequence[Table], way: Way) -> Integers:
    """Return the places in the stream of positions at the surface that messages of their own state."""
    own = [one.order for one in tables if "system" not in one.fixed and not one.fixed.get("beside")]
    orders = way.positions["order"][~way.positions["submerged"]]
    return np.asarray(orders[np.isin(orders, np.concatenate([_NONE, *own]))])


def _events(positions: Columns, profiles: Rows, means: Rows, linear: Sequence[int]) -> Integers:
    """Return the events in order, as in ``Block``; takes from the columns what says when each is due."""
    due: tuple[tuple[Integers, Any], ...] = (
        (positions["order"], pings.POSITION),
        *((rows.pop("due", _NONE), rows.pop("rank", _NONE)) for rows in (profiles, means)),
        (np.array(linear, np.int64), OWN),
    )
    whole = np.concatenate(
        [
            np.column_stack(np.broadcast_arrays(order, rank, kind, np.arange(len(order))))
            for kind, (order, rank) in enumerate(due)
        ]
    )
    return whole[np.lexsort((whole[:, 3], whole[:, 1], whole[:, 0]))][:, [0, 2, 3]]


def without(block: Block, rules: Sequence[str]) -> Block:
    """Return a block without the measurements that rules leave out, whose messages are noted as not used."""
    outcomes, reasons = block.outcomes.copy(), list(block.reasons)
    kept = np.ones(len(block.events), np.bool_)
    for k, (due, kind, row) in enumerate(block.events.tolist()):
        if kind == POSITION:
            continue
        if kind == LINEAR:
            one: LinearMeasurement = block.linear[row]
            of, dive, topic = one.label.kind, one.dive, block.topics.index(one.source.topic)
        else:
            of, columns = ("profiles", block.ping) if kind == PING else ("dac", block.mean)  # type: ignore[assignment]
            dive, topic = int(columns["dive"][row]), int(columns["topic"][row])
        if applied := rules_for(rules, of, dive):
            kept[k], reason = False, left_out_reason(applied)
            if reason not in reasons:
                reasons.append(reason)
            used = np.flatnonzero((outcomes == (due, topic, -1)).all(axis=1))
            outcomes[used[:1], 2] = reasons.index(reason)
    return replace(block, events=block.events[kept], outcomes=outcomes, reasons=tuple(reasons))
