"""Result file: messages, attachments and metadata, under a temporary name until complete.

A digest of the messages so far ends a chunk, at the same positions in every run. The contents of an unfinished file, or of the result of a
log that has grown, between two digests are copied by record: equal calls give equal bytes.
"""

import hashlib
import os
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, NamedTuple, Self

from mcap.records import Attachment, Message, Metadata
from mcap.writer import CompressionType, Writer

from replay_kit.core.errors import ConfigError, LogError, ReplayKitError
from replay_kit.core.files.atomic import open_part, part_of, sync
from replay_kit.core.message import OutChannels, RawChannel, RawMessage
from replay_kit.results.mcap.topics import DAMAGED, DIGEST_NAME, check_written, records

#: Name, encoding and definition of a schema.
Definition = tuple[str, str, bytes]

#: Input number of the result's own channels.
_OURS = -1
#: Topics of the result itself, and the beginnings of others.
_OWN_TOPICS = ("/tf", "/vehicle/fix", "/log")
_OWN_FOLDERS = ("/flow/", "/plan/")


class Written(NamedTuple):
    """State of a result at a digest.

    Attributes:
        digests: Number of digests.
        sha256: Last digest.
        held: Messages for the end of the file: topic, definition, data, time [ns, UTC].
    """

    digests: int
    sha256: str
    held: tuple[tuple[str, Definition, bytes, int], ...]


class ResultFile:
    """MCAP file that gets its name after it was read back; a context manager that completes it unless the block raises.

    After an exception or an interrupt the file stays as ``OUT.mcap.part``, closed and readable.

    Attributes:
        path: Final name.
        part: Name until it is complete.
        last_time_ns: Latest time of a message [ns, UTC].
    """

    def __init__(self, path: Path, overwrite: bool = False, goes_on: bool = False) -> None:
        """Open ``path`` + ``.part``; an existing part is replaced.

        Args:
            path: Result file.
            overwrite: Whether an existing result is replaced.
            goes_on: Whether the part of an interrupted run is kept until ``restore`` overwrites it.

        Raises:
            ConfigError: The result exists and may not be replaced, or its folder is missing or not writable.
        """
        self.path = Path(path)
        self.part = part_of(self.path)
        self._overwrite = overwrite
        self._check_target()
        self._file = open_part(self.path, goes_on)
        # keeps its lock until it has its name
        self._lock = os.dup(self._file.fileno())
        self._writer = Writer(
            self._file, compression=CompressionType.ZSTD, enable_crcs=True, enable_data_crcs=True
        )
        # without the library's version, which says nothing about the content
        self._writer.start(profile="replay-kit", library="replay-kit")
        self._out = OutChannels(self._writer)
        self._channels: dict[str, int] = {}
        self._held: dict[str, tuple[Definition, bytes, int]] = {}
        self._counts: Counter[str] = Counter()
        self._attachments = self._digests = 0
        self.last_time_ns = 0
        self._digest = hashlib.sha256()
        self._open = True

    def __enter__(self) -> Self:
        """Return the file."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Complete the file, or leave it as ``.part`` if the block raised."""
        if kind is None:
            self.close()
        else:
            self.abandon()

    def write_message(self, topic: str, definition: Definition, data: bytes, time_ns: int) -> None:
        """Write a message.

        Args:
            topic: Topic.
            definition: Definition of the topic's schema.
            data: Protobuf payload.
            time_ns: Log and publish time [ns, UTC].
        """
        assert self._open, "a closed result takes no messages"
        try:
            number = self._channels.get(topic)
            if number is None:
                number = self._channels[topic] = self._out.number(
                    _OURS, RawChannel(0, topic, "protobuf", (), definition)
                )
            self._writer.add_message(number, time_ns, data, time_ns, self._counts[topic])
        except OSError as error:
            raise self._full("write", error) from error
        self._digest.update(f"{topic}\0{time_ns}\0{len(data)}\0".encode() + data)
        self._counts[topic] += 1
        self.last_time_ns = max(self.last_time_ns, time_ns)

    def hold_message(self, topic: str, definition: Definition, data: bytes, time_ns: int) -> None:
        """Write a message at the end of the file, replacing an earlier one: viewers draw all messages of some topics at once.

        Args:
            topic: Topic.
            definition: See ``write_message``.
            data: See ``write_message``.
            time_ns: See ``write_message``.
        """
        self._held[topic] = definition, data, time_ns

    @property
    def topics(self) -> tuple[str, ...]:
        """The result's own topics with messages, including those for the end of the file."""
        return (*self._channels, *self._held)

    def attach(self, time_ns: int, name: str, media_type: str, data: bytes) -> None:
        """Write an attachment."""
        with self._storing(f"attach {name}"):
            self._writer.add_attachment(
                create_time=time_ns, log_time=time_ns, name=name, media_type=media_type, data=data
            )
        self._attachments += 1

    def write_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record."""
        with self._storing(f"write the metadata {name}"):
            self._writer.add_metadata(name, dict(values))

    def copy(self, source: Iterator[RawMessage]) -> None:
        """Write the inputs' messages unchanged; topics that are also the result's own get the prefix ``/input``.

        Args:
            source: Messages of all logs.
        """
        renamed: dict[RawChannel, RawChannel] = {}
        with self._storing("copy the inputs"):
            for message in source:
                channel = renamed.get(message.channel) or renamed.setdefault(
                    message.channel, _renamed(message.channel)
                )
                number = self._out.number(message.input, channel)
                self._writer.add_message(
                    number, message.log_ns, message.data, message.publish_ns, message.sequence
                )
                self._counts[channel.topic] += 1

    def flush(self) -> None:
        """Flush all data to disk as whole chunks, which ``convert`` recovers after a power cut."""
        with self._storing("write"):
            self._writer.flush()  # type: ignore[no-untyped-call]
            os.fsync(self._file.fileno())

    def digest(self, time_ns: int) -> None:
        """End the chunk and write the digest of the messages so far as a metadata record, for ``verify``.

        Args:
            time_ns: Time of the record [ns, UTC].
        """
        with self._storing("write"):
            self._writer.flush()  # type: ignore[no-untyped-call]
        values = {
            "time_ns": str(time_ns),
            "messages": str(self._counts.total()),
            "sha256": self._digest.hexdigest(),
        }
        self.write_metadata(DIGEST_NAME, values)
        self._digests += 1

    @property
    def written(self) -> Written:
        """State for ``restore`` to write the file up to its last digest."""
        held = tuple((topic, *each) for topic, each in self._held.items())
        return Written(self._digests, self._digest.hexdigest(), held)

    def restore(self, source: Path, written: Written) -> None:
        """Append the contents of a result or part from its first digest up to another one.

        Args:
            source: File; may be this file's own part.
            written: State at the last digest.

        Raises:
            LogError: The file does not hold this digest.
        """
        try:
            with source.open("rb") as file:
                self._write_again(file, written)
        except (OSError, *DAMAGED) as error:
            raise LogError(
                f"{source}: the part written by the run is damaged: {error!r}"
            ) from error
        if (self._digests, self._digest.hexdigest()) != written[:2]:
            raise LogError(f"{source}: differs from what the run wrote")
        self._held = {topic: (definition, data, ns) for topic, definition, data, ns in written.held}
        self._file.flush()
        self._file.truncate()

    def _write_again(self, source: BinaryIO, written: Written) -> None:
        begun = False
        for record, channel, schema in records(source):
            if isinstance(record, Metadata) and record.name == DIGEST_NAME:
                if begun:
                    self.digest(int(record.metadata["time_ns"]))
                begun = True
                if self._digests == written.digests:
                    return
            elif not begun:
                continue
            elif isinstance(record, Message):
                if channel is None or schema is None:
                    raise ValueError("a message without a schema")
                definition = schema.name, schema.encoding, schema.data
                self.write_message(channel.topic, definition, record.data, record.log_time)
            elif isinstance(record, Metadata):
                self.write_metadata(record.name, record.metadata)
            elif isinstance(record, Attachment):
                self.attach(record.log_time, record.name, record.media_type, record.data)

    def close(self) -> None:
        """Complete the file, read it back and rename it; a second call has no effect.

        Raises:
            ReplayKitError: Writing failed; the file stays as ``.part``.
            ConfigError: A file of this name has appeared and may not be replaced; the result stays as ``.part``.
        """
        if not self._open:
            return
        try:
            for topic, (definition, data, time_ns) in self._held.items():
                self.write_message(topic, definition, data, time_ns)
            self._end()
            check_written(self.part, self._counts, self._attachments)
            self._check_target()
            os.replace(self.part, self.path)
            sync(self.path.parent)
        finally:
            os.close(self._lock)

    def abandon(self) -> None:
        """Stop and leave the file as ``.part``; no effect on a closed result."""
        # The caller is already handling the error that stopped the run; a second one would hide it.
        with suppress(ReplayKitError):
            if self._open:
                os.close(self._lock)
                self._end()

    def discard(self) -> None:
        """Stop and remove the file; no effect on a closed result."""
        if self._open:
            self.abandon()
            self.part.unlink(missing_ok=True)

    def _end(self) -> None:
        self._open = False
        try:
            with self._storing("complete the result"):
                self._writer.finish()  # type: ignore[no-untyped-call]
                self._file.flush()
                os.fsync(self._file.fileno())
        finally:
            # what a full disk did not take is tried again by the file's closing
            with suppress(OSError):
                self._file.close()

    @contextmanager
    def _storing(self, what: str) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise self._full(what, error) from error

    def _full(self, what: str, error: OSError) -> ReplayKitError:
        return ReplayKitError(
            f"{self.part}: cannot {what}: {error}; is the disk full? The part written so far is kept"
        )

    def _check_target(self) -> None:
        if not self.path.parent.is_dir():
            raise ConfigError(
                f"{self.path}: the folder {self.path.parent} does not exist; make it or write elsewhere"
            )
        if self.path.exists() and not self._overwrite:
            raise ConfigError(
                f"{self.path}: exists already; pass --overwrite to replace it, or write elsewhere"
            )


def _renamed(channel: RawChannel) -> RawChannel:
    """Return an input's channel, with ``/input`` before a topic that is also the result's own."""
    if channel.topic not in _OWN_TOPICS and not channel.topic.startswith(_OWN_FOLDERS):
        return channel
    return replace(channel, topic=f"/input{channel.topic}")
