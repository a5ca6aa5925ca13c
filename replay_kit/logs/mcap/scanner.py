"""A scan of an open MCAP file: its messages in its order, damage counted and stepped over."""

import os
import struct
from collections.abc import Callable, Generator, Iterator
from typing import BinaryIO, Generic, TypeVar

from mcap.opcode import Opcode
from mcap.records import DataEnd, Statistics

from replay_kit.logs.mcap.channels import Channels
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
    indexed_messages,
    parse,
    parse_chunk,
)
from replay_kit.logs.mcap.summary import read_summary, resume_after
from replay_kit.logs.shared.statistics import ReadStatistics

#: Fixed part of a message record: channel, sequence, log time, publish time. Unpacked here at once, because the library's
#: reader takes each number with a call of its own and would be half of the reading time.
MESSAGE = struct.Struct("<HIQQ")

#: From a chunk's beginning to its data when it is not compressed [bytes].
_CHUNK_HEAD = HEAD_SIZE + 40
#: As a plain number, for the comparison made for every message.
_MESSAGE_OPCODE = int(Opcode.MESSAGE)
_EXTRAS = frozenset({Opcode.ATTACHMENT, Opcode.METADATA})

_T = TypeVar("_T")
#: Makes the scan's value of a message record ``data[start:end]``; None leaves it out.
Make = Callable[[Channels, bytes, int, int, int], _T | None]


class McapScanner(Generic[_T]):
    """One scan of an open file."""

    def __init__(
        self,
        file: BinaryIO,
        statistics: ReadStatistics,
        make: Make[_T],
        rename: Callable[[str], str] = str,
        on_extra: Callable[[Record], None] | None = None,
    ) -> None:
        """Remember what to do with each kind of record.

        Args:
            file: The open file.
            statistics: Counts losses and what no checksum covers.
            make: Called with the channels, the bytes, start and end of a message record's body, and the message's ordinal.
            rename: Gives what a topic of the file is called.
            on_extra: Called with each attachment and metadata record that is whole, an attachment without its body; an exception of
                ``RECORD_ERRORS`` that it raises is a loss.
        """
        self._file = file
        self._statistics = statistics
        self._make = make
        self._on_extra = on_extra
        self._size = os.fstat(file.fileno()).st_size
        self._summary = read_summary(file, self._size)
        self._channels = Channels(self._summary, rename)
        self._position = 0
        self._lost = 0
        self._lost_all_known = True
        self._outside = 0
        self._ended = False
        if self._summary.problem:
            what = f"{self._summary.problem}: the index is not used, all messages that can be found are"
            statistics.lose(what, self._size, 0, messages=0)

    def messages(self) -> Iterator[_T]:
        """Yield the values that ``make`` returns, in the order of the file."""
        offset: int | None = len(MAGIC)
        while offset is not None:
            offset = yield from self._read_from(offset)

    def _lose(self, what: str, start: int, end: int, messages: int | None, span: tuple[int, int] | None = None) -> None:
        if messages is None:
            self._lost_all_known = False
        else:
            self._lost += messages
        self._statistics.lose(what, start, end - start, messages=messages, span=span)

    def _read_from(self, start: int) -> Generator[_T, None, int | None]:
        """Yield messages up to the end or to damage; return the offset at which reading goes on, or None."""
        for record in file_records(self._file, start, self._size, self._summary.next_offset):
            if not record.whole or not self._as_indexed(record):
                return (yield from self._cut(record))
            if record.opcode == Opcode.CHUNK:
                if not (yield from self._chunk(record)):
                    return resume_after(self._file, record.offset, self._size, self._summary) or record.end
            elif record.opcode in (Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL):
                if self._summary.in_index(record.offset):
                    self._lose("a record of a chunk's index is damaged and not used", record.offset, record.end, 0)
                elif record.opcode == Opcode.MESSAGE:
                    self._outside += 1
                    message = self._message(record.body, 0, len(record.body), record)
                    if message is not None:
                        yield message
                else:
                    self._declare(record.opcode, record.body, record.offset)
            elif record.opcode in _EXTRAS:
                self._pass_on(record)
            else:
                self._check(record)
        return None

    def _pass_on(self, record: Record) -> None:
        try:
            if self._on_extra is not None:
                self._on_extra(record)
        except RECORD_ERRORS as error:
            self._lose(f"an attachment or metadata record is damaged and left out: {error}", record.offset, record.end, 0)

    def _as_indexed(self, record: Record) -> bool:
        """Return whether a record is the one that the summary lists at its offset."""
        chunk = self._summary.chunk_at(record.offset)
        return chunk is None or (record.opcode == Opcode.CHUNK and record.end - record.offset == chunk.chunk_length)

    def _chunk(self, record: Record) -> Generator[_T, None, bool]:
        """Yield the messages of a whole chunk; return whether its length is plausible."""
        try:
            chunk = parse_chunk(record.body)
        except RECORD_ERRORS:
            self._lose("chunk skipped: its head is damaged", record.offset, record.end, self._indexed(record))
            return False
        try:
            data = chunk_contents(chunk)
        except ChunkError as error:
            self._lose(f"chunk skipped: {error}", record.offset, record.end, self._indexed(record), _span(chunk))
            return len(chunk.data) == record.end - record.offset - _CHUNK_HEAD - len(chunk.compression)
        if chunk.crc == 0:
            self._statistics.unchecked["chunks without a checksum"] += 1
        before = self._position
        used = yield from self._contents(data, record, chunk if chunk.crc == 0 else None)
        if used < len(data):
            indexed = self._indexed(record)
            lost = None if indexed is None else max(0, indexed - (self._position - before))
            self._lose(
                f"chunk used up to byte {used} of its contents: no whole record follows",
                record.offset,
                record.offset + len(data) - used,
                lost,
                _span(chunk),
            )
        return True

    def _contents(self, data: bytes, record: Record, unchecked: Chunk | None) -> Generator[_T, None, int]:
        """Yield the messages of a chunk's contents; return how many bytes of them are whole records.

        Args:
            data: The contents.
            record: The record that holds them.
            unchecked: The chunk, when no checksum covers the contents: a message that contradicts the chunk's head is then left out, and
                a record that is no schema, channel or message is damage, not a kind of a later version of the format.
        """
        end = 0
        span = _span(unchecked) if unchecked else None
        make, channels, unpack, size = self._make, self._channels, RECORD_HEAD.unpack_from, len(data)
        # written out here: a generator of the records would take a tenth of the time of reading
        while end + HEAD_SIZE <= size:
            opcode, length = unpack(data, end)
            start = end + HEAD_SIZE
            stop = start + length
            if opcode == 0 or stop > size or (unchecked is not None and opcode not in INNER):
                break
            end = stop
            if opcode != _MESSAGE_OPCODE:
                if opcode in INNER:
                    self._declare(opcode, data[start:stop], record.offset)
            elif length < MESSAGE.size:
                self._lose("a message record is too short and left out", record.offset, record.offset + length, 1)
            elif span is not None and not span[0] <= MESSAGE.unpack_from(data, start)[2] <= span[1]:
                self._lose("a message left out: its time is outside its chunk's", record.offset, record.offset + length, 1)
            else:
                position = self._position
                self._position = position + 1
                message = make(channels, data, start, stop, position)
                if message is not None:
                    yield message
        return end

    def _cut(self, record: Record) -> Generator[_T, None, int | None]:
        """Yield the messages of what is left of a record that is not whole; return where reading goes on, or None."""
        resume = resume_after(self._file, record.offset, self._size, self._summary)
        end = resume or self._size
        on = f"; reading goes on at byte {resume}" if resume else ""
        before = self._position
        indexed = self._indexed(record)
        if record.opcode == Opcode.CHUNK:
            try:
                chunk = parse_chunk(record.body[: end - record.offset - HEAD_SIZE])
                data = cut_contents(chunk)
            except RECORD_ERRORS:
                pass
            else:
                used = yield from self._contents(data, record, chunk)
                whole = record.offset + (_CHUNK_HEAD + used if chunk.compression == "" else 0)
                lost = 0 if used == chunk.size else None if indexed is None else max(0, indexed - (self._position - before))
                what = f"cut inside a chunk: the whole records before the cut are used{on}"
                self._lose(what, whole, end, lost, _span(chunk))
                return resume
        if record.offset == self._size:
            self._lose("ends without a footer: everything before is used", record.offset, end, 0)
        else:
            what = f"cut inside a record, or no record begins here: everything before is used{on}"
            listed = self._summary.chunk_at(record.offset)
            span = None if listed is None else (listed.message_start_time, listed.message_end_time)
            self._lose(what, record.offset, end, indexed, span)
        return resume

    def _indexed(self, record: Record) -> int | None:
        """Return the number of messages that the index lists for a chunk; None when it lists none."""
        chunk = self._summary.chunk_at(record.offset)
        end = record.offset + chunk.chunk_length if chunk else record.end
        return indexed_messages(self._file, end, self._size)

    def _declare(self, opcode: int, body: bytes, offset: int) -> None:
        try:
            self._channels.declare(opcode, body)
        except RECORD_ERRORS:
            self._lose("a schema or channel record is damaged and left out", offset, offset + len(body), 0)

    def _message(self, data: bytes, start: int, end: int, record: Record) -> _T | None:
        if end - start < MESSAGE.size:
            self._lose("a message record is too short and left out", record.offset, record.offset + end - start, 1)
            return None
        position = self._position
        self._position += 1
        return self._make(self._channels, data, start, end, position)

    def _check(self, record: Record) -> None:
        """Compare the file's statements about itself with what was found, unless a loss already explains a difference."""
        if record.opcode == Opcode.FOOTER:
            self._file.seek(record.end)
            tail = self._file.read(len(MAGIC))
            if tail != MAGIC:
                self._lose("ends without the closing magic bytes: all messages are used", record.end, self._size, 0)
            if not self._ended and not self._statistics.lost:
                self._lose("the end of the data is missing: messages may be", record.offset, record.offset, None)
        if record.opcode not in (Opcode.DATA_END, Opcode.STATISTICS):
            return
        try:
            if record.opcode == Opcode.DATA_END:
                self._ended = True
                self._check_data(parse(DataEnd, record.body).data_section_crc, record)
            else:
                self._check_count(parse(Statistics, record.body).message_count, record)
        except RECORD_ERRORS:
            self._lose("the end of the file is damaged: all messages are used", record.offset, record.end, 0)

    def _check_data(self, stated: int, record: Record) -> None:
        if stated == 0:
            if self._outside:
                self._statistics.unchecked["messages outside chunks, without a checksum"] += self._outside
        elif stated != record.crc and not self._statistics.lost:
            what = "the checksum of the data section does not match: messages outside chunks may be wrong"
            self._lose(what, record.offset, record.offset, 0)

    def _check_count(self, stated: int, record: Record) -> None:
        if self._lost_all_known and stated != self._position + self._lost:
            what = f"the file states {stated} messages, {self._position} were found"
            self._lose(what, record.offset, record.offset, max(0, stated - self._position - self._lost))


def _span(chunk: Chunk) -> tuple[int, int] | None:
    """Return the span of its messages' times that a chunk states [ns]; None when it cannot be true."""
    return (chunk.start_ns, chunk.end_ns) if 0 < chunk.end_ns >= chunk.start_ns else None
