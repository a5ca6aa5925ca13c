"""The messages in a chunk's contents as columns, found without looking at any payload."""

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
_SHORTEST = MESSAGE_START.itemsize - HEAD_SIZE


class Columns(NamedTuple):
    """The records of a chunk.

    Attributes:
        offset: Where each message record begins in the contents, shape (n,), increasing [bytes].
        head: ``MESSAGE_START`` of each.
        declared: Opcode, and where the body begins and ends, of the schema and channel records.
    """

    offset: NDArray[np.int64]
    head: NDArray[np.void]
    declared: list[tuple[int, int, int]]

    @property
    def stop(self) -> NDArray[np.int64]:
        """Where each message record ends, shape (n,) [bytes]."""
        stop: NDArray[np.int64] = self.offset + HEAD_SIZE + self.head["length"].astype(np.int64)
        return stop


def columns_of(data: bytes) -> Columns | None:
    """Return the records of a chunk's contents; None when anything but whole schemas, channels and messages is in them."""
    offset: list[int] = []
    declared: list[tuple[int, int, int]] = []
    # walking is what takes the time; the numbers are gathered for all messages at once
    end, last, unpack, add = 0, len(data) - HEAD_SIZE, RECORD_HEAD.unpack_from, offset.append
    while end <= last:
        opcode, length = unpack(data, end)
        start, end = end, end + HEAD_SIZE + length
        if opcode == _MESSAGE and length >= _SHORTEST:
            add(start)
        elif opcode in INNER and opcode != _MESSAGE:
            declared.append((opcode, start + HEAD_SIZE, end))
        else:
            return None
    # the lengths add up only if no record reaches beyond the end
    return (
        Columns(np.array(offset, np.int64), _heads(data, offset), declared)
        if end == len(data)
        else None
    )


def _heads(data: bytes, offset: list[int]) -> NDArray[np.void]:
    if not offset:
        return np.empty(0, MESSAGE_START)
    # a record may begin at any byte
    anywhere: NDArray[np.void] = np.ndarray(
        (len(data) - MESSAGE_START.itemsize + 1,), MESSAGE_START, data, strides=(1,)
    )
    return anywhere[offset]
