"""Results of reading a log: counts and damage, messages as columns, and the overview from the log's index."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.message import LogReport, Loss, Message

#: Losses listed one by one; a log that is damaged in more places has the others summed in one more.
MAX_LOSSES = 20


class ReadStatistics:
    """Counts of messages and damage while a log is read.

    Attributes:
        read: Number of messages by topic, decoded or not.
        unchecked: Counts of records without a checksum, by kind.
        without_stamp: Number of messages without their own stamp, ordered by log time.
        notes: Notes on the log's clocks.
    """

    def __init__(self) -> None:
        self.read: Counter[str] = Counter()
        self.unchecked: Counter[str] = Counter()
        self.without_stamp = 0
        self.notes: tuple[str, ...] = ()
        self._undecodable: dict[str, tuple[int, str]] = {}
        self._losses: list[Loss] = []
        #: Of damage that is not listed: places, first offset, bytes.
        self._further = [0, 0, 0]

    def undecodable(self, topic: str, reason: str, messages: int = 1) -> None:
        """Count undecodable messages; the first reason of a topic is kept."""
        count, first = self._undecodable.get(topic, (0, reason))
        self._undecodable[topic] = (count + messages, first)

    def skip(self, topic: str, reason: str, messages: int = 1) -> None:
        """Count messages as read and undecodable."""
        if messages:
            self.read[topic] += messages
            self.undecodable(topic, reason, messages)

    def lose(
        self,
        what: str,
        offset: int,
        size: int,
        messages: int | None = None,
        span: tuple[int, int] | None = None,
    ) -> None:
        """Record damage.

        Args:
            what: Description.
            offset: Byte offset of the end of the last whole record.
            size: Number of unusable bytes.
            messages: Number of messages in them; None when unknown.
            span: Their first and last possible time [ns]; None when unknown.
        """
        first_ns, last_ns = span or (None, None)
        loss = Loss(what, offset, size, messages, first_ns, last_ns)
        if len(self._losses) < MAX_LOSSES:
            self._losses.append(loss)
            return
        places, first, total = self._further
        self._further = [places + 1, first or offset, total + size]

    def report(self, path: str, format_name: str) -> LogReport:
        """Return the counts as a report.

        Args:
            path: Path of the log.
            format_name: As in ``LogReport.format``.
        """
        places, first, total = self._further
        words = f"{places} further damaged places, not listed one by one"
        further = (Loss(words, first, total),) if places else ()
        return LogReport(
            path=path,
            format=format_name,
            read=dict(self.read),
            undecodable=dict(self._undecodable),
            losses=(*self._losses, *further),
            without_stamp=self.without_stamp,
            unchecked=dict(self.unchecked),
            notes=self.notes,
        )


_SIZE = 4096


class Block(NamedTuple):
    """Consecutive messages of a log, without those found undecodable.

    Attributes:
        kinds: Topic and schema of each kind of message.
        kind: Index in ``kinds`` of each message, shape (n,).
        time_ns: Time that orders each message, shape (n,) [ns, UTC].
        messages: Decoded messages.
    """

    kinds: tuple[tuple[str, str], ...]
    kind: NDArray[np.intp]
    time_ns: NDArray[np.int64]
    messages: list[Message]


def blocks_of(messages: Iterable[Message]) -> Iterator[Block]:
    """Yield blocks of decoded messages."""
    following = iter(messages)
    while batch := list(islice(following, _SIZE)):
        yield block_of(batch)


def block_of(messages: list[Message]) -> Block:
    """Return decoded messages as a block."""
    kinds: dict[tuple[str, str], int] = {}
    kind = [kinds.setdefault((message.topic, message.schema), len(kinds)) for message in messages]
    return Block(
        tuple(kinds),
        np.array(kind, np.intp),
        np.array([message.time_ns for message in messages], np.int64),
        messages,
    )


Indices = NDArray[np.signedinteger[Any]]


def chain(start: Indices, end: Indices) -> Indices:
    """Return the indices of candidates that are records, shape (m,), increasing: each search begins at the end of a record.

    Candidates that begin inside a record are excluded.

    Args:
        start: Start of each candidate, shape (n,), increasing.
        end: End of each candidate, shape (n,), after its start.
    """
    keep = np.ones(start.size, dtype=np.bool_)
    overlapped = np.flatnonzero(start[1:] < end[:-1])
    after = np.searchsorted(start, end[overlapped])
    for record, following in zip(overlapped.tolist(), after.tolist(), strict=True):
        if keep[record]:
            keep[record + 1 : following] = False
    return np.flatnonzero(keep)


def lose_gaps(
    statistics: ReadStatistics, what: str, before: int, start: Indices, end: Indices
) -> int:
    """Record the bytes between records as losses and return the end of the last record [bytes].

    Args:
        statistics: Statistics that receive the losses.
        what: Description of the losses.
        before: End of the previous record in the file.
        start: Start of each record in the file, shape (n,), increasing.
        end: End of each record, shape (n,).
    """
    ends = np.concatenate([[before], end])
    for gap in np.flatnonzero(start > ends[:-1]).tolist():
        statistics.lose(what, int(ends[gap]), int(start[gap] - ends[gap]))
    return int(ends[-1])


@dataclass(frozen=True, slots=True)
class TopicExtent:
    """Extent of one topic, by the file's index.

    Attributes:
        schema: Name of its schema.
        messages: Number of messages.
        first_ns: Earliest log time [ns].
        last_ns: Latest log time [ns].
    """

    schema: str
    messages: int
    first_ns: int
    last_ns: int

    def joined(self, other: "TopicExtent") -> "TopicExtent":
        """Return the extent of this topic in two parts of the file."""
        span = min(self.first_ns, other.first_ns), max(self.last_ns, other.last_ns)
        return TopicExtent(self.schema, self.messages + other.messages, *span)


@dataclass(frozen=True, slots=True)
class Overview:
    """Overview of a file by its index.

    Attributes:
        topics: Extents by topic.
        undecodable: Topic to the reason why it cannot be decoded.
        first: First messages of each other topic, in order of time.
    """

    topics: Mapping[str, TopicExtent]
    undecodable: Mapping[str, str]
    first: tuple[Message, ...]

    @property
    def messages(self) -> int:
        """Number of messages."""
        return sum(topic.messages for topic in self.topics.values())
