"""Overview of an MCAP file from its index, by a few reads."""

import os
import struct
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from operator import attrgetter
from typing import BinaryIO

import numpy as np
from mcap.opcode import Opcode
from mcap.records import ChunkIndex
from numpy.typing import NDArray

from replay_kit.core.message import Message
from replay_kit.logs.mcap.contents import Part, Row, messages_alone
from replay_kit.logs.mcap.records import RECORD_ERRORS, chunk_contents, file_records, parse_chunk
from replay_kit.logs.mcap.summary import Channels, Summary, read_summary
from replay_kit.logs.shared.blocks import Overview, TopicExtent

#: A file with fewer messages than this, and fewer bytes of them, is read whole in a second or so.
FEW_MESSAGES, FEW_BYTES = 50_000, 16_000_000
# decoded of each channel, and chunks in which they are looked for
_MOST_FIRST, _MOST_CHUNKS = 100, 4
# looked at for the first, and for the last, time of a channel; more only where chunks overlap each other
_MOST_INDEXES = 16
_INDEX_HEAD = struct.Struct("<BQHI")
_INDEX_ENTRY = np.dtype([("log_ns", "<u8"), ("offset", "<u8")])


def overview_of(
    file: BinaryIO,
    decoded: Callable[[Channels, Part, Row], Message | None],
    rename: Callable[[str], str],
) -> Overview | str:
    """Return the overview of an open file, or why its index does not suffice; empty for a file small enough to read whole.

    Args:
        file: The file.
        decoded: Returns a decoded message; None if undecodable.
        rename: Returns the name of a topic of the file.
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
    """Return the chunks with messages of each channel, in file order."""
    held: dict[int, list[ChunkIndex]] = defaultdict(list)
    for chunk in summary.chunks:
        for number in chunk.message_index_offsets:
            held[number].append(chunk)
    return held


def problem_of(summary: Summary) -> str:
    """Return why an index does not suffice; empty if it does."""
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
    """Return a channel's earliest or latest log time [ns] from its message indexes; None if too many chunks may hold it."""
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
    """Return a channel's message index in a chunk: ``log_ns``, and ``offset`` in the contents.

    Raises:
        struct.error, ValueError: ``RECORD_ERRORS``; the index is not at the offset in the summary.
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
    decoded: Callable[[Channels, Part, Row], Message | None],
) -> Iterator[Message]:
    """Yield the first decodable messages of each channel.

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
    for offset in sorted(chunks):
        record = next(file_records(file, offset, offset + chunks[offset].chunk_length))
        part = messages_alone(chunk_contents(parse_chunk(record.body)))
        for row in part.rows():
            if left.get(row[0], 0):
                left[row[0]] -= 1
                if (message := decoded(channels, part, row)) is not None:
                    yield message
