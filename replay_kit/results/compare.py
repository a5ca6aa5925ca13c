"""Two results message by message: where they first differ, and in which fields."""

import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import islice, zip_longest
from pathlib import Path
from typing import Any

import zstandard
from google.protobuf.message import DecodeError
from google.protobuf.message import Message as ProtobufMessage
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from mcap_protobuf.decoder import DecoderFactory

from replay_kit.core.errors import LogError
from replay_kit.results.topics import CONFIG_NAME, DIGEST_NAME, Digest

_FIELDS_SHOWN = 10
#: What the readers raise on a damaged file: their own errors, and what bytes taken for lengths and numbers lead to.
DAMAGED = (
    McapError,
    DecodeError,
    zstandard.ZstdError,
    struct.error,
    ValueError,
    LookupError,
    OverflowError,
    EOFError,
)


@dataclass(frozen=True, slots=True)
class Recorded:
    """What a result says of the run that made it.

    Attributes:
        metadata: Record name to keys and values; the last of a name counts.
        config_toml: The configuration.
        digests: In the order of the file.
        attachments: Name to bytes.
    """

    metadata: dict[str, dict[str, str]]
    config_toml: str
    digests: tuple[Digest, ...]
    attachments: dict[str, bytes]


@dataclass(frozen=True, slots=True)
class Written:
    """One message of a result.

    Attributes:
        topic: Its channel.
        time_ns: Its time [ns, UTC].
        publish_ns: Its publish time [ns, UTC].
        sequence: Its number in the channel.
        data: As written.
        encoding: Of the data.
        schema: Name and encoding of the schema; None without one.
        definition: Of the schema; two messages may be equal without it.
    """

    topic: str
    time_ns: int
    publish_ns: int
    sequence: int
    data: bytes
    encoding: str
    schema: tuple[str, str] | None
    definition: bytes = field(compare=False)


@dataclass(frozen=True, slots=True)
class Difference:
    """The first message that two results do not share.

    Attributes:
        index: Its ordinal in the file.
        topic: Of the first result's message, or the second's when the first has no more.
        time_ns: Of the same [ns, UTC].
        fields: What differs, in words: field path, then both values.
    """

    index: int
    topic: str
    time_ns: int
    fields: tuple[str, ...]


@contextmanager
def damage_named(path: Path, expected: str, advice: str) -> Iterator[None]:
    """Turn what readers raise on a file that is damaged, or another, into an error that names it.

    Raises:
        LogError: The file cannot be read as what was expected.
    """
    try:
        yield
    except OSError as error:
        raise LogError(
            f"{path}: cannot be read: {error.strerror}; check the file and its permissions"
        ) from error
    except DAMAGED as error:
        why = f"it has no {error.args[0]}" if isinstance(error, KeyError) else str(error)
        raise LogError(f"{path}: expected a {expected}, but {why}; {advice}") from error


def read_recorded(path: Path) -> Recorded:
    """Return what a result says of the run that made it.

    Raises:
        LogError: It cannot be read, or was made neither by a replay nor by a plan.
    """
    with damage_named(path, "whole result of replay-kit replay or plan", "give the file of --out"):
        with path.open("rb") as file:
            reader = make_reader(file)
            metadata, digests = {}, []
            for record in reader.iter_metadata():
                values = dict(record.metadata)
                metadata[record.name] = values
                if record.name == DIGEST_NAME:
                    digests.append(
                        Digest(int(values["time_ns"]), int(values["messages"]), values["sha256"])
                    )
            attachments = {record.name: record.data for record in reader.iter_attachments()}
        config = attachments[CONFIG_NAME].decode()
        # a replay has an ensemble, a plan made on its own estimates
        if not any(
            key.startswith(("ensemble", "flow")) for key in metadata.get("replay_kit.inputs", {})
        ):
            raise KeyError("replay_kit.inputs: ensemble or flow0")
    return Recorded(metadata, config, tuple(digests), attachments)


def first_difference(
    one: Path, other: Path, end: int | None = None, definitions: bool = True
) -> Difference | None:
    """Return the first message that two results do not share; None when they share all.

    Args:
        one: A result.
        other: A result; of both, an unfinished one will do.
        end: Ordinal at which to stop; None for the end.
        definitions: Whether the definitions of the schemas are compared too; results of different contract versions differ there.
    """
    pairs = zip_longest(_messages(one), _messages(other))
    for index, (a, b) in enumerate(islice(pairs, end)):
        if a is None or b is None:
            more = a or b
            assert more is not None
            return Difference(
                index,
                more.topic,
                more.time_ns,
                (f"only {'the first' if b is None else 'the second'} has this message",),
            )
        if a != b or (definitions and a.definition != b.definition):
            return Difference(
                index, a.topic, a.time_ns, tuple(islice(_what_differs(a, b), _FIELDS_SHOWN))
            )
    return None


def _messages(path: Path) -> Iterator[Written]:
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    with path.open("rb") as file:
        try:
            for record in StreamReader(file, record_size_limit=path.stat().st_size).records:
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel):
                    channels[record.id] = record
                elif isinstance(record, Message):
                    channel = channels[record.channel_id]
                    schema = schemas[channel.schema_id] if channel.schema_id else None
                    name, definition = (
                        ((schema.name, schema.encoding), schema.data) if schema else (None, b"")
                    )
                    times = record.log_time, record.publish_time, record.sequence
                    yield Written(
                        channel.topic,
                        *times,
                        record.data,
                        channel.message_encoding,
                        name,
                        definition,
                    )
        except DAMAGED:
            # an unfinished file ends where it ends
            return


def _what_differs(a: Written, b: Written) -> Iterator[str]:
    for name in ("topic", "time_ns", "publish_ns", "sequence", "encoding"):
        if getattr(a, name) != getattr(b, name):
            yield f"{name}: {getattr(a, name)} | {getattr(b, name)}"
    if a.schema != b.schema:
        yield "schema: " + " | ".join(" ".join(message.schema or ("none",)) for message in (a, b))
    elif a.definition != b.definition and a.data == b.data:
        yield f"schema: the definitions of {a.schema[0] if a.schema else None} differ"
    elif a.data != b.data:
        yield from _contents(a, b)


def _contents(a: Written, b: Written) -> Iterator[str]:
    """Yield the fields that differ of two messages of one schema."""
    try:
        schema = (
            Schema(id=1, name=a.schema[0], encoding=a.schema[1], data=a.definition)
            if a.schema
            else None
        )
        decode = DecoderFactory().decoder_for(a.encoding, schema)
        if decode is not None:
            yield from _fields(decode(a.data), decode(b.data), "")
            return
    except DAMAGED:
        pass
    yield from _values(a.data, b.data, "data")


def _fields(a: ProtobufMessage, b: ProtobufMessage, path: str) -> Iterator[str]:
    """Yield the fields that differ, each as path and both values."""
    for described in a.DESCRIPTOR.fields:
        ours, theirs, name = (
            getattr(a, described.name),
            getattr(b, described.name),
            f"{path}{described.name}",
        )
        if isinstance(ours, Sequence) and not isinstance(ours, str | bytes):
            if len(ours) != len(theirs):
                yield f"{name}: {len(ours)} | {len(theirs)} elements"
            for index, (x, y) in enumerate(zip(ours, theirs, strict=False)):
                yield from _values(x, y, f"{name}[{index}]")
        else:
            yield from _values(ours, theirs, name)


def _values(x: Any, y: Any, name: str) -> Iterator[str]:
    if isinstance(x, ProtobufMessage):
        yield from _fields(x, y, f"{name}.")
    elif isinstance(x, bytes):
        if x != y:
            at = next(
                (i for i, (p, q) in enumerate(zip(x, y, strict=False)) if p != q),
                min(len(x), len(y)),
            )
            yield f"{name}: {len(x)} | {len(y)} bytes, which differ at byte {at}"
    # repr tells apart all numbers that differ, and takes not-a-number for itself
    elif repr(x) != repr(y):
        yield f"{name}: {x!r} | {y!r}"
