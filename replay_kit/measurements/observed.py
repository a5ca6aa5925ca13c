"""Blocks from messages, and observations from the rows of blocks, for scripts."""

# keeps the signature in help() short
from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
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
from replay_kit.core.observation.table import LINEAR, MEAN, PING, Block, Columns
from replay_kit.logs.tables.columns import raws_of
from replay_kit.logs.tables.frames import Open, lost
from replay_kit.logs.tables.schemas import tables_of
from replay_kit.measurements.measure import Memory, measure

_NO_FRAMES: Open = {}
_LAST = np.iinfo(np.int64).max


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


def begun(system: int | None = None, component: int | None = None) -> Stream:
    """Return a stream before its first message; ``system`` and ``component`` select a MAVLink sender."""
    asked = [None if number is None else str(number) for number in (system, component)]
    return Stream(Memory(sender=(asked[0], asked[1])))


def taken(
    stream: Stream, messages: Sequence[Message], config: MeasurementConfig, last: bool = False
) -> tuple[Stream, Block]:
    """Return the stream after some messages, and their measurements; ``last`` marks the end of the log."""
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
    """Yield the measurements of blocks of a stream of messages; the last one at the end of the stream."""
    stream, rest = stream or Stream(), iter(messages)
    while part := list(islice(rest, size)):
        stream, block = taken(stream, part, config)
        yield block
    yield taken(stream, [], config, last=True)[1]


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
    one = {name: of[row].item() if of.ndim == 1 else of[row] for name, of in columns.items()}
    time = one.get("source_time", one["time"])
    source = Source(one["input"], block.topics[one["topic"]], one["ordinal"], time)
    one |= {"time_ns": one["time"], "source": source, **changes}
    return made(**{name: one[name] for name in made.__slots__ if name in one})


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
    one = {name: of[row].tolist() for name, of in columns.items()}
    points, reckoned = slice(one["points"]), tuple(one["reckoned"])
    found: PathMean = _value(
        PathMean,
        columns,
        row,
        block,
        **{name: columns[f"path_{name}"][row, points] for name in _OF_POINTS},
        path_time_ns=columns["path_time"][row, points],
        weight=columns["weight"][row, points],
        velocity=tuple(one["velocity"]),
        kind="dac",
        fixes=tuple(Fix(one[f"{name}_time"], *one[name]) for name in ("start", "end")),
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
