"""Merge of several logs in order of time, with a bounded reorder window.

Outlier stamps are excluded, and times continue after a jump of a log's clock; see ``Settling``.
"""

import heapq
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any, Generic, NamedTuple, Protocol, TypeVar, cast

import numpy as np

from replay_kit.core.message import Message, RawMessage
from replay_kit.core.words.quantities import CLOCKS, EARLIEST_NS
from replay_kit.core.words.text import time_text

#: End of the anomaly of times that the messages' own stamps mend.
BY_HEADER = "--clock header reads these"
# What the times of one message may differ by: a year [ns].
_APART_NS = 366 * 86_400 * 10**9
_MAX_NS = 2**63 - 1


def header_stamp(payload: Mapping[str, Any]) -> int | None:
    """Return the time stated in a payload [ns, UTC]; None without one.

    Read from ``header.stamp``, ``stamp`` and ``timestamp``, as a mapping of seconds and nanoseconds under the names in use. Zero means
    unset, as in ROS; values beyond int64 are ignored.
    """
    header = payload.get("header")
    stamps = [header.get("stamp")] if isinstance(header, Mapping) else []
    for stamp in (*stamps, payload.get("stamp"), payload.get("timestamp")):
        if isinstance(stamp, Mapping):
            seconds = _first_integer(stamp, ("sec", "secs", "seconds"))
            nanoseconds = _first_integer(stamp, ("nsec", "nanosec", "nsecs", "nanos"))
            if seconds is not None and nanoseconds is not None:
                time_ns = seconds * 1_000_000_000 + nanoseconds
                if 0 < time_ns <= _MAX_NS:
                    return time_ns
    return None


def _first_integer(stamp: Mapping[str, Any], names: tuple[str, ...]) -> int | None:
    return next((stamp[name] for name in names if isinstance(stamp.get(name), int)), None)


def doubtful_times(
    span: tuple[int, int], samples: Iterable[tuple[int, Mapping[str, Any]]], now_ns: int | None
) -> str:
    """Return the anomaly of the times of a log and a plausible explanation; empty for plausible times.

    Args:
        span: First and last time [ns, UTC].
        samples: Times and payloads of some messages.
        now_ns: Latest possible time, with a tolerance of a day [ns, UTC]; None for a result independent of today.
    """
    first_ns, last_ns = span
    latest = _MAX_NS if now_ns is None else now_ns + 86_400 * 10**9
    stated = [(time_ns, stamp) for time_ns, payload in samples if (stamp := header_stamp(payload))]
    apart = float(np.median([stamp - time_ns for time_ns, stamp in stated])) if stated else 0.0
    begin = f"the log begins {time_text(first_ns)}"
    if first_ns < EARLIEST_NS:
        odd = f"{begin}, before 1990"
    elif last_ns > latest:
        odd = f"the log ends {time_text(last_ns)}, in the future"
    elif abs(apart) > _APART_NS:
        odd = f"{begin}, {abs(apart) / 86_400e9:.0f} days {'before' if apart > 0 else 'after'} the stamps in its messages"
    else:
        return ""
    stamp = stated[0][1] if stated else 0
    if abs(apart) > _APART_NS and EARLIEST_NS <= stamp <= latest:
        return f"{odd}; by the stamps in the messages it is {time_text(stamp)}: {BY_HEADER}"
    for unit, factor in CLOCKS.items():
        if EARLIEST_NS <= first_ns * factor <= min(latest, EARLIEST_NS * 4):
            return f"{odd}; as if {unit} were taken for nanoseconds: that would be {time_text(first_ns * factor)}; correct the recorder"
    return f"{odd}; check the clock of the recorder"


#: Nearer stamps are no matter of a wrong clock: messages are late by hours where data are buffered [ns].
FAR_NS = 86_400_000_000_000
#: Following messages used to judge a stamp that is far from its neighbours.
LOOK_AHEAD = 32
#: Last part of latched topics, and words in it: their messages come once, when a recording begins, and hold from then on.
_LATCHED_TOPICS = frozenset({"tf_static", "robot_description", "PARAM_VALUE"})
_LATCHED_WORDS = ("config", "parameter")
#: A gap that neither the log's last message nor its first alone may make [ns].
_ALONE_NS = 366 * FAR_NS


@dataclass(frozen=True, slots=True)
class ClockJump:
    """Jump of one log's clock.

    Attributes:
        input: Position of the log among the run's inputs.
        before_ns: Corrected time of the last message before it [ns, UTC].
        stamp_ns: Stamp of the first message after it [ns].
        offset_ns: Correction of the later stamps [ns].
    """

    input: int
    before_ns: int
    stamp_ns: int
    offset_ns: int

    def __str__(self) -> str:
        begin = f"the clock jumps from {time_text(self.before_ns)} to {time_text(self.stamp_ns)}"
        moved = (
            f"{self.offset_ns / FAR_NS:.3f} days were added to their stamps"
            if self.offset_ns
            else "their stamps are used as they are"
        )
        return f"{begin}: the messages after it are a new segment, {moved}"


def is_latched(topic: str) -> bool:
    """Return whether a topic is latched: its messages (static transforms, parameters, configuration) stay valid."""
    last = topic.rsplit("/", 1)[-1]
    return last in _LATCHED_TOPICS or any(word in last.lower() for word in _LATCHED_WORDS)


_Item = TypeVar("_Item")


class Settled(NamedTuple, Generic[_Item]):
    """Message with a checked stamp.

    Attributes:
        item: Message.
        time_ns: Its time [ns, UTC]; None for an outlier.
        jump: Corrected time of the previous message and correction of stamps from this one on [ns], if the clock jumps; else None.
    """

    item: _Item
    time_ns: int | None
    jump: tuple[int, int] | None = None


class Settling(Generic[_Item]):
    """Check of the stamps of one log in file order; a distant stamp waits for those that follow.

    Mutable, as messages are streamed. A latched message may precede the recording: its distant stamp is kept.
    """

    def __init__(self) -> None:
        self._last_ns: int | None = None
        self._offset_ns = 0
        self._waiting: deque[tuple[_Item, int, str]] = deque()

    def steady_since(self) -> int | None:
        """Return the time of the last message [ns, UTC] if none waits and no stamp is corrected; else None."""
        return None if self._waiting or self._offset_ns else self._last_ns

    def go_on(self, time_ns: int) -> None:
        """Accept a message that ``steady_since`` shows to be near earlier ones."""
        self._last_ns = time_ns

    def take(self, item: _Item, stamp_ns: int, topic: str) -> Iterator[Settled[_Item]]:
        """Add the next message of the log, and yield those that wait no longer."""
        self._waiting.append((item, stamp_ns, topic))
        return self._checked(LOOK_AHEAD)

    def finish(self) -> Iterator[Settled[_Item]]:
        """Yield the waiting messages at the end of the log."""
        return self._checked(0)

    def _checked(self, following: int) -> Iterator[Settled[_Item]]:
        """Yield the messages that are decided, or that ``following`` others follow."""
        while self._waiting:
            item, stamp_ns, topic = self._waiting[0]
            time_ns, last_ns, jump = stamp_ns + self._offset_ns, self._last_ns, None
            if last_ns is None or abs(time_ns - last_ns) > FAR_NS:
                if is_latched(topic):
                    self._waiting.popleft()
                    yield Settled(item, stamp_ns)
                    continue
                if len(self._waiting) <= following:
                    return
                after = [
                    stamp
                    for _, stamp, name in islice(self._waiting, 1, 1 + LOOK_AHEAD)
                    if not is_latched(name)
                ]
                settled = self._judged(stamp_ns, after)
                if settled is None:
                    self._waiting.popleft()
                    yield Settled(item, None)
                    continue
                if last_ns is not None and settled[1] != self._offset_ns:
                    jump = last_ns, settled[1]
                time_ns, self._offset_ns = settled
            self._waiting.popleft()
            self._last_ns = time_ns
            yield Settled(item, time_ns, jump)

    def _judged(self, stamp_ns: int, following: Sequence[int]) -> tuple[int, int] | None:
        """Return the time of a message far from the last one, and the correction of stamps from it on [ns]; None if it is an outlier.

        A stamp more than a day from the previous one is accepted if most following stamps are nearer to it. One that goes back begins a
        new segment, which continues at the previous time, or at its own if that is within a day.

        Args:
            stamp_ns: Stamp of the message [ns].
            following: Next stamps, at most ``LOOK_AHEAD``, fewer at the end of the log [ns].
        """
        last_ns, offset_ns = self._last_ns, self._offset_ns
        if last_ns is None:
            astray = sum(
                stamp_ns - other > FAR_NS or other - stamp_ns > _ALONE_NS for other in following
            )
            return None if 2 * astray > len(following) else (stamp_ns, 0)
        time_ns = stamp_ns + offset_ns
        step = time_ns - last_ns
        others = [other + offset_ns for other in following]
        agree = sum(abs(other - time_ns) < abs(other - last_ns) for other in others)
        if 2 * agree <= len(others) and (others or not 0 < step <= _ALONE_NS):
            return None
        if abs(stamp_ns - last_ns) <= FAR_NS:
            return stamp_ns, 0
        return max(time_ns, last_ns), offset_ns + max(0, -step)


_T = TypeVar("_T", bound=Message | RawMessage)
_Read = TypeVar("_Read", bound=Message | RawMessage, covariant=True)


class Source(Protocol[_Read]):
    """Log opened for reading."""

    def messages(self) -> Iterator[_Read]:
        """Yield the messages in the file's order."""
        ...


class Merge(Generic[_T]):
    """Stream of several logs, ordered by (time, input, position).

    Each log is sorted on its own: a message waits until one is newer by more than the window. A late message, older than one of the same
    log already yielded, is excluded and counted; so are outlier stamps. After a backward jump of its clock a log's times continue
    (``Settling``). Each iteration reads the logs again and completes the attributes.

    Attributes:
        late: Number of late messages by topic.
        astray: Number of messages with outlier stamps by topic.
        jumps: Jumps of the logs' clocks.
    """

    def __init__(
        self,
        readers: Sequence[Source[_T]],
        reorder_window_s: float,
        start_ns: int | None = None,
        end_ns: int | None = None,
        keep_late: bool = False,
    ) -> None:
        """Create the stream.

        Args:
            readers: Logs with distinct ``input`` numbers.
            reorder_window_s: Reorder window [s, in the logs' time].
            start_ns: First time [ns, UTC], except for latched topics, ``is_latched``; None for no limit.
            end_ns: Last time [ns, UTC]; the logs are still read to their end, for complete reports.
            keep_late: Whether late messages are yielded out of order with their own stamps, for complete copies.
        """
        self._readers, self._window_ns = readers, round(reorder_window_s * 1e9)
        self._start_ns, self._end_ns, self._keep_late = start_ns, end_ns, keep_late
        self._begin()

    def _begin(self) -> None:
        self.late: Counter[str] = Counter()
        self.astray: Counter[str] = Counter()
        self.jumps: tuple[ClockJump, ...] = ()
        self._late_by_ns = 0
        self._firsts: list[_T] = []

    @property
    def late_by_s(self) -> float:
        """Largest delay of a late message behind the newest before it [s]: a window as long keeps all."""
        return 1e-9 * self._late_by_ns

    @property
    def doubtful_times(self) -> str:
        """Anomaly of the times of the logs' first messages as text; empty without one."""
        known = [(one.time_ns, one.payload) for one in self._firsts if isinstance(one, Message)]
        return next(
            (said for one in known if (said := doubtful_times((one[0], one[0]), [one], None))), ""
        )

    def __iter__(self) -> Iterator[_T]:
        """Yield the messages from the first to the last time inclusive; each iteration reads the logs again."""
        self._begin()
        ordered = [self._ordered(reader) for reader in self._readers]
        merged = ordered[0] if len(ordered) == 1 else heapq.merge(*ordered, key=_order)
        limited = (self._start_ns, self._end_ns) != (None, None)
        yield from filter(self._wanted, merged) if limited else merged

    def _wanted(self, message: _T) -> bool:
        if self._end_ns is not None and message.time_ns > self._end_ns:
            return False
        return (
            self._start_ns is None or message.time_ns >= self._start_ns or is_latched(message.topic)
        )

    def _ordered(self, reader: Source[_T]) -> Iterator[_T]:
        """Yield one log's messages in order; late ones in the wanted period are counted."""
        held: list[tuple[int, int, _T]] = []
        newest = yielded = -(2**63)
        for message in reader.messages() if self._keep_late else self._steady(reader.messages()):
            time_ns = message.time_ns
            if newest == -(2**63):
                self._firsts.append(message)
            if time_ns < yielded:
                if self._keep_late:
                    yield message
                elif self._wanted(message):
                    self.late[message.topic] += 1
                    self._late_by_ns = max(self._late_by_ns, newest - time_ns)
                continue
            heapq.heappush(held, (time_ns, message.position, message))
            newest = max(newest, time_ns)
            while newest - held[0][0] > self._window_ns:
                yielded, _, oldest = heapq.heappop(held)
                yield oldest
        while held:
            yield heapq.heappop(held)[2]

    def _steady(self, messages: Iterator[_T]) -> Iterator[_T]:
        """Yield one log's messages with corrected times; outliers are counted."""
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
                self.astray[message.topic] += 1
                continue
            if jump is not None:
                self.jumps += (ClockJump(message.input, jump[0], message.time_ns, jump[1]),)
            # both are tuples, whose copy is of their own kind
            yield (
                message
                if time_ns == message.time_ns
                else cast(_T, message._replace(time_ns=time_ns))
            )


#: Merges logs as one ordered stream.
merge = Merge


def _order(message: _T) -> tuple[int, int, int]:
    return message.time_ns, message.input, message.position
