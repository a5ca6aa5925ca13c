"""A log's messages, decoded or as stored, and a reader's report on the log as a whole."""

from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

from replay_kit.core.text import time_text


class Message(NamedTuple):
    """One decoded message of a log; a tuple, as a log has millions and a frozen dataclass takes four times as long to make.

    Attributes:
        time_ns: The time that orders the replay [ns, UTC], by the clock the reader was asked for.
        topic: Channel name; for MAVLink ``mavlink/{system}/{component}/{NAME}``.
        schema: Schema name as in the file (``foxglove.LocationFix``, ``sensor_msgs/msg/NavSatFix``); for MAVLink the
            message's name.
        payload: Plain mapping of field names to numbers, strings, bytes, lists and mappings, whatever the encoding was.
        input: Position of the log among the run's inputs.
        position: Ordinal or byte offset in that log; grows through the file.
    """

    time_ns: int
    topic: str
    schema: str
    payload: Mapping[str, Any]
    input: int
    position: int

    def __repr__(self) -> str:
        """Return what it is and the names of its fields, without their values."""
        return f"Message {time_text(self.time_ns)} {self.topic} ({self.schema}): {', '.join(map(str, self.payload))}"


@dataclass(frozen=True, slots=True)
class Loss:
    """Part of a damaged log that is lost.

    Attributes:
        what: For a person: where the damage is and what was done.
        offset: Byte offset in the file at which whole records end.
        bytes: Number of bytes that could not be used.
        messages: Number of messages in them; None when the file does not state it.
        first_ns: Earliest time that they may have [ns, UTC]; None when the file does not state it.
        last_ns: Latest.
    """

    what: str
    offset: int
    bytes: int
    messages: int | None = None
    first_ns: int | None = None
    last_ns: int | None = None


@dataclass(frozen=True, slots=True)
class LogReport:
    """What a reader found in one log, complete once its messages were read to the end.

    Attributes:
        path: The log.
        format: ``mcap``, ``tlog``, ``dataflash``, ``pd0``, ``ad2cp``, or a dialect of glider files, such as ``seaglider``.
        read: Messages found, by topic, decoded or not.
        undecodable: Topic to (count, reason) for what no decoder could read.
        losses: Damage found; empty for a sound file.
        without_stamp: Messages ordered by their log time although the clock is ``header``, because they carry no stamp.
        unchecked: What no checksum covers, so that damage to it cannot be detected: kind to count.
        notes: What a user should know about its clocks, and what was assumed of its units, signs and names.
        mission: Name of the mission that it is of; empty when it does not state it.
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
    """A log opened for reading, a context whose end closes the passes that were not finished."""

    path: str
    format: str
    input: int

    def messages(self) -> Iterator[Message]:
        """Yield the decoded messages in the file's order; ``merge`` puts them in the order of their times."""
        ...

    def report(self) -> LogReport:
        """Return what was found so far."""
        ...


#: Begins a reader's note on what may be or give mean currents, of a log that states none.
NO_MEANS = "mean currents: "
#: Encoding of channels that hold the frames of a telemetry log as they were: no schema, log time is the entry's stamp.
MAVLINK_FRAMES = "mavlink"


@dataclass(frozen=True, slots=True)
class RawChannel:
    """A channel as an MCAP file declares it.

    Attributes:
        number: Tells it from others of the same topic in its file.
        topic: Its name.
        encoding: Of its messages.
        metadata: Keys and values.
        schema: Name, encoding and data; None when it has none.
    """

    number: int
    topic: str
    encoding: str
    metadata: tuple[tuple[str, str], ...]
    schema: tuple[str, str, bytes] | None


class RawMessage(NamedTuple):
    """A message, its bytes untouched; a tuple for the same reason as ``Message``.

    Attributes:
        time_ns: The time that orders it, by the clock asked for [ns].
        input: Position of the log among the run's inputs.
        position: Ordinal in that log.
        channel: Where it was sent.
        sequence: As in the file.
        log_ns: As in the file.
        publish_ns: As in the file.
        data: The payload.
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
        """The channel's topic."""
        return self.channel.topic


class OutChannels:
    """Gives the numbers of channels in the file being written; each is declared once, before its first message."""

    def __init__(self, writer: Any) -> None:
        """Begin with none.

        Args:
            writer: Where new ones are declared, by ``register_schema`` and ``register_channel`` as MCAP's own writer has them.
        """
        self._writer = writer
        # without a schema its number is 0
        self._schemas: dict[Any, int] = {None: 0}
        self._channels: dict[tuple[int, RawChannel], int] = {}

    def number(self, input: int, channel: RawChannel) -> int:
        """Return a channel's number in the file, declared when it is new.

        Args:
            input: Tells the channels of one log from those of another.
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
