"""Two results message by message: where they first differ, and in which fields."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import count, islice, zip_longest
from pathlib import Path
from typing import Any, NamedTuple

from google.protobuf.message import Message as ProtobufMessage
from mcap.records import Message, Schema
from mcap_protobuf.decoder import DecoderFactory

from replay_kit.core.errors import LogError
from replay_kit.results.reader import ResultReader
from replay_kit.results.topics import CONFIG_NAME, DAMAGED, DIGEST_NAME, Digest, records

_FIELDS_SHOWN = 10


@dataclass(frozen=True, slots=True)
class Recorded:
    """What a result says of the run that made it.

    Attributes:
        metadata: Record name to keys and values, without digests.
        config_toml: The configuration.
        digests: In the order of the file.
        attachments: Name to bytes.
    """

    metadata: dict[str, dict[str, str]]
    config_toml: str
    digests: tuple[Digest, ...]
    attachments: dict[str, bytes]


class Written(NamedTuple):
    """One message of a result.

    Attributes:
        about: Its topic, times [ns, UTC], number in the channel, encoding, and name and encoding of its schema.
        data: As written.
        schema: None without one; two messages may be equal without its definition.
    """

    about: dict[str, Any]
    data: bytes
    schema: Schema | None

    @property
    def definition(self) -> bytes:
        """Of the schema."""
        return b"" if self.schema is None else self.schema.data


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


def read_recorded(path: Path) -> Recorded:
    """Return what a result says of the run that made it.

    Raises:
        LogError: It cannot be read, or was made neither by a replay nor by a plan.
    """
    reader = ResultReader(path)
    attachments = {name: one.data for name, one in reader.attachments(bool).items()}
    digests = (
        Digest(int(values["time_ns"]), int(values["messages"]), values["sha256"])
        for name, values in reader.records
        if name == DIGEST_NAME
    )
    metadata = reader.metadata
    # a replay has an ensemble, a plan made on its own estimates
    inputs = metadata.get("replay_kit.inputs", {})
    known = any(key.startswith(("ensemble", "flow")) for key in inputs)
    if CONFIG_NAME not in attachments or not known:
        lacking = (
            "replay_kit.inputs: ensemble or flow0" if CONFIG_NAME in attachments else CONFIG_NAME
        )
        raise LogError(
            f"{path}: expected a whole result of replay-kit replay or plan, but it has no {lacking}; give the file of --out"
        )
    return Recorded(metadata, attachments[CONFIG_NAME].decode(), tuple(digests), attachments)


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
        held = a or b
        if a is None or b is None:
            which = "the first" if b is None else "the second"
            found: Sequence[str] = (f"only {which} has this message",)
        elif a[:2] != b[:2] or (definitions and a.definition != b.definition):
            found = [*islice(_what_differs(a, b), _FIELDS_SHOWN)]
        else:
            continue
        return Difference(index, held.about["topic"], held.about["time_ns"], tuple(found))
    return None


def _messages(path: Path) -> Iterator[Written]:
    # an unfinished file ends where it ends
    with path.open("rb") as file, suppress(*DAMAGED):
        for record, channel, schema in records(file):
            if isinstance(record, Message) and channel is not None:
                about = {
                    "topic": channel.topic,
                    "time_ns": record.log_time,
                    "publish_ns": record.publish_time,
                    "sequence": record.sequence,
                    "encoding": channel.message_encoding,
                    "schema": f"{schema.name} {schema.encoding}" if schema else "none",
                }
                yield Written(about, record.data, schema)


def _what_differs(a: Written, b: Written) -> Iterator[str]:
    for name, value in a.about.items():
        if value != b.about[name]:
            yield f"{name}: {value} | {b.about[name]}"
    if a.about["schema"] != b.about["schema"]:
        return
    if a.data != b.data:
        yield from _contents(a, b)
    elif a.definition != b.definition and a.schema is not None:
        yield f"schema: the definitions of {a.schema.name} differ"


def _contents(a: Written, b: Written) -> Iterator[str]:
    """Yield the fields that differ of two messages of one schema."""
    with suppress(*DAMAGED):
        decode = DecoderFactory().decoder_for(a.about["encoding"], a.schema)
        if decode is not None:
            yield from _values(decode(a.data), decode(b.data), "")
            return
    yield from _values(a.data, b.data, "data")


def _values(x: Any, y: Any, name: str) -> Iterator[str]:
    """Yield what differs of two values, each as path and both values."""
    if isinstance(x, ProtobufMessage):
        for field in x.DESCRIPTOR.fields:
            path = f"{name}.{field.name}" if name else field.name
            yield from _values(getattr(x, field.name), getattr(y, field.name), path)
    elif isinstance(x, bytes):
        if x != y:
            at = next(k for k in count() if x[k : k + 1] != y[k : k + 1])
            yield f"{name}: {len(x)} | {len(y)} bytes, which differ at byte {at}"
    elif isinstance(x, Sequence) and not isinstance(x, str):
        if len(x) != len(y):
            yield f"{name}: {len(x)} | {len(y)} elements"
        for index, pair in enumerate(zip(x, y, strict=False)):
            yield from _values(*pair, f"{name}[{index}]")
    # repr tells apart all numbers that differ, and takes not-a-number for itself
    elif repr(x) != repr(y):
        yield f"{name}: {x!r} | {y!r}"
