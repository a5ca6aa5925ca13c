"""Extent of reading a log for its contents, index and first messages or all; and the time order of its messages."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.message import LogReport
from replay_kit.logs.blocks import Block
from replay_kit.logs.merge import FAR_NS, Settled, Settling
from replay_kit.logs.reader import LogFile
from replay_kit.logs.tables.schemas import may_state
from replay_kit.logs.tables.suggest import NAMED

# of a topic's mean time between messages, and at least so long [ns], is a gap that is reported
_TIMES_MEAN, _LEAST_GAP_NS = 10, 60_000_000_000
# before every time
_NEVER = -(2**63)


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """Topic of a log.

    Attributes:
        schema: Schema or message name.
        messages: Messages in the log, decoded or not.
        first_ns: Earliest time of a message [ns, UTC]; None if unknown. If all were read, messages with distant stamps are excluded and
            clock jumps corrected, as in a replay.
        last_ns: Latest time of a message [ns, UTC].
        late: Messages later than the reorder window, excluded from a replay; None if not all were read.
        late_by_ns: Largest delay of these behind the newest message before [ns].
        gap_ns: Longest time between a message and the next newer one [ns]; None if not all were read.
        gap_from_ns: Start of this gap [ns, UTC].
    """

    schema: str = ""
    messages: int = 0
    first_ns: int | None = None
    last_ns: int | None = None
    late: int | None = 0
    gap_ns: int | None = 0
    gap_from_ns: int | None = None
    late_by_ns: int = 0

    @property
    def has_gap(self) -> bool:
        """Whether the longest gap is conspicuous."""
        if (
            self.gap_ns is None
            or self.first_ns is None
            or self.last_ns is None
            or self.messages < 2
        ):
            return False
        mean_ns = (self.last_ns - self.first_ns) / (self.messages - 1)
        return self.gap_ns >= max(_TIMES_MEAN * mean_ns, _LEAST_GAP_NS)

    def extended(
        self, schema: str, time_ns: NDArray[np.int64], late_ns: NDArray[np.int64]
    ) -> "TopicInfo":
        """Return the topic extended by messages in log order.

        Args:
            schema: Schema name.
            time_ns: shape (n,), n at least 1 [ns, UTC], times.
            late_ns: shape (n,) [ns], delay of late messages behind the newest before, else 0.
        """
        before = int(time_ns[0]) if self.last_ns is None else self.last_ns
        newest = np.maximum.accumulate(np.append(before, time_ns))
        steps = np.diff(newest)
        longest = int(np.argmax(steps))
        first_ns = (
            int(time_ns.min()) if self.first_ns is None else min(self.first_ns, int(time_ns.min()))
        )
        found = replace(
            self,
            schema=schema,
            first_ns=first_ns,
            last_ns=int(newest[-1]),
            late=(self.late or 0) + int(np.count_nonzero(late_ns)),
            late_by_ns=max(self.late_by_ns, int(late_ns.max())),
        )
        if int(steps[longest]) > (self.gap_ns or 0):
            found = replace(found, gap_ns=int(steps[longest]), gap_from_ns=int(newest[longest]))
        return found


class Order:
    """Topics of a log, accumulated block by block."""

    def __init__(self, window_s: float) -> None:
        """Begin without messages.

        Args:
            window_s: Reorder window of a replay [s].
        """
        self._window_ns = round(window_s * 1e9)
        self._topics: dict[str, TopicInfo] = {}
        self._held = np.empty(0, np.int64)
        self._yielded = _NEVER
        self._settling: Settling[tuple[str, str]] = Settling()

    @property
    def topics(self) -> Mapping[str, TopicInfo]:
        """Topics by name, without the number of messages, as some cannot be decoded."""
        return dict(self._topics)

    def add(self, block: Block) -> None:
        """Add the next block of the log."""
        if not block.kind.size:
            return
        since = self._settling.steady_since()
        if since is not None and np.all(
            np.abs(np.diff(block.time_ns, prepend=np.int64(since))) <= FAR_NS
        ):
            self._settling.go_on(int(block.time_ns[-1]))
            self._add(block.kinds, block.kind, block.time_ns)
            return
        for kind, time_ns in zip(block.kind.tolist(), block.time_ns.tolist(), strict=True):
            topic, schema = block.kinds[kind]
            self._add_settled(self._settling.take((topic, schema), time_ns, topic))

    def finish(self) -> None:
        """Add the messages still held back at the end of the log."""
        self._add_settled(self._settling.finish())

    def _add_settled(self, judged: Iterable[Settled[tuple[str, str]]]) -> None:
        for kind, time_ns, _ in judged:
            if time_ns is not None:
                self._add((kind,), np.zeros(1, np.intp), np.array([time_ns], np.int64))

    def _add(
        self, kinds: tuple[tuple[str, str], ...], kind: NDArray[np.intp], time_ns: NDArray[np.int64]
    ) -> None:
        """Add messages by kind and time."""
        late = self._late(time_ns)
        by_kind = np.argsort(kind, kind="stable")
        ends = np.cumsum(np.bincount(kind, minlength=len(kinds)))
        for (topic, schema), rows in zip(kinds, np.split(by_kind, ends[:-1]), strict=True):
            if rows.size:
                known = self._topics.get(topic, TopicInfo())
                self._topics[topic] = known.extended(schema, time_ns[rows], late[rows])

    def _late(self, time_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the delay of messages that ``merge`` would exclude [ns], 0 for others.

        These are older than a message already released, that is, one at least a window old.
        """
        times, late = np.append(self._held, time_ns), np.zeros(time_ns.size, np.int64)
        newest = np.maximum.accumulate(times)
        held = self._held.size
        for k in np.flatnonzero(times[1:] < newest[:-1] - self._window_ns) + 1:
            gone = times[:k][times[:k] < newest[k - 1] - self._window_ns]
            if k >= held and times[k] < max(self._yielded, int(gone.max(initial=_NEVER))):
                late[k - held] = newest[k - 1] - times[k]
        if times.size:
            let_go = times < newest[-1] - self._window_ns
            self._yielded = max(self._yielded, int(times[let_go].max(initial=_NEVER)))
            self._held = times[~let_go]
        return late


@dataclass(frozen=True, slots=True)
class Reading:
    """Reading of a log.

    Attributes:
        blocks: Blocks of messages; of topics without usable content only one is decoded.
        sampled: Number of messages read, where the times are those of the index; None if all are read.
        note: Reason for a slow complete reading; empty otherwise.
    """

    blocks: Iterable[Block]
    sampled: int | None = None
    note: str = ""

    def completed(
        self, report: LogReport, topics: Mapping[str, TopicInfo]
    ) -> tuple[LogReport, dict[str, TopicInfo]]:
        """Return the report with the note, and the topics with message counts; without what the index does not tell if it was used.

        Args:
            report: Report of the log.
            topics: Topics of the messages read.
        """
        unknown: dict[str, Any] = {}
        if self.sampled is not None:
            unknown = {"late": None, "gap_ns": None, "gap_from_ns": None}
        counted = {
            name: replace(topics.get(name, TopicInfo()), messages=number, **unknown)
            for name, number in report.read.items()
        }
        noted = (*report.notes, self.note) if self.note else report.notes
        return replace(report, notes=noted), {**topics, **counted}


def read_log(log: LogFile, full: bool, config: MeasurementConfig) -> Reading:
    """Return the reading of a log.

    Args:
        log: The log.
        full: Whether all messages are read despite an index.
        config: Settings of observations.

    Raises:
        LogError: It cannot be read.
    """
    overview = "" if full else log.overview()
    if isinstance(overview, Block):
        return Reading([overview], len(overview.messages))
    return Reading(
        log.blocks(partial(_may_state, config)),
        note=f"all of it was read: {overview}" if overview else "",
    )


def _may_state(config: MeasurementConfig, topic: str, schema: str) -> bool:
    """Return whether messages of a topic and schema can hold usable content, or differ from each other in kind."""
    mapped = any(entry.topic == topic for entry in config.map)
    return mapped or topic.rpartition("/")[2] in NAMED or may_state(schema, topic)


def count_alike(
    not_used: Counter[tuple[str, str]], report: LogReport, decoded: Mapping[str, int]
) -> None:
    """Add to the reasons the messages not decoded because those of their topic and schema are all alike.

    Args:
        not_used: Number of messages by (topic, reason).
        report: Report on the whole log.
        decoded: Number of messages decoded, by topic.
    """
    reasons: dict[str, str] = {}
    for topic, reason in not_used:
        reasons.setdefault(topic, reason)
    for topic, reason in reasons.items():
        undecodable, _ = report.undecodable.get(topic, (0, ""))
        not_used[topic, reason] += max(0, report.read[topic] - undecodable - decoded[topic])
