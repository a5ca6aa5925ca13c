"""Index of an MCAP file: an overview by a few reads, and the messages in order of log time for any order of its chunks.

Recorders and tools write topic after topic, or chunks that overlap in time. If by the message indexes messages are later than the reorder
window allows, the file is read in time slices that fit into memory; some chunks are decompressed more than once. A file whose clock was set
back by more than a day keeps its order.
"""

import struct
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from operator import attrgetter
from typing import BinaryIO, NamedTuple

import numpy as np
from mcap.opcode import Opcode
from mcap.records import ChunkIndex
from numpy.typing import NDArray

from replay_kit.core.message import Message
from replay_kit.logs.mcap.channels import Channels
from replay_kit.logs.mcap.chunk import Chunk, Part, Row, chunk_contents, parse_chunk, walk
from replay_kit.logs.mcap.records import RECORD_ERRORS, file_records
from replay_kit.logs.mcap.summary import Summary
from replay_kit.logs.merge import FAR_NS
from replay_kit.logs.shared.blocks import Overview, ReadStatistics, TopicExtent

#: A file with fewer messages than this, and fewer bytes of them, is read whole in a second or so.
FEW_MESSAGES, FEW_BYTES = 50_000, 16_000_000
# decoded of each channel, and chunks in which they are looked for
_MOST_FIRST, _MOST_CHUNKS = 100, 4
# Bytes of a slice of time, about: its messages are held twice. Times that describe the messages of a chunk.
_SLICE, _TIMES = 1 << 26, 17
_LAST_NS = 2**63 - 1
_INDEX_HEAD = struct.Struct("<BQHI")
_INDEX_ENTRY = np.dtype([("log_ns", "<u8"), ("offset", "<u8")])


def problem_of(summary: Summary) -> str:
    """Return why an index does not suffice; empty if it does."""
    statistics = summary.statistics
    if statistics is None:
        return summary.problem or "it has no index, or its end is missing"
    located = {number for chunk in summary.chunks for number in chunk.message_index_offsets}
    counts = {number: count for number, count in statistics.channel_message_counts.items() if count}
    if sum(counts.values()) != statistics.message_count:
        return "its index does not count the messages of each topic"
    if not counts.keys() <= summary.channels.keys():
        return "its index does not declare all topics"
    if not counts.keys() <= located or len(summary.chunks) != statistics.chunk_count:
        return "its index does not locate the messages of each topic"
    return ""


def overview_of(
    file: BinaryIO,
    summary: Summary,
    channels: Channels,
    decoded: Callable[[Part, Row], Message | None],
) -> Overview | str:
    """Return the overview of an open file, or why its index does not suffice; empty for a file small enough to read whole.

    Args:
        file: The file.
        summary: Its summary.
        channels: Its channels.
        decoded: Returns a decoded message; None if undecodable.
    """
    statistics = summary.statistics
    if (problem := problem_of(summary)) or statistics is None:
        return problem
    size = sum(chunk.uncompressed_size for chunk in summary.chunks)
    if statistics.message_count < FEW_MESSAGES and size < FEW_BYTES:
        return ""
    held: dict[int, list[ChunkIndex]] = defaultdict(list)
    for chunk in summary.chunks:
        for number in chunk.message_index_offsets:
            held[number].append(chunk)
    try:
        topics = _topics(file, held, channels)
        first = sorted(_first_messages(file, channels, held, decoded), key=attrgetter("time_ns"))
    except RECORD_ERRORS as error:
        return f"its index or one of the first chunks is damaged: {error}"
    sinks = [channels.sink(number) for number in held]
    undecodable = {sink.topic: sink.decode for sink in sinks if isinstance(sink.decode, str)}
    return Overview(topics, undecodable, tuple(first))


def _topics(
    file: BinaryIO, held: Mapping[int, Sequence[ChunkIndex]], channels: Channels
) -> dict[str, TopicExtent]:
    """Return the extent of each topic by the message indexes."""
    topics: dict[str, TopicExtent] = {}
    for number, chunks in held.items():
        sink = channels.sink(number)
        for chunk in chunks:
            times = _index_entries(file, number, chunk)["log_ns"]
            if times.size:
                extent = TopicExtent(sink.schema, times.size, int(times.min()), int(times.max()))
                known = topics.get(sink.topic)
                topics[sink.topic] = extent if known is None else known.joined(extent)
    return topics


def _index_entries(file: BinaryIO, channel: int, chunk: ChunkIndex) -> NDArray[np.void]:
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
    decoded: Callable[[Part, Row], Message | None],
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
        _, part = _read_chunk(file, chunks[offset])
        for row in part.rows():
            if left.get(row[0], 0):
                left[row[0]] -= 1
                if (message := decoded(part, row)) is not None:
                    yield message


def _read_chunk(file: BinaryIO, listed: ChunkIndex) -> tuple[Chunk, Part]:
    """Return a chunk of the index and its messages.

    Raises:
        struct.error, ValueError: ``RECORD_ERRORS``; it is damaged.
    """
    offset = listed.chunk_start_offset
    chunk = parse_chunk(next(file_records(file, offset, offset + listed.chunk_length)).body)
    return chunk, walk(chunk_contents(chunk), chunk)[0]


class ChunkTimes(NamedTuple):
    """Log times of a chunk.

    Attributes:
        chunk: Index entry of the chunk.
        first: Ordinal of its first message in the file.
        messages: Number of messages.
        times: shape (17,) [ns], quantiles of the times in equal steps, from the first to the last that the chunk states.
    """

    chunk: ChunkIndex
    first: int
    messages: int
    times: NDArray[np.int64]


def disordered(file: BinaryIO, summary: Summary, window_ns: int) -> list[ChunkTimes] | None:
    """Return the times of each chunk; None if the file order suffices or the index does not show another.

    Args:
        file: The open file.
        summary: Summary of the file.
        window_ns: Reorder window [ns].
    """
    held, newest, first, latest = list[ChunkTimes](), dict[int, int](), 0, 0
    for chunk in summary.chunks:
        try:
            parts = [_index_entries(file, number, chunk) for number in chunk.message_index_offsets]
        except RECORD_ERRORS:
            return None
        if not parts:
            continue
        entries = np.concatenate(parts)
        order = np.argsort(entries["offset"], kind="stable")
        times = entries["log_ns"].astype(np.int64)[order]
        of = np.repeat([*chunk.message_index_offsets], [part.size for part in parts])[order]
        for number in chunk.message_index_offsets:
            lag, newest[number] = _lag(times[of == number], newest.get(number, 0))
            if lag > FAR_NS:
                return None
        lag, newest[-1] = _lag(times, newest.get(-1, 0))
        latest = max(latest, lag)
        if times.size:
            start, end = chunk.message_start_time, chunk.message_end_time
            # a message index that is damaged must not leave out messages
            if not start <= times.min() <= times.max() <= end <= _LAST_NS:
                return None
            at = np.linspace(0, times.size - 1, _TIMES).astype(np.int64)
            quantiles = np.sort(times)[at]
            quantiles[0], quantiles[-1] = start, end
            held.append(ChunkTimes(chunk, first, times.size, quantiles))
        first += times.size
    counted = summary.statistics is not None and summary.statistics.message_count == first
    return held if latest > window_ns and counted else None


def _lag(times: NDArray[np.int64], newest: int) -> tuple[int, int]:
    """Return the largest lag of times behind the newest before them [ns], and the newest of all."""
    tops = np.maximum.accumulate(np.append(newest, times))
    return int((tops[1:] - times).max(initial=0)), int(tops[-1])


def slices(file: BinaryIO, held: list[ChunkTimes], statistics: ReadStatistics) -> Iterator[Part]:
    """Yield the messages of a file in order of log time, equal times in file order.

    Args:
        file: The open file.
        held: Times of each chunk.
        statistics: Statistics that count damaged and unchecked chunks.
    """
    times = np.concatenate([each.times[1:] for each in held])
    sizes = np.repeat([each.chunk.uncompressed_size / (_TIMES - 1) for each in held], _TIMES - 1)
    order = np.argsort(times, kind="stable")
    filled = np.cumsum(sizes[order])
    cuts = times[order][np.searchsorted(filled, np.arange(_SLICE, filled[-1], _SLICE))]
    before, seen = min(int(each.times[0]) for each in held) - 1, set[int]()
    for begin, end in pairwise([before, *np.unique(np.append(cuts, times.max())).tolist()]):
        pieces, logged, ordinals = list[bytes](), [np.empty(0, np.int64)], [np.empty(0, np.int64)]
        for each in held:
            if each.times[0] > end or each.times[-1] <= begin:
                continue
            statistics_of = ReadStatistics() if each.first in seen else statistics
            seen.add(each.first)
            part = _checked(file, each, statistics_of)
            log_ns = part.head["log_ns"].astype(np.int64)
            at = np.flatnonzero((log_ns > begin) & (log_ns <= end))
            spans = zip(part.offset[at].tolist(), part.stop[at].tolist(), strict=True)
            pieces += [part.contents[start:stop] for start, stop in spans]
            logged.append(log_ns[at])
            ordinals.append(each.first + at)
        ordinal = np.concatenate(ordinals)
        in_time = np.lexsort((ordinal, np.concatenate(logged)))
        if in_time.size:
            part, _ = walk(b"".join([pieces[k] for k in in_time.tolist()]))
            yield part._replace(ordinal=ordinal[in_time])


def _checked(file: BinaryIO, each: ChunkTimes, statistics: ReadStatistics) -> Part:
    """Return the messages of a chunk; none, counted as lost, if it is damaged."""
    try:
        chunk, part = _read_chunk(file, each.chunk)
        log_ns, (first, *_, last) = part.head["log_ns"], each.times.tolist()
        if part.offset.size != each.messages or ((log_ns < first) | (log_ns > last)).any():
            raise ValueError("its messages are not those of its index")
    except RECORD_ERRORS as error:
        span = int(each.times[0]), int(each.times[-1])
        offset, length = each.chunk.chunk_start_offset, each.chunk.chunk_length
        statistics.lose(f"chunk skipped: {error}", offset, length, each.messages, span)
        return walk(b"")[0]
    if chunk.crc == 0:
        statistics.unchecked["chunks without a checksum"] += 1
    return part
