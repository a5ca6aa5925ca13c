"""A scan of an MCAP file that decodes some topics only: the others are counted and timed in bulk, chunk by chunk."""

from collections.abc import Callable, Generator, Iterator
from itertools import islice
from typing import BinaryIO, NamedTuple

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from replay_kit.core.message import Message
from replay_kit.logs.mcap.channels import Sink
from replay_kit.logs.mcap.records import HEAD_SIZE, INNER, RECORD_HEAD, Chunk, Record
from replay_kit.logs.mcap.scanner import Make, McapScanner
from replay_kit.logs.shared.blocks import Block, block_of
from replay_kit.logs.shared.statistics import ReadStatistics

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


_LAST_NS = np.uint64(2**63 - 1)


class SurveyScanner(McapScanner[Block]):
    """One scan of an open file: a block for each chunk, and for each message outside chunks or in a chunk with a fault."""

    def __init__(
        self,
        file: BinaryIO,
        statistics: ReadStatistics,
        decoded: Make[Message],
        stamp: str,
        wanted: Callable[[str, str], bool],
        rename: Callable[[str], str],
    ) -> None:
        """Remember what to do with messages.

        Args:
            file: The open file.
            statistics: Counts messages and losses.
            decoded: Returns a message decoded and counts it; None when it cannot be.
            stamp: Which stamp orders messages: ``log_ns`` or ``publish_ns``.
            wanted: Whether the messages of a topic and schema are decoded; of others the first is, as a sample.
            rename: Gives what a topic of the file is called.
        """

        def alone(*record: object) -> Block | None:
            message = decoded(*record)  # type: ignore[arg-type]
            return None if message is None else block_of([message])

        super().__init__(file, statistics, alone, rename)
        self._decoded = decoded
        self._stamp = stamp
        self._wanted = wanted
        self._sampled: set[tuple[str, str]] = set()

    def _contents(
        self, data: bytes, record: Record, unchecked: Chunk | None
    ) -> Generator[Block, None, int]:
        found = columns_of(data)
        if found is None or self._strange(found, unchecked):
            # one by one, so that what is wrong with a message is said of it
            return (yield from super()._contents(data, record, unchecked))
        for opcode, start, stop in found.declared:
            self._declare(opcode, data[start:stop], record.offset)
        if found.offset.size:
            yield self._block(data, found)
        return len(data)

    def _strange(self, found: Columns, unchecked: Chunk | None) -> bool:
        """Return whether a message has a time that cannot be used, or contradicts its chunk where no checksum covers both."""
        times = found.head["log_ns"]
        outside = unchecked is not None and np.any(
            (times < unchecked.start_ns) | (times > unchecked.end_ns)
        )
        return bool(outside or np.any(found.head[self._stamp] > _LAST_NS))

    def _block(self, data: bytes, found: Columns) -> Block:
        counts = np.bincount(found.head["channel"])
        channels = np.flatnonzero(counts)
        kind = np.searchsorted(channels, found.head["channel"])
        sinks = [self._channels.sink(channel) for channel in channels.tolist()]
        wanted = np.array(
            [callable(sink.decode) and self._wanted(sink.topic, sink.schema) for sink in sinks]
        )
        first = self._position
        self._position += kind.size
        messages = list(self._messages(data, found, np.flatnonzero(wanted[kind]), first))
        for number in np.flatnonzero(~wanted).tolist():
            count = int(counts[channels[number]])
            if (
                callable(sinks[number].decode)
                and (sinks[number].topic, sinks[number].schema) not in self._sampled
            ):
                sample, tried = self._sample(
                    sinks[number], data, found, np.flatnonzero(kind == number), first
                )
                messages, count = messages + sample, count - tried
            self._count(sinks[number], count)
        messages.sort(key=lambda message: message.position)
        kinds = tuple((sink.topic, sink.schema) for sink in sinks)
        return Block(kinds, kind, found.head[self._stamp].astype(np.int64), messages)

    def _messages(
        self, data: bytes, found: Columns, rows: NDArray[np.intp], first: int
    ) -> Iterator[Message]:
        """Yield the messages of some rows that can be decoded."""
        starts, stops = (found.offset[rows] + HEAD_SIZE).tolist(), found.stop[rows].tolist()
        for row, start, stop in zip(rows.tolist(), starts, stops, strict=True):
            message = self._decoded(self._channels, data, start, stop, first + row)
            if message is not None:
                yield message

    def _sample(
        self, sink: Sink, data: bytes, found: Columns, rows: NDArray[np.intp], first: int
    ) -> tuple[list[Message], int]:
        """Return the first message of a topic that can be decoded, and how many were tried and counted."""
        before = self._statistics.read[sink.topic]
        sample = list(islice(self._messages(data, found, rows, first), 1))
        if sample:
            self._sampled.add((sink.topic, sink.schema))
        return sample, self._statistics.read[sink.topic] - before

    def _count(self, sink: Sink, messages: int) -> None:
        if isinstance(sink.decode, str):
            self._statistics.undecodable(sink.topic, sink.decode, messages)
        self._statistics.read[sink.topic] += messages
