"""Messages to an MCAP log with JSON payloads, byte for byte the same each time."""

import base64
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import orjson
from mcap.writer import CompressionType, Writer

from replay_kit.errors import LogError
from replay_kit.logs.atomic import atomic_file
from replay_kit.logs.json_schemas import ANY_OBJECT, JSON_SCHEMAS
from replay_kit.types import Message

_LIBRARY = "replay-kit"


class McapLogWriter:
    """An MCAP log being written; ``open_mcap_log`` makes one."""

    def __init__(self, file: BinaryIO) -> None:
        """Begin the log.

        Args:
            file: Where it goes.
        """
        # Not compressed and without the library's version in the header: the bytes then do not depend on the version of
        # zstd, lz4 or mcap, so that a log that is kept in a repository can be made again and compared.
        self._writer = Writer(file, compression=CompressionType.NONE, enable_crcs=True, enable_data_crcs=True)
        self._writer.start(profile="", library=_LIBRARY)
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[str, str], int] = {}
        self._written: Counter[str] = Counter()

    @property
    def written(self) -> Mapping[str, int]:
        """Messages written so far, by topic."""
        return dict(self._written)

    def write(self, message: Message) -> None:
        """Append a message; NaN and infinities become null, bytes become base64.

        Raises:
            LogError: The payload has no JSON form.
        """
        channel = self._channel(message.topic, message.schema)
        try:
            data = orjson.dumps(message.payload, default=_plain, option=orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_NON_STR_KEYS)
        except (orjson.JSONEncodeError, TypeError) as error:
            raise LogError(f"{message.topic} at {message.time_ns} ns: expected a payload that JSON can hold: {error}") from error
        self._writer.add_message(channel, message.time_ns, data, message.time_ns, self._written[message.topic])
        self._written[message.topic] += 1

    def finish(self) -> None:
        """Write the summary and the end of the file."""
        self._writer.finish()  # type: ignore[no-untyped-call]

    def _channel(self, topic: str, schema: str) -> int:
        """Return the channel of a topic and schema; one topic of two schemas has two channels."""
        key = (topic, schema)
        if key not in self._channels:
            if schema not in self._schemas:
                text = orjson.dumps(JSON_SCHEMAS.get(schema, ANY_OBJECT))
                # schema 0 means none: a message without a name keeps it that way
                self._schemas[schema] = self._writer.register_schema(schema, "jsonschema", text) if schema else 0
            self._channels[key] = self._writer.register_channel(topic, "json", self._schemas[schema])
        return self._channels[key]


@contextmanager
def open_mcap_log(path: Path) -> Iterator[McapLogWriter]:
    """Give a writer of a log that appears under its name when the block ends without an error.

    Args:
        path: The log; a file of that name is replaced.

    Raises:
        ConfigError: The file cannot be written.
    """
    with atomic_file(path) as file:
        writer = McapLogWriter(file)
        yield writer
        writer.finish()


def write_mcap_log(path: Path, messages: Iterable[Message]) -> Mapping[str, int]:
    """Write messages, in the order given, as an MCAP log and return their number by topic.

    Args:
        path: The log; a file of that name is replaced.
        messages: Payloads are plain mappings, as readers give them.

    Raises:
        ConfigError: The file cannot be written.
        LogError: A payload has no JSON form.
    """
    with open_mcap_log(path) as writer:
        for message in messages:
            writer.write(message)
    return writer.written


def _plain(value: Any) -> Any:
    if isinstance(value, bytes | bytearray | memoryview):
        return base64.b64encode(value).decode()
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, int):
        # beyond 64 bits
        return str(value)
    if hasattr(value, "__iter__"):
        return list(value)
    raise TypeError(f"{type(value).__name__} has no JSON form")
