"""Messages of several logs in one order of time, with a bounded window for reordering."""

import heapq
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Generic, Protocol, TypeVar, cast

from replay_kit.core.message import Message, RawMessage
from replay_kit.logs.shared.stamps import FAR_NS, ClockJump, Settled, Settling, is_latched

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
    older than one of the same log that was already yielded, is left out and counted. Before that, stamps far from their neighbours are
    set aside and counted, and after a jump back of a log's clock its messages continue where it stood (``settle``). Each iteration reads
    the logs anew.

    Attributes:
        readers: The logs; each has an ``input`` of its own in its messages.
        reorder_window_s: How long a message is held back [s, in the logs' time].
        start_ns: Earlier messages are left out [ns, UTC], save those of latched topics, ``is_latched``; None for no limit.
        end_ns: Later messages are left out [ns, UTC]; the logs are still read to their end, so that reports are complete.
        keep_late: Yield late messages as they come, out of order, with their own stamps: for copies, which must lose nothing.
    """

    readers: Sequence[Source[_T]]
    reorder_window_s: float
    start_ns: int | None = None
    end_ns: int | None = None
    keep_late: bool = False
    _late: Counter[str] = field(default_factory=Counter, init=False, repr=False)
    _astray: Counter[str] = field(default_factory=Counter, init=False, repr=False)
    _jumps: list[ClockJump] = field(default_factory=list, init=False, repr=False)

    @property
    def late(self) -> Mapping[str, int]:
        """Late messages left out, by topic; complete once the iteration is."""
        return dict(self._late)

    @property
    def astray(self) -> Mapping[str, int]:
        """Messages set aside because their stamps are far from their neighbours', by topic; complete once the iteration is."""
        return dict(self._astray)

    @property
    def jumps(self) -> tuple[ClockJump, ...]:
        """Jumps of the logs' clocks; complete once the iteration is."""
        return tuple(self._jumps)

    def __iter__(self) -> Iterator[_T]:
        """Yield the messages from ``start_ns`` to ``end_ns``, both included; each iteration reads the logs anew."""
        self._late.clear()
        self._astray.clear()
        self._jumps.clear()
        ordered = [self._ordered(reader) for reader in self.readers]
        merged = ordered[0] if len(ordered) == 1 else heapq.merge(*ordered, key=_order)
        yield from (
            merged
            if self.start_ns is None and self.end_ns is None
            else filter(self._wanted, merged)
        )

    def _wanted(self, message: _T) -> bool:
        if self.end_ns is not None and message.time_ns > self.end_ns:
            return False
        return (
            self.start_ns is None or message.time_ns >= self.start_ns or is_latched(message.topic)
        )

    def _ordered(self, reader: Source[_T]) -> Iterator[_T]:
        """Yield one log's messages in order; late ones within the wanted time are counted."""
        window_ns = round(self.reorder_window_s * 1e9)
        held: list[tuple[int, int, _T]] = []
        newest = yielded = -(2**63)
        for message in reader.messages() if self.keep_late else self._steady(reader.messages()):
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

    def _steady(self, messages: Iterator[_T]) -> Iterator[_T]:
        """Yield one log's messages with corrected times; those with a stamp far from its neighbours are counted."""
        settling: Settling[_T] = Settling()
        for message in messages:
            time_ns, last_ns = message.time_ns, settling.steady_since()
            if last_ns is not None and abs(time_ns - last_ns) <= FAR_NS:
                settling.go_on(time_ns)
                yield message
            else:
                yield from self._kept(settling.take(message, time_ns, message.topic))
        yield from self._kept(settling.finish())

    def _kept(self, judged: Iterator[Settled[_T]]) -> Iterator[_T]:
        for message, time_ns, jump in judged:
            if time_ns is None:
                self._astray[message.topic] += 1
                continue
            if jump is not None:
                self._jumps.append(ClockJump(message.input, jump[0], message.time_ns, jump[1]))
            # both are tuples, whose copy is of their own kind
            yield (
                message
                if time_ns == message.time_ns
                else cast(_T, message._replace(time_ns=time_ns))
            )


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


def _order(message: _T) -> tuple[int, int, int]:
    return message.time_ns, message.input, message.position
