"""Contents of a result MCAP: names of records and attachments, messages of a topic by time, and checks.

Completeness is checked before the file gets its name, checksums before it is read. The libraries for estimates are not needed.
"""

import os
import struct
import weakref
import zlib
from bisect import bisect_left
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import zstandard
from google.protobuf.message import DecodeError
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import CRCValidationError, StreamReader, get_chunk_data_stream

from replay_kit.core.errors import LogError, ReplayKitError
from replay_kit.core.files.inputs import open_input

if TYPE_CHECKING:
    from mcap.summary import Summary

#: Names of attachments and metadata records.
ESTIMATE_NAME = "estimate.npz"
#: Its name in results of 0.3, which is not read.
EARLIER_ESTIMATE = "estimate.nc"
#: Beginning of the names of the estimates of windows that the vehicle left; their number and the same ending follow.
WINDOW_NAME = "estimate_window_"
#: Name of the metadata record that holds how many of them, the first ones, belong to an estimate that was rebuilt.
WINDOWS_RECORD = "replay_kit.windows"
CONFIG_NAME = "config.toml"
SUMMARY_NAME = "summary.json"
LAYOUT_NAME = "layout.json"
DIGEST_NAME = "replay_kit.digest"
_SHARED = ("/flow/estimate", "/flow/grid/", "/flow/arrows/", "/flow/surface", "/plan/seabed")
_SHORT = {
    "/vehicle/fix": "fix",
    "/flow/innovation": "innovation",
    "/flow/consistency": "consistency",
    "/flow/surfacing": "surfacing",
}

# opcode, length; channel, sequence, time of log, time of publication
_HEAD, _MESSAGE = struct.Struct("<BQ"), struct.Struct("<HIQQ")
_MAGIC = b"\x89MCAP0\r\n"
# Opcode, length and checksum of the data. Of the footer: place of the summary, of its offsets, the summary's checksum.
_DATA_END, _FOOTER = struct.Struct("<BQI"), struct.Struct("<BQQQI")
# The summary's checksum and the closing magic bytes; bytes read at once.
_TAIL, _PIECE = 12, 1 << 20
#: What the readers raise on a damaged file: their own errors, and what bytes taken for lengths and numbers lead to.
DAMAGED = (
    *(McapError, CRCValidationError, DecodeError, zstandard.ZstdError, struct.error),
    *(ValueError, LookupError, OverflowError, EOFError),
)


def topic_of(vehicle: str, topic: str) -> str:
    """Return the topic of a vehicle's messages; unchanged for a single vehicle (empty name) and for the estimate."""
    if not vehicle or topic.startswith(_SHARED):
        return topic
    return f"/{vehicle}/{_SHORT.get(topic, topic[1:])}"


def name_of(vehicle: str, name: str) -> str:
    """Return the name of a vehicle's record or attachment; unchanged for a single vehicle."""
    return f"{vehicle}/{name}" if vehicle else name


@contextmanager
def naming_errors(path: Path) -> Iterator[None]:
    """Convert exceptions of reading a result to an error that names it.

    Raises:
        LogError: The file is missing or no complete result.
    """
    try:
        yield
    except OSError as error:
        raise LogError(
            f"{path}: cannot read the result: {error.strerror}; check the path"
        ) from error
    except DAMAGED as error:
        with path.open("rb") as file:
            begins = file.read(len(_MAGIC))
        if begins not in (b"", _MAGIC):
            raise LogError(
                f"{path}: expected a result of replay-kit replay or plan, got a file that is no MCAP; give the file of --out"
            ) from error
        raise LogError(
            f"{path}: expected a complete result of replay-kit replay: {error!r}; replay-kit convert recovers the messages of a partial one"
        ) from error


class _Records(StreamReader):
    """Records of a file without message indexes, which the library would parse entry by entry."""

    def _read_record(self, opcode: int, length: int) -> McapRecord | None:
        return None if opcode == Opcode.MESSAGE_INDEX else super()._read_record(opcode, length)


def records(file: BinaryIO) -> Iterator[tuple[McapRecord, Channel | None, Schema | None]]:
    """Yield the records of a file in order, including those in chunks; messages with channel and schema.

    Raises:
        McapError: And all of ``DAMAGED``: the file is damaged or truncated.
    """
    schemas, channels = dict[int, Schema | None]({0: None}), dict[int, Channel]()
    size = os.fstat(file.fileno()).st_size
    for record in _Records(file, validate_crcs=True, record_size_limit=size).records:
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        channel = channels[record.channel_id] if isinstance(record, Message) else None
        yield record, channel, schemas[channel.schema_id] if channel else None


def message_counts(summary: "Summary") -> Counter[str]:
    """Return the number of messages by topic in a summary."""
    found = Counter[str]()
    for number, count in summary.statistics.channel_message_counts.items():  # type: ignore[union-attr]
        found[summary.channels[number].topic] += count
    return found


def check_written(path: Path, messages: Mapping[str, int], attachments: int) -> None:
    """Verify the checksums of a file, and its counts against those written.

    The library computes checksums of its input and does not report a full disk; dropped bytes show here.

    Args:
        path: File.
        messages: Number of messages written, by topic.
        attachments: Number of attachments written.

    Raises:
        ReplayKitError: The file is incomplete.
    """
    with path.open("rb") as file:
        if not checksums_fit(file):
            raise ReplayKitError(f"{path}: the result does not read back; is the disk full?")
        file.seek(0)
        summary = make_reader(file).get_summary()
    assert summary is not None, "its checksum fits"
    read, attached = message_counts(summary), len(summary.attachment_indexes)
    if read != Counter(messages) or attached != attachments:
        raise ReplayKitError(
            f"{path}: wrote {sum(messages.values())} messages and {attachments} attachments, but read back {read.total()} and {attached}"
        )


def checksums_fit(file: BinaryIO) -> bool:
    """Return whether a file has valid checksums of its data and its summary; nothing is decompressed."""
    try:
        size = os.fstat(file.fileno()).st_size
        at = size - len(_MAGIC) - _FOOTER.size
        file.seek(max(at, 0))
        opcode, _, summary, _, summary_crc = _FOOTER.unpack(file.read(_FOOTER.size))
        end = summary - _DATA_END.size
        if opcode != Opcode.FOOTER or file.read() != _MAGIC or not len(_MAGIC) <= end < at:
            return False
        file.seek(end)
        opcode, _, crc = _DATA_END.unpack(file.read(_DATA_END.size))
        # the summary's checksum covers the footer up to itself
        if opcode != Opcode.DATA_END or _crc(file, size - _TAIL - summary) != summary_crc:
            return False
        file.seek(0)
        return bool(_crc(file, end) == crc)
    except struct.error:
        return False


def _crc(file: BinaryIO, length: int) -> int:
    """Return the CRC-32 of the next bytes, read in pieces."""
    crc = 0
    for start in range(0, length, _PIECE):
        crc = zlib.crc32(file.read(min(_PIECE, length - start)), crc)
    return crc


class OpenResult:
    """Result MCAP, opened once; concurrent reads are possible, as each has its own position.

    Attributes:
        path: File.
        file: Open file, closed with its last reader.
    """

    def __init__(self, path: Path) -> None:
        """Open the file.

        Raises:
            LogError: The file is missing or no MCAP file.
        """
        self.path = path
        with naming_errors(path):
            self.file = open_input(path)
            weakref.finalize(self, self.file.close)
            self.reader = make_reader(self.file)

    @cached_property
    def summary(self) -> "Summary":
        """Summary of the file.

        Raises:
            LogError: The file has no summary.
        """
        with naming_errors(self.path):
            found = self.reader.get_summary()
            if found is None or found.statistics is None:
                raise ValueError("it has no summary")
            if found.statistics.message_count and not found.chunk_indexes:
                raise ValueError("its messages are in no chunks")
        return found

    @cached_property
    def records(self) -> list[tuple[str, dict[str, str]]]:
        """Metadata records with their names, in order."""
        with naming_errors(self.path):
            return [(one.name, dict(one.metadata)) for one in self.reader.iter_metadata()]

    def attachment(self, offset: int) -> Attachment:
        """Return the attachment at an offset in the summary."""
        with naming_errors(self.path):
            self.file.seek(offset)
            record = next(StreamReader(self.file, skip_magic=True).records)
            if not isinstance(record, Attachment):
                raise ValueError(f"expected an attachment, got {type(record).__name__}")
        return record

    def messages(self, topics: Collection[str]) -> Iterator[tuple[int, bytes]]:
        """Yield time [ns, UTC] and payload of the messages of topics in order of time, equal times in file order.

        Messages of other topics are skipped by their lengths, which is faster than the library.

        Raises:
            McapError: The file is damaged.
        """
        summary = self.summary
        wanted = {number for number, channel in summary.channels.items() if channel.topic in topics}
        waiting: list[Any] = []
        chunks = sorted(
            summary.chunk_indexes, key=lambda one: (one.message_start_time, one.chunk_start_offset)
        )
        for index in chunks:
            held, offset = index.message_index_offsets, index.chunk_start_offset
            if held and wanted.isdisjoint(held):
                continue
            waiting.sort()
            before = bisect_left(waiting, (index.message_start_time,))
            yield from ((time_ns, data) for time_ns, _, data in waiting[:before])
            self.file.seek(offset + _HEAD.size)
            chunk = Chunk.read(ReadDataStream(self.file))
            waiting = [*waiting[before:], *_in_chunk(chunk, wanted, offset)]
        yield from ((time_ns, data) for time_ns, _, data in sorted(waiting))

    def newest(
        self, topics: Collection[str], until_ns: int | None = None
    ) -> Iterator[tuple[int, bytes]]:
        """Yield time [ns, UTC] and payload of the messages of topics from the last one backward, lazily.

        Args:
            topics: Their topics.
            until_ns: Time of the latest message [ns, UTC]; None for the last.
        """
        end = None if until_ns is None else until_ns + 1
        found = self.reader.iter_messages([*topics], ending_before=end, reverse=True)
        return ((message.log_time, message.data) for _, _, message in found)


def _in_chunk(chunk: Chunk, wanted: set[int], offset: int) -> Iterator[tuple[int, int, bytes]]:
    """Yield time, position in the file and payload of the messages of some channels; positions increase by chunk and within it."""
    stream, size = get_chunk_data_stream(chunk)
    data, at = stream.read(size), 0
    while at < size:
        opcode, length = _HEAD.unpack_from(data, at)
        begin, at = at + _HEAD.size, at + _HEAD.size + length
        if opcode == Opcode.MESSAGE:
            number, _, time_ns, _ = _MESSAGE.unpack_from(data, begin)
            if number in wanted:
                # less than 2^64 in a chunk, in which places of files lie
                yield time_ns, (offset << 64) + begin, data[begin + _MESSAGE.size : at]
