"""An MCAP file surveyed without decoding it all.

``Survey`` decodes some topics only; the others are counted and timed in bulk, chunk by chunk. ``overview_of`` reads the index at the end of
the file and the first messages of each topic: a few reads, however large the file is.
"""

import os
import struct
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import islice
from operator import attrgetter
from typing import BinaryIO, NamedTuple

import numpy as np
from mcap.opcode import Opcode
from mcap.records import ChunkIndex
from numpy.typing import NDArray

from replay_kit.core.message import Message
from replay_kit.logs.mcap.records import (
    HEAD_SIZE,
    INNER,
    RECORD_ERRORS,
    RECORD_HEAD,
    chunk_contents,
    file_records,
    parse_chunk,
)
from replay_kit.logs.mcap.summary import Channels, Make, Summary, read_summary
from replay_kit.logs.shared.blocks import Block, Overview, ReadStatistics, TopicExtent, block_of

#: Opcode, length and fixed part of a message record.
MESSAGE_START = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_ns", "<u8"),
        ("publish_ns", "<u8"),
    ]
)
_MESSAGE = int(Opcode.MESSAGE)
_LAST_NS = 2**63 - 1
_SHORTEST = MESSAGE_START.itemsize - HEAD_SIZE


class Columns(NamedTuple):
    """The records of a chunk.

    Attributes:
        offset: Where each message record begins in the contents, shape (n,), increasing [bytes].
        head: ``MESSAGE_START`` of each.
        declared: Opcode, and where the body begins and ends, of the schema and channel records.
    """

    offset: NDArray[np.int64]
    head: NDArray[np.void]
    declared: list[tuple[int, int, int]]

    @property
    def stop(self) -> NDArray[np.int64]:
        """Where each message record ends, shape (n,) [bytes]."""
        stop: NDArray[np.int64] = self.offset + HEAD_SIZE + self.head["length"].astype(np.int64)
        return stop


def columns_of(data: bytes) -> Columns | None:
    """Return the records of a chunk's contents; None when anything but whole schemas, channels and messages is in them."""
    offset: list[int] = []
    declared: list[tuple[int, int, int]] = []
    # walking is what takes the time; the numbers are gathered for all messages at once
    end, last, unpack, add = 0, len(data) - HEAD_SIZE, RECORD_HEAD.unpack_from, offset.append
    while end <= last:
        opcode, length = unpack(data, end)
        start, end = end, end + HEAD_SIZE + length
        if opcode == _MESSAGE and length >= _SHORTEST:
            add(start)
        elif opcode in INNER and opcode != _MESSAGE:
            declared.append((opcode, start + HEAD_SIZE, end))
        else:
            return None
    # the lengths add up only if no record reaches beyond the end
    return (
        Columns(np.array(offset, np.int64), _heads(data, offset), declared)
        if end == len(data)
        else None
    )


def _heads(data: bytes, offset: list[int]) -> NDArray[np.void]:
    if not offset:
        return np.empty(0, MESSAGE_START)
    # a record may begin at any byte
    anywhere: NDArray[np.void] = np.ndarray(
        (len(data) - MESSAGE_START.itemsize + 1,), MESSAGE_START, data, strides=(1,)
    )
    return anywhere[offset]


class Survey:
    """Makes blocks of messages, of which only those of wanted topics are decoded, and of others the first, as a sample."""

    def __init__(
        self,
        statistics: ReadStatistics,
        decoded: Make[Message],
        stamp: str,
        wanted: Callable[[str, str], bool],
    ) -> None:
        """Remember what to do with messages.

        Args:
            statistics: Counts messages.
            decoded: Returns a message decoded and counts it; None when it cannot be.
            stamp: Which stamp orders messages: ``log_ns`` or ``publish_ns``.
            wanted: Whether the messages of a topic and schema are decoded.
        """
        self._statistics = statistics
        self._decoded = decoded
        self._stamp = stamp
        self._wanted = wanted
        self._sampled: set[tuple[str, str]] = set()

    def single(
        self, channels: Channels, data: bytes, start: int, end: int, position: int
    ) -> Block | None:
        """Return a block of one message record; None when it cannot be decoded."""
        message = self._decoded(channels, data, start, end, position)
        return None if message is None else block_of([message])

    def takes(self, found: Columns, span: tuple[int, int] | None) -> bool:
        """Return whether all messages can be used: their times can, and the log times lie in a span [ns] where one is given."""
        log_ns = found.head["log_ns"]
        if span is not None and np.any((log_ns < span[0]) | (log_ns > span[1])):
            return False
        return not np.any(found.head[self._stamp] > _LAST_NS)

    def block(self, channels: Channels, data: bytes, found: Columns, first: int) -> Block:
        """Return the block of a chunk's contents, of which there is at least one message.

        Args:
            channels: Declared so far.
            data: The contents.
            found: Their records.
            first: Ordinal in the file of the first message.
        """
        counts = np.bincount(found.head["channel"])
        numbers = np.flatnonzero(counts)
        kind = np.searchsorted(numbers, found.head["channel"])
        sinks = [channels.sink(number) for number in numbers.tolist()]
        wanted = np.array(
            [callable(sink.decode) and self._wanted(sink.topic, sink.schema) for sink in sinks]
        )
        decoded = partial(self._messages, channels, data, found, first)
        messages = list(decoded(np.flatnonzero(wanted[kind])))
        for number in np.flatnonzero(~wanted).tolist():
            sink, count = sinks[number], int(counts[numbers[number]])
            if callable(sink.decode) and (sink.topic, sink.schema) not in self._sampled:
                before = self._statistics.read[sink.topic]
                sample = list(islice(decoded(np.flatnonzero(kind == number)), 1))
                if sample:
                    self._sampled.add((sink.topic, sink.schema))
                messages += sample
                # those tried are counted already
                count -= self._statistics.read[sink.topic] - before
            if isinstance(sink.decode, str):
                self._statistics.undecodable(sink.topic, sink.decode, count)
            self._statistics.read[sink.topic] += count
        messages.sort(key=lambda message: message.position)
        kinds = tuple((sink.topic, sink.schema) for sink in sinks)
        return Block(kinds, kind, found.head[self._stamp].astype(np.int64), messages)

    def _messages(
        self, channels: Channels, data: bytes, found: Columns, first: int, rows: NDArray[np.intp]
    ) -> Iterator[Message]:
        """Yield the messages of some rows that can be decoded."""
        starts, stops = (found.offset[rows] + HEAD_SIZE).tolist(), found.stop[rows].tolist()
        for row, start, stop in zip(rows.tolist(), starts, stops, strict=True):
            message = self._decoded(channels, data, start, stop, first + row)
            if message is not None:
                yield message


#: A file with fewer messages than this, and fewer bytes of them, is read whole in a second or so.
FEW_MESSAGES, FEW_BYTES = 50_000, 16_000_000
# decoded of each channel, and chunks in which they are looked for
_MOST_FIRST, _MOST_CHUNKS = 100, 4
# looked at for the first, and for the last, time of a channel; more only where chunks overlap each other
_MOST_INDEXES = 16
_INDEX_HEAD = struct.Struct("<BQHI")
_INDEX_ENTRY = np.dtype([("log_ns", "<u8"), ("offset", "<u8")])


def overview_of(
    file: BinaryIO, decoded: Make[Message], rename: Callable[[str], str]
) -> Overview | str:
    """Return the overview of an open file, or why its index says too little; empty when the file is so small that all can be read.

    Args:
        file: The file.
        decoded: Returns a message decoded; None when it cannot be.
        rename: Gives what a topic of the file is called.
    """
    summary = read_summary(file, os.fstat(file.fileno()).st_size)
    held = _chunks_by_channel(summary)
    if (problem := problem_of(summary)) or _is_small(summary):
        return problem
    channels = Channels(summary, rename)
    try:
        topics = _topics(file, summary, channels, held)
        first = sorted(_first_messages(file, channels, held, decoded), key=attrgetter("time_ns"))
    except RECORD_ERRORS as error:
        return f"its index or one of the first chunks is damaged: {error}"
    sinks = [channels.sink(number) for number in held]
    return Overview(
        topics,
        {sink.topic: sink.decode for sink in sinks if isinstance(sink.decode, str)},
        tuple(first),
    )


def _chunks_by_channel(summary: Summary) -> dict[int, list[ChunkIndex]]:
    """Return the chunks that hold messages of each channel, in the order of the file."""
    held: dict[int, list[ChunkIndex]] = defaultdict(list)
    for chunk in summary.chunks:
        for number in chunk.message_index_offsets:
            held[number].append(chunk)
    return held


def problem_of(summary: Summary) -> str:
    """Return why an index says too little of its file; empty when it says enough."""
    held = _chunks_by_channel(summary)
    statistics = summary.statistics
    if statistics is None:
        return summary.problem or "it has no index, or its end is missing"
    counts = {number: count for number, count in statistics.channel_message_counts.items() if count}
    if sum(counts.values()) != statistics.message_count:
        return "its index does not count the messages of each topic"
    if not counts.keys() <= summary.channels.keys():
        return "its index does not declare all topics"
    if not counts.keys() <= held.keys() or len(summary.chunks) != statistics.chunk_count:
        return "its index does not locate the messages of each topic"
    return ""


def _is_small(summary: Summary) -> bool:
    size = sum(chunk.uncompressed_size for chunk in summary.chunks)
    return (
        summary.statistics is not None
        and summary.statistics.message_count < FEW_MESSAGES
        and size < FEW_BYTES
    )


def _topics(
    file: BinaryIO, summary: Summary, channels: Channels, held: Mapping[int, Sequence[ChunkIndex]]
) -> dict[str, TopicExtent]:
    topics: dict[str, TopicExtent] = {}
    counts = {} if summary.statistics is None else summary.statistics.channel_message_counts
    for number, messages in counts.items():
        if messages:
            sink = channels.sink(number)
            first_ns, last_ns = (_edge(file, number, held[number], last) for last in (False, True))
            extent = TopicExtent(sink.schema, messages, first_ns, last_ns)
            topics[sink.topic] = (
                topics[sink.topic].joined(extent) if sink.topic in topics else extent
            )
    return topics


def _edge(file: BinaryIO, channel: int, chunks: Sequence[ChunkIndex], last: bool) -> int | None:
    """Return a channel's earliest, or latest, log time [ns] by its message indexes; None when many chunks might hold it."""
    sign = -1 if last else 1
    # by the bound that each chunk states for its own messages
    bounds = sorted(
        (sign * (chunk.message_end_time if last else chunk.message_start_time), k)
        for k, chunk in enumerate(chunks)
    )
    best: int | None = None
    for read, (bound, k) in enumerate(bounds):
        if best is not None and bound >= best:
            break
        if read == _MOST_INDEXES:
            return None
        times = index_entries(file, channel, chunks[k])["log_ns"]
        if times.size:
            found = sign * int(times.max() if last else times.min())
            best = found if best is None else min(best, found)
    return None if best is None else sign * best


def index_entries(file: BinaryIO, channel: int, chunk: ChunkIndex) -> NDArray[np.void]:
    """Return what a chunk's message index lists for a channel: ``log_ns``, and ``offset`` in the contents.

    Raises:
        struct.error, ValueError: ``RECORD_ERRORS``; no such index is where the summary says.
    """
    offset = chunk.message_index_offsets[channel]
    file.seek(offset)
    opcode, _, number, size = _INDEX_HEAD.unpack(file.read(_INDEX_HEAD.size))
    if opcode != Opcode.MESSAGE_INDEX or number != channel or size > chunk.message_index_length:
        raise ValueError(f"no message index of channel {channel} begins at byte {offset}")
    return np.frombuffer(file.read(size), _INDEX_ENTRY)


def _first_messages(
    file: BinaryIO,
    channels: Channels,
    held: Mapping[int, Sequence[ChunkIndex]],
    decoded: Make[Message],
) -> Iterator[Message]:
    """Yield the first messages of each channel that can be decoded.

    Raises:
        struct.error, ValueError: ``RECORD_ERRORS``; a chunk is damaged.
    """
    left = {number: _MOST_FIRST if callable(channels.sink(number).decode) else 0 for number in held}
    chunks = {
        chunk.chunk_start_offset: chunk
        for number in held
        if left[number]
        for chunk in held[number][:_MOST_CHUNKS]
    }
    position = 0
    for offset in sorted(chunks):
        record = next(file_records(file, offset, offset + chunks[offset].chunk_length))
        data = chunk_contents(parse_chunk(record.body))
        found = columns_of(data)
        if found is None:
            raise ValueError(
                f"the chunk at byte {offset} holds more than schemas, channels and messages"
            )
        rows = zip(
            found.head["channel"].tolist(),
            (found.offset + HEAD_SIZE).tolist(),
            found.stop.tolist(),
            strict=True,
        )
        for number, start, stop in rows:
            if left.get(number, 0):
                left[number] -= 1
                position += 1
                message = decoded(channels, data, start, stop, position)
                if message is not None:
                    yield message
