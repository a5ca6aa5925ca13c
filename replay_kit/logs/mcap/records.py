"""Records of an MCAP file with their byte offsets, and the contents of chunks, in bounded memory.

The framing (one byte of opcode, eight of length) is parsed here, not by ``mcap.stream_reader``, as a damaged file must be read by offset
and the library decompresses any claimed size. Record bodies are parsed by ``mcap.records``.
"""

import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import BinaryIO, TypeVar

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import McapRecord

MAGIC = b"\x89MCAP0\r\n"

#: Largest record read [bytes]; a larger claim counts as damage.
MAX_SIZE = 1 << 28

#: Largest chunk decompressed whatever its bytes in the file [bytes], and how many bytes each of them may become beyond that: the
#: uncompressed size is the file's claim, and may be a decompression bomb.
MAX_CONTENTS, MAX_RATIO = 1 << 25, 8

#: What the record parsers of ``mcap.records`` raise on bytes that are no such record.
RECORD_ERRORS = (struct.error, ValueError, OverflowError, McapError)

#: Opcode and length before each record's body [bytes].
HEAD_SIZE = 9

#: Opcode and length.
RECORD_HEAD = struct.Struct("<BQ")
_PIECE = 1 << 20
_CHUNK_HEAD = struct.Struct("<QQQII")
_KEPT = frozenset(
    {
        Opcode.SCHEMA,
        Opcode.CHANNEL,
        Opcode.MESSAGE,
        Opcode.CHUNK,
        Opcode.DATA_END,
        Opcode.FOOTER,
        Opcode.STATISTICS,
        Opcode.HEADER,
        Opcode.METADATA,
        Opcode.CHUNK_INDEX,
        Opcode.ATTACHMENT_INDEX,
        Opcode.METADATA_INDEX,
    }
)
#: What a chunk holds, as plain numbers.
INNER = frozenset({int(Opcode.SCHEMA), int(Opcode.CHANNEL), int(Opcode.MESSAGE)})

_Parsed = TypeVar("_Parsed", bound=McapRecord)


class ChunkError(ValueError):
    """Chunk with contents that cannot be decompressed or fail their checksum; the text states the reason."""


@dataclass(frozen=True, slots=True)
class Record:
    """Record of the file, or the rest of a damaged one.

    Attributes:
        opcode: Opcode; 0 if no record begins here.
        offset: Start [bytes].
        end: End of the record or the file [bytes].
        body: Bytes after opcode and length; empty for skipped record types.
        whole: False if the file ends inside it or its length is implausible; nothing follows it then.
        crc: CRC-32 of the file from the first record to this one.
    """

    opcode: int
    offset: int
    end: int
    body: bytes
    whole: bool
    crc: int


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
    def span(self) -> tuple[int, int] | None:
        """Stated first and last time of its messages [ns]; None if impossible."""
        return (self.start_ns, self.end_ns) if 0 < self.end_ns >= self.start_ns else None


def parse_chunk(body: bytes) -> Chunk:
    """Return the chunk in a record's body; ``data`` ends with a truncated body.

    The library would copy the data.

    Raises:
        struct.error, ValueError: ``RECORD_ERRORS``; the body is no chunk.
    """
    start_ns, end_ns, size, crc, name_length = _CHUNK_HEAD.unpack_from(body)
    offset = _CHUNK_HEAD.size + name_length
    compression = body[_CHUNK_HEAD.size : offset].decode("utf-8")
    (length,) = struct.unpack_from("<Q", body, offset)
    return Chunk(
        start_ns, end_ns, size, crc, compression, memoryview(body)[offset + 8 : offset + 8 + length]
    )


def file_records(
    file: BinaryIO, start: int, size: int, bound: Callable[[int], int | None] | None = None
) -> Iterator[Record]:
    """Yield the records of a file up to the footer or the first incomplete record, inclusive.

    Args:
        file: Open log; its position may change between records.
        start: Byte offset of the first record.
        size: Size of the file [bytes].
        bound: Returns the next known start of a record after an offset; a record that extends beyond it is incomplete.
    """
    offset, crc = start, zlib.crc32(MAGIC)
    while True:
        file.seek(offset)
        head = file.read(HEAD_SIZE)
        if len(head) < HEAD_SIZE:
            yield Record(0, offset, size, b"", False, crc)
            return
        opcode, length = RECORD_HEAD.unpack(head)
        end = offset + HEAD_SIZE + length
        limit = (bound(offset) if bound else None) or size
        kept = opcode in _KEPT
        if opcode == 0 or end > limit or (kept and length > MAX_SIZE):
            rest = (
                file.read(min(limit - offset - HEAD_SIZE, MAX_SIZE))
                if opcode == Opcode.CHUNK and limit > offset + HEAD_SIZE
                else b""
            )
            yield Record(opcode, offset, size, rest, False, crc)
            return
        before, crc = crc, zlib.crc32(head, crc)
        body = file.read(length) if kept else b""
        crc = zlib.crc32(body, crc) if kept else crc_of_rest(file, length, crc)
        yield Record(opcode, offset, end, body, True, before)
        if opcode == Opcode.FOOTER:
            return
        offset = end


def crc_of_rest(file: BinaryIO, length: int, crc: int) -> int:
    """Return the CRC updated with the next bytes, read in pieces: attachments may exceed memory."""
    while length > 0:
        piece = file.read(min(length, _PIECE))
        if not piece:
            break
        crc = zlib.crc32(piece, crc)
        length -= len(piece)
    return crc


def parse(kind: type[_Parsed], body: bytes) -> _Parsed:
    """Return a record's body parsed by the library.

    Raises:
        struct.error, ValueError, OverflowError, mcap.exceptions.McapError: ``RECORD_ERRORS``; the body is no such record.
    """
    # every record class of the library has it, their base does not declare it
    value: _Parsed = kind.read(ReadDataStream(BytesIO(body)))  # type: ignore[attr-defined]
    return value


def chunk_contents(chunk: Chunk) -> bytes:
    """Return the contents of a whole chunk, decompressed and checked against size and CRC.

    Raises:
        ChunkError: The claimed size is implausible or wrong, or the CRC differs.
    """
    _check_claim(chunk)
    data = _decompress(chunk, strict=True)
    if len(data) != chunk.size:
        raise ChunkError(f"holds {len(data)} bytes where {chunk.size} are claimed")
    if chunk.crc not in (0, zlib.crc32(data)):
        raise ChunkError("its checksum does not match")
    return data


def cut_contents(chunk: Chunk) -> bytes:
    """Return the recoverable contents of a chunk whose end is missing or unknown; complete contents must match the checksum.

    Raises:
        ChunkError: The claimed size is implausible, the compression is unknown, or the CRC of complete contents differs.
    """
    _check_claim(chunk)
    data = _decompress(chunk, strict=False)
    # bytes after the chunk's data in the file do not belong to it
    data = data[: chunk.size]
    if len(data) == chunk.size and chunk.crc not in (0, zlib.crc32(data)):
        raise ChunkError("its checksum does not match")
    return data


def _check_claim(chunk: Chunk) -> None:
    limit = (
        min(max(MAX_CONTENTS, MAX_RATIO * len(chunk.data)), MAX_SIZE)
        if chunk.compression
        else MAX_SIZE
    )
    if chunk.size > limit:
        raise ChunkError(f"claims {chunk.size} bytes, more than the {limit} that are read at once")


def _decompress(chunk: Chunk, strict: bool) -> bytes:
    """Return the decompressed data, at most one byte more than claimed."""
    if chunk.compression == "":
        return bytes(chunk.data)
    limit = chunk.size + 1
    if chunk.compression == "zstd":
        pieces = _zstd_pieces(chunk.data, limit)
    elif chunk.compression == "lz4":
        pieces = _lz4_pieces(chunk.data, limit)
    else:
        raise ChunkError(f"compression {chunk.compression!r} is not known; known: zstd, lz4, none")
    # grows with the data and returns its bytes without a copy
    out = BytesIO()
    try:
        for piece in pieces:
            out.write(piece)
    except (zstandard.ZstdError, RuntimeError) as error:
        if strict:
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
