"""The checks of a result file: that it is complete, before it gets its name; that its checksums fit, before it is read."""

import os
import struct
import zlib
from collections import Counter
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Footer, McapRecord, Message, Statistics
from mcap.stream_reader import CRCValidationError, StreamReader, get_chunk_data_stream

from replay_kit.core.errors import ReplayKitError
from replay_kit.core.inputs import open_input

# opcode, length, and the channel when it is a message
_START = struct.Struct("<BQH")
_HEAD = 9
# the summary's checksum and the closing magic bytes
_TAIL = 12
_MESSAGE = int(Opcode.MESSAGE)
_MAGIC = b"\x89MCAP0\r\n"
# Opcode, length and checksum of the data. Of the footer: place of the summary, of its offsets, the summary's checksum.
_DATA_END, _FOOTER = struct.Struct("<BQI"), struct.Struct("<BQQQI")
# Bytes read at once.
_PIECE = 1 << 20


def check_written(path: Path, messages: Mapping[str, int], attachments: int) -> None:
    """Read a file from end to end, with its checksums, and compare it with what was written.

    The writing library reports a full disk in no return value: what it dropped shows here.

    Args:
        path: The file.
        messages: Topic to number of messages written.
        attachments: Number of attachments written.

    Raises:
        ReplayKitError: The file does not hold what was written.
    """
    try:
        found = _Found()
        with path.open("rb") as file:
            for record in Records(
                file, emit_chunks=True, validate_crcs=True, record_size_limit=path.stat().st_size
            ).records:
                found.add(record)
            found.check_summary(file)
        read, summary = found.by_topic(found.messages), found.by_topic(found.stated)
    except (
        OSError,
        McapError,
        CRCValidationError,
        zstandard.ZstdError,
        struct.error,
        ValueError,
        OverflowError,
        KeyError,
    ) as error:
        raise ReplayKitError(
            f"{path}: the result does not read back: {error}; is the disk full?"
        ) from error
    if not read == summary == Counter(messages) or found.attachments != attachments:
        raise ReplayKitError(
            f"{path}: wrote {sum(messages.values())} messages and {attachments} attachments, but read back {read.total()} and "
            f"{found.attachments}, and its summary says {summary.total()}; is the disk full?"
        )


def checksums_fit(path: Path) -> bool | None:
    """Return whether a file states checksums of its data and of its summary, and both fit; nothing is unpacked.

    None for a file that cannot be opened or does not begin as an MCAP file: its readers say so.
    """
    try:
        with open_input(path) as file:
            if file.read(len(_MAGIC)) != _MAGIC:
                return None
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
    except OSError:
        return None
    except struct.error:
        return False


def _crc(file: BinaryIO, length: int) -> int:
    """Return the CRC-32 of the next bytes, read in pieces."""
    crc = 0
    for start in range(0, length, _PIECE):
        crc = zlib.crc32(file.read(min(_PIECE, length - start)), crc)
    return crc


class Records(StreamReader):
    """The records of a file without the message indexes, whose entries the library would parse one by one."""

    def _read_record(self, opcode: int, length: int) -> McapRecord | None:
        return None if opcode == Opcode.MESSAGE_INDEX else super()._read_record(opcode, length)


class _Found:
    """What a file holds, counted record by record.

    Attributes:
        messages: Number of messages, by channel.
        stated: As the file's own statistics state it.
        attachments: Number of attachments.
    """

    def __init__(self) -> None:
        self.messages: Counter[int] = Counter()
        self.stated: Mapping[int, int] = {}
        self.attachments = 0
        self._topics: dict[int, str] = {}
        self._footer: Footer | None = None

    def add(self, record: McapRecord) -> None:
        if isinstance(record, Chunk):
            self._add_chunk(record)
        elif isinstance(record, Channel):
            self._topics[record.id] = record.topic
        elif isinstance(record, Message):
            self.messages[record.channel_id] += 1
        elif isinstance(record, Attachment):
            self.attachments += 1
        elif isinstance(record, Statistics):
            self.stated = record.channel_message_counts
        elif isinstance(record, Footer):
            self._footer = record

    def check_summary(self, file: BinaryIO) -> None:
        """Raise ValueError when the checksum of the summary, which the library does not compare, does not match."""
        assert self._footer is not None, "the library reads to the footer or raises"
        file.seek(self._footer.summary_start)
        if zlib.crc32(file.read()[:-_TAIL]) != self._footer.summary_crc:
            raise ValueError("the checksum of the summary does not match")

    def by_topic(self, numbers: Mapping[int, int]) -> Counter[str]:
        found: Counter[str] = Counter()
        for number, count in numbers.items():
            found[self._topics[number]] += count
        return found

    def _add_chunk(self, chunk: Chunk) -> None:
        """Count the messages of a chunk by the lengths of its records: its checksum covers them, no payload is looked at."""
        stream, size = get_chunk_data_stream(chunk, validate_crc=True)
        data, end, channels = stream.read(size), 0, []
        while end < size:
            opcode, length, number = _START.unpack_from(data, end)
            if opcode == _MESSAGE:
                channels.append(number)
            elif opcode == Opcode.CHANNEL:
                self.add(
                    Channel.read(ReadDataStream(BytesIO(data[end + _HEAD : end + _HEAD + length])))
                )
            end += _HEAD + length
        if end != size:
            raise ValueError(f"the records of a chunk end at byte {end} of its {size}")
        self.messages.update(channels)
