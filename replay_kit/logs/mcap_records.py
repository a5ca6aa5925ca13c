"""Records of an MCAP file with their byte offsets, and the contents of chunks, in bounded memory.

The framing (one byte of opcode, eight of length) is walked here and not by ``mcap.stream_reader`` because a damaged file
needs to know where each record stands, and because the library reads and decompresses whatever size a file claims. What is
inside a record is parsed by ``mcap.records``.
"""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import BinaryIO, TypeVar

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex, DataEnd, Footer, Schema, Statistics

MAGIC = b"\x89MCAP0\r\n"

#: Largest record read and largest chunk decompressed [bytes]; a file that claims more is taken as damaged there.
MAX_SIZE = 1 << 30

#: What the record parsers of ``mcap.records`` raise on bytes that are no such record.
RECORD_ERRORS = (struct.error, ValueError, OverflowError, McapError)

#: Opcode and length before each record's body [bytes].
HEAD_SIZE = 9

_HEAD = struct.Struct("<BQ")
_PIECE = 1 << 20
_KEPT = frozenset({Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK, Opcode.DATA_END, Opcode.FOOTER, Opcode.STATISTICS})
_KEPT |= {Opcode.CHUNK_INDEX}

_Parsed = TypeVar("_Parsed", Channel, Chunk, ChunkIndex, DataEnd, Footer, Schema, Statistics)


class ChunkError(ValueError):
    """A chunk whose contents cannot be trusted or had; the text says why."""


@dataclass(frozen=True, slots=True)
class Record:
    """One record of the file, or what is left of it.

    Attributes:
        opcode: What it is; 0 when no record begins here.
        offset: Where it begins [bytes].
        end: Where it ends or the file does [bytes].
        body: Its bytes after opcode and length; empty for records that a reader has no use for.
        whole: False when the file ends inside it or it claims more than is believable; nothing follows it then.
        crc: CRC-32 of the file before it, from where the walk began.
    """

    opcode: int
    offset: int
    end: int
    body: bytes
    whole: bool
    crc: int


def file_records(file: BinaryIO, start: int, size: int) -> Iterator[Record]:
    """Yield the records of a file up to and with the footer, or up to and with the first that is not whole.

    Args:
        file: The open log; it may be moved between two records.
        start: Byte offset of the first record.
        size: Size of the file [bytes].
    """
    offset, crc = start, zlib.crc32(MAGIC)
    while True:
        file.seek(offset)
        head = file.read(HEAD_SIZE)
        if len(head) < HEAD_SIZE:
            yield Record(0, offset, size, b"", False, crc)
            return
        opcode, length = _HEAD.unpack(head)
        end = offset + HEAD_SIZE + length
        kept = opcode in _KEPT
        if opcode == 0 or end > size or (kept and length > MAX_SIZE):
            rest = file.read(min(size - offset - HEAD_SIZE, MAX_SIZE)) if opcode == Opcode.CHUNK else b""
            yield Record(opcode, offset, size, rest, False, crc)
            return
        before, crc = crc, zlib.crc32(head, crc)
        body = file.read(length) if kept else b""
        crc = zlib.crc32(body, crc) if kept else _crc_of_rest(file, length, crc)
        yield Record(opcode, offset, end, body, True, before)
        if opcode == Opcode.FOOTER:
            return
        offset = end


def _crc_of_rest(file: BinaryIO, length: int, crc: int) -> int:
    """Return the CRC carried over the next bytes, read in pieces: an attachment may be larger than memory."""
    while length > 0:
        piece = file.read(min(length, _PIECE))
        if not piece:
            break
        crc = zlib.crc32(piece, crc)
        length -= len(piece)
    return crc


def parse(kind: type[_Parsed], body: bytes) -> _Parsed:
    """Return a record's body as the library's value.

    Raises:
        struct.error, ValueError, OverflowError, mcap.exceptions.McapError: ``RECORD_ERRORS``; the body is no such record.
    """
    value: _Parsed = kind.read(ReadDataStream(BytesIO(body)))
    return value


def chunk_contents(chunk: Chunk) -> bytes:
    """Return the records of a whole chunk, decompressed and checked against size and CRC.

    Raises:
        ChunkError: The size claimed is not believable, the data do not decompress to it, or the CRC differs.
    """
    if chunk.uncompressed_size > MAX_SIZE:
        raise ChunkError(f"claims {chunk.uncompressed_size} bytes, more than the {MAX_SIZE} that are read at once")
    data = _decompress(chunk, strict=True)
    if len(data) != chunk.uncompressed_size:
        raise ChunkError(f"holds {len(data)} bytes where {chunk.uncompressed_size} are claimed")
    if chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        raise ChunkError("its checksum does not match")
    return data


def cut_contents(chunk: Chunk) -> bytes:
    """Return what can be had from a chunk whose end is missing; no checksum covers it.

    Raises:
        ChunkError: The compression is unknown.
    """
    return _decompress(chunk, strict=False)


def _decompress(chunk: Chunk, strict: bool) -> bytes:
    """Return at most one byte more than claimed, whatever the compressed data would unfold to."""
    if chunk.compression == "":
        return chunk.data
    limit = min(chunk.uncompressed_size, MAX_SIZE) + 1
    if chunk.compression == "zstd":
        pieces = _zstd_pieces(chunk.data, limit)
    elif chunk.compression == "lz4":
        pieces = _lz4_pieces(chunk.data, limit)
    else:
        raise ChunkError(f"compression {chunk.compression!r} is not known; known: zstd, lz4, none")
    out = bytearray()
    try:
        for piece in pieces:
            out += piece
    except (zstandard.ZstdError, RuntimeError) as error:
        if strict:
            raise ChunkError(f"its {chunk.compression} data are damaged: {error}") from error
    return bytes(out)


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


def inner_records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield (opcode, start, end) of the body of each whole record inside a chunk's contents.

    Bytes after the last whole record are left to the caller, who sees that the last ``end`` is short of the length.
    """
    offset, size = 0, len(data)
    while offset + HEAD_SIZE <= size:
        opcode, length = _HEAD.unpack_from(data, offset)
        offset += HEAD_SIZE
        if opcode == 0 or offset + length > size:
            return
        yield opcode, offset, offset + length
        offset += length


@dataclass(frozen=True, slots=True)
class Summary:
    """What the end of a finished file says about the whole of it.

    Attributes:
        schemas: By number.
        channels: By number.
        chunk_offsets: Where chunks begin [bytes], increasing.
    """

    schemas: dict[int, Schema]
    channels: dict[int, Channel]
    chunk_offsets: tuple[int, ...]


def read_summary(file: BinaryIO, size: int) -> Summary:
    """Return the summary section; empty when the file has none or its end is missing or damaged.

    Args:
        file: The open log.
        size: Size of the file [bytes].
    """
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    offsets: set[int] = set()
    length = HEAD_SIZE + 20 + len(MAGIC)
    file.seek(max(0, size - length))
    tail = file.read(length)
    if len(tail) == length and tail.endswith(MAGIC) and _HEAD.unpack_from(tail) == (Opcode.FOOTER, 20):
        start = parse(Footer, tail[HEAD_SIZE:]).summary_start or size
        for record in file_records(file, start, size) if start < size else ():
            try:
                if record.opcode == Opcode.SCHEMA:
                    schema = parse(Schema, record.body)
                    schemas[schema.id] = schema
                elif record.opcode == Opcode.CHANNEL:
                    channel = parse(Channel, record.body)
                    channels[channel.id] = channel
                elif record.opcode == Opcode.CHUNK_INDEX:
                    offsets.add(parse(ChunkIndex, record.body).chunk_start_offset)
            except RECORD_ERRORS:
                continue
    return Summary(schemas, channels, tuple(sorted(offset for offset in offsets if offset < size)))
