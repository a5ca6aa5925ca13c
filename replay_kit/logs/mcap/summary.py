"""Summary section of an MCAP file, and the message indexes that it locates."""

import struct
from bisect import bisect_right
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, BinaryIO

import numpy as np
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    Footer,
    MetadataIndex,
    Schema,
    Statistics,
)
from numpy.typing import NDArray

from replay_kit.logs.decode.budget import MOST_DECLARED
from replay_kit.logs.mcap.records import (
    HEAD_SIZE,
    MAGIC,
    RECORD_ERRORS,
    RECORD_HEAD,
    crc_of_rest,
    file_records,
    parse,
)

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
    def _chunk_starts(self) -> tuple[int, ...]:
        return tuple(chunk.chunk_start_offset for chunk in self.chunks)

    def chunk_at(self, offset: int) -> ChunkIndex | None:
        """Return the index entry of the chunk at an offset; None without one."""
        place = bisect_right(self._chunk_starts, offset) - 1
        return self.chunks[place] if place >= 0 and self._chunk_starts[place] == offset else None

    def next_offset(self, offset: int) -> int | None:
        """Return the offset of the next record listed in the summary; None without one."""
        place = bisect_right(self.offsets, offset)
        return self.offsets[place] if place < len(self.offsets) else None


def read_summary(file: BinaryIO, size: int) -> Summary:
    """Return the summary section, verified by its checksum if any.

    Args:
        file: The open log.
        size: Size of the file [bytes].
    """
    length = _FOOTER_SIZE + len(MAGIC)
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
