"""Chunks of an MCAP file: their contents, decompressed in bounded memory and checked, and the messages in them as columns."""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard
from mcap.opcode import Opcode
from numpy.typing import NDArray

from replay_kit.logs.mcap.records import HEAD_SIZE, INNER, MAX_SIZE, RECORD_HEAD

#: Largest chunk decompressed whatever its bytes in the file [bytes], and how many bytes each of them may become beyond that: the
#: uncompressed size is the file's claim, and may be a decompression bomb.
MAX_CONTENTS, MAX_RATIO = 1 << 25, 8
_PIECE = 1 << 20
_HEAD = struct.Struct("<QQQII")
#: Length of a chunk's body before the name of its compression and its data [bytes].
CHUNK_HEAD = _HEAD.size + 8
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


@dataclass(frozen=True, slots=True)
class Chunk:
    """Chunk record with compressed contents.

    Attributes:
        start_ns: Stated earliest log time [ns].
        end_ns: Stated latest log time [ns].
        size: Stated size of the decompressed contents [bytes].
        crc: CRC-32 of the contents; 0 for none.
        compression: ``zstd``, ``lz4`` or empty.
        data: Compressed contents.
    """

    start_ns: int
    end_ns: int
    size: int
    crc: int
    compression: str
    data: memoryview

    @property
    def length(self) -> int:
        """Length of the body by its own statements [bytes]."""
        return CHUNK_HEAD + len(self.compression) + len(self.data)

    @property
    def span(self) -> tuple[int, int] | None:
        """Stated first and last time of its messages [ns]; None if impossible."""
        return (self.start_ns, self.end_ns) if 0 < self.end_ns >= self.start_ns else None


def own_length(head: bytes) -> int:
    """Return the length of the chunk that begins with these bytes, by its own statements [bytes].

    Raises:
        struct.error: The bytes end before its data.
    """
    named = _HEAD.unpack_from(head)[4]
    (data,) = struct.unpack_from("<Q", head, _HEAD.size + named)
    return int(CHUNK_HEAD + named + data)


def parse_chunk(body: bytes) -> Chunk:
    """Return the chunk in a record's body, without a copy of its data.

    Raises:
        struct.error, ValueError: ``RECORD_ERRORS``; the body is no chunk.
    """
    start_ns, end_ns, size, crc, named = _HEAD.unpack_from(body)
    end = own_length(body)
    if end > len(body):
        raise ValueError("its head is damaged")
    name = body[_HEAD.size : _HEAD.size + named].decode("utf-8")
    return Chunk(start_ns, end_ns, size, crc, name, memoryview(body)[CHUNK_HEAD + named : end])


def chunk_contents(chunk: Chunk) -> bytes:
    """Return the contents of a chunk, decompressed and checked against size and CRC.

    Raises:
        ChunkError: The claimed size is implausible or wrong, or the CRC differs.
    """
    most = min(max(MAX_CONTENTS, MAX_RATIO * len(chunk.data)), MAX_SIZE)
    limit = most if chunk.compression else MAX_SIZE
    if chunk.size > limit:
        raise ChunkError(f"claims {chunk.size} bytes, more than the {limit} that are read at once")
    data = _decompress(chunk)
    if len(data) != chunk.size:
        raise ChunkError(f"holds {len(data)} bytes where {chunk.size} are claimed")
    if chunk.crc not in (0, zlib.crc32(data)):
        raise ChunkError("its checksum does not match")
    return data


def _decompress(chunk: Chunk) -> bytes:
    """Return the decompressed data, at most one byte more than claimed."""
    if chunk.compression == "":
        return bytes(chunk.data)
    pieces = {"zstd": _zstd_pieces, "lz4": _lz4_pieces}.get(chunk.compression)
    if pieces is None:
        raise ChunkError(f"compression {chunk.compression!r} is not known; known: zstd, lz4, none")
    # grows with the data and returns its bytes without a copy
    out = BytesIO()
    try:
        for piece in pieces(chunk.data, chunk.size + 1):
            out.write(piece)
    except (zstandard.ZstdError, RuntimeError) as error:
        raise ChunkError(f"its {chunk.compression} data are damaged: {error}") from error
    return out.getvalue()


def _zstd_pieces(data: memoryview, limit: int) -> Iterator[bytes]:
    with zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True) as reader:
        while limit > 0 and (piece := reader.read(min(limit, _PIECE))):
            limit -= len(piece)
            yield piece


def _lz4_pieces(data: memoryview | bytes, limit: int) -> Iterator[bytes]:
    decompressor = lz4.frame.LZ4FrameDecompressor()
    while limit > 0 and not decompressor.eof:
        piece = decompressor.decompress(data, max_length=min(limit, _PIECE))
        data = b""
        if not piece and decompressor.needs_input:
            return
        limit -= len(piece)
        yield piece


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

    def take(self, which: NDArray[np.bool_] | NDArray[np.intp]) -> "Part":
        """Return a subset of the messages."""
        return Part(self.contents, self.offset[which], self.head[which], self.ordinal[which])

    def rows(self) -> Iterator[Row]:
        """Yield the messages."""
        columns = (self.head[name].tolist() for name in MESSAGE_START.names[2:])  # type: ignore[index]
        starts, stops = (self.offset + MESSAGE_START.itemsize).tolist(), self.stop.tolist()
        return zip(*columns, starts, stops, self.ordinal.tolist(), strict=True)


def walk(data: bytes, chunk: Chunk | None = None) -> tuple[Part, list[tuple[int, int, int]]]:
    """Return the messages in contents, and opcode, start and end of the bodies of schemas and channels.

    Args:
        data: Contents.
        chunk: Their chunk; one without a checksum holds schemas, channels and messages within its span alone.

    Raises:
        ChunkError: The contents are not whole records, or contradict the chunk.
    """
    strict = chunk is not None and chunk.crc == 0
    offset: list[int] = []
    declared: list[tuple[int, int, int]] = []
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
            declared.append((opcode, end + HEAD_SIZE, stop))
        end = stop
    if end < size:
        raise ChunkError(f"no whole record begins at byte {end} of its contents")
    at = np.array(offset, np.int64)
    part = Part(data, at, _heads(data, offset), np.arange(at.size))
    if strict and chunk is not None and (span := chunk.span) is not None:
        log_ns = part.head["log_ns"]
        if ((log_ns < span[0]) | (log_ns > span[1])).any():
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
