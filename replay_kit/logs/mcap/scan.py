"""Scan of an MCAP file: messages in parts, in file order; damage is counted and skipped."""

import os
from collections.abc import Callable, Generator, Iterator
from typing import BinaryIO

import numpy as np
from mcap.opcode import Opcode
from mcap.records import DataEnd, Statistics

from replay_kit.logs.mcap.channels import Channels
from replay_kit.logs.mcap.chunk import Part, walk
from replay_kit.logs.mcap.records import (
    HEAD_SIZE,
    INNER,
    MAGIC,
    RECORD_ERRORS,
    RECORD_HEAD,
    Record,
    file_records,
    parse,
)
from replay_kit.logs.mcap.salvage import Salvage
from replay_kit.logs.mcap.summary import Summary
from replay_kit.logs.shared.blocks import ReadStatistics

#: Bytes of messages outside chunks that are a part.
_PART = 1 << 20
_IN_CHUNKS = INNER | {int(Opcode.CHUNK)}


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
        self._damaged = False
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
        messages: int | None = 0,
        span: tuple[int, int] | None = None,
    ) -> None:
        self._damaged = True
        if messages is None:
            self._lost_all_known = False
        else:
            self._lost += messages
        self._statistics.lose(what, start, end - start, messages=messages, span=span)

    def _read_from(self, start: int) -> Generator[Part, None, int | None]:
        """Yield messages up to the end or to damage; return the offset at which reading resumes, or None."""
        self._search_from = start + 1
        for record in file_records(self._file, start, self._size, self._summary.next_offset):
            is_chunk = record.opcode == Opcode.CHUNK or self._summary.chunk_at(record.offset)
            if is_chunk or record.opcode != Opcode.MESSAGE:
                yield from self._from_outside()
            in_index = record.whole and self._summary.in_index(record.offset)
            if in_index and record.opcode in _IN_CHUNKS:
                what = "a record of a chunk's index is damaged and ignored"
                self._lose(what, record.offset, record.end)
            elif is_chunk or not self._salvage.is_sound(record):
                if (after := (yield from self._chunk(record))) != record.end:
                    return after
            elif record.opcode == Opcode.MESSAGE:
                yield from self._outside_chunks(record)
            elif record.opcode in INNER:
                self._declare(record.opcode, record.body, record.offset, not self._chunked)
            elif record.opcode in (Opcode.ATTACHMENT, Opcode.METADATA):
                self.pass_on(record)
            else:
                self._check(record)
                if record.opcode == Opcode.FOOTER:
                    return None
            # should no record follow, the next one may begin within this one
            self._search_from = max(self._search_from, record.offset + 1)
        return None

    def pass_on(self, record: Record) -> None:
        """Pass an attachment or metadata record to ``on_extra``; its errors are losses."""
        try:
            if self._on_extra is not None:
                self._on_extra(record)
        except RECORD_ERRORS as error:
            what = f"an attachment or metadata record is damaged and excluded: {error}"
            self._lose(what, record.offset, record.end)

    def _chunk(self, record: Record) -> Generator[Part, None, int | None]:
        """Yield the messages of a chunk; return its end, or the offset at which reading resumes after damage, or None."""
        try:
            chunk, contents = self._salvage.chunk_of(record)
            part, declared = walk(contents, chunk)
        except RECORD_ERRORS as error:
            return self._skip(record, error)
        self._chunked = True
        for opcode, begin, stop in declared:
            self._declare(opcode, contents[begin:stop], record.offset)
        if chunk.crc == 0:
            self._statistics.unchecked["chunks without a checksum"] += 1
        yield from self._counted(part)
        end = record.offset + HEAD_SIZE + chunk.length
        if end == record.end and record.opcode == Opcode.CHUNK:
            self._search_from = end
            return end
        what = "the opcode or length of a chunk is damaged; its checksum fits, and all its messages are used"
        self._lose(what, record.offset, record.offset + HEAD_SIZE)
        if record.whole and self._salvage.begins_chain(record.end):
            return record.end
        if self._salvage.begins_chain(end):
            return end
        resume = self._salvage.resume(record, record.offset + 1, False)
        self._lose("bad bytes after a chunk", end, max(end, resume or self._size), None)
        return resume

    def _skip(self, record: Record, error: Exception) -> int | None:
        """Count a damaged record; return the offset at which reading resumes, or None."""
        listed = self._summary.chunk_at(record.offset)
        self._chunked = self._chunked or record.opcode == Opcode.CHUNK
        if record.offset == self._size:
            self._lose(
                "ends without a footer: everything before is used", self._size, self._size, None
            )
            return None
        resume = self._salvage.resume(record, self._search_from, not self._chunked)
        is_chunk = listed is not None or (record.opcode == Opcode.CHUNK and record.whole)
        messages = self._salvage.indexed_messages(record) if is_chunk else None
        span = (
            (listed.message_start_time, listed.message_end_time)
            if listed is not None
            else self._salvage.stated_span(record)
        )
        what = "cut inside a record, or no record begins here: everything before is used"
        if is_chunk and record.whole:
            what = f"chunk skipped: {error}"
        on = "" if resume in (None, record.end) else f"; reading resumes at byte {resume}"
        end = self._size if resume is None else max(resume, record.offset)
        self._lose(what + on, record.offset, end, messages, span)
        return resume

    def _counted(self, part: Part) -> Iterator[Part]:
        """Yield a part with the ordinals of its messages, if any."""
        if n := part.offset.size:
            ordinal = self._position + np.arange(n)
            self._position += n
            yield part._replace(ordinal=ordinal)

    def _outside_chunks(self, record: Record) -> Iterator[Part]:
        """Collect a message outside chunks; yield the collected ones if they are many."""
        self._n_outside += 1
        self._outside += RECORD_HEAD.pack(record.opcode, len(record.body)) + record.body
        if len(self._outside) > _PART:
            yield from self._from_outside()

    def _from_outside(self) -> Iterator[Part]:
        """Yield the collected messages outside chunks."""
        if self._outside:
            part, _ = walk(bytes(self._outside))
            self._outside.clear()
            yield from self._counted(part)

    def _declare(self, opcode: int, body: bytes, offset: int, is_known: bool = True) -> None:
        """Add a declaration; a damaged one is a loss, in a file of chunks perhaps of the chunk that it was."""
        try:
            self.channels.declare(opcode, body)
        except RECORD_ERRORS:
            what = "a schema or channel record is damaged and excluded"
            self._lose(what, offset, offset + len(body), 0 if is_known else None)

    def _check(self, record: Record) -> None:
        """Compare the file's statistics with the records found, unless a loss explains a difference."""
        at = record.offset
        try:
            if record.opcode == Opcode.FOOTER:
                self._check_end(record)
            elif record.opcode == Opcode.DATA_END:
                self._ended = True
                stated = parse(DataEnd, record.body).data_section_crc
                self._verified = stated == record.crc and not self._damaged
                if stated not in (0, record.crc) and not self._damaged:
                    what = "the checksum of the data section does not match: messages outside chunks may be wrong"
                    self._lose(what, at, at)
            elif record.opcode == Opcode.STATISTICS:
                count = parse(Statistics, record.body).message_count
                if self._lost_all_known and count != self._position + self._lost:
                    missing = max(0, count - self._position - self._lost)
                    what = f"the file states {count} messages, {self._position} were found"
                    self._lose(what, at, at, None if self._summary.problem else missing)
        except RECORD_ERRORS:
            self._lose("the end of the file is damaged: all messages are used", at, record.end)

    def _check_end(self, footer: Record) -> None:
        self._file.seek(footer.end)
        if self._file.read(len(MAGIC)) != MAGIC:
            what = "ends without the closing magic bytes: all messages are used"
            self._lose(what, footer.end, self._size)
        if not self._ended and not self._damaged:
            what = "the end of the data section is missing, perhaps messages too"
            self._lose(what, footer.offset, footer.offset, None)
