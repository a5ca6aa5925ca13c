"""Messages to blocks, and the rows of blocks as observations: what a script loops over."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from typing import Any, NamedTuple

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

_NO_FRAMES: Open = {}
_LAST = np.iinfo(np.int64).max


class Stream(NamedTuple):
    """What is carried from block to block.

    Attributes:
        memory: Of the measurements.
        pending: Frames of MAVLink's pings that are not complete.
        order: Number of messages so far.
    """

    memory: Memory = Memory()
    pending: Open = _NO_FRAMES
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


def _row(columns: Columns, row: int, topics: Sequence[str], time: str = "time") -> dict[str, Any]:
    """Return the values of a row by name, numbers as Python's, and its source."""
    one = {name: of[row].item() if of.ndim == 1 else of[row] for name, of in columns.items()}
    return one | {"source": Source(one["input"], topics[one["topic"]], one["ordinal"], one[time])}


def vehicle_state(block: Block, row: int) -> VehicleState:
    """Return a position of a block."""
    one = _row(block.position, row, block.topics)
    names = ("longitude", "latitude", "depth", "dead_reckoned", "source")
    return VehicleState(one["time"], **{name: one[name] for name in names})


def observation(block: Block, row: int) -> Observation:
    """Return a profile of a block."""
    one, bins = _row(block.ping, row, block.topics), int(block.ping["bins"][row])
    names = ("longitude", "latitude", "dive", "source", "common_std", "correlation_depth")
    own = {name: one[name] for name in (*names, "position_std")}
    own |= {name: one[name][:bins] for name in _OF_BINS}
    platform = tuple(one["platform"].tolist())
    return Observation(
        one["time"],
        reference="platform" if np.isinf(one["common_std"]) else "earth",
        platform_velocity=None if np.isnan(platform).any() else platform,
        **own,
    )


_OF_BINS = ("depth", "velocity", "error_std", "flags", "reasons")


def path_mean(block: Block, row: int) -> PathMean:
    """Return a mean current of a block."""
    one = _row(block.mean, row, block.topics, "source_time")
    points, reckoned = one["points"], tuple(one["reckoned"].tolist())
    start, end = (Fix(one[f"{name}_time"], *one[name].tolist()) for name in ("start", "end"))
    names = ("error_std", "dive", "source", "beside_profiles", "deepest")
    own = {name: one[name] for name in names}
    own |= {name: one[f"path_{name}"][:points] for name in ("longitude", "latitude", "depth")}
    return PathMean(
        one["time"],
        path_time_ns=one["path_time"][:points],
        weight=one["weight"][:points],
        velocity=tuple(one["velocity"].tolist()),
        kind="dac",
        fixes=(start, end),
        reckoned=None if np.isnan(reckoned[0]) else reckoned,
        **own,
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
