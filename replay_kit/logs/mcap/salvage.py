"""Damage to an MCAP file: what a lost chunk held, and where reading goes on.

Reading goes on at the next chunk that the summary lists. Without a summary it does at the next chunk whose checksum fits, or at three
records that follow one another.
"""

import re
import struct
from collections.abc import Mapping
from typing import BinaryIO

from mcap.opcode import Opcode

from replay_kit.logs.mcap.chunk import (
    CHUNK_HEAD,
    SHORTEST,
    Chunk,
    ChunkError,
    chunk_contents,
    own_length,
    parse_chunk,
)
from replay_kit.logs.mcap.records import (
    HEAD_SIZE,
    INNER,
    MAGIC,
    RECORD_ERRORS,
    RECORD_HEAD,
    Record,
)
from replay_kit.logs.mcap.summary import Summary

#: One record may be bytes of a payload by chance; three that follow one another are not.
_CHAIN = 3
#: A known opcode and a length below 4 GiB; the lookahead finds those that overlap, too.
_CANDIDATE = re.compile(rb"(?=[\x01-\x0f].{4}\x00{4})", re.DOTALL)
#: Least and, of kinds of fixed length, largest length of a body; a later version of the format may append some bytes.
_LEAST, _SPARE = 4, 40
_FIXED: Mapping[int, int] = {Opcode.FOOTER: 20, Opcode.SUMMARY_OFFSET: 17, Opcode.DATA_END: 4}
_PIECE = 1 << 20
#: Bytes of candidates that are decompressed or checked, by the file's size: sound files compress to a fiftieth at most.
_COST = 64
_INDEX_HEAD, _INDEX_ENTRY = struct.Struct("<HI"), 16
_SPAN = struct.Struct("<QQ")


class Salvage:
    """Recovery of records of a damaged file; the cost of checking candidates is bounded by the file size."""

    def __init__(self, file: BinaryIO, size: int, summary: Summary) -> None:
        """Create the recovery of a file from its size [bytes] and summary."""
        self._file = file
        self._size = size
        self._summary = summary
        self._left = _COST * size

    def chunk_of(self, record: Record) -> tuple[Chunk, bytes]:
        """Return the chunk in a record with its contents; of a damaged record that which begins there by its own statements.

        Raises:
            struct.error, ValueError, OverflowError, mcap.exceptions.McapError: There is none whose checksum fits.
        """
        problem: Exception = ValueError("its head is damaged")
        if record.whole and record.opcode == Opcode.CHUNK:
            try:
                chunk = parse_chunk(record.body)
                if chunk.crc or chunk.length == len(record.body):
                    return chunk, chunk_contents(chunk)
            except ChunkError as error:
                problem = error
            except RECORD_ERRORS:
                pass
        if (own := self.own_chunk(record.offset)) is None:
            raise problem
        return own

    def own_chunk(self, offset: int) -> tuple[Chunk, bytes] | None:
        """Return the chunk at an offset and its contents if its checksum fits, whatever opcode and length its record states."""
        self._file.seek(offset + HEAD_SIZE)
        try:
            # the longest name of a compression has four bytes
            length = own_length(self._file.read(CHUNK_HEAD + 4))
            if offset + HEAD_SIZE + length > self._size or length > self._left:
                return None
            self._left -= length
            self._file.seek(offset + HEAD_SIZE)
            chunk = parse_chunk(self._file.read(length))
            cost = chunk.size if chunk.compression else 0
            if chunk.crc == 0 or cost > self._left or not (cost or chunk.size == len(chunk.data)):
                return None
            self._left -= cost
            return chunk, chunk_contents(chunk)
        except RECORD_ERRORS:
            return None

    def stated_span(self, record: Record) -> tuple[int, int] | None:
        """Return the first and last time that the head of a chunk states [ns]; None if impossible, or of another record."""
        self._file.seek(record.offset + HEAD_SIZE)
        head = self._file.read(_SPAN.size)
        if record.opcode != Opcode.CHUNK or len(head) < _SPAN.size:
            return None
        first_ns, last_ns = _SPAN.unpack(head)
        return (first_ns, last_ns) if 0 < last_ns >= first_ns else None

    def is_sound(self, record: Record) -> bool:
        """Return whether a record is whole, of a known kind, and no chunk with another opcode."""
        length = record.end - record.offset - HEAD_SIZE
        if not record.whole or record.opcode == Opcode.MESSAGE:
            return record.whole and length >= SHORTEST
        if record.opcode == Opcode.MESSAGE_INDEX:
            return self._listed(record.offset) is not None
        # nothing but the closing magic bytes follows a footer
        if record.opcode == Opcode.FOOTER and record.end + len(MAGIC) < self._size:
            return False
        if length > _FIXED.get(record.opcode, length) + _SPARE or self.own_chunk(record.offset):
            return False
        # or a kind of a later version of the format
        return record.opcode <= Opcode.DATA_END or self.begins_chain(record.end)

    def begins_chain(self, offset: int) -> bool:
        """Return whether three consecutive records, or fewer up to the end of the file, begin at an offset."""
        for _ in range(_CHAIN):
            if offset == self._size:
                return True
            self._file.seek(offset)
            head = self._file.read(HEAD_SIZE)
            if len(head) < HEAD_SIZE:
                return head == MAGIC
            opcode, length = RECORD_HEAD.unpack(head)
            offset += HEAD_SIZE + length
            most = _FIXED.get(opcode, length) + _SPARE
            if not 0 < opcode <= Opcode.DATA_END or not _LEAST <= length < most:
                return False
            if offset > self._size:
                return False
        return True

    def indexed_messages(self, record: Record) -> int | None:
        """Return the number of messages in the message indexes after a chunk; None if they are not all whole."""
        listed = self._summary.chunk_at(record.offset)
        offset, count = record.offset + listed.chunk_length if listed else record.end, None
        while (found := self._listed(offset)) is not None:
            count, offset = (count or 0) + found[0], found[1]
        return count if self.begins_chain(offset) else None

    def _listed(self, offset: int) -> tuple[int, int] | None:
        """Return the number of messages in the message index at an offset, and its end; None if none begins there."""
        self._file.seek(offset)
        head = self._file.read(HEAD_SIZE + _INDEX_HEAD.size)
        if len(head) < HEAD_SIZE + _INDEX_HEAD.size or head[0] != Opcode.MESSAGE_INDEX:
            return None
        _, length = RECORD_HEAD.unpack_from(head)
        _, listed = _INDEX_HEAD.unpack_from(head, HEAD_SIZE)
        spare = length - _INDEX_HEAD.size - listed
        fits = listed % _INDEX_ENTRY == 0 and 0 <= spare < _SPARE
        return (listed // _INDEX_ENTRY, offset + HEAD_SIZE + length) if fits else None

    def resume(self, record: Record, search_from: int, inner: bool) -> int | None:
        """Return the offset of the next record after a damaged one; None without one.

        Args:
            record: Damaged record.
            search_from: Start of the search [bytes]: before that record if the previous length may be wrong.
            inner: Whether schemas, channels and messages may come first; in a file of chunks they belong to a chunk with a checksum.
        """
        following = self._summary.next_offset(record.offset)
        if self._summary.chunks:
            return following
        return self._search(record.offset, search_from, following or self._size, inner) or following

    def _search(self, damaged: int, offset: int, end: int, inner: bool) -> int | None:
        """Return the offset of the next three consecutive records, or chunk with valid checksum, but the damaged one; None without."""
        buffer, base = b"", offset
        self._file.seek(offset)
        while piece := self._file.read(min(_PIECE, max(0, end + HEAD_SIZE - base - len(buffer)))):
            buffer += piece
            for match in _CANDIDATE.finditer(buffer):
                place, opcode = base + match.start(), buffer[match.start()]
                if place >= end or place == damaged or (opcode in INNER and not inner):
                    continue
                if self.begins_chain(place) or (opcode == Opcode.CHUNK and self.own_chunk(place)):
                    return place
            kept = min(len(buffer), HEAD_SIZE - 1)
            base += len(buffer) - kept
            buffer = buffer[len(buffer) - kept :]
            self._file.seek(base + kept)
        return None
