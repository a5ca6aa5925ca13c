"""Records of an MCAP file with their byte offsets, in bounded memory, and the index at its end.

The framing (one byte of opcode, eight of length) is parsed here, not by ``mcap.stream_reader``, as a damaged file must be read by offset
and the library decompresses any claimed size. Record bodies are parsed by ``mcap.records``.
"""

import struct
import zlib
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from io import SEEK_END, BytesIO
from typing import Any, BinaryIO, TypeVar

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    Footer,
    McapRecord,
    MetadataIndex,
    Schema,
    Statistics,
)
from numpy.typing import NDArray

from replay_kit.core.errors import ReplayKitError

# The budget of a message or a schema, equal for all encodings. A few bytes can claim billions of values: empty messages in an array take no
# bytes, compressed JSON a thousandth of its length. Decoders charge values before creating them; a message beyond it is undecodable.
#: Values that one message may hold: numbers, texts and lists count one each, mappings ``MAPPING``. They take about 40 MB at most.
MOST_VALUES = 1 << 19
#: Longest message that is decoded [bytes]; a longer one, such as a large image, can still be copied.
MOST_BYTES = 1 << 24
#: What a mapping costs, in values: its memory is that of so many numbers.
MAPPING = 4
#: Values for each byte of a message, and for a message without bytes: what is encoded in bytes has fewer in any encoding.
PER_BYTE, FREE = 16, 1024
#: Largest schema that is parsed, and all that are parsed of one log [bytes]: a schema in use has some kB, and parsed it takes 60 to 250
#: times its length. What a log may declare in all, schemas and channels [bytes].
MOST_SCHEMA, MOST_SCHEMAS, MOST_DECLARED = 1 << 18, 1 << 20, 1 << 23


class BudgetError(ReplayKitError, ValueError):
    """Message or schema beyond the budget."""


class Budget:
    """Remaining budget of one message; mutable, as decoders charge it while they read."""

    __slots__ = ("left",)

    def __init__(self, size: int) -> None:
        """Create the budget of a message.

        Raises:
            BudgetError: The message is longer than the limit.
        """
        check_size(size, MOST_BYTES, "a message")
        self.left = min(MOST_VALUES, FREE + PER_BYTE * size)

    def spend(self, values: int) -> None:
        """Charge values before they are created.

        Raises:
            BudgetError: The budget is exceeded.
        """
        self.left -= values
        if self.left < 0:
            raise BudgetError(
                f"more values than a message may hold ({PER_BYTE} a byte, {MOST_VALUES} in all)"
            )


def check_size(size: int, most: int, what: str) -> None:
    """Raise BudgetError if a size exceeds its limit.

    Args:
        size: Size [bytes].
        most: Limit [bytes].
        what: Subject of the message.
    """
    if size > most:
        raise BudgetError(f"{what}: {size} bytes, more than the {most} that are read")


MAGIC = b"\x89MCAP0\r\n"

#: Largest record read [bytes]; a larger claim counts as damage.
MAX_SIZE = 1 << 28

#: What the record parsers of ``mcap.records`` raise on bytes that are no such record.
RECORD_ERRORS = (struct.error, ValueError, OverflowError, McapError)

#: Opcode and length before each record's body [bytes].
HEAD_SIZE = 9

#: Opcode and length.
RECORD_HEAD = struct.Struct("<BQ")
_PIECE = 1 << 20
# known kinds, but that whose body is read where it is needed
_KEPT = frozenset(map(int, Opcode)) - {Opcode.ATTACHMENT}
#: What a chunk holds, as plain numbers.
INNER = frozenset({int(Opcode.SCHEMA), int(Opcode.CHANNEL), int(Opcode.MESSAGE)})

_Parsed = TypeVar("_Parsed", bound=McapRecord)


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


def file_records(
    file: BinaryIO,
    start: int,
    size: int | None = None,
    bound: Callable[[int], int | None] | None = None,
) -> Iterator[Record]:
    """Yield the records of a file up to the first incomplete one, inclusive; the closing magic bytes are none.

    Args:
        file: Open log; its position may change between records.
        start: Byte offset of the first record.
        size: Size of the file, or of its part up to the last record [bytes]; None for all of the file.
        bound: Returns the next known start of a record after an offset; a record that extends beyond it is incomplete.
    """
    offset, crc = start, zlib.crc32(MAGIC)
    size = file.seek(0, SEEK_END) if size is None else size
    while True:
        file.seek(offset)
        head = file.read(HEAD_SIZE)
        # where the file ends in a head no record begins
        opcode, length = RECORD_HEAD.unpack(head) if len(head) == HEAD_SIZE else (0, 0)
        end = offset + HEAD_SIZE + length
        limit = (bound(offset) if bound else None) or size
        kept = opcode in _KEPT
        if opcode == 0 or end > limit or (kept and length > MAX_SIZE):
            yield Record(opcode, offset, size, b"", False, crc)
            return
        before, crc = crc, zlib.crc32(head, crc)
        body = file.read(length) if kept else b""
        crc = zlib.crc32(body, crc) if kept else crc_of_rest(file, length, crc)
        yield Record(opcode, offset, end, body, True, before)
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


_FOOTER_SIZE = HEAD_SIZE + 20
_INDEX_HEAD = struct.Struct("<BQHI")
_INDEX_ENTRY = np.dtype([("log_ns", "<u8"), ("offset", "<u8")])
#: Records of a summary that are used.
_KINDS: Mapping[int, Any] = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK_INDEX: ChunkIndex,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex,
    Opcode.METADATA_INDEX: MetadataIndex,
    Opcode.STATISTICS: Statistics,
}


@dataclass(frozen=True)
class Summary:
    """Summary section; empty if missing or damaged.

    Attributes:
        schemas: Schemas by number.
        channels: Channels by number.
        chunks: Index entries of chunks by offset.
        offsets: Offsets of chunks, attachments, metadata and the summary [bytes], increasing.
        statistics: Counts stated in the file; None without.
        problem: Why an existing summary is not used; else empty.
    """

    schemas: Mapping[int, Schema] = field(default_factory=dict)
    channels: Mapping[int, Channel] = field(default_factory=dict)
    chunks: tuple[ChunkIndex, ...] = ()
    offsets: tuple[int, ...] = ()
    statistics: Statistics | None = None
    problem: str = ""

    @cached_property
    def _at(self) -> Mapping[int, ChunkIndex]:
        return {chunk.chunk_start_offset: chunk for chunk in self.chunks}

    def chunk_at(self, offset: int) -> ChunkIndex | None:
        """Return the index entry of the chunk at an offset; None without one."""
        return self._at.get(offset)

    def next_offset(self, offset: int) -> int | None:
        """Return the offset of the next record listed in the summary; None without one."""
        place = bisect_right(self.offsets, offset)
        return self.offsets[place] if place < len(self.offsets) else None


def read_summary(file: BinaryIO) -> Summary:
    """Return the summary section of an open log, verified by its checksum if any."""
    length, size = _FOOTER_SIZE + len(MAGIC), file.seek(0, SEEK_END)
    file.seek(max(0, size - length))
    tail = file.read(length)
    if (
        len(tail) < length
        or not tail.endswith(MAGIC)
        or RECORD_HEAD.unpack_from(tail) != (Opcode.FOOTER, 20)
    ):
        return Summary()
    footer = parse(Footer, tail[HEAD_SIZE:])
    start = footer.summary_start
    if not len(MAGIC) <= start < size - length:
        return Summary(problem="the footer points to no summary" if start else "")
    file.seek(start)
    if footer.summary_crc not in (0, crc_of_rest(file, size - len(MAGIC) - 4 - start, 0)):
        return Summary(problem="the checksum of the summary does not match")
    return _collect(file, start, size)


def _collect(file: BinaryIO, start: int, size: int) -> Summary:
    found: dict[int, list[Any]] = {opcode: [] for opcode in _KINDS}
    declared = 0
    # of what is there twice the data section's own declarations count where these are left out
    for record in file_records(file, start, size):
        if record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            declared += len(record.body)
            if declared > MOST_DECLARED:
                continue
        if record.opcode in _KINDS:
            with suppress(*RECORD_ERRORS):
                found[record.opcode].append(parse(_KINDS[record.opcode], record.body))
    chunks = {
        chunk.chunk_start_offset: chunk
        for chunk in found[Opcode.CHUNK_INDEX]
        if len(MAGIC) <= chunk.chunk_start_offset < start
    }
    others = {
        index.offset
        for opcode in (Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX)
        for index in found[opcode]
        if len(MAGIC) <= index.offset < start
    }
    return Summary(
        schemas={schema.id: schema for schema in found[Opcode.SCHEMA]},
        channels={channel.id: channel for channel in found[Opcode.CHANNEL]},
        chunks=tuple(chunks[offset] for offset in sorted(chunks)),
        offsets=tuple(sorted({*others, *chunks, start})),
        statistics=found[Opcode.STATISTICS][-1] if found[Opcode.STATISTICS] else None,
    )


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
