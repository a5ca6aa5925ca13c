"""Chunks of an MCAP file as columns; an overview by its index in a few reads, and messages in order of log time for any order of chunks.

Recorders and tools write topic after topic, or chunks that overlap in time. If by the message indexes messages are later than the reorder
window allows, the chunks are read in order of their first times. A file whose clock was set back by more than a day keeps its order.
"""

import struct
import zlib
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from io import BytesIO
from operator import attrgetter
from typing import BinaryIO, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard
from mcap.opcode import Opcode
from mcap.records import Chunk, ChunkIndex
from numpy.typing import NDArray

from replay_kit.core.arrays import Indices, Mask, Times
from replay_kit.core.message import Message
from replay_kit.logs.blocks import Block, ReadStatistics, block_of
from replay_kit.logs.decode.decoders import Channels
from replay_kit.logs.mcap.records import (
    HEAD_SIZE,
    INNER,
    MAX_SIZE,
    RECORD_ERRORS,
    RECORD_HEAD,
    Summary,
    file_records,
    index_entries,
    parse,
)
from replay_kit.logs.merge import FAR_NS

#: Largest chunk decompressed whatever its bytes in the file [bytes], and how many bytes each of them may become beyond that: the
#: uncompressed size is the file's claim, and may be a decompression bomb.
MAX_CONTENTS, MAX_RATIO = 1 << 25, 8
_PIECE = 1 << 20
#: Bytes of a chunk's body before the name of its compression and its data: times, size, checksum, and two lengths.
CHUNK_HEAD = 40
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
#: Least length of a message record's body [bytes].
SHORTEST = MESSAGE_START.itemsize - HEAD_SIZE
#: A message: channel, sequence, log and publish time [ns], where its payload begins and ends in the contents, its ordinal in the file.
Row = tuple[int, int, int, int, int, int, int]


class ChunkError(ValueError):
    """Chunk with contents that cannot be decompressed or fail their checksum; the text states the reason."""


class Part(NamedTuple):
    """Consecutive messages, in the file or in time.

    Attributes:
        contents: Bytes with their records.
        offset: Start of each message record, shape (n,), increasing [bytes].
        head: ``MESSAGE_START`` of each.
        ordinal: Ordinal of each in the file.
    """

    contents: bytes
    offset: NDArray[np.int64]
    head: NDArray[np.void]
    ordinal: NDArray[np.int64]

    @property
    def stop(self) -> NDArray[np.int64]:
        """End of each message record, shape (n,) [bytes]."""
        stop: NDArray[np.int64] = self.offset + HEAD_SIZE + self.head["length"].astype(np.int64)
        return stop

    def take(self, which: Mask) -> "Part":
        """Return a subset of the messages."""
        return Part(self.contents, self.offset[which], self.head[which], self.ordinal[which])

    def rows(self) -> Iterator[Row]:
        """Yield the messages."""
        columns = (self.head[name].tolist() for name in MESSAGE_START.names[2:])  # type: ignore[index]
        starts, stops = (self.offset + MESSAGE_START.itemsize).tolist(), self.stop.tolist()
        return zip(*columns, starts, stops, self.ordinal.tolist(), strict=True)


class Opened(NamedTuple):
    """Contents of a chunk.

    Attributes:
        part: Its messages, counted from 0.
        declared: Opcode and body of its schemas and channels.
        length: Length of the chunk's body by its own statements [bytes].
        is_checked: Whether a checksum covers it.
    """

    part: Part
    declared: Sequence[tuple[int, bytes]]
    length: int
    is_checked: bool


def open_chunk(body: bytes) -> Opened:
    """Return the contents of the chunk in a record's body.

    Raises:
        struct.error, ValueError, OverflowError, mcap.exceptions.McapError: ``RECORD_ERRORS``; the body is no sound chunk.
    """
    chunk = parse(Chunk, body)
    length = CHUNK_HEAD + len(chunk.compression) + len(chunk.data)
    if chunk.uncompressed_crc == 0 and length != len(body):
        raise ChunkError("its head is damaged")
    return Opened(*walk(_contents(chunk), chunk), length, chunk.uncompressed_crc != 0)


def own_length(head: bytes) -> int:
    """Return the length of the chunk that begins with these bytes, by its own statements [bytes].

    Raises:
        struct.error: The bytes end before its data.
    """
    (named,) = struct.unpack_from("<I", head, CHUNK_HEAD - 12)
    (data,) = struct.unpack_from("<Q", head, CHUNK_HEAD - 8 + named)
    return int(CHUNK_HEAD + named + data)


def _contents(chunk: Chunk) -> bytes:
    """Return the contents of a chunk, decompressed and checked against size and CRC.

    Raises:
        ChunkError: The claimed size is implausible or wrong, or the CRC differs.
    """
    size, crc = chunk.uncompressed_size, chunk.uncompressed_crc
    most = min(max(MAX_CONTENTS, MAX_RATIO * len(chunk.data)), MAX_SIZE)
    limit = most if chunk.compression else MAX_SIZE
    if size > limit:
        raise ChunkError(f"claims {size} bytes, more than the {limit} that are read at once")
    data = _decompressed(chunk)
    if len(data) != size:
        raise ChunkError(f"holds {len(data)} bytes where {size} are claimed")
    if crc not in (0, zlib.crc32(data)):
        raise ChunkError("its checksum does not match")
    return data


def _decompressed(chunk: Chunk) -> bytes:
    """Return the decompressed data, at most one byte more than claimed."""
    if chunk.compression == "":
        return chunk.data
    pieces = {"zstd": _zstd_pieces, "lz4": _lz4_pieces}.get(chunk.compression)
    if pieces is None:
        raise ChunkError(f"compression {chunk.compression!r} is not known; known: zstd, lz4, none")
    # grows with the data and returns its bytes without a copy
    out = BytesIO()
    try:
        for piece in pieces(chunk.data, chunk.uncompressed_size + 1):
            out.write(piece)
    except (zstandard.ZstdError, RuntimeError) as error:
        raise ChunkError(f"its {chunk.compression} data are damaged: {error}") from error
    return out.getvalue()


def _zstd_pieces(data: bytes, limit: int) -> Iterator[bytes]:
    with zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True) as reader:
        while limit > 0 and (piece := reader.read(min(limit, _PIECE))):
            limit -= len(piece)
            yield piece


def _lz4_pieces(data: bytes, limit: int) -> Iterator[bytes]:
    decompressor = lz4.frame.LZ4FrameDecompressor()
    while limit > 0 and not decompressor.eof:
        piece = decompressor.decompress(data, max_length=min(limit, _PIECE))
        data = b""
        if not piece and decompressor.needs_input:
            return
        limit -= len(piece)
        yield piece


def walk(data: bytes, chunk: Chunk | None = None) -> tuple[Part, list[tuple[int, bytes]]]:
    """Return the messages in contents, and opcode and body of schemas and channels.

    Args:
        data: Contents.
        chunk: Their chunk; one without a checksum holds schemas, channels and messages within its span alone.

    Raises:
        ChunkError: The contents are not whole records, or contradict the chunk.
    """
    strict = chunk is not None and chunk.uncompressed_crc == 0
    offset: list[int] = []
    declared: list[tuple[int, bytes]] = []
    # walking is what takes the time; the numbers are gathered for all messages at once
    end, size, unpack, add = 0, len(data), RECORD_HEAD.unpack_from, offset.append
    message = int(Opcode.MESSAGE)
    while end + HEAD_SIZE <= size:
        opcode, length = unpack(data, end)
        stop = end + HEAD_SIZE + length
        if stop > size or opcode == 0 or (strict and opcode not in INNER):
            break
        if opcode == message:
            if length < SHORTEST:
                break
            add(end)
        elif opcode in INNER:
            declared.append((opcode, data[end + HEAD_SIZE : stop]))
        end = stop
    if end < size:
        raise ChunkError(f"no whole record begins at byte {end} of its contents")
    part = Part(data, np.array(offset, np.int64), _heads(data, offset), np.arange(len(offset)))
    if strict and chunk is not None and 0 < chunk.message_end_time >= chunk.message_start_time:
        log_ns = part.head["log_ns"]
        if ((log_ns < chunk.message_start_time) | (log_ns > chunk.message_end_time)).any():
            raise ChunkError("it has no checksum, and a message outside the span that it states")
    return part, declared


def _heads(data: bytes, offset: list[int]) -> NDArray[np.void]:
    if not offset:
        return np.empty(0, MESSAGE_START)
    # a record may begin at any byte
    anywhere: NDArray[np.void] = np.ndarray(
        (len(data) - MESSAGE_START.itemsize + 1,), MESSAGE_START, data, strides=(1,)
    )
    return anywhere[offset]


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
        channel = np.repeat(numbers, [part.size for part in parts])[order]
        start, end = chunk.message_start_time, chunk.message_end_time
        if not start <= times.min() <= times.max() <= end <= _LAST_NS:
            return None
        for number in numbers:
            lag, newest[number] = _lag(times[channel == number], newest.get(number, 0))
            if lag > FAR_NS:
                return None
        lag, newest[-1] = _lag(times, newest.get(-1, 0))
        latest = max(latest, lag)
    counted = summary.statistics is not None and summary.statistics.message_count == sum(counts)
    return counts if latest > window_ns and counted else None


def _lag(times: Times, newest: int) -> tuple[int, int]:
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

    def chosen(at: Indices) -> Part:
        contents = b"".join([pieces[k] for k in at.tolist()])
        return Part(contents, np.cumsum(lengths[at]) - lengths[at], head[at], ordinal[at])

    return chosen(order[:before]), chosen(order[before:])
