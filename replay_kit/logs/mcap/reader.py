"""Streaming MCAP reader: one chunk in memory, messages in file order or that of the index, damage counted and skipped."""

import os
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from typing import Any, BinaryIO, TypeVar

from mcap.opcode import Opcode
from mcap.records import Attachment, Header, Metadata

from replay_kit.core.errors import LogError
from replay_kit.core.message import MAVLINK_FRAMES, Message, RawMessage
from replay_kit.logs.decode.decoders import PAYLOAD_ERRORS, explain
from replay_kit.logs.decode.to_json import DIVE_MEAN
from replay_kit.logs.mcap.ordered import Slice, disordered, slices
from replay_kit.logs.mcap.records import (
    HEAD_SIZE,
    MAGIC,
    MAX_SIZE,
    RECORD_ERRORS,
    Record,
    file_records,
    parse,
)
from replay_kit.logs.mcap.scanner import MESSAGE, McapScanner
from replay_kit.logs.mcap.summary import Channels, Make, read_summary
from replay_kit.logs.mcap.survey import Survey, overview_of, problem_of
from replay_kit.logs.reader import LogFile, OnExtra
from replay_kit.logs.shared.blocks import Block, Overview, ReadStatistics
from replay_kit.logs.shared.times import header_stamp

_MAX_TIME_NS = 2**63 - 1
_T = TypeVar("_T")


class McapReader(LogFile):
    """An MCAP file opened for reading. The clock of the configuration chooses which stamp becomes ``time_ns``."""

    format = "mcap"

    def messages(self) -> Iterator[Message]:
        """Yield the decoded messages in the order in which the file holds them; in order of log time where its index tells of another.

        ``position`` is the ordinal of the message in the file, undecodable ones counted.

        Raises:
            LogError: The file cannot be read or is no MCAP file.
        """
        self.statistics = ReadStatistics()
        yield from self._scan(self._decoded)

    def blocks(self, wanted: Callable[[str, str], bool]) -> Iterator[Block]:
        """Yield a block for each chunk; only wanted topics are decoded, and of others the first message. As ``LogFile.blocks``."""
        if self._clock == "header":
            # the stamp is in the payload
            yield from super().blocks(wanted)
            return
        self.statistics = ReadStatistics()
        survey = Survey(self.statistics, self._decoded, f"{self._clock}_ns", wanted)
        with self._opened() as file:
            self._check_magic(file)
            if (ordered := self._ordered(file)) is None:
                yield from McapScanner(
                    file, self.statistics, survey.single, self._topic, bulk=survey
                ).messages()
                return
            (channels, parts), first = ordered, 0
            for part in parts:
                if part.ordinals.size:
                    yield survey.block(channels, part.contents, part.found, first)
                first += part.ordinals.size

    def overview(self) -> Overview | str:
        """Return what the index at the end of the file says; as ``LogFile.overview``."""
        if self._clock != "log":
            return f"the index holds log times alone, and the clock is {self._clock}"
        self.statistics = ReadStatistics()
        with self._opened() as file:
            return overview_of(file, self._decoded, self._topic)

    def raw_messages(self, on_extra: OnExtra | None = None) -> Iterator[RawMessage]:
        """Yield the messages as they are in the file, none decoded; the clock ``header`` decodes to find the stamp.

        Args:
            on_extra: Called with each attachment and metadata record; damaged ones are losses.

        Raises:
            LogError: The file cannot be read or is no MCAP file.
        """
        self.statistics = ReadStatistics()
        yield from self._scan(self._raw, on_extra)

    def frames(self) -> Iterator[RawMessage]:
        """Yield the entries of a telemetry log that was converted to this file."""
        with self._opened() as file:
            yield from McapScanner(file, ReadStatistics(), self._frame, self._topic).messages()

    def profile(self) -> str | None:
        """Return the profile that the header states; None when the header is damaged."""
        with self._opened() as file:
            record = next(file_records(file, len(MAGIC), os.fstat(file.fileno()).st_size))
        try:
            return (
                parse(Header, record.body).profile
                if record.opcode == Opcode.HEADER and record.whole
                else None
            )
        except RECORD_ERRORS:
            return None

    def is_gliders(self) -> bool:
        """Return whether a channel states mean currents of dives; without an index of the channels, whether a message does."""
        with self._opened() as file:
            schemas = read_summary(file, os.fstat(file.fileno()).st_size).schemas
        if schemas:
            return any(schema.name == DIVE_MEAN for schema in schemas.values())
        return any(message.schema == DIVE_MEAN for message in self.messages())

    def _scan(self, make: Make[_T], on_extra: OnExtra | None = None) -> Iterator[_T]:
        with self._opened() as file:
            self._check_magic(file)
            on_record = None if on_extra is None else lambda record: on_extra(_extra(file, record))
            ordered = self._ordered(file)
            scanner = McapScanner(file, self.statistics, make, self._topic, on_record)
            if ordered is None:
                yield from scanner.messages()
                return
            for record in file_records(file, len(MAGIC), os.fstat(file.fileno()).st_size):
                if record.opcode in (Opcode.ATTACHMENT, Opcode.METADATA):
                    scanner.pass_on(record)
            channels, parts = ordered
            for part in parts:
                starts, stops = (part.found.offset + HEAD_SIZE).tolist(), part.found.stop.tolist()
                for row in zip(starts, stops, part.ordinals.tolist(), strict=True):
                    if (made := make(channels, part.contents, *row)) is not None:
                        yield made

    def _ordered(self, file: BinaryIO) -> tuple[Channels, Iterator[Slice]] | None:
        """Return the channels, and the messages in order of time, in parts; None where the order of the file will do or is all there is."""
        summary = read_summary(file, os.fstat(file.fileno()).st_size)
        window_ns = round(self._config.reorder_window * 1e9)
        held = None if problem_of(summary) else disordered(file, summary, window_ns)
        file.seek(len(MAGIC))
        if held is None:
            return None
        return Channels(summary, self._topic), slices(file, held, self.statistics)

    def _check_magic(self, file: BinaryIO) -> None:
        if (head := file.read(len(MAGIC))) != MAGIC:
            raise LogError(
                f"{self.path}: expected an MCAP file, whose first bytes are {MAGIC.hex(' ')}; they are {head.hex(' ')}; give a log"
            )

    def _decoded(
        self, channels: Channels, data: bytes, start: int, end: int, position: int
    ) -> Message | None:
        """Return a message decoded; None, and a count, when it cannot be."""
        channel_id, _, time_ns, publish_ns = MESSAGE.unpack_from(data, start)
        sink = channels.sinks.get(channel_id) or channels.sink(channel_id)
        statistics = self.statistics
        statistics.read[sink.topic] += 1
        decode = sink.decode
        if decode is None or isinstance(decode, str):
            if decode:
                statistics.undecodable(sink.topic, decode)
            return None
        try:
            payload = decode(data[start + 22 : end])
        except PAYLOAD_ERRORS as error:
            statistics.undecodable(sink.topic, explain(error))
            return None
        if self._clock != "log":
            time_ns = publish_ns if self._clock == "publish" else self._stamped(payload, time_ns)
        if time_ns > _MAX_TIME_NS:
            statistics.undecodable(sink.topic, f"its time, {time_ns} ns, is past the year 2262")
            return None
        return Message(time_ns, sink.topic, sink.schema, payload, self.input, position)

    def _raw(
        self, channels: Channels, data: bytes, start: int, end: int, position: int
    ) -> RawMessage:
        channel_id, sequence, log_ns, publish_ns = MESSAGE.unpack_from(data, start)
        sink = channels.sink(channel_id)
        self.statistics.read[sink.topic] += 1
        body = data[start + MESSAGE.size : end]
        time_ns = publish_ns if self._clock == "publish" else log_ns
        if self._clock == "header" and callable(sink.decode):
            try:
                time_ns = self._stamped(sink.decode(body), time_ns)
            except PAYLOAD_ERRORS:
                self.statistics.without_stamp += 1
        return RawMessage(
            time_ns, self.input, position, sink.channel, sequence, log_ns, publish_ns, body
        )

    def _frame(
        self, channels: Channels, data: bytes, start: int, end: int, position: int
    ) -> RawMessage | None:
        """Return the entry of a telemetry log; None for other messages. By every clock its time is the entry's stamp."""
        channel_id, sequence, log_ns, publish_ns = MESSAGE.unpack_from(data, start)
        channel = channels.sink(channel_id).channel
        if channel.encoding != MAVLINK_FRAMES:
            return None
        return RawMessage(
            log_ns,
            self.input,
            position,
            channel,
            sequence,
            log_ns,
            publish_ns,
            data[start + MESSAGE.size : end],
        )

    def _stamped(self, payload: Mapping[str, Any], log_ns: int) -> int:
        """Return a payload's own stamp; the log time, and a count, when it has none."""
        stamp = header_stamp(payload)
        if stamp is None:
            self.statistics.without_stamp += 1
            return log_ns
        return stamp


def _extra(file: BinaryIO, record: Record) -> Attachment | Metadata:
    """Return a metadata record, or an attachment, whose body is read here and checked.

    Raises:
        struct.error, ValueError, OverflowError, mcap.exceptions.McapError: ``RECORD_ERRORS``; it is damaged.
    """
    if record.opcode == Opcode.METADATA:
        return parse(Metadata, record.body)
    length = record.end - record.offset - HEAD_SIZE
    if length > MAX_SIZE:
        raise ValueError(
            f"an attachment of {length} bytes, more than the {MAX_SIZE} that are read at once"
        )
    file.seek(record.offset + HEAD_SIZE)
    body = file.read(length)
    (stated,) = struct.unpack_from("<I", body, length - 4)
    if stated not in (0, zlib.crc32(body[:-4])):
        raise ValueError("its checksum does not match")
    return parse(Attachment, body)
