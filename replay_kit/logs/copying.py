"""Logs to copy: messages as they stand in their files, with what stands beside them; JSON where a format has none of its own."""

import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Attachment, Header, Metadata

from replay_kit.config.run import LogConfig
from replay_kit.core.message import LogReport
from replay_kit.logs.decode.to_json import JsonChannels
from replay_kit.logs.mcap.reader import McapReader
from replay_kit.logs.mcap.records import HEAD_SIZE, MAGIC, MAX_SIZE, RECORD_ERRORS, Record, file_records, parse
from replay_kit.logs.opening import open_kept
from replay_kit.logs.raw import MAVLINK_FRAMES, RawChannel, RawMessage

_FRAMES_TOPIC = "mavlink/frames"


class RawLog:
    """A log opened to be copied; ``messages`` reads it anew.

    Attributes:
        path: The log.
    """

    def __init__(self, path: Path, input: int, config: LogConfig, beside: Callable[[Attachment | Metadata], None] | None = None) -> None:
        """Open the log.

        Args:
            path: The log.
            input: Position of the log among the inputs.
            config: Clock that orders the messages.
            beside: Called with each attachment and metadata record met.

        Raises:
            LogError: The file is missing or no log.
        """
        self.path = Path(path)
        self._input = input
        self._reader = open_kept(path, input, config)
        self._beside = beside
        self._names = config.remap
        self._renamed: dict[RawChannel, RawChannel] = {}

    def messages(self) -> Iterator[RawMessage]:
        """Yield the messages, in the file's order, on topics called by the names that ``logs.remap`` gives them."""
        for message in self._as_kept():
            if message.channel.topic in self._names:
                channel = self._renamed.get(message.channel) or replace(message.channel, topic=self._names[message.channel.topic])
                message.channel = self._renamed[message.channel] = channel
            yield message

    def _as_kept(self) -> Iterator[RawMessage]:
        if isinstance(self._reader, McapReader):
            yield from self._reader.raw_messages(self._record if self._beside else None)
            return
        channels = JsonChannels()
        for message in self._reader.messages():
            yield channels.raw(message)

    def frames(self) -> Iterator[RawMessage]:
        """Yield the entries of a telemetry log as they stand in it, or in the MCAP that it was converted to; else nothing."""
        if isinstance(self._reader, McapReader):
            yield from (message for message in self._reader.raw_messages() if message.channel.encoding == MAVLINK_FRAMES)
        elif self._reader.format == "tlog":
            from replay_kit.logs.mavlink.reader import entries

            channel = RawChannel(0, _FRAMES_TOPIC if self._input == 0 else f"{_FRAMES_TOPIC}/{self._input}", MAVLINK_FRAMES, (), None)
            for position, (stamp_us, frame) in enumerate(entries(self.path)):
                time_ns = stamp_us * 1000
                yield RawMessage(time_ns, self._input, position, channel, position % 2**32, time_ns, time_ns, frame)

    def has_own_frames(self) -> bool:
        """Return whether the log's own form is not that of ``messages``, so that ``frames`` must be copied, too."""
        return self._reader.format == "tlog"

    def report(self) -> LogReport:
        """Return what was met so far."""
        return self._reader.report()

    def _record(self, record: Record) -> None:
        assert self._beside is not None
        if record.opcode == Opcode.METADATA:
            self._beside(parse(Metadata, record.body))
        elif record.opcode == Opcode.ATTACHMENT:
            self._beside(self._attachment(record))

    def _attachment(self, record: Record) -> Attachment:
        length = record.end - record.offset - HEAD_SIZE
        if length > MAX_SIZE:
            raise ValueError(f"an attachment of {length} bytes, more than the {MAX_SIZE} that are read at once")
        with open(self.path, "rb") as file:
            file.seek(record.offset + HEAD_SIZE)
            body = file.read(length)
        (stated,) = struct.unpack_from("<I", body, length - 4)
        if stated not in (0, zlib.crc32(body[:-4])):
            raise ValueError("its checksum does not match")
        return parse(Attachment, body)


def header_of(path: Path) -> Header | None:
    """Return the header of an MCAP; None when the file is none, or its header is damaged."""
    with open(path, "rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            return None
        record = next(file_records(file, len(MAGIC), path.stat().st_size))
    try:
        return parse(Header, record.body) if record.opcode == Opcode.HEADER and record.whole else None
    except RECORD_ERRORS:
        return None
