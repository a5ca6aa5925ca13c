"""Messages as they are in a file, undecoded, for copies."""

from dataclasses import dataclass
from typing import NamedTuple

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
