"""Index of an MCAP file: an overview by a few reads, and the messages in order of log time for any order of its chunks.

Recorders and tools write topic after topic, or chunks that overlap in time. If by the message indexes messages are later than the reorder
window allows, the chunks are read in order of their first times. A file whose clock was set back by more than a day keeps its order.
"""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from operator import attrgetter
from typing import BinaryIO

import numpy as np
from mcap.records import ChunkIndex
from numpy.typing import NDArray

from replay_kit.core.message import Message
from replay_kit.logs.blocks import Block, ReadStatistics, block_of
from replay_kit.logs.decode.decoders import Channels
from replay_kit.logs.mcap.chunk import Part, Row, open_chunk
from replay_kit.logs.mcap.records import (
    HEAD_SIZE,
    RECORD_ERRORS,
    Summary,
    file_records,
    index_entries,
)
from replay_kit.logs.merge import FAR_NS

#: A file with fewer messages than this, and fewer bytes of them, is read whole in a second or so.
FEW_MESSAGES, FEW_BYTES = 50_000, 16_000_000
# decoded of each channel, and chunks in which they are looked for
_MOST_FIRST, _MOST_CHUNKS = 100, 4
# bytes of chunks that are put in order at once
_AT_ONCE = 1 << 25
_LAST_NS = 2**63 - 1


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
    statistics: ReadStatistics,
) -> Block | str:
    """Return the first and last time of each topic in each chunk, with the first messages of each topic, in order of time.

    Args:
        file: The open file.
        summary: Its summary.
        channels: Its channels.
        decoded: Returns a decoded message; None if undecodable.
        statistics: Statistics that count all messages of the file.

    Returns:
        The times and messages; or why the index does not suffice, empty for a file small enough to read whole.
    """
    stated = summary.statistics
    if (problem := problem_of(summary)) or stated is None:
        return problem
    size = sum(chunk.uncompressed_size for chunk in summary.chunks)
    if stated.message_count < FEW_MESSAGES and size < FEW_BYTES:
        return ""
    ends, counts = list[tuple[int, str, str]](), Counter[int]()
    first: dict[int, list[ChunkIndex]] = defaultdict(list)
    messages = list[Message]()
    try:
        for chunk in summary.chunks:
            for number in chunk.message_index_offsets:
                sink, times = channels.sink(number), index_entries(file, number, chunk)["log_ns"]
                counts[number] += times.size
                spanned = (times.min(), times.max()) if times.size else ()
                ends += ((int(time), sink.topic, sink.schema) for time in spanned)
                if callable(sink.decode) and len(first[number]) < _MOST_CHUNKS:
                    first[number].append(chunk)
        some = {chunk.chunk_start_offset: chunk for each in first.values() for chunk in each}
        left = dict.fromkeys(first, _MOST_FIRST)
        for offset in sorted(some):
            part = _read_chunk(file, some[offset])[0]
            for row in part.rows():
                if left.get(row[0], 0):
                    left[row[0]] -= 1
                    messages += filter(None, [decoded(part, row)])
        held = block_of(sorted(ends), tuple(sorted(messages, key=attrgetter("time_ns"))))
    except RECORD_ERRORS as error:
        return f"its index or one of the first chunks is damaged: {error}"
    statistics.read.clear()
    for number, count in counts.items():
        sink = channels.sink(number)
        statistics.read[sink.topic] += count
        if isinstance(sink.decode, str):
            statistics.undecodable(sink.topic, sink.decode, count)
    return held


def _read_chunk(file: BinaryIO, listed: ChunkIndex) -> tuple[Part, bool]:
    """Return the messages of a chunk of the index, and whether a checksum covers them.

    Raises:
        struct.error, ValueError: ``RECORD_ERRORS``; it is damaged.
    """
    offset = listed.chunk_start_offset
    opened = open_chunk(next(file_records(file, offset, offset + listed.chunk_length)).body)
    return opened.part, opened.is_checked


def disordered(file: BinaryIO, summary: Summary, window_ns: int) -> list[int] | None:
    """Return the number of messages in each chunk; None if the file order suffices or the index does not show another.

    Args:
        file: The open file.
        summary: Summary of the file.
        window_ns: Reorder window [ns].
    """
    counts, newest, latest = list[int](), dict[int, int](), 0
    for chunk in summary.chunks:
        numbers = [*chunk.message_index_offsets]
        try:
            parts = [index_entries(file, number, chunk) for number in numbers]
        except RECORD_ERRORS:
            return None
        counts.append(sum(part.size for part in parts))
        if not counts[-1]:
            continue
        entries = np.concatenate(parts)
        order = np.argsort(entries["offset"], kind="stable")
        times = entries["log_ns"].astype(np.int64)[order]
        of = np.repeat(numbers, [part.size for part in parts])[order]
        start, end = chunk.message_start_time, chunk.message_end_time
        if not start <= times.min() <= times.max() <= end <= _LAST_NS:
            return None
        for number in numbers:
            lag, newest[number] = _lag(times[of == number], newest.get(number, 0))
            if lag > FAR_NS:
                return None
        lag, newest[-1] = _lag(times, newest.get(-1, 0))
        latest = max(latest, lag)
    counted = summary.statistics is not None and summary.statistics.message_count == sum(counts)
    return counts if latest > window_ns and counted else None


def _lag(times: NDArray[np.int64], newest: int) -> tuple[int, int]:
    """Return the largest lag of times behind the newest before them [ns], and the newest of all."""
    tops = np.maximum.accumulate(np.append(newest, times))
    return int((tops[1:] - times).max(initial=0)), int(tops[-1])


def in_time(
    file: BinaryIO, chunks: Sequence[ChunkIndex], counts: Sequence[int], statistics: ReadStatistics
) -> Iterator[Part]:
    """Yield the messages of a file in order of log time, equal times in file order.

    Args:
        file: The open file.
        chunks: Its chunks in file order.
        counts: Number of messages in each.
        statistics: Statistics that count damaged and unchecked chunks.
    """
    firsts = np.cumsum(counts) - counts
    order = sorted(range(len(chunks)), key=lambda k: chunks[k].message_start_time)
    starts = [chunks[k].message_start_time for k in order[1:]]
    waiting, size = list[Part](), 0
    for k, until in zip(order, [*starts, _LAST_NS], strict=True):
        chunk = chunks[k]
        size += chunk.uncompressed_size
        try:
            part, is_checked = _read_chunk(file, chunk)
        except RECORD_ERRORS as error:
            place = chunk.chunk_start_offset, chunk.chunk_length
            span = chunk.message_start_time, chunk.message_end_time
            statistics.lose(f"chunk skipped: {error}", *place, counts[k], span)
        else:
            if not is_checked:
                statistics.unchecked["chunks without a checksum"] += 1
            waiting.append(part._replace(ordinal=firsts[k] + part.ordinal))
        if waiting and (size > _AT_ONCE or until == _LAST_NS):
            done, left = _split(waiting, until)
            waiting, size = [left], 0
            if done.offset.size:
                yield done


def _split(parts: list[Part], until: int) -> tuple[Part, Part]:
    """Return the messages before a time [ns], and the others, in order of log time; the parts are emptied."""
    head, ordinal = (
        np.concatenate(each) for each in zip(*(part[2:] for part in parts), strict=True)
    )
    lengths = HEAD_SIZE + head["length"].astype(np.int64)
    spans = [zip(part.offset.tolist(), part.stop.tolist(), strict=True) for part in parts]
    pieces = [
        part.contents[start:stop]
        for part, each in zip(parts, spans, strict=True)
        for start, stop in each
    ]
    parts.clear()
    order = np.lexsort((ordinal, head["log_ns"]))
    before = np.searchsorted(head["log_ns"][order], until) if until < _LAST_NS else order.size

    def chosen(at: NDArray[np.intp]) -> Part:
        contents = b"".join([pieces[k] for k in at.tolist()])
        return Part(contents, np.cumsum(lengths[at]) - lengths[at], head[at], ordinal[at])

    return chosen(order[:before]), chosen(order[before:])
