"""Declarations of an MCAP file: its summary section, and topic, schema and decoder of each channel."""

from bisect import bisect_right
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any, BinaryIO

from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    Footer,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.well_known import MessageEncoding

from replay_kit.core.message import MAVLINK_FRAMES, RawChannel
from replay_kit.logs.decode.budget import MOST_DECLARED, MOST_SCHEMA, MOST_SCHEMAS, check_size
from replay_kit.logs.decode.decoders import Decoder, channel_decoder
from replay_kit.logs.mcap.records import (
    HEAD_SIZE,
    MAGIC,
    RECORD_ERRORS,
    RECORD_HEAD,
    crc_of_rest,
    file_records,
    parse,
)

_FOOTER_SIZE = HEAD_SIZE + 20
#: Records of a summary that are used.
_KINDS: Mapping[int, Any] = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK_INDEX: ChunkIndex,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex,
    Opcode.METADATA_INDEX: MetadataIndex,
    Opcode.STATISTICS: Statistics,
}


@dataclass(frozen=True)
class Summary:
    """Summary section; empty if missing or damaged.

    Attributes:
        schemas: Schemas by number.
        channels: Channels by number.
        chunks: Index entries of chunks by offset.
        offsets: Offsets of chunks, attachments, metadata and the summary [bytes], increasing.
        statistics: Counts stated in the file; None without.
        problem: Why an existing summary is not used; else empty.
        checked: Whether it has a checksum.
    """

    schemas: dict[int, Schema]
    channels: dict[int, Channel]
    chunks: tuple[ChunkIndex, ...]
    offsets: tuple[int, ...]
    statistics: Statistics | None = None
    problem: str = ""
    checked: bool = False

    @cached_property
    def _chunk_starts(self) -> tuple[int, ...]:
        return tuple(chunk.chunk_start_offset for chunk in self.chunks)

    def chunk_at(self, offset: int) -> ChunkIndex | None:
        """Return the index entry of the chunk at an offset; None without one."""
        place = bisect_right(self._chunk_starts, offset) - 1
        return self.chunks[place] if place >= 0 and self._chunk_starts[place] == offset else None

    def next_offset(self, offset: int) -> int | None:
        """Return the offset of the next record listed in the summary; None without one."""
        place = bisect_right(self.offsets, offset)
        return self.offsets[place] if place < len(self.offsets) else None

    def in_index(self, offset: int) -> bool:
        """Return whether a byte belongs to a chunk's message index, which holds no messages."""
        place = bisect_right(self._chunk_starts, offset) - 1
        if place < 0:
            return False
        chunk = self.chunks[place]
        begin = chunk.chunk_start_offset + chunk.chunk_length
        return begin <= offset < begin + chunk.message_index_length


_NOTHING = Summary({}, {}, (), ())


def read_summary(file: BinaryIO, size: int) -> Summary:
    """Return the summary section, verified by its checksum if any.

    Args:
        file: The open log.
        size: Size of the file [bytes].
    """
    length = _FOOTER_SIZE + len(MAGIC)
    file.seek(max(0, size - length))
    tail = file.read(length)
    if (
        len(tail) < length
        or not tail.endswith(MAGIC)
        or RECORD_HEAD.unpack_from(tail) != (Opcode.FOOTER, 20)
    ):
        return _NOTHING
    footer = parse(Footer, tail[HEAD_SIZE:])
    start = footer.summary_start
    if not len(MAGIC) <= start < size - length:
        return (
            Summary({}, {}, (), (), problem="the footer points to no summary")
            if start
            else _NOTHING
        )
    file.seek(start)
    if footer.summary_crc not in (0, crc_of_rest(file, size - len(MAGIC) - 4 - start, 0)):
        return Summary({}, {}, (), (), problem="the checksum of the summary does not match")
    return _collect(file, start, size, footer.summary_crc != 0)


def _collect(file: BinaryIO, start: int, size: int, checked: bool) -> Summary:
    found: dict[int, list[Any]] = {opcode: [] for opcode in _KINDS}
    declared = 0
    # of what is there twice the data section's own declarations count where these are left out
    for record in file_records(file, start, size):
        if record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            declared += len(record.body)
            if declared > MOST_DECLARED:
                continue
        if record.opcode in _KINDS:
            with suppress(*RECORD_ERRORS):
                found[record.opcode].append(parse(_KINDS[record.opcode], record.body))
    chunks = {
        chunk.chunk_start_offset: chunk
        for chunk in found[Opcode.CHUNK_INDEX]
        if len(MAGIC) <= chunk.chunk_start_offset < start
    }
    others = {
        index.offset
        for opcode in (Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX)
        for index in found[opcode]
    }
    return Summary(
        schemas={schema.id: schema for schema in found[Opcode.SCHEMA]},
        channels={channel.id: channel for channel in found[Opcode.CHANNEL]},
        chunks=tuple(chunks[offset] for offset in sorted(chunks)),
        offsets=tuple(
            sorted(
                {offset for offset in others if len(MAGIC) <= offset < start}.union(
                    chunks, (start,)
                )
            )
        ),
        statistics=found[Opcode.STATISTICS][-1] if found[Opcode.STATISTICS] else None,
        checked=checked,
    )


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
    """Channels and schemas declared so far; decoders are built at the first message."""

    def __init__(self, summary: Summary, rename: Callable[[str], str]) -> None:
        """Create an empty registry.

        Args:
            summary: Summary of the file, for channels without a declaration, as after a lost chunk.
            rename: Returns the name of a topic of the file.
        """
        self._summary = summary
        self._rename = rename
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
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
        if opcode == Opcode.SCHEMA:
            schema = parse(Schema, body)
            if self._schemas.get(schema.id) != schema:
                self._schemas[schema.id] = schema
                self._declared += len(body)
                self.sinks.clear()
        else:
            channel = parse(Channel, body)
            if self._channels.get(channel.id) != channel:
                self._channels[channel.id] = channel
                self._declared += len(body)
                self.sinks.pop(channel.id, None)

    def sink(self, channel_id: int) -> Sink:
        """Return the sink of a channel, declared or not."""
        found = self.sinks.get(channel_id)
        if found is None:
            found = self.sinks[channel_id] = self._build(channel_id)
        return found

    def _build(self, channel_id: int) -> Sink:
        channel = self._channels.get(channel_id) or self._summary.channels.get(channel_id)
        if channel is None:
            unknown = RawChannel(channel_id, f"(channel {channel_id})", "", (), None)
            return Sink(unknown.topic, "", "the file does not declare this channel", unknown)
        schema = None
        if channel.schema_id != 0:
            schema = self._schemas.get(channel.schema_id) or self._summary.schemas.get(
                channel.schema_id
            )
        definition = (schema.name, schema.encoding, schema.data) if schema else None
        topic = self._rename(channel.topic)
        raw = RawChannel(
            channel_id, topic, channel.message_encoding, tuple(channel.metadata.items()), definition
        )
        name = schema.name if schema else ""
        # `mavlink/` first: the dialect takes longer to load than a small log to read
        if channel.message_encoding == MessageEncoding.JSON and channel.topic.startswith(
            "mavlink/"
        ):
            from replay_kit.logs.decode.blueos import mavlink_channel

            if (known := mavlink_channel(channel.topic)) is not None:
                return Sink(topic, known[0] or name, known[1], raw)
        decode = (
            None
            if raw.encoding == MAVLINK_FRAMES
            else self._decoder(channel.message_encoding, schema)
        )
        return Sink(topic, name, decode, raw)

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
