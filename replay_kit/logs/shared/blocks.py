"""Messages that follow one another in a log, as columns: what needs no payload is known of all, and some are decoded."""

from collections.abc import Iterable, Iterator
from itertools import islice
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.message import Message

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
