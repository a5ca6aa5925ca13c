"""Streaming MCAP reader: one chunk in memory, messages in file order, damage counted and stepped over."""

import os
import struct
from collections.abc import Generator, Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO, Literal

from mcap.opcode import Opcode
from mcap.records import Chunk, DataEnd, Statistics

from replay_kit.config import LogConfig
from replay_kit.errors import LogError
from replay_kit.logs.decode import PAYLOAD_ERRORS, explain
from replay_kit.logs.mcap_channels import Channels
from replay_kit.logs.mcap_records import (
    HEAD_SIZE,
    MAGIC,
    RECORD_ERRORS,
    ChunkError,
    Record,
    Summary,
    chunk_contents,
    cut_contents,
    file_records,
    inner_records,
    parse,
    read_summary,
)
from replay_kit.logs.tally import Tally
from replay_kit.types import LogReport, Message

#: Fixed part of a message record: channel, sequence, log time, publish time. Unpacked here at once, because the library's
#: reader takes each number with a call of its own and would be half of the reading time.
_MESSAGE = struct.Struct("<HIQQ")

#: From a chunk's beginning to its data when it is not compressed [bytes].
_CHUNK_HEAD = HEAD_SIZE + 40
_MAX_TIME_NS = 2**63 - 1

_Clock = Literal["log", "publish", "header"]


class McapReader:
    """An MCAP file opened for reading; each call of ``messages`` reads it anew.

    Attributes:
        path: The log.
        format: ``mcap``.
        input: Position of the log among the run's inputs.
        clock: Which stamp becomes ``time_ns``.
        without_stamp: Messages that took their log time because their payload has no stamp, when the clock is ``header``.
    """

    path: str
    format: str = "mcap"

    def __init__(self, path: Path, input: int = 0, config: LogConfig | None = None) -> None:
        """Remember what to read; the file is opened by ``messages``.

        Args:
            path: The log.
            input: Position of the log among the run's inputs.
            config: Which clock orders the messages; the defaults when None.
        """
        self.path = str(path)
        self.without_stamp = 0
        self.clock: _Clock = config.clock if config else "log"
        self.input = input
        self._tally = Tally()

    def messages(self) -> Iterator[Message]:
        """Yield the decoded messages in the order in which the file holds them.

        ``position`` is the ordinal of the message in the file, undecodable ones counted.

        Raises:
            LogError: The file cannot be read or is no MCAP file.
        """
        self._tally = Tally()
        self.without_stamp = 0
        try:
            with open(self.path, "rb") as file:
                head = file.read(len(MAGIC))
                if head != MAGIC:
                    raise LogError(
                        f"{self.path}: expected an MCAP file, whose first bytes are {MAGIC.hex(' ')}; they are {head.hex(' ')}; give a log"
                    )
                yield from _Pass(self, self._tally, file).messages()
        except OSError as error:
            raise LogError(f"{self.path}: cannot be read: {error.strerror}; check the file and its permissions") from error

    def report(self) -> LogReport:
        """Return what was met so far."""
        return replace(self._tally.report(self.path, self.format), without_stamp=self.without_stamp)


class _Pass:
    """One pass over an open file."""

    def __init__(self, reader: McapReader, tally: Tally, file: BinaryIO) -> None:
        self._reader = reader
        self._tally = tally
        self._file = file
        self._size = os.fstat(file.fileno()).st_size
        self._channels = Channels(lambda: self._summary)
        self._position = 0

    @cached_property
    def _summary(self) -> Summary:
        return read_summary(self._file, self._size)

    def messages(self) -> Iterator[Message]:
        offset: int | None = len(MAGIC)
        while offset is not None:
            offset = yield from self._read_from(offset)

    def _lose(self, what: str, start: int, end: int) -> None:
        self._tally.lose(what, start, end - start)

    def _read_from(self, start: int) -> Generator[Message, None, int | None]:
        """Yield messages up to the end or to damage; return the offset at which to go on, or None."""
        for record in file_records(self._file, start, self._size):
            if not record.whole:
                return (yield from self._cut(record))
            if record.opcode == Opcode.CHUNK:
                yield from self._chunk(record)
            elif record.opcode == Opcode.MESSAGE:
                message = self._message(record.body, 0, len(record.body), record)
                if message is not None:
                    yield message
            elif record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._declare(record.opcode, record.body, record)
            else:
                self._check(record)
        return None

    def _chunk(self, record: Record) -> Iterator[Message]:
        try:
            data = chunk_contents(parse(Chunk, record.body))
        except ChunkError as error:
            self._lose(f"chunk skipped: {error}", record.offset, record.end)
            return
        except RECORD_ERRORS:
            self._lose("chunk skipped: its head is damaged", record.offset, record.end)
            return
        used = yield from self._contents(data, record)
        if used < len(data):
            self._tally.lose(f"chunk used up to byte {used} of its contents: no whole record follows", record.offset, len(data) - used)

    def _contents(self, data: bytes, record: Record) -> Generator[Message, None, int]:
        """Yield the messages of a chunk's contents; return how many bytes of them are whole records."""
        end = 0
        for opcode, start, end in inner_records(data):
            if opcode == Opcode.MESSAGE:
                message = self._message(data, start, end, record)
                if message is not None:
                    yield message
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._declare(opcode, data[start:end], record)
        return end

    def _cut(self, record: Record) -> Generator[Message, None, int | None]:
        """Use what is left of a record that is not whole; return where the next chunk begins if the summary knows one."""
        resume = next((offset for offset in self._summary.chunk_offsets if offset > record.offset), None)
        end = resume or self._size
        on = "; reading goes on at the next chunk" if resume else ""
        if record.opcode == Opcode.CHUNK:
            try:
                chunk = parse(Chunk, record.body[: end - record.offset - HEAD_SIZE])
                used = yield from self._contents(cut_contents(chunk), record)
            except RECORD_ERRORS:
                pass
            else:
                whole = record.offset + (_CHUNK_HEAD + used if chunk.compression == "" else 0)
                self._lose(f"cut inside a chunk: the whole records before the cut are used{on}", whole, end)
                return resume
        if record.offset == self._size:
            self._lose("ends without a footer: everything before is used", record.offset, end)
        else:
            self._lose(f"cut inside a record, or no record begins here: everything before is used{on}", record.offset, end)
        return resume

    def _declare(self, opcode: int, body: bytes, record: Record) -> None:
        try:
            self._channels.declare(opcode, body)
        except RECORD_ERRORS:
            self._tally.lose("a schema or channel record is damaged and left out", record.offset, len(body))

    def _message(self, data: bytes, start: int, end: int, record: Record) -> Message | None:
        """Return the message whose record's body is ``data[start:end]``; None, and a count, when it cannot be decoded."""
        if end - start < _MESSAGE.size:
            self._tally.lose("a message record is too short and left out", record.offset, end - start)
            return None
        channel_id, _, time_ns, publish_ns = _MESSAGE.unpack_from(data, start)
        sink = self._channels.sink(channel_id)
        position = self._position
        self._position += 1
        self._tally.read[sink.topic] += 1
        if isinstance(sink.decode, str):
            self._tally.undecodable(sink.topic, sink.decode)
            return None
        try:
            payload = sink.decode(data[start + _MESSAGE.size : end])
        except PAYLOAD_ERRORS as error:
            self._tally.undecodable(sink.topic, explain(error))
            return None
        if self._reader.clock == "publish":
            time_ns = publish_ns
        elif self._reader.clock == "header":
            stamp = header_stamp(payload)
            if stamp is None:
                self._reader.without_stamp += 1
            else:
                time_ns = stamp
        if time_ns > _MAX_TIME_NS:
            self._tally.undecodable(sink.topic, f"its time, {time_ns} ns, is past the year 2262")
            return None
        return Message(time_ns, sink.topic, sink.schema, payload, self._reader.input, position)

    def _check(self, record: Record) -> None:
        """Compare what the file says about itself with what was met, unless a loss already explains a difference."""
        if record.opcode == Opcode.FOOTER:
            self._file.seek(record.end)
            tail = self._file.read(len(MAGIC))
            if tail != MAGIC:
                self._lose("ends without the closing magic bytes: all messages are used", record.end, self._size)
        if self._tally.lost or record.opcode not in (Opcode.DATA_END, Opcode.STATISTICS):
            return
        try:
            if record.opcode == Opcode.DATA_END:
                if parse(DataEnd, record.body).data_section_crc not in (0, record.crc):
                    self._lose(
                        "the checksum of the data section does not match: messages outside chunks may be wrong",
                        record.offset,
                        record.offset,
                    )
            elif (count := parse(Statistics, record.body).message_count) != self._position:
                self._lose(f"the file says that it holds {count} messages, {self._position} were met", record.offset, record.offset)
        except RECORD_ERRORS:
            self._lose("the end of the file is damaged: all messages are used", record.offset, record.end)


def header_stamp(payload: Mapping[str, Any]) -> int | None:
    """Return the time that a payload states about itself [ns, UTC]; None when it states none.

    Looked for in ``header.stamp``, ``stamp`` and ``timestamp``, as a mapping of seconds and nanoseconds under the names in
    use. Zero means unset, as in ROS; what int64 cannot hold is no time.
    """
    header = payload.get("header")
    stamps = [header.get("stamp")] if isinstance(header, Mapping) else []
    for stamp in (*stamps, payload.get("stamp"), payload.get("timestamp")):
        if isinstance(stamp, Mapping):
            seconds = _first_integer(stamp, ("sec", "secs", "seconds"))
            nanoseconds = _first_integer(stamp, ("nsec", "nanosec", "nsecs", "nanos"))
            if seconds is not None and nanoseconds is not None:
                time_ns = seconds * 1_000_000_000 + nanoseconds
                if 0 < time_ns <= _MAX_TIME_NS:
                    return time_ns
    return None


def _first_integer(stamp: Mapping[str, Any], names: tuple[str, ...]) -> int | None:
    return next((stamp[name] for name in names if isinstance(stamp.get(name), int)), None)
