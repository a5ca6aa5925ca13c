"""Messages as columns, decoded only where needed, and the overview that a log's own index gives."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.message import Message
from replay_kit.logs.shared.statistics import ReadStatistics

_SIZE = 4096


class Block(NamedTuple):
    """Messages that follow one another in a log; those that could not be decoded, as far as that was tried, are left out.

    Attributes:
        kinds: Topic and schema of each kind of message.
        kind: Which of them each message is, shape (n,).
        time_ns: Time that orders each message, shape (n,) [ns, UTC].
        messages: The decoded ones.
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
    """Return which candidates are records when each search begins at the end of the record before, shape (m,), increasing.

    A candidate that begins inside a record is none: its first bytes are the record's contents.

    Args:
        start: Where each candidate begins, shape (n,), increasing.
        end: Where each ends, shape (n,), greater than its start.
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
    """Record the bytes between records as losses and return where the last record ends [bytes].

    Args:
        statistics: Where the losses are recorded.
        what: Description of such a loss.
        before: Where the record before the first one ends in the file.
        start: Where each record begins in the file, shape (n,), increasing.
        end: Where each ends, shape (n,).
    """
    ends = np.concatenate([[before], end])
    for gap in np.flatnonzero(start > ends[:-1]).tolist():
        statistics.lose(what, int(ends[gap]), int(start[gap] - ends[gap]))
    return int(ends[-1])


@dataclass(frozen=True, slots=True)
class TopicExtent:
    """One topic of a file, by its index.

    Attributes:
        schema: Name of its schema.
        messages: Number of messages.
        first_ns: Earliest log time [ns]; None when the index does not say it in a few reads.
        last_ns: Latest.
    """

    schema: str
    messages: int
    first_ns: int | None
    last_ns: int | None

    def joined(self, other: "TopicExtent") -> "TopicExtent":
        """Return this topic with the messages of another channel."""
        firsts, lasts = (self.first_ns, other.first_ns), (self.last_ns, other.last_ns)
        first_ns = None if None in firsts else min(firsts)  # type: ignore[type-var]
        last_ns = None if None in lasts else max(lasts)  # type: ignore[type-var]
        return TopicExtent(self.schema, self.messages + other.messages, first_ns, last_ns)


@dataclass(frozen=True, slots=True)
class Overview:
    """A file by its index.

    Attributes:
        topics: By name.
        undecodable: Topic to the reason why none of its messages can be decoded.
        first: The first messages of each other topic, in the order of the file.
    """

    topics: Mapping[str, TopicExtent]
    undecodable: Mapping[str, str]
    first: tuple[Message, ...]

    @property
    def messages(self) -> int:
        """Number of messages."""
        return sum(topic.messages for topic in self.topics.values())
