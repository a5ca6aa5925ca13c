"""Measurement step in columns, from a state and a block of messages to a state and measurements; rows of blocks as objects, for scripts.

Every event has a ``due``, the position in the stream of the message that completes it, which orders events independently of the division
into blocks; online use is a block of one message.
"""

# keeps the signature in help() short
from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.message import Message
from replay_kit.core.observation import (
    Fix,
    Measurement,
    Observation,
    PathMean,
    Source,
    VehicleState,
)
from replay_kit.core.observation.table import (
    LINEAR,
    MEAN,
    PING,
    Block,
    Columns,
    Integers,
    Rows,
    Table,
    chosen_rows,
)
from replay_kit.logs.tables.columns import raws_of
from replay_kit.logs.tables.instruments import Open, lost_frames
from replay_kit.logs.tables.schemas import tables_of
from replay_kit.measurements.means import Ways, means_of
from replay_kit.measurements.profiles import pings
from replay_kit.measurements.profiles.earth import attitudes_of, motions_of, no_triples, to_earth
from replay_kit.measurements.step import Found, Step
from replay_kit.measurements.surface.vectors import DrifterFix, other_measurements
from replay_kit.measurements.track.dives import depth_of, depths_of, no_depths
from replay_kit.measurements.track.navigation import Depth, Frames, Sender, from_sender, locate
from replay_kit.measurements.track.positions import appended, as_of, no_rows, positions_at, recent
from replay_kit.measurements.track.reach import THROWN, Reach, within_reach

_NONE = np.empty(0, np.int64)
_NO_NAMES: Mapping[str, Any] = {}
_LAST = slice(-1, None)


class Memory(NamedTuple):
    """State of the measurements between blocks.

    Attributes:
        topics: Names of topics by number.
        sender: Numbers of the used MAVLink system and component: as requested, or the first that state a position.
        depths: Depth and dive of the vehicle, one row.
        frames: Frames of positions.
        positions: Last positions of the vehicle.
        reach: Reach of the vehicle by its positions so far.
        attitudes: Its last attitude, at most one row.
        motions: Its last DVL velocity, at most one row.
        waiting: Pings that wait for a position.
        ways: Path since the last fixes.
        line: ``SectionLine`` of the CTD; None before its first sample.
        drifters: Reference fix of each drifter's displacement, by name.
    """

    topics: tuple[str, ...] = ()
    sender: Sender = (None, None)
    depths: Columns = no_depths()
    frames: Frames = Frames()
    positions: Columns = no_rows()
    reach: Reach = Reach()
    attitudes: Columns = no_triples()
    motions: Columns = no_triples()
    waiting: tuple[Table, ...] = ()
    ways: Ways = Ways()
    line: Any = None
    drifters: Mapping[str, DrifterFix] = _NO_NAMES


def measure(
    memory: Memory,
    tables: Sequence[Table],
    clock: tuple[Integers, Integers],
    config: MeasurementConfig,
    last: bool = False,
) -> tuple[Memory, Block]:
    """Return the state after a block of messages, and their measurements.

    Args:
        memory: State before the block.
        tables: Tables of the messages from ``logs.tables``.
        clock: Positions in the stream and times [ns, UTC] of all messages of the block, also of those in no table.
        config: Settings of the measurements.
        last: Whether the log ends with the block.
    """
    tables = sorted(
        (table for table in tables if len(table)), key=lambda table: int(table.order[0])
    )
    step = Step(config, clock, last, {name: k for k, name in enumerate(memory.topics)}, {}, [])
    for table in tables:
        step.topic(table.topic)
    sender, tables = from_sender(memory.sender, tables, step)
    by_kind = defaultdict[str, list[Table]](list)
    for table in tables:
        by_kind[table.kind].append(table)
    for table in by_kind["unused"]:
        step.note(table, table["reason"])
    frames, positions, stated = locate(memory.frames, by_kind, step)
    reach, rows, counts, findings = within_reach(memory.reach, positions, last)
    of_vehicle, reached = rows["own"], chosen_rows(rows, counts)
    step.add(
        rows["order"][of_vehicle],
        rows["topic"][of_vehicle],
        np.where(counts, "", THROWN)[of_vehicle],
    )
    attitudes = attitudes_of(memory.attitudes, tables, step)
    motions, water = motions_of(memory.motions, by_kind["dvl"], attitudes, step)
    arrivals = [to_earth(table, attitudes, motions, config) for table in (*by_kind["ping"], *water)]
    positions = appended(memory.positions, reached)
    stated += _depths((*by_kind["depth"], *arrivals), positions, step)
    depths = depths_of(memory.depths, stated, config.surface_depth)
    step = step._replace(depths=depths, new=len(memory.positions["order"]), reach=reach)
    dived = step.dived(reached["order"])
    new = reached | {name: dived[name] for name in ("depth", "submerged", "dive")}
    positions = appended(memory.positions, new)
    step = step._replace(positions=positions)
    came = [pings.arrived_pings(table, step) for table in arrivals]
    waiting, decided = pings.decided_pings(memory.waiting, came, step)
    found = [made for table in decided for made in pings.profiles_of(table, step)]
    profiles, tests = pings.stacked_profiles(found)
    ways, means = means_of(memory.ways, by_kind["mean"], step)
    line, linear = _ctd_measurements(memory.line, by_kind, step)
    drifters = dict(memory.drifters)
    linear += other_measurements(
        drifters, by_kind["radar"] + by_kind["drifter"] + by_kind["sensor"], step
    )
    linear.sort(key=lambda pair: pair[0])
    after = Memory(
        tuple(step.topics),
        sender,
        chosen_rows(depths, _LAST),
        frames,
        recent(positions),
        reach,
        chosen_rows(attitudes, _LAST),
        chosen_rows(motions, _LAST),
        waiting,
        ways,
        line,
        drifters,
    )
    block = Block(
        _events(new, profiles, means, linear),
        new,
        profiles,
        means,
        [table for _, table in linear],
        tuple(step.topics),
        step.outcomes(),
        tuple(step.reasons),
        tests,
        tuple(findings),
    )
    return after, block


def _events(positions: Rows, profiles: Rows, means: Rows, linear: Found) -> Integers:
    """Return the events in order, as in ``Block``; removes the columns with their order."""
    due: tuple[tuple[Integers, Any], ...] = (
        (positions["order"], pings.POSITION),
        *((rows.pop("due", _NONE), rows.pop("rank", _NONE)) for rows in (profiles, means)),
        (np.array([order for order, _ in linear], np.int64), pings.OWN),
    )
    events = np.concatenate(
        [
            np.column_stack(np.broadcast_arrays(order, rank, kind, np.arange(len(order))))
            for kind, (order, rank) in enumerate(due)
        ]
    )
    return events[np.lexsort((events[:, 3], events[:, 1], events[:, 0]))][:, [0, 2, 3]]


def _ctd_measurements(
    line: Any, by_kind: Mapping[str, Sequence[Table]], step: Step
) -> tuple[Any, Found]:
    """Return the CTD's line after a block, and the completed measurements."""
    if line is None and not by_kind["ctd"]:
        return None, []
    # loads scipy, which most logs need not
    from replay_kit.measurements.ctd.lines import SectionLine, ctd_shears

    new = chosen_rows(step.positions, slice(step.new, None))
    surfacings = new["order"][~new["submerged"]]
    return ctd_shears(line or SectionLine(), by_kind["ctd"], surfacings, step)


def _depths(tables: Sequence[Table], positions: Columns, step: Step) -> list[Depth]:
    """Return the depths in tables, or of pings with pressure in logs without other depths; notes the messages of the former."""
    rows = list[Depth]()
    for table in tables:
        by, is_stated = table.fixed.get("by", "pressure"), table.kind == "depth"
        depth = table[by]
        if by == "pressure":
            depth = depth_of(
                depth, positions_at(positions, as_of(table.order, positions["order"]))[2]
            )
        if is_stated:
            step.note(table, np.where(np.isfinite(depth), "", f"{by} is not a number"))
        else:
            counts = (table["why"] == "") & (table["absolute"] | step.config.use_relative)
            depth = np.where(counts & np.isnan(table["place"][:, 0]), depth, np.nan)
        rows.append((table.order, depth, is_stated))
    return rows


_NO_FRAMES: Open = {}
_ENDLESS = np.iinfo(np.int64).max


class Stream(NamedTuple):
    """State of a stream between blocks.

    Attributes:
        memory: State of the measurements.
        pending: Frames of incomplete MAVLink pings.
        order: Number of messages so far.
    """

    memory: Memory = Memory()
    pending: Open = _NO_FRAMES
    order: int = 0


def new_stream(system: int | None = None, component: int | None = None) -> Stream:
    """Return a stream before its first message; ``system`` and ``component`` select a MAVLink sender."""
    asked = [None if number is None else str(number) for number in (system, component)]
    return Stream(Memory(sender=(asked[0], asked[1])))


def measure_messages(
    stream: Stream, messages: Sequence[Message], config: MeasurementConfig, last: bool = False
) -> tuple[Stream, Block]:
    """Return the stream after some messages, and their measurements; ``last`` marks the end of the log."""
    tables, pending = tables_of(raws_of(messages, stream.order), config, stream.pending)
    order = stream.order + len(messages)
    if last:
        tables, pending = [*tables, *lost_frames(pending, _ENDLESS)], {}
    times = np.array([message.time_ns for message in messages], np.int64)
    clock = np.arange(stream.order, order), times
    memory, block = measure(stream.memory, tables, clock, config, last)
    return Stream(memory, pending, order), block


def blocks(
    messages: Iterable[Message],
    config: MeasurementConfig,
    size: int = 4096,
    stream: Stream | None = None,
) -> Iterator[Block]:
    """Yield the measurements of blocks of a stream of messages; the last one at the end of the stream."""
    stream, rest = stream or Stream(), iter(messages)
    while part := list(islice(rest, size)):
        stream, block = measure_messages(stream, part, config)
        yield block
    yield measure_messages(stream, [], config, last=True)[1]


def rows(block: Block) -> Iterator[VehicleState | Measurement]:
    """Yield the events of a block in order as objects."""
    for _, kind, row in block.events.tolist():
        if kind == LINEAR:
            yield block.linear[row]
        elif kind == PING:
            yield observation(block, row)
        else:
            mean = kind == MEAN
            yield (
                path_mean(block, row) if mean else _value(VehicleState, block.position, row, block)
            )


def _value(made: Any, columns: Columns, row: int, block: Block, **changes: Any) -> Any:
    """Return a row of a block as an object with fields from the columns of their names, except for ``changes``."""
    values = {
        name: column[row].item() if column.ndim == 1 else column[row]
        for name, column in columns.items()
    }
    time = values.get("source_time", values["time"])
    source = Source(values["input"], block.topics[values["topic"]], values["ordinal"], time)
    values |= {"time_ns": values["time"], "source": source, **changes}
    return made(**{name: values[name] for name in made.__slots__ if name in values})


def observation(block: Block, row: int) -> Observation:
    """Return a profile of a block."""
    columns = block.ping
    bins, platform = columns["bins"][row], tuple(columns["platform"][row].tolist())
    found: Observation = _value(
        Observation,
        columns,
        row,
        block,
        **{name: columns[name][row, :bins] for name in _OF_BINS},
        reference="platform" if np.isinf(columns["common_std"][row]) else "earth",
        platform_velocity=None if np.isnan(platform).any() else platform,
    )
    return found


_OF_BINS = ("depth", "velocity", "error_std", "flags", "reasons")
_OF_POINTS = ("longitude", "latitude", "depth")


def path_mean(block: Block, row: int) -> PathMean:
    """Return a mean current of a block."""
    columns = block.mean
    values = {name: column[row].tolist() for name, column in columns.items()}
    points, reckoned = slice(values["points"]), tuple(values["reckoned"])
    found: PathMean = _value(
        PathMean,
        columns,
        row,
        block,
        **{name: columns[f"path_{name}"][row, points] for name in _OF_POINTS},
        path_time_ns=columns["path_time"][row, points],
        weight=columns["weight"][row, points],
        velocity=tuple(values["velocity"]),
        kind="dac",
        fixes=tuple(Fix(values[f"{name}_time"], *values[name]) for name in ("start", "end")),
        reckoned=None if np.isnan(reckoned[0]) else reckoned,
    )
    return found


def observations(
    messages: Iterable[Message], config: MeasurementConfig | None = None
) -> Iterator[Measurement]:
    """Yield the profiles and mean currents in a stream of messages, for post-mission scripts.

    Mean currents are skipped if profiles computed from them are used, to prevent double counting.
    """
    for block in blocks(messages, config or MeasurementConfig()):
        for event in rows(block):
            beside = isinstance(event, PathMean) and event.beside_profiles
            if isinstance(event, Measurement) and not beside:
                yield event
