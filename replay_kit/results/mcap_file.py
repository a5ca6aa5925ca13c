"""The file of a result: messages, attachments and metadata as they come, under a temporary name until it is complete.

Everything written is also appended to a journal, if there is one, from which the file can be written again byte for byte.
"""

import hashlib
import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from mcap.writer import CompressionType, Writer

from replay_kit.core.atomic import open_part, part_of, sync
from replay_kit.core.errors import ConfigError, ReplayKitError
from replay_kit.core.message import OutChannels, RawChannel, RawMessage
from replay_kit.results.journal import Journal
from replay_kit.results.readback import check_written
from replay_kit.results.topics import Digest

#: Name, encoding and definition of a schema.
Definition = tuple[str, str, bytes]

#: Input number of the result's own channels.
_OURS = -1
#: Topics of the result itself, and the beginnings of others.
_OWN_TOPICS = ("/tf", "/vehicle/fix", "/log")
_OWN_FOLDERS = ("/flow/", "/plan/")


class ResultFile:
    """An MCAP file that gets its name after it was read back; a context manager that completes the file when its block ends well.

    After an exception or an interrupt the file stays as ``OUT.mcap.part``, closed and readable up to there.

    Attributes:
        path: Its name.
        part: Its name until it is complete.
        last_time_ns: Latest time of a message [ns, UTC].
    """

    def __init__(self, path: Path, overwrite: bool, journal: Journal | None) -> None:
        """Open ``path`` + ``.part``; one left over by an interrupted run is replaced.

        Args:
            path: The result file.
            overwrite: Replace an existing result.
            journal: Records everything that is written.

        Raises:
            ConfigError: The result exists and may not be replaced, or its folder does not exist or cannot be written.
        """
        self.path = Path(path)
        self.part = part_of(self.path)
        self._overwrite = overwrite
        self._check_target()
        self._file = open_part(self.path)
        # keeps its lock until it has its name
        self._lock = os.dup(self._file.fileno())
        self._writer = Writer(
            self._file, compression=CompressionType.ZSTD, enable_crcs=True, enable_data_crcs=True
        )
        # without the library's version, which says nothing about the content
        self._writer.start(profile="replay-kit", library="replay-kit")
        self._out = OutChannels(self._writer)
        self._channels: dict[str, int] = {}
        self._held: dict[str, tuple[Callable[[], Definition], bytes, int]] = {}
        self._counts: Counter[str] = Counter()
        self._attachments = 0
        self.last_time_ns = 0
        self._digest = hashlib.sha256()
        self._journal = journal
        self._recording = True
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
        """Complete the file, or leave it as ``.part`` when the block raised."""
        if kind is None:
            self.close()
        else:
            self.abandon()

    def write_message(
        self, topic: str, schema: Callable[[], Definition], data: bytes, time_ns: int
    ) -> None:
        """Write a message.

        Args:
            topic: Its channel.
            schema: Makes the channel's schema, when it is new.
            data: Protobuf.
            time_ns: Log and publish time [ns, UTC].
        """
        assert self._open, "a closed result takes no messages"
        try:
            number = self._channels.get(topic)
            if number is None:
                name, encoding, definition = schema()
                number = self._channels[topic] = self._out.number(
                    _OURS, RawChannel(0, topic, "protobuf", (), (name, encoding, definition))
                )
                self._record(
                    {"kind": "schema", "topic": topic, "name": name, "encoding": encoding},
                    definition,
                )
            self._writer.add_message(number, time_ns, data, time_ns, self._counts[topic])
        except OSError as error:
            raise self._full("write", error) from error
        if self._journal is not None:
            self._record({"kind": "message", "topic": topic, "time_ns": time_ns}, data)
        self._digest.update(f"{topic}\0{time_ns}\0{len(data)}\0".encode() + data)
        self._counts[topic] += 1
        self.last_time_ns = max(self.last_time_ns, time_ns)

    def hold_message(
        self, topic: str, schema: Callable[[], Definition], data: bytes, time_ns: int
    ) -> None:
        """Write a message when the file is completed, in place of one held before: of some topics viewers draw all messages at once.

        Args:
            topic: Its channel.
            schema: As of ``write_message``.
            data: As of ``write_message``.
            time_ns: As of ``write_message``.
        """
        self._held[topic] = schema, data, time_ns
        name, encoding, definition = schema()
        head = {"kind": "schema", "topic": topic, "name": name, "encoding": encoding}
        self._record(head, definition)
        self._record({"kind": "held", "topic": topic, "time_ns": time_ns}, data)

    @property
    def topics(self) -> tuple[str, ...]:
        """The result's own topics that have messages, or will have them when it is complete."""
        return (*self._channels, *self._held)

    def attach(self, time_ns: int, name: str, media_type: str, data: bytes) -> None:
        """Write an attachment."""
        with self._storing(f"attach {name}"):
            self._writer.add_attachment(
                create_time=time_ns, log_time=time_ns, name=name, media_type=media_type, data=data
            )
        self._record(
            {"kind": "attachment", "time_ns": time_ns, "name": name, "media_type": media_type}, data
        )
        self._attachments += 1

    def write_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record."""
        with self._storing(f"write the metadata {name}"):
            self._writer.add_metadata(name, dict(values))
        self._record({"kind": "metadata", "name": name, "values": dict(values)}, b"")

    def copy(self, source: Iterator[RawMessage]) -> None:
        """Write an input's messages unchanged; ``/input`` is put before a topic that is also one of the result's own.

        Args:
            source: The messages of all logs.
        """
        self._record({"kind": "copies"}, b"")
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
        """Put everything written so far on the disk as whole chunks, from which ``convert`` recovers it after a power cut."""
        with self._storing("write"):
            self._writer.flush()  # type: ignore[no-untyped-call]
            os.fsync(self._file.fileno())
        self._record({"kind": "checkpoint"}, b"")

    def current_digest(self, time_ns: int) -> Digest:
        """Return the digest of the messages so far."""
        return Digest(time_ns, self._counts.total(), self._digest.hexdigest())

    def write_entries(
        self, entries: Iterable[tuple[dict[str, Any], bytes]], copy_inputs: Callable[[], None]
    ) -> None:
        """Write what is recorded in a journal.

        Args:
            entries: Of the journal; they are not recorded again.
            copy_inputs: Copies the inputs, which the journal does not hold.
        """
        journal, self._journal = self._journal, None
        schemas: dict[str, Definition] = {}
        for head, data in entries:
            if head["kind"] == "schema":
                schemas[head["topic"]] = (head["name"], head["encoding"], data)
            elif head["kind"] == "message":
                self.write_message(
                    head["topic"],
                    partial(schemas.__getitem__, head["topic"]),
                    data,
                    head["time_ns"],
                )
            elif head["kind"] == "held":
                schema = partial(schemas.__getitem__, head["topic"])
                self.hold_message(head["topic"], schema, data, head["time_ns"])
            elif head["kind"] == "attachment":
                self.attach(head["time_ns"], head["name"], head["media_type"], data)
            elif head["kind"] == "copies":
                copy_inputs()
            elif head["kind"] == "checkpoint":
                self.flush()
            else:
                self.write_metadata(head["name"], head["values"])
        self._journal = journal

    def close(self) -> None:
        """Complete the file, read it back and give it its name; a second call does nothing.

        Raises:
            ReplayKitError: The file could not be written completely; it stays as ``.part``.
            ConfigError: Meanwhile a file of this name appeared, which may not be replaced; the result stays as ``.part``.
        """
        if not self._open:
            return
        try:
            for topic, (schema, data, time_ns) in self._held.items():
                self.write_message(topic, schema, data, time_ns)
            self._end()
            check_written(self.part, self._counts, self._attachments)
            self._check_target()
            os.replace(self.part, self.path)
            sync(self.path.parent)
        finally:
            os.close(self._lock)

    def abandon(self) -> None:
        """Stop: what was written so far stays as ``.part``; on a closed result this does nothing."""
        # The caller is already handling the error that stopped the run; a second one would hide it.
        with suppress(ReplayKitError):
            if self._open:
                os.close(self._lock)
                self._end()

    def discard(self) -> None:
        """Stop and leave nothing; on a closed result this does nothing."""
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
    def unrecorded(self) -> Iterator[None]:
        """Record nothing in the journal but schemas, which later messages need: for what is written anew each time."""
        self._recording = False
        try:
            yield
        finally:
            self._recording = True

    def _record(self, head: dict[str, Any], data: bytes) -> None:
        if self._journal is not None and (self._recording or head["kind"] == "schema"):
            self._journal.append(head, data)

    @contextmanager
    def _storing(self, what: str) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise self._full(what, error) from error

    def _full(self, what: str, error: OSError) -> ReplayKitError:
        return ReplayKitError(
            f"{self.part}: cannot {what}: {error}; is the disk full? What was written so far stays there"
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
    """Return an input's channel, with ``/input`` before a topic that is also one of the result's own."""
    if channel.topic not in _OWN_TOPICS and not channel.topic.startswith(_OWN_FOLDERS):
        return channel
    return replace(channel, topic=f"/input{channel.topic}")
