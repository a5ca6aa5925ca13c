"""Messages of several logs in one order of time, with a bounded window for reordering."""

import heapq
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

from replay_kit.types import LogReader, Message


class Merge:
    """Several logs as one stream, ordered by (time, input, position).

    Each log is put in order on its own: a message is held back until its log has shown one that is newer by more than the
    window. What still comes too late, older than a message of the same log that was already given, is left out and counted.
    """

    def __init__(
        self, readers: Sequence[LogReader], reorder_window_s: float, start_ns: int | None = None, end_ns: int | None = None
    ) -> None:
        """Remember what to merge; nothing is read before the iteration.

        Args:
            readers: The logs; each has an ``input`` of its own in its messages.
            reorder_window_s: How long a message is held back [s, in the logs' time].
            start_ns: Earlier messages are not given [ns, UTC]; None for no limit.
            end_ns: Later messages are not given [ns, UTC]; the logs are still read to their end, so that reports are complete.
        """
        self._readers = tuple(readers)
        self._window_ns = round(reorder_window_s * 1e9)
        self._start_ns = start_ns
        self._end_ns = end_ns
        self._late: Counter[str] = Counter()

    @property
    def late(self) -> Mapping[str, int]:
        """Messages left out because they came too late, by topic; complete once the iteration is."""
        return dict(self._late)

    def __iter__(self) -> Iterator[Message]:
        """Yield the messages from ``start_ns`` to ``end_ns``, both included; each iteration reads the logs anew."""
        self._late = Counter()
        ordered = [self._ordered(reader) for reader in self._readers]
        merged = ordered[0] if len(ordered) == 1 else heapq.merge(*ordered, key=_order)
        yield from merged if self._start_ns is None and self._end_ns is None else filter(self._wanted, merged)

    def _wanted(self, message: Message) -> bool:
        return (self._start_ns is None or message.time_ns >= self._start_ns) and (self._end_ns is None or message.time_ns <= self._end_ns)

    def _ordered(self, reader: LogReader) -> Iterator[Message]:
        """Yield one log's messages in order; late ones within the wanted time are counted."""
        held: list[tuple[int, int, Message]] = []
        newest = given = -(2**63)
        for message in reader.messages():
            if message.time_ns < given:
                if self._wanted(message):
                    self._late[message.topic] += 1
                continue
            heapq.heappush(held, (message.time_ns, message.position, message))
            newest = max(newest, message.time_ns)
            while newest - held[0][0] > self._window_ns:
                given, _, oldest = heapq.heappop(held)
                yield oldest
        while held:
            yield heapq.heappop(held)[2]


def merge(readers: Sequence[LogReader], reorder_window_s: float, start_ns: int | None = None, end_ns: int | None = None) -> Merge:
    """Return the messages of several logs as one ordered stream; see ``Merge``.

    Args:
        readers: The logs, each with an input number of its own.
        reorder_window_s: How long a message is held back to let older ones pass [s].
        start_ns: First time given [ns, UTC]; None for no limit.
        end_ns: Last time given [ns, UTC]; None for no limit.
    """
    return Merge(readers, reorder_window_s, start_ns, end_ns)


def _order(message: Message) -> tuple[int, int, int]:
    return message.time_ns, message.input, message.position
