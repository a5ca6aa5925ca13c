"""Streaming MCAP reader: one chunk in memory, messages in file or index order, damage counted and skipped."""

import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any, BinaryIO, TypeVar

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Attachment, Header, Metadata

from replay_kit.core.errors import LogError
from replay_kit.core.message import Message, RawMessage
from replay_kit.logs.blocks import Block, ReadStatistics
from replay_kit.logs.decode.decoders import PAYLOAD_ERRORS, Channels, explain
from replay_kit.logs.mcap.index import Part, Row, disordered, in_time, overview_of, problem_of
from replay_kit.logs.mcap.records import (
    HEAD_SIZE,
    MAGIC,
    MAX_SIZE,
    RECORD_ERRORS,
    Record,
    file_records,
    parse,
    read_summary,
)
from replay_kit.logs.mcap.scan import Scan
from replay_kit.logs.merge import header_stamp
from replay_kit.logs.payloads import DIVE_MEAN
from replay_kit.logs.reader import LogFile, OnExtra

_MAX_TIME_NS = 2**63 - 1
_T = TypeVar("_T")
#: Makes a value of a message; None leaves it out.
Make = Callable[[Channels, Part, Row], _T | None]


class McapReader(LogFile):
    """Reader of an MCAP file; the configured clock selects the stamp for ``time_ns``."""

    format = "mcap"

    def messages(self) -> Iterator[Message]:
        """Yield the decoded messages in file order, or in order of log time if the index shows another.

        ``position`` is the ordinal of the message in the file, including undecodable ones.

        Raises:
            LogError: The file cannot be read or is no MCAP file.
        """
        yield from self._each(self._decoded)

    def blocks(self, wanted: Callable[[str, str], bool]) -> Iterator[Block]:
        """Yield a block per chunk, decoding wanted topics and the first message of others; see ``LogFile.blocks``."""
        if self._clock == "header":
            # the stamp is in the payload
            yield from super().blocks(wanted)
            return
        sampled: set[tuple[str, str]] = set()
        for channels, part in self._parts():
            yield self._block(channels, part, wanted, sampled)

    def overview(self) -> Block | str:
        """Return the overview by the index at the end of the file; see ``LogFile.overview``."""
        if self._clock != "log":
            return f"the index holds log times alone, and the clock is {self._clock}"
        self.statistics = ReadStatistics()
        with self._opened() as file:
            summary = read_summary(file)
            channels = Channels(summary, self._topic)
            decoded = partial(self._decoded, channels)
            return overview_of(file, summary, channels, decoded, self.statistics)

    def raw_messages(self, on_extra: OnExtra | None = None) -> Iterator[RawMessage]:
        """Yield the raw messages; only the clock ``header`` needs decoding.

        Args:
            on_extra: Called with each attachment and metadata record; damaged ones are losses.

        Raises:
            LogError: The file cannot be read or is no MCAP file.
        """
        yield from self._each(self._raw, on_extra)

    def profile(self) -> str | None:
        """Return the profile in the header; None if it is damaged."""
        with self._opened() as file:
            record = next(file_records(file, len(MAGIC)))
        try:
            is_header = record.opcode == Opcode.HEADER and record.whole
            return parse(Header, record.body).profile if is_header else None
        except RECORD_ERRORS:
            return None

    def is_gliders(self) -> bool:
        """Return whether a channel, or without a channel index a message, holds mean currents of dives."""
        with self._opened() as file:
            schemas = read_summary(file).schemas
        if schemas:
            return any(schema.name == DIVE_MEAN for schema in schemas.values())
        # a reader of its own, as a pass of this one may go on
        with McapReader(self.files, self.input, self._config) as asked:
            return any(message.schema == DIVE_MEAN for message in asked.messages())

    def _each(self, make: Make[_T], on_extra: OnExtra | None = None) -> Iterator[_T]:
        """Yield the result of ``make`` for each message."""
        for channels, part in self._parts(on_extra):
            for row in part.rows():
                if (made := make(channels, part, row)) is not None:
                    yield made

    def _parts(self, on_extra: OnExtra | None = None) -> Iterator[tuple[Channels, Part]]:
        """Yield the messages of one pass in parts, in order of time if the index shows another order of the file."""
        self.statistics = ReadStatistics()
        with self._opened() as file:
            self._check_magic(file)
            summary = read_summary(file)
            channels = Channels(summary, self._topic)
            on_record = None if on_extra is None else lambda record: on_extra(_extra(file, record))
            scan = Scan(file, summary, channels, self.statistics, on_record)
            window_ns = round(self._config.reorder_window * 1e9)
            counts = None if problem_of(summary) else disordered(file, summary, window_ns)
            parts = scan.parts()
            if counts is not None:
                parts = in_time(file, summary.chunks, counts, self.statistics)
                for record in file_records(file, len(MAGIC)) if on_extra else ():
                    if record.opcode in (Opcode.ATTACHMENT, Opcode.METADATA):
                        scan.pass_on(record)
            for part in parts:
                yield channels, part

    def _check_magic(self, file: BinaryIO) -> None:
        if (head := file.read(len(MAGIC))) != MAGIC:
            raise LogError(
                f"{self.path}: expected an MCAP file, whose first bytes are {MAGIC.hex(' ')}; they are {head.hex(' ')}; give a log"
            )

    def _decoded(self, channels: Channels, part: Part, row: Row) -> Message | None:
        """Return a decoded message; None, counted, if undecodable."""
        channel, _, time_ns, publish_ns, start, stop, position = row
        sink = channels.sink(channel)
        statistics = self.statistics
        statistics.read[sink.topic] += 1
        decode = sink.decode
        if decode is None or isinstance(decode, str):
            if decode:
                statistics.undecodable(sink.topic, decode)
            return None
        try:
            payload = decode(part.contents[start:stop])
        except PAYLOAD_ERRORS as error:
            statistics.undecodable(sink.topic, explain(error))
            return None
        if self._clock != "log":
            time_ns = publish_ns if self._clock == "publish" else self._stamped(payload, time_ns)
        if time_ns > _MAX_TIME_NS:
            statistics.undecodable(sink.topic, f"its time, {time_ns} ns, is past the year 2262")
            return None
        return Message(time_ns, sink.topic, sink.schema, payload, self.input, position)

    def _block(
        self,
        channels: Channels,
        part: Part,
        wanted: Callable[[str, str], bool],
        sampled: set[tuple[str, str]],
    ) -> Block:
        """Return a part as a block with wanted messages decoded, and of other kinds one."""
        numbers, kind = np.unique(part.head["channel"], return_inverse=True)
        sinks = [channels.sink(number) for number in numbers.tolist()]
        kinds = tuple((sink.topic, sink.schema) for sink in sinks)
        times = part.head[f"{self._clock}_ns"]
        possible = times <= _MAX_TIME_NS
        # a message of an impossible time is counted where it is decoded
        chosen = ~possible
        for number, named in enumerate(kinds):
            if wanted(*named):
                chosen |= kind == number
            elif named not in sampled:
                chosen[np.argmax(kind == number)] = True
        rows = part.take(chosen).rows()
        made = [one for row in rows if (one := self._decoded(channels, part, row)) is not None]
        sampled |= {(message.topic, message.schema) for message in made}
        for sink, count in zip(
            sinks, np.bincount(kind[~chosen], minlength=len(sinks)).tolist(), strict=True
        ):
            self.statistics.read[sink.topic] += count
            if count and isinstance(sink.decode, str):
                self.statistics.undecodable(sink.topic, sink.decode, count)
        return Block(kinds, kind[possible], times[possible].astype(np.int64), made)

    def _raw(self, channels: Channels, part: Part, row: Row) -> RawMessage:
        channel, sequence, log_ns, publish_ns, start, stop, position = row
        sink = channels.sink(channel)
        self.statistics.read[sink.topic] += 1
        time_ns = publish_ns if self._clock == "publish" else log_ns
        if self._clock == "header" and callable(sink.decode):
            try:
                time_ns = self._stamped(sink.decode(part.contents[start:stop]), time_ns)
            except PAYLOAD_ERRORS:
                self.statistics.without_stamp += 1
        copied = sink.channel, sequence, log_ns, publish_ns, part.contents[start:stop]
        return RawMessage(time_ns, self.input, position, *copied)

    def _stamped(self, payload: Mapping[str, Any], log_ns: int) -> int:
        """Return a payload's own stamp; without one the log time, counted."""
        stamp = header_stamp(payload)
        if stamp is None:
            self.statistics.without_stamp += 1
            return log_ns
        return stamp


def _extra(file: BinaryIO, record: Record) -> Attachment | Metadata:
    """Return a metadata record or an attachment after a check.

    Raises:
        struct.error, ValueError, OverflowError, mcap.exceptions.McapError: ``RECORD_ERRORS``; it is damaged.
    """
    if record.opcode == Opcode.METADATA:
        return parse(Metadata, record.body)
    length = record.end - record.offset - HEAD_SIZE
    if length > MAX_SIZE:
        raise ValueError(f"an attachment of {length} bytes, more than {MAX_SIZE}")
    file.seek(record.offset + HEAD_SIZE)
    body = file.read(length)
    (stated,) = struct.unpack_from("<I", body, length - 4)
    if stated not in (0, zlib.crc32(body[:-4])):
        raise ValueError("its checksum does not match")
    return parse(Attachment, body)
