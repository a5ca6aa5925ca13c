"""Messages as they are in a file, undecoded, for copies; and the numbers of their channels in the copy."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

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


class ChannelWriter(Protocol):
    """A file being written in which schemas and channels are declared, as MCAP's own writer."""

    def register_schema(self, name: str, encoding: str, data: bytes, /) -> int:
        """Declare a schema and return its number."""
        ...

    def register_channel(
        self, topic: str, message_encoding: str, schema_id: int, metadata: dict[str, str], /
    ) -> int:
        """Declare a channel and return its number."""
        ...


class OutChannels:
    """Gives the numbers of channels in the file being written; each is declared once, before its first message."""

    def __init__(self, writer: ChannelWriter) -> None:
        """Begin with none.

        Args:
            writer: Where new ones are declared.
        """
        self._writer = writer
        self._schemas: dict[tuple[str, str, bytes], int] = {}
        self._channels: dict[tuple[int, RawChannel], int] = {}

    def number(self, input: int, channel: RawChannel) -> int:
        """Return a channel's number in the file, declared when it is new.

        Args:
            input: Tells the channels of one log from those of another.
            channel: The channel.
        """
        key = (input, channel)
        number = self._channels.get(key)
        if number is None:
            number = self._writer.register_channel(
                channel.topic, channel.encoding, self._schema(channel), dict(channel.metadata)
            )
            self._channels[key] = number
        return number

    def _schema(self, channel: RawChannel) -> int:
        if channel.schema is None:
            return 0
        if channel.schema not in self._schemas:
            self._schemas[channel.schema] = self._writer.register_schema(*channel.schema)
        return self._schemas[channel.schema]
