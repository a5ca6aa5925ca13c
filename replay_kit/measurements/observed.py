"""Messages to blocks, and the rows of blocks as observations: what a script loops over."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.block import LINEAR, MEAN, PING, Block
from replay_kit.core.message import Message
from replay_kit.core.observation import (
    Fix,
    Measurement,
    Observation,
    PathMean,
    Source,
    VehicleState,
)
from replay_kit.core.table import Columns
from replay_kit.logs.tables.columns import raws_of
from replay_kit.logs.tables.frames import Open, lost
from replay_kit.logs.tables.schemas import tables_of
from replay_kit.measurements.measure import Memory, measure

_LAST = np.iinfo(np.int64).max


@dataclass(frozen=True, slots=True, eq=False)
class Stream:
    """What is carried from block to block.

    Attributes:
        memory: Of the measurements.
        pending: Frames of MAVLink's pings that are not complete.
        order: Number of messages so far.
    """

    memory: Memory = field(default_factory=Memory)
    pending: Open = field(default_factory=dict)
    order: int = 0


def begun(system: int | None = None, component: int | None = None) -> Stream:
    """Return a stream before its first message; ``system`` and ``component`` are those of MAVLink asked for, in logs that hold several."""
    asked = [None if number is None else str(number) for number in (system, component)]
    return Stream(Memory(sender=(asked[0], asked[1])))


def taken(
    stream: Stream, messages: Sequence[Message], config: MeasurementConfig, last: bool = False
) -> tuple[Stream, Block]:
    """Return what is carried on after some messages, and what they measured; ``last`` says that the log ends with them."""
    tables, pending = tables_of(raws_of(messages, stream.order), config, stream.pending)
    order = stream.order + len(messages)
    if last:
        tables, pending = [*tables, *lost(pending, _LAST)], {}
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
    """Yield what the blocks of a stream of messages measured; the last one when the stream has ended."""
    stream, rest = stream or Stream(), iter(messages)
    while part := list(islice(rest, size)):
        stream, block = taken(stream, part, config)
        yield block
    yield taken(stream, [], config, last=True)[1]


def rows(block: Block) -> Iterator[VehicleState | Measurement]:
    """Yield the events of a block in order, each as a value of its own."""
    for _, kind, row in block.events.tolist():
        if kind == LINEAR:
            yield block.linear[row]
        elif kind == PING:
            yield observation(block, row)
        else:
            yield path_mean(block, row) if kind == MEAN else vehicle_state(block, row)


def _source(columns: Columns, row: int, topics: Any, time: str = "time") -> Source:
    return Source(
        int(columns["input"][row]),
        topics[columns["topic"][row]],
        int(columns["ordinal"][row]),
        int(columns[time][row]),
    )


def vehicle_state(block: Block, row: int) -> VehicleState:
    """Return a position of a block."""
    columns = block.position
    return VehicleState(
        int(columns["time"][row]),
        float(columns["longitude"][row]),
        float(columns["latitude"][row]),
        float(columns["depth"][row]),
        bool(columns["dead_reckoned"][row]),
        _source(columns, row, block.topics),
    )


def observation(block: Block, row: int) -> Observation:
    """Return a profile of a block."""
    columns, bins = block.ping, slice(0, int(block.ping["bins"][row]))
    common_std = float(columns["common_std"][row])
    platform = columns["platform"][row]
    return Observation(
        int(columns["time"][row]),
        float(columns["longitude"][row]),
        float(columns["latitude"][row]),
        columns["depth"][row, bins],
        columns["velocity"][row, bins],
        columns["error_std"][row, bins],
        "platform" if np.isinf(common_std) else "earth",
        columns["flags"][row, bins],
        columns["reasons"][row, bins],
        int(columns["dive"][row]),
        _source(columns, row, block.topics),
        common_std,
        float(columns["correlation_depth"][row]),
        None if np.isnan(platform).any() else (float(platform[0]), float(platform[1])),
        position_std=float(columns["position_std"][row]),
    )


def path_mean(block: Block, row: int) -> PathMean:
    """Return a mean current of a block."""
    columns, points = block.mean, slice(0, int(block.mean["points"][row]))
    velocity, reckoned = columns["velocity"][row].tolist(), columns["reckoned"][row].tolist()
    start, end = (
        Fix(int(columns[f"{name}_time"][row]), *columns[name][row].tolist())
        for name in ("start", "end")
    )
    return PathMean(
        int(columns["time"][row]),
        columns["path_time"][row, points],
        columns["path_longitude"][row, points],
        columns["path_latitude"][row, points],
        columns["path_depth"][row, points],
        columns["weight"][row, points],
        (velocity[0], velocity[1]),
        float(columns["error_std"][row]),
        "dac",
        int(columns["dive"][row]),
        _source(columns, row, block.topics, "source_time"),
        (start, end),
        beside_profiles=bool(columns["beside_profiles"][row]),
        deepest=float(columns["deepest"][row]),
        reckoned=None if np.isnan(reckoned[0]) else (reckoned[0], reckoned[1]),
    )


def observations(
    messages: Iterable[Message], config: MeasurementConfig | None = None
) -> Iterator[Measurement]:
    """Yield the profiles and mean currents in a stream of messages: what a post-mission script loops over.

    A mean current beside profiles that were computed from it is left out: without the flight model's bias it would count twice.
    """
    for block in blocks(messages, config or MeasurementConfig()):
        for event in rows(block):
            beside = isinstance(event, PathMean) and event.beside_profiles
            if isinstance(event, Measurement) and not beside:
                yield event
