"""Channels of an MCAP file: topic, schema and decoder of each."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from mcap.opcode import Opcode
from mcap.records import Channel, Schema
from mcap.well_known import MessageEncoding

from replay_kit.core.message import MAVLINK_FRAMES, RawChannel
from replay_kit.logs.decode.budget import MOST_DECLARED, MOST_SCHEMA, MOST_SCHEMAS, check_size
from replay_kit.logs.decode.decoders import Decoder, channel_decoder
from replay_kit.logs.mcap.records import Summary, parse


@dataclass(frozen=True, slots=True)
class Sink:
    """Topic, schema and decoder of one channel.

    Attributes:
        topic: Topic of the channel.
        schema: Name of its schema; empty without one.
        decode: Decoder; the reason for a missing one; or None for raw frames, whose decoded messages are on other topics.
        channel: Channel as declared in the file.
    """

    topic: str
    schema: str
    decode: Decoder | str | None
    channel: RawChannel


class Channels:
    """Channels and schemas of the summary and those declared so far; decoders are built at the first message."""

    def __init__(self, summary: Summary, rename: Callable[[str], str]) -> None:
        """Create the registry.

        Args:
            summary: Summary of the file, for channels without a declaration, as after a lost chunk.
            rename: Returns the name of a topic of the file.
        """
        self._rename = rename
        self._schemas: dict[int, Schema] = dict(summary.schemas)
        self._channels: dict[int, Channel] = dict(summary.channels)
        self._declared = 0
        #: By encoding and schema: channels of one schema share a decoder.
        self._decoders: dict[tuple[str, str, str, bytes], Decoder | str] = {}
        self._parsed = 0
        #: Those built so far, by channel; read directly where a call for each message would cost time.
        self.sinks: dict[int, Sink] = {}

    def declare(self, opcode: int, body: bytes) -> None:
        """Add a schema or channel record.

        Raises:
            struct.error, ValueError, OverflowError, mcap.exceptions.McapError: The body is invalid, or the log declares too much.
        """
        check_size(self._declared + len(body), MOST_DECLARED, "all schemas and channels")
        kind: Any = Schema if opcode == Opcode.SCHEMA else Channel
        known: dict[int, Any] = self._schemas if opcode == Opcode.SCHEMA else self._channels
        record = parse(kind, body)
        if known.get(record.id) != record:
            known[record.id] = record
            self._declared += len(body)
            self.sinks.clear()

    def sink(self, channel_id: int) -> Sink:
        """Return the sink of a channel, declared or not."""
        found = self.sinks.get(channel_id)
        if found is None:
            found = self.sinks[channel_id] = self._build(channel_id)
        return found

    def _build(self, channel_id: int) -> Sink:
        channel = self._channels.get(channel_id)
        if channel is None:
            unknown = RawChannel(channel_id, f"(channel {channel_id})", "", (), None)
            return Sink(unknown.topic, "", "the file does not declare this channel", unknown)
        schema = self._schemas.get(channel.schema_id) if channel.schema_id else None
        definition = (schema.name, schema.encoding, schema.data) if schema else None
        topic = self._rename(channel.topic)
        raw = RawChannel(
            channel_id, topic, channel.message_encoding, tuple(channel.metadata.items()), definition
        )
        name = schema.name if schema else ""
        # `mavlink/` first: the dialect takes longer to load than a small log to read
        if raw.encoding == MessageEncoding.JSON and channel.topic.startswith("mavlink/"):
            from replay_kit.logs.decode.blueos import mavlink_channel

            if (known := mavlink_channel(channel.topic)) is not None:
                return Sink(topic, known[0] or name, known[1], raw)
        framed = raw.encoding == MAVLINK_FRAMES
        return Sink(topic, name, None if framed else self._decoder(raw.encoding, schema), raw)

    def _decoder(self, encoding: str, schema: Schema | None) -> Decoder | str:
        """Return the result of ``channel_decoder``, or the reason if the log's schemas are too large in total."""
        if schema is None:
            return channel_decoder(encoding, None)
        key = encoding, schema.name, schema.encoding, schema.data
        if key not in self._decoders:
            self._parsed += min(len(schema.data), MOST_SCHEMA)
            full = self._parsed > MOST_SCHEMAS
            why = f"the schemas of this log have more than the {MOST_SCHEMAS} bytes that are parsed of one log"
            self._decoders[key] = (
                why
                if full and encoding != MessageEncoding.JSON
                else channel_decoder(encoding, schema)
            )
        return self._decoders[key]
