"""Records of an MCAP file with their byte offsets, in bounded memory.

The framing (one byte of opcode, eight of length) is parsed here, not by ``mcap.stream_reader``, as a damaged file must be read by offset
and the library decompresses any claimed size. Record bodies are parsed by ``mcap.records``.
"""

import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import BinaryIO, TypeVar

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import McapRecord

MAGIC = b"\x89MCAP0\r\n"

#: Largest record read [bytes]; a larger claim counts as damage.
MAX_SIZE = 1 << 28

#: What the record parsers of ``mcap.records`` raise on bytes that are no such record.
RECORD_ERRORS = (struct.error, ValueError, OverflowError, McapError)

#: Opcode and length before each record's body [bytes].
HEAD_SIZE = 9

#: Opcode and length.
RECORD_HEAD = struct.Struct("<BQ")
_PIECE = 1 << 20
# known kinds, but that whose body is read where it is needed
_KEPT = frozenset(map(int, Opcode)) - {Opcode.ATTACHMENT}
#: What a chunk holds, as plain numbers.
INNER = frozenset({int(Opcode.SCHEMA), int(Opcode.CHANNEL), int(Opcode.MESSAGE)})

_Parsed = TypeVar("_Parsed", bound=McapRecord)


@dataclass(frozen=True, slots=True)
class Record:
    """Record of the file, or the rest of a damaged one.

    Attributes:
        opcode: Opcode; 0 if no record begins here.
        offset: Start [bytes].
        end: End of the record or the file [bytes].
        body: Bytes after opcode and length; empty for skipped record types.
        whole: False if the file ends inside it or its length is implausible; nothing follows it then.
        crc: CRC-32 of the file from the first record to this one.
    """

    opcode: int
    offset: int
    end: int
    body: bytes
    whole: bool
    crc: int


def file_records(
    file: BinaryIO, start: int, size: int, bound: Callable[[int], int | None] | None = None
) -> Iterator[Record]:
    """Yield the records of a file up to the first incomplete one, inclusive; the closing magic bytes are none.

    Args:
        file: Open log; its position may change between records.
        start: Byte offset of the first record.
        size: Size of the file [bytes].
        bound: Returns the next known start of a record after an offset; a record that extends beyond it is incomplete.
    """
    offset, crc = start, zlib.crc32(MAGIC)
    while True:
        file.seek(offset)
        head = file.read(HEAD_SIZE)
        # where the file ends in a head no record begins
        opcode, length = RECORD_HEAD.unpack(head) if len(head) == HEAD_SIZE else (0, 0)
        end = offset + HEAD_SIZE + length
        limit = (bound(offset) if bound else None) or size
        kept = opcode in _KEPT
        if opcode == 0 or end > limit or (kept and length > MAX_SIZE):
            yield Record(opcode, offset, size, b"", False, crc)
            return
        before, crc = crc, zlib.crc32(head, crc)
        body = file.read(length) if kept else b""
        crc = zlib.crc32(body, crc) if kept else crc_of_rest(file, length, crc)
        yield Record(opcode, offset, end, body, True, before)
        offset = end


def crc_of_rest(file: BinaryIO, length: int, crc: int) -> int:
    """Return the CRC updated with the next bytes, read in pieces: attachments may exceed memory."""
    while length > 0:
        piece = file.read(min(length, _PIECE))
        if not piece:
            break
        crc = zlib.crc32(piece, crc)
        length -= len(piece)
    return crc


def parse(kind: type[_Parsed], body: bytes) -> _Parsed:
    """Return a record's body parsed by the library.

    Raises:
        struct.error, ValueError, OverflowError, mcap.exceptions.McapError: ``RECORD_ERRORS``; the body is no such record.
    """
    # every record class of the library has it, their base does not declare it
    value: _Parsed = kind.read(ReadDataStream(BytesIO(body)))  # type: ignore[attr-defined]
    return value
