"""Results of reading a log: counts and damage, and messages as columns."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Times
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
    time_ns: Times
    messages: Sequence[Message]


def blocks_of(messages: Iterable[Message]) -> Iterator[Block]:
    """Yield blocks of decoded messages."""
    following = iter(messages)
    while batch := list(islice(following, _SIZE)):
        yield block_of([message[:3] for message in batch], batch)


def block_of(stated: Sequence[tuple[int, str, str]], messages: Sequence[Message]) -> Block:
    """Return a block.

    Args:
        stated: Time [ns, UTC], topic and schema of each message.
        messages: Decoded messages, of these or some of them.

    Raises:
        OverflowError: A time is past the year 2262.
    """
    kinds: dict[tuple[str, str], int] = {}
    kind = [kinds.setdefault((topic, schema), len(kinds)) for _, topic, schema in stated]
    times = np.array([time_ns for time_ns, _, _ in stated], np.int64)
    return Block(tuple(kinds), np.array(kind, np.intp), times, messages)


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


def gaps(what: str, before: int, start: Indices, end: Indices) -> list[Loss]:
    """Return the bytes between records as losses.

    Args:
        what: Description of the losses.
        before: End of the previous record in the file.
        start: Start of each record in the file, shape (n,), increasing.
        end: End of each record, shape (n,).
    """
    ends = np.append(before, end)
    at = np.flatnonzero(start > ends[:-1]).tolist()
    return [Loss(what, int(ends[k]), int(start[k] - ends[k])) for k in at]
