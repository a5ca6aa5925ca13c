"""Streaming MCAP reader: one chunk in memory, messages in file order, damage counted and stepped over."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO, Literal

from replay_kit.config.run import LogConfig
from replay_kit.core.errors import LogError
from replay_kit.core.message import LogReport, Message
from replay_kit.logs.decode.decoders import PAYLOAD_ERRORS, explain
from replay_kit.logs.mcap.channels import Channels
from replay_kit.logs.mcap.records import MAGIC, Record
from replay_kit.logs.mcap.scanner import MESSAGE, Pass
from replay_kit.logs.raw import RawMessage
from replay_kit.logs.statistics import Tally

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
        with self._open() as file:
            yield from Pass(file, self._tally, self._decoded).messages()

    def raw_messages(self, beside: Callable[[Record], None] | None = None) -> Iterator[RawMessage]:
        """Yield the messages as they stand in the file, none decoded; the clock ``header`` decodes to find the stamp.

        Args:
            beside: As for ``Pass``.

        Raises:
            LogError: The file cannot be read or is no MCAP file.
        """
        with self._open() as file:
            yield from Pass(file, self._tally, self._raw, beside).messages()

    def report(self) -> LogReport:
        """Return what was met so far."""
        return replace(self._tally.report(self.path, self.format), without_stamp=self.without_stamp)

    @contextmanager
    def _open(self) -> Iterator[BinaryIO]:
        self._tally = Tally()
        self.without_stamp = 0
        try:
            with open(self.path, "rb") as file:
                head = file.read(len(MAGIC))
                if head != MAGIC:
                    raise LogError(
                        f"{self.path}: expected an MCAP file, whose first bytes are {MAGIC.hex(' ')}; they are {head.hex(' ')}; give a log"
                    )
                yield file
        except OSError as error:
            raise LogError(f"{self.path}: cannot be read: {error.strerror}; check the file and its permissions") from error

    def _decoded(self, channels: Channels, data: bytes, start: int, end: int, position: int) -> Message | None:
        """Return a message decoded; None, and a count, when it cannot be."""
        channel_id, _, time_ns, publish_ns = MESSAGE.unpack_from(data, start)
        sink = channels.sinks.get(channel_id) or channels.sink(channel_id)
        tally = self._tally
        tally.read[sink.topic] += 1
        decode = sink.decode
        if decode is None or isinstance(decode, str):
            if decode:
                tally.undecodable(sink.topic, decode)
            return None
        try:
            payload = decode(data[start + 22 : end])
        except PAYLOAD_ERRORS as error:
            tally.undecodable(sink.topic, explain(error))
            return None
        if self.clock != "log":
            time_ns = publish_ns if self.clock == "publish" else self._stamped(payload, time_ns)
        if time_ns > _MAX_TIME_NS:
            tally.undecodable(sink.topic, f"its time, {time_ns} ns, is past the year 2262")
            return None
        return Message(time_ns, sink.topic, sink.schema, payload, self.input, position)

    def _raw(self, channels: Channels, data: bytes, start: int, end: int, position: int) -> RawMessage | None:
        channel_id, sequence, log_ns, publish_ns = MESSAGE.unpack_from(data, start)
        sink = channels.sink(channel_id)
        self._tally.read[sink.topic] += 1
        body = data[start + MESSAGE.size : end]
        time_ns = publish_ns if self.clock == "publish" else log_ns
        if self.clock == "header" and callable(sink.decode):
            try:
                time_ns = self._stamped(sink.decode(body), time_ns)
            except PAYLOAD_ERRORS:
                self.without_stamp += 1
        return RawMessage(time_ns, self.input, position, sink.channel, sequence, log_ns, publish_ns, body)

    def _stamped(self, payload: Mapping[str, Any], log_ns: int) -> int:
        """Return a payload's own stamp; the log time, and a count, when it has none."""
        stamp = header_stamp(payload)
        if stamp is None:
            self.without_stamp += 1
            return log_ns
        return stamp


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
