"""Scan of an MCAP file: messages in parts, in file order; damage is counted and skipped.

After damage reading goes on at the next chunk that the summary lists. Without a summary it does at the next chunk whose checksum fits.
"""

import os
import re
import struct
from collections.abc import Callable, Generator, Iterator, Mapping
from mmap import ACCESS_READ, mmap
from typing import BinaryIO

import numpy as np
from mcap.opcode import Opcode
from mcap.records import DataEnd, Statistics

from replay_kit.logs.blocks import ReadStatistics
from replay_kit.logs.decode.decoders import Channels
from replay_kit.logs.mcap.index import (
    CHUNK_HEAD,
    SHORTEST,
    Opened,
    Part,
    open_chunk,
    own_length,
    walk,
)
from replay_kit.logs.mcap.records import (
    HEAD_SIZE,
    INNER,
    MAGIC,
    RECORD_ERRORS,
    RECORD_HEAD,
    Record,
    Summary,
    file_records,
    index_entries,
    parse,
)

#: Bytes of messages outside chunks that are a part.
_PART = 1 << 20
#: Opcode of a chunk and a length below 4 GiB.
_CANDIDATE = re.compile(rb"\x06(?=.{4}\x00{4})", re.DOTALL)
#: Bytes of candidates that are decompressed or checked, by the file's size: sound files compress to a fiftieth at most.
_COST = 64
#: Lengths of bodies of kinds of fixed length; a later version of the format may append some bytes.
_FIXED: Mapping[int, int] = {Opcode.FOOTER: 20, Opcode.SUMMARY_OFFSET: 17, Opcode.DATA_END: 4}
_SPARE = 40
_INDEX_HEAD, _SPAN = struct.Struct("<HI"), struct.Struct("<QQ")


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
        self._file, self._summary, self.channels = file, summary, channels
        self._statistics, self._on_extra = statistics, on_extra
        self._size = os.fstat(file.fileno()).st_size
        self._position = 0
        # None where their number is not known
        self._lost: int | None = 0
        self._damaged = self._ended = self._verified = False
        self._outside, self._n_outside = bytearray(), 0
        self._chunked = bool(summary.chunks)
        self._search_from = len(MAGIC)
        self._left = _COST * self._size
        if summary.problem:
            what = f"{summary.problem}: the index is ignored, the file is scanned"
            statistics.lose(what, self._size, 0, messages=0)

    def parts(self) -> Iterator[Part]:
        """Yield the messages in file order: those of a chunk, or some outside chunks."""
        offset: int | None = len(MAGIC)
        while offset is not None:
            offset = yield from self._read_from(offset)
            yield from self._from_outside()
        if self._n_outside and not self._verified:
            what = "messages outside chunks, without a checksum"
            self._statistics.unchecked[what] += self._n_outside

    def pass_on(self, record: Record) -> None:
        """Pass an attachment or metadata record to ``on_extra``; its errors are losses."""
        try:
            if self._on_extra is not None:
                self._on_extra(record)
        except RECORD_ERRORS as error:
            what = f"an attachment or metadata record is damaged and excluded: {error}"
            self._lose(what, record.offset, record.end)

    def _lose(
        self,
        what: str,
        start: int,
        end: int,
        messages: int | None = 0,
        span: tuple[int, int] | None = None,
    ) -> None:
        self._damaged = True
        self._lost = None if self._lost is None or messages is None else self._lost + messages
        self._statistics.lose(what, start, end - start, messages=messages, span=span)

    def _read_from(self, start: int) -> Generator[Part, None, int | None]:
        """Yield messages up to the end or to damage; return the offset at which reading goes on, or None."""
        for record in file_records(self._file, start, self._size, self._summary.next_offset):
            if record.opcode != Opcode.MESSAGE:
                yield from self._from_outside()
            if self._is_chunk(record) or not self._is_sound(record):
                if (after := (yield from self._chunk(record))) != record.end:
                    return after
            elif record.opcode == Opcode.MESSAGE:
                self._n_outside += 1
                self._outside += RECORD_HEAD.pack(record.opcode, len(record.body)) + record.body
                if len(self._outside) > _PART:
                    yield from self._from_outside()
            elif record.opcode in INNER:
                self._declare(record.opcode, record.body, record.offset, not self._chunked)
            elif record.opcode in (Opcode.ATTACHMENT, Opcode.METADATA):
                self.pass_on(record)
            else:
                self._check(record)
                if record.opcode == Opcode.FOOTER:
                    return None
        return None

    def _is_chunk(self, record: Record) -> bool:
        return record.opcode == Opcode.CHUNK or self._summary.chunk_at(record.offset) is not None

    def _is_sound(self, record: Record) -> bool:
        """Return whether a record is whole, of its kind's length, and no chunk with another opcode."""
        length = record.end - record.offset - HEAD_SIZE
        if not record.whole:
            return False
        if record.opcode == Opcode.MESSAGE:
            # in a file of chunks it would have no checksum, and is what damage made
            return length >= SHORTEST and not self._chunked
        if record.opcode == Opcode.MESSAGE_INDEX:
            listed = _INDEX_HEAD.unpack_from(record.body)[1] if length >= _INDEX_HEAD.size else -1
            return 0 <= length - _INDEX_HEAD.size - listed < _SPARE
        if record.opcode == Opcode.FOOTER and record.end + len(MAGIC) < self._size:
            return False
        fits = length <= _FIXED.get(record.opcode, length) + _SPARE
        return fits and self._own_chunk(record.offset) is None

    def _chunk(self, record: Record) -> Generator[Part, None, int | None]:
        """Yield the messages of a chunk; return its end, or the offset at which reading goes on after damage, or None."""
        opened: Opened | None = None
        problem: Exception = ValueError("its head is damaged")
        if record.whole and record.opcode == Opcode.CHUNK:
            try:
                opened = open_chunk(record.body)
            except RECORD_ERRORS as error:
                problem = error
        opened = opened or self._own_chunk(record.offset)
        if opened is None:
            return self._skip(record, problem)
        self._chunked = True
        for opcode, body in opened.declared:
            self._declare(opcode, body, record.offset)
        if not opened.is_checked:
            self._statistics.unchecked["chunks without a checksum"] += 1
        yield from self._counted(opened.part)
        end = self._search_from = record.offset + HEAD_SIZE + opened.length
        if end != record.end or record.opcode != Opcode.CHUNK:
            what = "the opcode or length of a chunk is damaged; its checksum fits, and all its messages are used"
            self._lose(what, record.offset, record.offset + HEAD_SIZE)
        return end

    def _own_chunk(self, offset: int) -> Opened | None:
        """Return the chunk with messages that begins at an offset by its own statements; None without a sound one."""
        self._file.seek(offset + HEAD_SIZE)
        try:
            # the longest name of a compression has four bytes
            head = self._file.read(CHUNK_HEAD + 4)
            length = own_length(head)
            cost = length + int.from_bytes(head[16:24], "little")
            if offset + HEAD_SIZE + length > self._size or cost > self._left:
                return None
            self._left -= cost
            self._file.seek(offset + HEAD_SIZE)
            opened = open_chunk(self._file.read(length))
        except RECORD_ERRORS:
            return None
        return opened if opened.part.offset.size else None

    def _skip(self, record: Record, error: Exception) -> int | None:
        """Count a damaged record; return the offset at which reading goes on, or None."""
        if record.offset == self._size:
            what = "ends without a footer: everything before is used"
            self._lose(what, self._size, self._size, None)
            return None
        is_chunk = self._is_chunk(record)
        self._chunked = self._chunked or is_chunk
        what, resume = f"chunk skipped: {error}", self._after(record)
        if not (is_chunk and record.whole):
            what = "cut inside a record, or no record begins here: everything before is used"
        on = "" if resume in (None, record.end) else f"; reading resumes at byte {resume}"
        end = self._size if resume is None else max(resume, record.offset)
        self._lose(what + on, record.offset, end, *self._lost_in(record))
        return resume

    def _lost_in(self, record: Record) -> tuple[int | None, tuple[int, int] | None]:
        """Return the number of messages in a lost chunk by its index, and their span as it states it [ns]; None if unknown."""
        listed = self._summary.chunk_at(record.offset)
        count: int | None = None
        if listed is None and record.whole and self._summary.chunks:
            # a record of another kind, as all chunks are listed
            return 0, None
        if listed is not None:
            numbers = listed.message_index_offsets
            try:
                count = sum(index_entries(self._file, each, listed).size for each in numbers)
            except RECORD_ERRORS:
                count = None
        self._file.seek(record.offset + HEAD_SIZE)
        head = self._file.read(_SPAN.size)
        span = 0, 0
        if listed is not None:
            span = listed.message_start_time, listed.message_end_time
        elif record.opcode == Opcode.CHUNK and len(head) == _SPAN.size:
            span = _SPAN.unpack(head)
        return count or None, span if 0 < span[1] >= span[0] else None

    def _after(self, record: Record) -> int | None:
        """Return the end of a whole chunk, else the offset of the next one, else of what the summary lists next; None without any."""
        if record.whole and self._is_chunk(record):
            return record.end
        following = self._summary.next_offset(record.offset)
        if self._summary.chunks:
            return following
        data = mmap(self._file.fileno(), 0, access=ACCESS_READ)
        places = (match.start() for match in _CANDIDATE.finditer(data, self._search_from))
        return next((place for place in places if self._own_chunk(place)), following)

    def _counted(self, part: Part) -> Iterator[Part]:
        """Yield a part with the ordinals of its messages, if any."""
        if n := part.offset.size:
            ordinal = self._position + np.arange(n)
            self._position += n
            yield part._replace(ordinal=ordinal)

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
                    # a record of a damaged kind is stepped over, whatever it held
                    self._lose(what, at, at, None)
            elif record.opcode == Opcode.STATISTICS and self._lost is not None:
                count = parse(Statistics, record.body).message_count
                if count != self._position + self._lost:
                    missing = max(0, count - self._position - self._lost)
                    what = f"the file states {count} messages, {self._position} were found"
                    # more messages than the file has bytes: the number itself is damaged, or of no use
                    is_known = not self._summary.problem and missing < self._size
                    self._lose(what, at, at, missing if is_known else None)
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
