"""Writer of MCAP logs; equal messages give equal bytes."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from mcap.records import Attachment, Metadata
from mcap.writer import CompressionType, Writer

from replay_kit.core.files.atomic import atomic_file
from replay_kit.core.message import Message, OutChannels, RawMessage
from replay_kit.logs.payloads import JsonChannels

_LIBRARY = "replay-kit"

# A flipped bit costs the chunk that it is in.
_CHUNK = 64 << 10


class McapLogWriter:
    """MCAP log being written; ``open_mcap_log`` creates one.

    Attributes:
        attachments: Attachments written so far.
    """

    def __init__(self, file: BinaryIO, profile: str = "") -> None:
        """Write the header.

        Args:
            file: Output file.
            profile: Profile in the header, the name of a convention for channels and messages.
        """
        # Not compressed and without the library's version in the header: the bytes then do not depend on the version of
        # zstd, lz4 or mcap, so that a log that is kept in a repository can be made again and compared.
        self._writer = Writer(
            file,
            chunk_size=_CHUNK,
            compression=CompressionType.NONE,
            enable_crcs=True,
            enable_data_crcs=True,
        )
        self._writer.start(profile=profile, library=_LIBRARY)
        self._channels = OutChannels(self._writer)
        self._json = JsonChannels()
        self._written: Counter[str] = Counter()
        self.attachments = 0

    @property
    def written(self) -> Mapping[str, int]:
        """Number of messages written so far, by topic."""
        return dict(self._written)

    def write(self, message: Message) -> None:
        """Append a message as JSON; NaN and infinities become null, bytes become base64.

        Raises:
            LogError: The payload has no JSON form.
        """
        # channels of messages made here are shared by all inputs
        self._append(-1, self._json.raw(message))

    def copy(self, message: RawMessage) -> None:
        """Append a raw message unchanged."""
        self._append(message.input, message)

    def copy_extra(self, record: Attachment | Metadata) -> None:
        """Append an attachment or a metadata record unchanged."""
        if isinstance(record, Metadata):
            self._writer.add_metadata(record.name, record.metadata)
            return
        self._writer.add_attachment(
            record.create_time, record.log_time, record.name, record.media_type, record.data
        )
        self.attachments += 1

    def finish(self) -> None:
        """Write the summary and the end of the file."""
        self._writer.finish()  # type: ignore[no-untyped-call]

    def _append(self, input: int, message: RawMessage) -> None:
        channel = self._channels.number(input, message.channel)
        self._writer.add_message(
            channel, message.log_ns, message.data, message.publish_ns, message.sequence
        )
        self._written[message.channel.topic] += 1


@contextmanager
def open_mcap_log(
    path: Path, profile: str = "", check: Callable[[Path, McapLogWriter], None] | None = None
) -> Iterator[McapLogWriter]:
    """Yield a writer of a log that gets its final name if the block ends without an error.

    Args:
        path: Log; an existing file is replaced.
        profile: Profile in the header.
        check: Called with the complete temporary file and the writer; if it raises, the file keeps its temporary name.

    Raises:
        ConfigError: The file cannot be written.
    """
    writer: McapLogWriter | None = None

    def checked(part: Path) -> None:
        if check is not None and writer is not None:
            check(part, writer)

    with atomic_file(path, checked) as file:
        writer = McapLogWriter(file, profile)
        yield writer
        writer.finish()


def write_mcap_log(path: Path, messages: Iterable[Message]) -> Mapping[str, int]:
    """Write messages in the given order as an MCAP log and return their number by topic.

    Args:
        path: Log; an existing file is replaced.
        messages: Messages with plain mappings as payloads, as from readers.

    Raises:
        ConfigError: The file cannot be written.
        LogError: A payload has no JSON form.
    """
    with open_mcap_log(path) as writer:
        for message in messages:
            writer.write(message)
    return writer.written
