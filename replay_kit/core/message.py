"""Decoded and raw messages of a log, and a reader's report on it."""

from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

from replay_kit.core.words.text import time_text


class Message(NamedTuple):
    """Decoded message of a log; a tuple, four times as fast as a frozen dataclass.

    Attributes:
        time_ns: Time that orders the replay [ns, UTC], by the reader's chosen clock.
        topic: Channel name; for MAVLink ``mavlink/{system}/{component}/{NAME}``.
        schema: Schema name as in the file (``foxglove.LocationFix``, ``sensor_msgs/msg/NavSatFix``); for MAVLink the message's name.
        payload: Field names to numbers, strings, bytes, lists, mappings.
        input: Position of the log among the run's inputs.
        position: Ordinal or byte offset in that log, increasing.
    """

    time_ns: int
    topic: str
    schema: str
    payload: Mapping[str, Any]
    input: int
    position: int

    def __repr__(self) -> str:
        """Return time, topic, schema and field names as text."""
        return f"Message {time_text(self.time_ns)} {self.topic} ({self.schema}): {', '.join(map(str, self.payload))}"


@dataclass(frozen=True, slots=True)
class Loss:
    """Lost part of a damaged log.

    Attributes:
        what: Description of the damage and its handling.
        offset: Byte offset of the end of the last whole record.
        bytes: Number of unusable bytes.
        messages: Number of messages in them; None if not stated.
        first_ns: Earliest possible time of them [ns, UTC]; None if not stated.
        last_ns: Latest possible time of them [ns, UTC].
    """

    what: str
    offset: int
    bytes: int
    messages: int | None = None
    first_ns: int | None = None
    last_ns: int | None = None


@dataclass(frozen=True, slots=True)
class LogReport:
    """Reader's report on one log, complete once all messages were read.

    Attributes:
        path: The log.
        format: ``mcap``, ``tlog``, ``dataflash``, ``pd0``, ``ad2cp``, or a dialect of glider files, such as ``seaglider``.
        read: Number of messages by topic, decoded or not.
        undecodable: Topic to (count, reason) of undecodable messages.
        losses: Lost parts; empty for an intact file.
        without_stamp: Number of messages without a header stamp, ordered by log time.
        unchecked: Counts of records without a checksum, by kind.
        notes: Notes on its clocks and on assumed units, signs and names.
        mission: Name of the mission; empty if not stated.
    """

    path: str
    format: str
    read: Mapping[str, int]
    undecodable: Mapping[str, tuple[int, str]]
    losses: tuple[Loss, ...]
    without_stamp: int = 0
    unchecked: Mapping[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    mission: str = ""


class LogReader(AbstractContextManager["LogReader"], Protocol):
    """A log opened for reading, a context manager that closes unfinished passes."""

    path: str
    format: str
    input: int

    def messages(self) -> Iterator[Message]:
        """Yield the decoded messages in file order; ``merge`` sorts them by time."""
        ...

    def report(self) -> LogReport:
        """Return the report on the messages read so far."""
        ...


#: Begins a reader's note on what may be or give mean currents, of a log that states none.
NO_MEANS = "mean currents: "
#: Encoding of channels that hold the frames of a telemetry log as they were: no schema, log time is the entry's stamp.
MAVLINK_FRAMES = "mavlink"


@dataclass(frozen=True, slots=True)
class RawChannel:
    """A channel as an MCAP file declares it.

    Attributes:
        number: Number that distinguishes channels of one topic in its file.
        topic: Topic name.
        encoding: Encoding of its messages.
        metadata: Pairs of key and value.
        schema: Name, encoding and data; None without a schema.
    """

    number: int
    topic: str
    encoding: str
    metadata: tuple[tuple[str, str], ...]
    schema: tuple[str, str, bytes] | None


class RawMessage(NamedTuple):
    """Message with its bytes unchanged.

    Attributes:
        time_ns: Time that orders it, by the chosen clock [ns].
        input: Position of the log among the run's inputs.
        position: Ordinal in that log.
        channel: Its channel.
        sequence: Sequence number in the file.
        log_ns: Log time in the file [ns].
        publish_ns: Publish time in the file [ns].
        data: Payload.
    """

    time_ns: int
    input: int
    position: int
    channel: RawChannel
    sequence: int
    log_ns: int
    publish_ns: int
    data: bytes

    @property
    def topic(self) -> str:
        """Topic of the channel."""
        return self.channel.topic


class OutChannels:
    """Registry of the channels of the file being written; each is declared once, before its first message."""

    def __init__(self, writer: Any) -> None:
        """Create an empty registry.

        Args:
            writer: Writer with ``register_schema`` and ``register_channel``, as in the package mcap.
        """
        self._writer = writer
        # without a schema its number is 0
        self._schemas: dict[Any, int] = {None: 0}
        self._channels: dict[tuple[int, RawChannel], int] = {}

    def number(self, input: int, channel: RawChannel) -> int:
        """Return a channel's number in the file; declares new ones.

        Args:
            input: Number of the channel's log.
            channel: The channel.
        """
        key: tuple[int, RawChannel] = (input, channel)
        schema: Any = channel.schema
        if key not in self._channels:
            if schema not in self._schemas:
                self._schemas[schema] = self._writer.register_schema(*schema)
            self._channels[key] = self._writer.register_channel(
                channel.topic, channel.encoding, self._schemas[schema], dict(channel.metadata)
            )
        return self._channels[key]
