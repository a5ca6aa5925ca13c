"""Messages of an MCAP chunk as columns, from one pass over its records."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from replay_kit.logs.mcap.records import HEAD_SIZE, INNER, RECORD_HEAD

#: Opcode, length and fixed part of a message record.
MESSAGE_START = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_ns", "<u8"),
        ("publish_ns", "<u8"),
    ]
)
_MESSAGE = int(Opcode.MESSAGE)
#: Least length of a message record's body [bytes].
SHORTEST = MESSAGE_START.itemsize - HEAD_SIZE


#: A message: channel, sequence, log and publish time [ns], where its payload begins and ends in the contents, its ordinal in the file.
Row = tuple[int, int, int, int, int, int, int]


class Part(NamedTuple):
    """Consecutive messages, in the file or in time.

    Attributes:
        contents: Bytes with their records.
        offset: Start of each message record, shape (n,), increasing [bytes].
        head: ``MESSAGE_START`` of each.
        ordinal: Ordinal of each in the file.
    """

    contents: bytes
    offset: NDArray[np.int64]
    head: NDArray[np.void]
    ordinal: NDArray[np.int64]

    @property
    def stop(self) -> NDArray[np.int64]:
        """End of each message record, shape (n,) [bytes]."""
        stop: NDArray[np.int64] = self.offset + HEAD_SIZE + self.head["length"].astype(np.int64)
        return stop

    def take(self, which: NDArray[np.bool_] | NDArray[np.intp]) -> "Part":
        """Return a subset of the messages."""
        return Part(self.contents, self.offset[which], self.head[which], self.ordinal[which])

    def rows(self) -> Iterator[Row]:
        """Yield the messages."""
        columns = (self.head[name].tolist() for name in MESSAGE_START.names[2:])  # type: ignore[index]
        starts, stops = (self.offset + MESSAGE_START.itemsize).tolist(), self.stop.tolist()
        return zip(*columns, starts, stops, self.ordinal.tolist(), strict=True)


class Walked(NamedTuple):
    """Records of a chunk's contents.

    Attributes:
        part: Messages, with ordinals from the first.
        declared: Opcode, start and end of the body of schema and channel records.
        short: Lengths of truncated message records.
        end: End of the last whole record [bytes].
    """

    part: Part
    declared: list[tuple[int, int, int]]
    short: list[int]
    end: int


def walk(data: bytes, strict: bool = False) -> Walked:
    """Return the records of a chunk's contents, up to the last whole one.

    Args:
        data: Contents of the chunk.
        strict: Whether a record other than schema, channel or message ends the walk; otherwise it is skipped.
    """
    offset: list[int] = []
    declared: list[tuple[int, int, int]] = []
    short: list[int] = []
    # walking is what takes the time; the numbers are gathered for all messages at once
    end, size, unpack, add = 0, len(data), RECORD_HEAD.unpack_from, offset.append
    while end + HEAD_SIZE <= size:
        opcode, length = unpack(data, end)
        stop = end + HEAD_SIZE + length
        if stop > size or opcode == 0 or (strict and opcode not in INNER):
            break
        if opcode == _MESSAGE and length >= SHORTEST:
            add(end)
        elif opcode == _MESSAGE:
            short.append(length)
        elif opcode in INNER:
            declared.append((opcode, end + HEAD_SIZE, stop))
        end = stop
    at = np.array(offset, np.int64)
    part = Part(data, at, _heads(data, offset), np.arange(at.size))
    return Walked(part, declared, short, end)


def messages_alone(data: bytes) -> Part:
    """Return the messages of a whole chunk.

    Raises:
        ValueError: It holds other records than schemas, channels and messages.
    """
    found = walk(data, strict=True)
    if found.short or found.end < len(data):
        raise ValueError("it holds more than schemas, channels and messages")
    return found.part


def _heads(data: bytes, offset: list[int]) -> NDArray[np.void]:
    if not offset:
        return np.empty(0, MESSAGE_START)
    # a record may begin at any byte
    anywhere: NDArray[np.void] = np.ndarray(
        (len(data) - MESSAGE_START.itemsize + 1,), MESSAGE_START, data, strides=(1,)
    )
    return anywhere[offset]
