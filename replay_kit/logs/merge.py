"""Messages of several logs in one order of time, with a bounded window for reordering."""

import heapq
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Generic, Protocol, TypeVar

from replay_kit.core.message import Message
from replay_kit.core.raw import RawMessage

#: Last part of latched topics, and words in it: their messages come once, when a recording begins, and hold from then on.
_LATCHED_TOPICS = frozenset({"tf_static", "robot_description", "PARAM_VALUE"})
_LATCHED_WORDS = ("config", "parameter")


_T = TypeVar("_T", bound=Message | RawMessage)
_Read = TypeVar("_Read", bound=Message | RawMessage, covariant=True)


class Source(Protocol[_Read]):
    """A log opened for reading."""

    def messages(self) -> Iterator[_Read]:
        """Yield the messages in the file's order."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Merge(Generic[_T]):
    """Several logs as one stream, ordered by (time, input, position).

    Each log is sorted on its own: a message is held back until one comes that is newer by more than the window. A late message,
    older than one of the same log that was already yielded, is left out and counted. Each iteration reads the logs anew.

    Attributes:
        readers: The logs; each has an ``input`` of its own in its messages.
        reorder_window_s: How long a message is held back [s, in the logs' time].
        start_ns: Earlier messages are left out [ns, UTC], save those of latched topics, ``is_latched``; None for no limit.
        end_ns: Later messages are left out [ns, UTC]; the logs are still read to their end, so that reports are complete.
        keep_late: Yield late messages as they come, out of order: for copies, which must lose nothing.
    """

    readers: Sequence[Source[_T]]
    reorder_window_s: float
    start_ns: int | None = None
    end_ns: int | None = None
    keep_late: bool = False
    _late: Counter[str] = field(default_factory=Counter, init=False, repr=False)

    @property
    def late(self) -> Mapping[str, int]:
        """Late messages left out, by topic; complete once the iteration is."""
        return dict(self._late)

    def __iter__(self) -> Iterator[_T]:
        """Yield the messages from ``start_ns`` to ``end_ns``, both included; each iteration reads the logs anew."""
        self._late.clear()
        ordered = [self._ordered(reader) for reader in self.readers]
        merged = ordered[0] if len(ordered) == 1 else heapq.merge(*ordered, key=_order)
        yield from merged if self.start_ns is None and self.end_ns is None else filter(self._wanted, merged)

    def _wanted(self, message: _T) -> bool:
        if self.end_ns is not None and message.time_ns > self.end_ns:
            return False
        return self.start_ns is None or message.time_ns >= self.start_ns or is_latched(message.topic)

    def _ordered(self, reader: Source[_T]) -> Iterator[_T]:
        """Yield one log's messages in order; late ones within the wanted time are counted."""
        window_ns = round(self.reorder_window_s * 1e9)
        held: list[tuple[int, int, _T]] = []
        newest = yielded = -(2**63)
        for message in reader.messages():
            time_ns = message.time_ns
            if time_ns < yielded:
                if self.keep_late:
                    yield message
                elif self._wanted(message):
                    self._late[message.topic] += 1
                continue
            heapq.heappush(held, (time_ns, message.position, message))
            newest = max(newest, time_ns)
            while newest - held[0][0] > window_ns:
                yielded, _, oldest = heapq.heappop(held)
                yield oldest
        while held:
            yield heapq.heappop(held)[2]


def merge(
    readers: Sequence[Source[_T]],
    reorder_window_s: float,
    start_ns: int | None = None,
    end_ns: int | None = None,
    keep_late: bool = False,
) -> Merge[_T]:
    """Return the messages of several logs as one ordered stream; see ``Merge``.

    Args:
        readers: The logs, each with an input number of its own.
        reorder_window_s: How long a message is held back to let older ones pass [s].
        start_ns: First time yielded [ns, UTC]; None for no limit.
        end_ns: Last time yielded [ns, UTC]; None for no limit.
        keep_late: Whether late messages are yielded out of order instead of left out.
    """
    return Merge(readers, reorder_window_s, start_ns, end_ns, keep_late)


def is_latched(topic: str) -> bool:
    """Return whether a topic is latched: its messages (static transforms, parameters, configuration) stay valid from then on."""
    last = topic.rsplit("/", 1)[-1]
    return last in _LATCHED_TOPICS or any(word in last.lower() for word in _LATCHED_WORDS)


def _order(message: _T) -> tuple[int, int, int]:
    return message.time_ns, message.input, message.position
