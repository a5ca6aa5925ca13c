"""Resynchronisation after damage to an MCAP file: the next offset of records or of a chunk with valid checksum."""

import re
import struct
from dataclasses import replace
from typing import BinaryIO, NamedTuple

from mcap.opcode import Opcode

from replay_kit.logs.mcap.records import (
    HEAD_SIZE,
    INNER,
    MAGIC,
    MAX_SIZE,
    RECORD_ERRORS,
    RECORD_HEAD,
    Record,
    chunk_contents,
    parse_chunk,
)
from replay_kit.logs.mcap.summary import Summary

#: Least length of the body of each kind of record [bytes].
_LEAST = {
    Opcode.HEADER: 8,
    Opcode.FOOTER: 20,
    Opcode.SCHEMA: 14,
    Opcode.CHANNEL: 16,
    Opcode.MESSAGE: 22,
    Opcode.CHUNK: 40,
    Opcode.MESSAGE_INDEX: 6,
    Opcode.CHUNK_INDEX: 64,
    Opcode.ATTACHMENT: 36,
    Opcode.ATTACHMENT_INDEX: 48,
    Opcode.STATISTICS: 46,
    Opcode.METADATA: 8,
    Opcode.METADATA_INDEX: 20,
    Opcode.SUMMARY_OFFSET: 17,
    Opcode.DATA_END: 4,
}
#: One record may be bytes of a payload by chance; three that follow one another are not.
_CHAIN = 3
#: A known opcode and a length below 4 GiB; the lookahead finds those that overlap, too.
_CANDIDATE = re.compile(rb"(?=[\x01-\x0f].{4}\x00{4})", re.DOTALL)
_FIXED = frozenset({Opcode.FOOTER, Opcode.SUMMARY_OFFSET, Opcode.DATA_END})
#: A later version of the format may append to a record, but not as much as would reach into the contents of a chunk [bytes].
_SPARE = 40
_PIECE = 1 << 20
#: Bytes of candidates that are decompressed or checked, by the file's size: sound files compress to a fiftieth at most.
_COST = 64
_INDEX_ENTRY = 16
_INDEX_HEAD = struct.Struct("<HI")


class WholeChunk(NamedTuple):
    """Chunk with a valid checksum, whatever the stated length of its record.

    Attributes:
        contents: Records of the chunk.
        end: End of its data in the file [bytes].
    """

    contents: bytes
    end: int


def _is_index(body: bytes, length: int) -> bool:
    """Return whether the body of a record, or its beginning, is that of a message index of this length."""
    if len(body) < _INDEX_HEAD.size:
        return False
    listed: int = _INDEX_HEAD.unpack_from(body)[1]
    return listed % _INDEX_ENTRY == 0 and 0 <= length - _INDEX_HEAD.size - listed < _SPARE


class Salvage:
    """Recovery of records of a damaged file; the cost of checking candidates is bounded by the file size."""

    def __init__(self, file: BinaryIO, size: int, summary: Summary) -> None:
        """Create the recovery of a file from its size [bytes] and summary."""
        self._file = file
        self._size = size
        self._summary = summary
        self._left = _COST * size

    def begins_record(self, offset: int) -> int | None:
        """Return the end of the record at an offset [bytes]; None if opcode or length are invalid."""
        self._file.seek(offset)
        head = self._file.read(HEAD_SIZE + _INDEX_HEAD.size)
        if len(head) < HEAD_SIZE + 4:
            return None
        opcode, length = RECORD_HEAD.unpack_from(head)
        end: int = offset + HEAD_SIZE + length
        if length < _LEAST.get(opcode, MAX_SIZE) or end > self._size:
            return None
        if opcode == Opcode.MESSAGE_INDEX:
            return end if _is_index(head[HEAD_SIZE:], length) else None
        if opcode in _FIXED and length - _LEAST[opcode] >= _SPARE:
            return None
        # nothing but the closing magic bytes follows a footer
        return end if opcode != Opcode.FOOTER or end + len(MAGIC) >= self._size else None

    def begins_chain(self, offset: int) -> bool:
        """Return whether three consecutive records, or fewer up to the end of the file, begin at an offset."""
        for _ in range(_CHAIN):
            end = self.begins_record(offset)
            if end is None:
                self._file.seek(offset)
                return self._size - offset <= len(MAGIC) and self._file.read() == MAGIC
            if end == self._size:
                return True
            offset = end
        return True

    def is_believable(self, record: Record) -> bool:
        """Return whether a record is whole, agrees with the summary, and has a valid kind and length."""
        if not record.whole:
            return False
        if (listed := self._summary.chunk_at(record.offset)) is not None:
            return (
                record.opcode == Opcode.CHUNK and record.end - record.offset == listed.chunk_length
            )
        if record.opcode in (Opcode.MESSAGE, Opcode.CHUNK):
            return True
        if record.opcode != Opcode.MESSAGE_INDEX and self.whole_chunk(record.offset) is not None:
            return False
        if record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            return True
        if record.opcode in _LEAST:
            return self.begins_record(record.offset) is not None
        # a kind of a later version of the format
        return self.begins_chain(record.end)

    def follows(self, record: Record) -> bool:
        """Return whether a record follows this one, by the summary or by the next records."""
        listed = self._summary.chunk_at(record.offset) is not None
        return listed or record.end == self._size or self.begins_chain(record.end)

    def indexed_messages(self, record: Record) -> int | None:
        """Return the number of messages in the message indexes after a chunk; None if no index, or no record after them, follows.

        An index with a damaged opcode is no chunk; the indexes after it belong to the chunk before.
        """
        if _is_index(record.body, record.end - record.offset - HEAD_SIZE):
            return 0
        listed = self._summary.chunk_at(record.offset)
        offset, count = record.offset + listed.chunk_length if listed else record.end, None
        while (end := self.begins_record(offset)) is not None:
            self._file.seek(offset)
            head = self._file.read(HEAD_SIZE + _INDEX_HEAD.size)
            if head[0] != Opcode.MESSAGE_INDEX:
                return count
            count = (count or 0) + _INDEX_HEAD.unpack_from(head, HEAD_SIZE)[1] // _INDEX_ENTRY
            offset = end
        return count if offset == self._size else None

    def resume(self, damaged: int, search_from: int, inner: bool) -> int | None:
        """Return the offset of the next record, by the summary or by a search; None without one.

        Args:
            damaged: Offset of the damaged record [bytes].
            search_from: Start of the search [bytes]: before that record if the previous length may be wrong.
            inner: See ``next_record``.
        """
        following = self._summary.next_offset(damaged)
        if self._summary.chunks:
            return following
        return self.next_record(search_from, following or self._size, inner) or following

    def whole_chunk(self, offset: int) -> WholeChunk | None:
        """Return the chunk at an offset by its own lengths and checksum, ignoring the record's opcode and length.

        Args:
            offset: Start of its record [bytes].
        """
        self._file.seek(offset + HEAD_SIZE)
        head = self._file.read(_LEAST[Opcode.CHUNK] + 4)
        try:
            stated = parse_chunk(head)
            start = offset + HEAD_SIZE + _LEAST[Opcode.CHUNK] + len(stated.compression)
            (length,) = struct.unpack_from("<Q", head, start - offset - HEAD_SIZE - 8)
            cost = length + (stated.size if stated.compression else 0)
            if (
                stated.crc == 0
                or start + length > self._size
                or cost > self._left
                or (not stated.compression and stated.size != length)
            ):
                return None
            self._left -= cost
            self._file.seek(start)
            chunk = replace(stated, data=memoryview(self._file.read(length)))
            return WholeChunk(chunk_contents(chunk), start + length)
        except RECORD_ERRORS:
            return None

    def next_record(self, offset: int, end: int, inner: bool) -> int | None:
        """Return the offset of the next three consecutive records, or of a chunk with valid checksum; None without one.

        Args:
            offset: Start of the search [bytes].
            end: End of the search [bytes].
            inner: Whether schemas, channels and messages may come first; in a file of chunks they belong to a chunk with a checksum.
        """
        buffer, base = b"", offset
        self._file.seek(offset)
        while piece := self._file.read(min(_PIECE, max(0, end + HEAD_SIZE - base - len(buffer)))):
            buffer += piece
            for match in _CANDIDATE.finditer(buffer):
                place = base + match.start()
                if (
                    place < end
                    and (inner or buffer[match.start()] not in INNER)
                    and self._goes_on(place, buffer[match.start()])
                ):
                    return place
            kept = min(len(buffer), HEAD_SIZE - 1)
            base += len(buffer) - kept
            buffer = buffer[len(buffer) - kept :]
            self._file.seek(base + kept)
        return None

    def _goes_on(self, place: int, opcode: int) -> bool:
        return self.begins_chain(place) or (
            opcode == Opcode.CHUNK and self.whole_chunk(place) is not None
        )


def goes_on(resume: int | None) -> str:
    """Return the end of a sentence with the offset at which reading resumes; empty without one."""
    return "" if resume is None else f"; reading resumes at byte {resume}"
