"""Chunks of an MCAP file, decompressed in bounded memory and checked, and the messages in them as columns."""

import struct
import zlib
from collections.abc import Iterator, Sequence
from io import BytesIO
from typing import NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard
from mcap.opcode import Opcode
from mcap.records import Chunk
from numpy.typing import NDArray

from replay_kit.logs.mcap.records import HEAD_SIZE, INNER, MAX_SIZE, RECORD_HEAD, parse

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

    def take(self, which: NDArray[np.bool_]) -> "Part":
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
