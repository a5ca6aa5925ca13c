"""The measurement step in columns: memory and tables of a block of messages in; memory, and what the block measured, out.

Every event has a ``due``, the place in the stream of the message that completes it. Sorted by it, events are in the order in which one
message at a time gives them, so that nothing depends on how the stream is cut into blocks; online is a block of one message.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.quality import rules_for
from replay_kit.config.run import MeasurementConfig
from replay_kit.core.block import LINEAR, MEAN, PING, POSITION, Block
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
        for topic in np.unique(rows["topic"][rows["own"]]).tolist():
            own = rows["own"] & (rows["topic"] == topic)
            ledger.add(rows["order"][own], ledger.topics[topic], reason)
    attitudes = attitudes_of(memory.attitudes, tables, ledger)
    motions, water = motions_of(memory.motions, of.get("dvl", ()), attitudes, config, ledger)
    turned = [to_earth(one, attitudes, motions, config) for one in (*of.get("ping", ()), *water)]
    arrivals = [
        (replace(one, columns=columns), why)
        for one, (columns, why) in zip((*of.get("ping", ()), *water), turned, strict=True)
    ]
    depths = _depths(memory, reached, stated, of.get("depth", ()), arrivals, config, ledger)
    positions = _with_depths(reached, depths)
    known = memory.places
    fixes = fixes_after(known.fixes, positions)
    way = Way(joined(known.last, positions), len(known.last["time"]), fixes, clock, last)
    came = [pings.arrived(one, why, way, depths, config, ledger) for one, why in arrivals]
    waiting, decided = pings.decided(memory.waiting, came, way, config)
    found = [pings.profiled(*one, way, config, ledger) for one in _alike(decided)]
    profiles, tests = pings.stacked([one for one in found if one is not None])
    ways, means, due = _means(memory.ways, positions, depths, of.get("mean", ()), config, ledger)
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
    events = _events(positions, profiles, due, [order for order, _ in linear])
    measured = [one for _, one in linear]
    for name in ("due", "rank"):
        profiles.pop(name, None)
    block = Block(
        events,
        positions,
        profiles,
        means,
        measured,
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
    arrivals: Sequence[tuple[Table, NDArray[np.object_]]],
    config: MeasurementConfig,
    ledger: Ledger,
) -> Depths:
    """Return the vehicle's depths; a log whose only depth is the pressure of its pings still has dives."""
    rows = [(*one, True) for one in stated]
    positions = joined(memory.places.last, positions)
    for one in tables:
        depth, by = one[one.fixed["by"]], one.fixed["by"]
        if by == "pressure":
            latitude = beside(positions, as_of(one.order, positions["order"]))[2]
            depth = depth_of(depth, latitude)
        known = np.isfinite(depth)
        ledger.add(
            one.order, one.topic, np.where(known, "", f"{by} is not a number").astype(object)
        )
        rows.append((one.order, depth, True))
    if np.isfinite(memory.diving.depth):
        return Depths.of(memory.diving, rows, config.surface_depth)
    first = min(
        (int(order[np.isfinite(depth)].min(initial=_NEVER)) for order, depth, _ in rows),
        default=_NEVER,
    )
    for one, why in arrivals:
        counts = (one.order < first) & (why == "") & np.isnan(one["place"][:, 0])
        counts &= one["absolute"] | config.use_relative
        latitude = beside(positions, as_of(one.order, positions["order"]))[2]
        rows.append((one.order[counts], depth_of(one["pressure"], latitude)[counts], False))
    return Depths.of(memory.diving, rows, config.surface_depth)


def _with_depths(positions: Columns, depths: Depths) -> dict[str, NDArray[Any]]:
    """Return positions with the vehicle's depth and dive."""
    depth, under, dive = depths.at(positions["order"])
    return {**positions, "depth": depth, "submerged": under, "dive": dive}


def _alike(decided: Sequence[tuple[Table, Columns]]) -> list[tuple[Table, Columns]]:
    """Return decided pings of one layout and topic as one table each."""
    groups: dict[tuple[str, str, int], list[tuple[Table, Columns]]] = {}
    for one in decided:
        groups.setdefault((one[0].fixed["layout"], one[0].topic, one[0].input), []).append(one)
    found = []
    for parts in groups.values():
        first, when = parts[0]
        if len(parts) > 1:
            time, order, ordinal = (
                np.concatenate([getattr(part, name) for part, _ in parts])
                for name in ("time", "order", "position")
            )
            columns = {
                name: np.concatenate([part[name] for part, _ in parts]) for name in first.columns
            }
            first = replace(first, columns=columns, time=time, order=order, position=ordinal)
            when = {name: np.concatenate([own[name] for _, own in parts]) for name in when}
        found.append((first, when))
    return found


def _means(
    ways: Ways,
    positions: Columns,
    depths: Depths,
    tables: Sequence[Table],
    config: MeasurementConfig,
    ledger: Ledger,
) -> tuple[Ways, dict[str, NDArray[Any]], list[tuple[int, int]]]:
    """Return the way after a block, the columns of its mean currents, and the place in the stream and rank of each."""
    rows = sorted(
        (int(order), t, k) for t, one in enumerate(tables) for k, order in enumerate(one.order)
    )
    stated = [
        {
            "order": np.int64(order),
            **{name: column[k] for name, column in tables[t].columns.items()},
        }
        for order, t, k in rows
    ]
    ways, computed, found = means_of(ways, positions, (depths.order, depths.depth), stated, config)
    made: list[tuple[tuple[int, int], dict[str, Any]]] = []
    for order, row, mean in computed:
        assert not isinstance(mean, str), "it was computed"
        own = {
            name: positions[name][row] for name in ("input", "topic", "ordinal", "order", "dive")
        }
        made.append(
            (
                (order, COMPUTED),
                {
                    **mean,
                    **own,
                    "time": mean["end_time"],
                    "source_time": mean["end_time"],
                    "beside_profiles": False,
                },
            )
        )
    for (order, t, k), (_, _, mean) in zip(rows, found, strict=True):
        table = tables[t]
        ledger.add(np.array([order]), table.topic, mean if isinstance(mean, str) else "")
        if isinstance(mean, str):
            continue
        dive, time = int(table["dive"][k]), int(table.time[k])
        own = {
            "input": table.input,
            "topic": ledger.topic(table.topic),
            "ordinal": table.position[k],
            "order": order,
            "dive": dive if dive >= 0 else int(depths.at(np.array([order]))[2][0]),
            "time": max(int(mean["end_time"]), time),
            "source_time": time,
            "beside_profiles": bool(table["inverted"][k]) and config.use_inverted,
        }
        made.append(((order, OWN), {**mean, **own}))
    made.sort(key=lambda one: one[0])
    if not made:
        return ways, {}, []
    columns = {}
    for name in made[0][1]:
        values = [np.asarray(row[name])[None] for _, row in made]
        columns[name] = padded(values, 0.0 if name == "weight" else None)
    columns["points"] = np.array([len(row["weight"]) for _, row in made])
    return ways, columns, [due for due, _ in made]


def _surfacings(tables: Sequence[Table], way: Way) -> Integers:
    """Return the places in the stream of positions at the surface that messages of their own state."""
    own = [one.order for one in tables if "system" not in one.fixed and not one.fixed.get("beside")]
    positions = chosen(way.positions, slice(way.new, None))
    orders = positions["order"][~positions["submerged"]]
    return np.asarray(orders[np.isin(orders, np.concatenate([_NONE, *own]))])


def _events(
    positions: Columns, profiles: Columns, means: Sequence[tuple[int, int]], linear: Sequence[int]
) -> Integers:
    """Return the events in order, as in ``Block``."""
    n, rows = len(positions["order"]), []
    rows.append(
        np.column_stack(
            [positions["order"], np.full(n, pings.POSITION), np.full(n, POSITION), np.arange(n)]
        )
    )
    if profiles:
        n = len(profiles["due"])
        rows.append(
            np.column_stack([profiles["due"], profiles["rank"], np.full(n, PING), np.arange(n)])
        )
    rows += [np.array([[due, rank, MEAN, k]]) for k, (due, rank) in enumerate(means)]
    rows += [np.array([[due, OWN, LINEAR, k]]) for k, due in enumerate(linear)]
    whole = np.concatenate(rows).astype(np.int64)
    return whole[np.lexsort((whole[:, 3], whole[:, 1], whole[:, 0]))][:, [0, 2, 3]]


def kind_of(block: Block, kind: int, row: int) -> tuple[str, int]:
    """Return the kind of a measurement, as the rules of the settings name it, and its dive."""
    if kind == LINEAR:
        one: LinearMeasurement = block.linear[row]
        return one.label.kind, one.dive
    return (
        ("profiles", int(block.ping["dive"][row]))
        if kind == PING
        else ("dac", int(block.mean["dive"][row]))
    )


def without(block: Block, rules: Sequence[str]) -> Block:
    """Return a block without the measurements that rules leave out, whose messages are noted as not used."""
    outcomes, reasons, kept = (
        block.outcomes.copy(),
        list(block.reasons),
        np.ones(len(block.events), np.bool_),
    )
    for k, (due, kind, row) in enumerate(block.events.tolist()):
        if kind == POSITION:
            continue
        applied = rules_for(rules, *kind_of(block, kind, row))
        if not applied:
            continue
        kept[k] = False
        if kind == LINEAR:
            topic = block.topics.index(block.linear[row].source.topic)
        else:
            topic = int((block.ping if kind == PING else block.mean)["topic"][row])
        used = np.flatnonzero((outcomes == (due, topic, -1)).all(axis=1))
        reason = left_out_reason(applied)
        if reason not in reasons:
            reasons.append(reason)
        outcomes[used[:1], 2] = reasons.index(reason)
    return replace(block, events=block.events[kept], outcomes=outcomes, reasons=tuple(reasons))
