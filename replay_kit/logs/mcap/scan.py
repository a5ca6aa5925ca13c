"""Scan of an MCAP file: messages in parts, in file order; damage is counted and skipped."""

import os
from collections.abc import Callable, Generator, Iterator
from typing import BinaryIO

import numpy as np
from mcap.opcode import Opcode
from mcap.records import DataEnd, Statistics

from replay_kit.logs.mcap.contents import SHORTEST, Part, walk
from replay_kit.logs.mcap.records import (
    HEAD_SIZE,
    INNER,
    MAGIC,
    RECORD_ERRORS,
    RECORD_HEAD,
    Chunk,
    ChunkError,
    Record,
    chunk_contents,
    cut_contents,
    file_records,
    parse,
    parse_chunk,
)
from replay_kit.logs.mcap.salvage import Salvage, WholeChunk, goes_on
from replay_kit.logs.mcap.summary import Channels, Summary
from replay_kit.logs.shared.blocks import ReadStatistics

#: From a chunk's beginning to its data when it is not compressed [bytes].
_CHUNK_HEAD = HEAD_SIZE + 40
#: Bytes of messages outside chunks that are a part.
_PART = 1 << 20


class Scan:
    """Scan of an open file.

    Attributes:
        channels: Declarations up to the last part.
    """

    def __init__(
        self,
        file: BinaryIO,
        summary: Summary,
        channels: Channels,
        statistics: ReadStatistics,
        on_extra: Callable[[Record], None] | None = None,
    ) -> None:
        """Create a scan.

        Args:
            file: The open file.
            summary: Summary of the file.
            channels: Channels that receive the declarations.
            statistics: Statistics that count losses and unchecked records.
            on_extra: Called with each whole attachment (without body) and metadata record; an exception of ``RECORD_ERRORS`` is a loss.
        """
        self._file = file
        self._statistics = statistics
        self._on_extra = on_extra
        self._size = os.fstat(file.fileno()).st_size
        self._summary = summary
        self.channels = channels
        self._position = 0
        self._lost = 0
        self._lost_all_known = True
        self._outside = bytearray()
        self._n_outside = 0
        self._ended = False
        self._verified = False
        self._search_from = len(MAGIC)
        self._chunked = bool(self._summary.chunks)
        self._salvage = Salvage(file, self._size, self._summary)
        if self._summary.problem:
            what = f"{self._summary.problem}: the index is ignored, the file is scanned"
            statistics.lose(what, self._size, 0, messages=0)

    def parts(self) -> Iterator[Part]:
        """Yield the messages in file order: those of a chunk, or some outside chunks."""
        offset: int | None = len(MAGIC)
        while offset is not None:
            offset = yield from self._read_from(offset)
            yield from self._from_outside()
        if self._n_outside and not self._verified:
            self._statistics.unchecked["messages outside chunks, without a checksum"] += (
                self._n_outside
            )

    def _lose(
        self,
        what: str,
        start: int,
        end: int,
        messages: int | None,
        span: tuple[int, int] | None = None,
    ) -> None:
        if messages is None:
            self._lost_all_known = False
        else:
            self._lost += messages
        self._statistics.lose(what, start, end - start, messages=messages, span=span)

    def _read_from(self, start: int) -> Generator[Part, None, int | None]:
        """Yield messages up to the end or to damage; return the offset at which reading resumes, or None."""
        self._search_from = start + 1
        for record in file_records(self._file, start, self._size, self._summary.next_offset):
            self._chunked = self._chunked or record.opcode == Opcode.CHUNK
            believable = self._salvage.is_believable(record)
            if not believable or record.opcode != Opcode.MESSAGE:
                yield from self._from_outside()
            if not believable:
                return (yield from self._cut(record))
            if record.opcode == Opcode.CHUNK:
                if (after := (yield from self._chunk(record))) != record.end:
                    return after
            elif record.opcode in INNER:
                if self._summary.in_index(record.offset):
                    self._lose(
                        "a record of a chunk's index is damaged and ignored",
                        record.offset,
                        record.end,
                        0,
                    )
                elif record.opcode == Opcode.MESSAGE:
                    yield from self._outside_chunks(record)
                else:
                    self._declare(
                        record.opcode, record.body, record.offset, None if self._chunked else 0
                    )
            elif record.opcode in (Opcode.ATTACHMENT, Opcode.METADATA):
                self.pass_on(record)
            else:
                self._check(record)
            # should no record follow, the next one may begin within this one
            self._search_from = max(self._search_from, record.offset + 1)
        return None

    def pass_on(self, record: Record) -> None:
        """Pass an attachment or metadata record to ``on_extra``; its errors are losses."""
        try:
            if self._on_extra is not None:
                self._on_extra(record)
        except RECORD_ERRORS as error:
            self._lose(
                f"an attachment or metadata record is damaged and excluded: {error}",
                record.offset,
                record.end,
                0,
            )

    def _chunk(self, record: Record) -> Generator[Part, None, int | None]:
        """Yield the messages of a whole chunk record; return the offset at which reading resumes, or None."""
        try:
            chunk = parse_chunk(record.body)
            data = chunk_contents(chunk)
        except RECORD_ERRORS as error:
            return (yield from self._damaged_chunk(record, error))
        end = record.offset + _CHUNK_HEAD + len(chunk.compression) + len(chunk.data)
        if chunk.crc == 0:
            self._statistics.unchecked["chunks without a checksum"] += 1
        before = self._position + self._lost
        used = yield from self._contents(data, record, chunk if chunk.crc == 0 else None)
        if chunk.crc != 0 and end == record.end and used == len(data):
            self._search_from = end
            return end
        indexed = self._salvage.indexed_messages(record)
        lost = None if indexed is None else max(0, indexed + before - self._position - self._lost)
        if used < len(data):
            what = f"chunk used up to byte {used} of its contents: no whole record follows"
            self._lose(what, record.offset, record.offset + len(data) - used, lost, chunk.span)
        elif lost:
            self._lose(
                "chunk holds fewer messages than its index lists",
                record.offset,
                record.end,
                lost,
                chunk.span,
            )
        if self._salvage.follows(record):
            return record.end
        if chunk.crc != 0:
            return self._after_chunk(record, end)
        resume = self._salvage.resume(record.offset, record.offset + 1, False)
        what = f"bytes are missing in a chunk without a checksum, or its length is damaged{goes_on(resume)}"
        self._lose(what, record.offset, resume or self._size, None, chunk.span)
        return resume

    def _damaged_chunk(self, record: Record, error: Exception) -> Generator[Part, None, int | None]:
        """Yield the messages of a chunk with a wrong record header if its own lengths and checksum are valid; as ``_chunk``."""
        if (own := self._salvage.whole_chunk(record.offset)) is not None:
            return (yield from self._as_stated_by_itself(record, own))
        in_data = isinstance(error, ChunkError)
        span, why = (
            (parse_chunk(record.body).span, str(error))
            if in_data
            else (None, "its head is damaged")
        )
        resume = (
            record.end
            if self._salvage.follows(record)
            else self._salvage.resume(record.offset, record.offset + 1, False)
        )
        self._lose(
            f"chunk skipped: {why}",
            record.offset,
            resume or self._size,
            self._salvage.indexed_messages(record),
            span,
        )
        return resume

    def _as_stated_by_itself(
        self, record: Record, own: WholeChunk
    ) -> Generator[Part, None, int | None]:
        """Yield the messages of a chunk whose record states another kind or length; as ``_chunk``."""
        self._chunked = True
        yield from self._contents(own.contents, record, None)
        return self._after_chunk(record, own.end)

    def _after_chunk(self, record: Record, end: int) -> int | None:
        """Count damage to the opcode or length of a valid chunk; return the offset at which reading resumes, or None."""
        resume = (
            end
            if (follows := self._salvage.begins_chain(end))
            else self._salvage.resume(end - 1, end, False)
        )
        what = (
            "the opcode or length of a chunk is damaged; its checksum fits, and all its messages are used"
            + goes_on(resume)
        )
        self._lose(what, record.offset, record.offset + HEAD_SIZE, 0)
        if not follows:
            self._lose("bad bytes after a chunk", end, resume or self._size, None)
        return resume

    def _contents(
        self, data: bytes, record: Record, unchecked: Chunk | None
    ) -> Generator[Part, None, int]:
        """Yield the messages of a chunk's contents; return the length of the whole records [bytes].

        Args:
            data: Contents.
            record: Record of the chunk.
            unchecked: Chunk without a checksum: messages that contradict its header are then excluded, and records other than schemas,
                channels and messages are damage.
        """
        found = walk(data, strict=unchecked is not None)
        for opcode, start, stop in found.declared:
            self._declare(opcode, data[start:stop], record.offset)
        for length in found.short:
            what = "a message record is too short and excluded"
            self._lose(what, record.offset, record.offset + length, 1)
        part = found.part
        if unchecked is not None and (span := unchecked.span) is not None:
            log_ns = part.head["log_ns"]
            outside = (log_ns < span[0]) | (log_ns > span[1])
            for length in part.head["length"][outside].tolist():
                what = "message excluded: its time is outside its chunk's range"
                self._lose(what, record.offset, record.offset + length, 1)
            part = part.take(~outside)
        yield from self._counted(part)
        return found.end

    def _counted(self, part: Part) -> Iterator[Part]:
        """Yield a part with the ordinals of its messages, if any."""
        if n := part.offset.size:
            ordinal = self._position + np.arange(n)
            self._position += n
            yield part._replace(ordinal=ordinal)

    def _outside_chunks(self, record: Record) -> Iterator[Part]:
        """Collect a message outside chunks; yield the collected ones if they are many."""
        self._n_outside += 1
        if len(record.body) < SHORTEST:
            self._lose("a message record is too short and excluded", record.offset, record.end, 1)
            return
        self._outside += RECORD_HEAD.pack(record.opcode, len(record.body)) + record.body
        if len(self._outside) > _PART:
            yield from self._from_outside()

    def _from_outside(self) -> Iterator[Part]:
        """Yield the collected messages outside chunks."""
        if self._outside:
            part = walk(bytes(self._outside)).part
            self._outside.clear()
            yield from self._counted(part)

    def _cut(self, record: Record) -> Generator[Part, None, int | None]:
        """Yield the messages in the rest of an incomplete record; return the offset at which reading resumes, or None."""
        if (own := self._salvage.whole_chunk(record.offset)) is not None:
            return (yield from self._as_stated_by_itself(record, own))
        resume = self._salvage.resume(record.offset, self._search_from, not self._chunked)
        end = self._size if resume is None else max(resume, record.offset)
        before = self._position
        listed = self._summary.chunk_at(record.offset)
        indexed = None if listed is None else self._salvage.indexed_messages(record)
        if record.opcode == Opcode.CHUNK:
            try:
                chunk = parse_chunk(record.body[: end - record.offset - HEAD_SIZE])
                data = cut_contents(chunk)
            except RECORD_ERRORS:
                pass
            else:
                used = yield from self._contents(data, record, chunk)
                found = self._position - before
                if found:
                    self._statistics.unchecked[
                        "messages of cut chunks, whose checksum cannot be verified"
                    ] += found
                whole = record.offset + (_CHUNK_HEAD + used if chunk.compression == "" else 0)
                lost = (
                    0
                    if used == chunk.size and resume
                    else None
                    if indexed is None
                    else max(0, indexed - found)
                )
                what = f"cut inside a chunk: the whole records before the cut are used{goes_on(resume)}"
                self._lose(what, whole, end, lost, chunk.span)
                return resume
        if record.offset == self._size:
            self._lose("ends without a footer: everything before is used", record.offset, end, None)
        else:
            what = f"cut inside a record, or no record begins here: everything before is used{goes_on(resume)}"
            span = None if listed is None else (listed.message_start_time, listed.message_end_time)
            self._lose(what, record.offset, end, indexed, span)
        return resume

    def _declare(self, opcode: int, body: bytes, offset: int, messages: int | None = 0) -> None:
        try:
            self.channels.declare(opcode, body)
        except RECORD_ERRORS:
            self._lose(
                "a schema or channel record is damaged and excluded",
                offset,
                offset + len(body),
                messages,
            )

    def _check(self, record: Record) -> None:
        """Compare the file's statistics with the records found, unless a loss explains a difference."""
        if record.opcode == Opcode.FOOTER:
            self._file.seek(record.end)
            if self._file.read(len(MAGIC)) != MAGIC:
                self._lose(
                    "ends without the closing magic bytes: all messages are used",
                    record.end,
                    self._size,
                    0,
                )
            if not self._ended and not self._statistics.lost:
                self._lose(
                    "the end of the data section is missing, perhaps messages too",
                    record.offset,
                    record.offset,
                    None,
                )
        try:
            if record.opcode == Opcode.DATA_END:
                self._ended = True
                self._check_data(parse(DataEnd, record.body).data_section_crc, record)
            elif record.opcode == Opcode.STATISTICS:
                self._check_count(parse(Statistics, record.body).message_count, record)
        except RECORD_ERRORS:
            self._lose(
                "the end of the file is damaged: all messages are used",
                record.offset,
                record.end,
                0,
            )

    def _check_data(self, stated: int, record: Record) -> None:
        self._verified = stated == record.crc
        if stated not in (0, record.crc) and not self._statistics.lost:
            what = "the checksum of the data section does not match: messages outside chunks may be wrong"
            self._lose(what, record.offset, record.offset, 0)

    def _check_count(self, stated: int, record: Record) -> None:
        if self._lost_all_known and stated != self._position + self._lost:
            what = f"the file states {stated} messages, {self._position} were found"
            missing = max(0, stated - self._position - self._lost)
            self._lose(
                what, record.offset, record.offset, None if self._summary.problem else missing
            )
