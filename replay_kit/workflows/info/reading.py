"""How much of a log is read to say what is in it, its index and first messages or all; and the order of its messages in time."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.message import LogReport
from replay_kit.logs.merge import FAR_NS, Settled, Settling
from replay_kit.logs.reader import LogFile
from replay_kit.logs.shared.blocks import Block, Overview, block_of
from replay_kit.logs.tables.schemas import may_state
from replay_kit.logs.tables.suggest import NAMED

# of a topic's mean time between messages, and at least so long [ns], is a gap that is reported
_TIMES_MEAN, _LEAST_GAP_NS = 10, 60_000_000_000
# before every time
_NEVER = -(2**63)


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """One topic of a log.

    Attributes:
        schema: Schema or message name.
        messages: Number of messages in the log, decoded or not.
        first_ns: Earliest time of a message [ns, UTC]; None when it is not known. Where all were read, messages that a replay sets aside
            for stamps far from their neighbours' do not count, and after a jump of the clock times are corrected as there.
        last_ns: Latest time of one.
        late: Messages that a replay leaves out because they come later than the reorder window allows; None when not all were read.
        late_by_ns: By how much the latest of these is older than the newest before it [ns].
        gap_ns: Longest time from one message to the next that is newer than all before it [ns]; None when not all were read.
        gap_from_ns: When that begins [ns, UTC].
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
        """Whether the longest gap stands out."""
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
        """Return the topic with further messages, in the order of the log.

        Args:
            schema: Name of their schema.
            time_ns: Their times, shape (n,), n at least 1 [ns, UTC].
            late_ns: Of late ones, by how much each is older than the newest before it; else 0, shape (n,) [ns].
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
    """The topics of a log, block by block."""

    def __init__(self, window_s: float) -> None:
        """Begin without a message.

        Args:
            window_s: How long a replay holds a message back to let older ones pass [s].
        """
        self._window_ns = round(window_s * 1e9)
        self._topics: dict[str, TopicInfo] = {}
        self._held = np.empty(0, np.int64)
        self._yielded = _NEVER
        self._settling: Settling[tuple[str, str]] = Settling()

    @property
    def topics(self) -> Mapping[str, TopicInfo]:
        """By name, without the number of messages, some of which cannot be decoded."""
        return dict(self._topics)

    def add(self, block: Block) -> None:
        """Take the next messages of the log."""
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
        """Take what still waited for its neighbours when the log ended."""
        self._add_settled(self._settling.finish())

    def _add_settled(self, judged: Iterable[Settled[tuple[str, str]]]) -> None:
        for kind, time_ns, _ in judged:
            if time_ns is not None:
                self._add((kind,), np.zeros(1, np.intp), np.array([time_ns], np.int64))

    def _add(
        self, kinds: tuple[tuple[str, str], ...], kind: NDArray[np.intp], time_ns: NDArray[np.int64]
    ) -> None:
        """Take messages by their kinds and times."""
        late = self._late(time_ns)
        by_kind = np.argsort(kind, kind="stable")
        ends = np.cumsum(np.bincount(kind, minlength=len(kinds)))
        for (topic, schema), rows in zip(kinds, np.split(by_kind, ends[:-1]), strict=True):
            if rows.size:
                known = self._topics.get(topic, TopicInfo())
                self._topics[topic] = known.extended(schema, time_ns[rows], late[rows])

    def _late(self, time_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return by how much messages are late that ``merge`` would leave out [ns], 0 for others.

        These are older than one that it has let go, as all have that are a window old.
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
    """A log as it is read.

    Attributes:
        blocks: Its messages; of topics that cannot state anything one is decoded.
        overview: What its index says; None when all is read.
        note: Why all is read although it takes long; empty otherwise.
    """

    blocks: Iterable[Block]
    overview: Overview | None = None
    note: str = ""

    @property
    def sampled(self) -> int | None:
        """Number of messages read; None when all are."""
        return None if self.overview is None else len(self.overview.first)

    def completed(
        self, report: LogReport, topics: Mapping[str, TopicInfo]
    ) -> tuple[LogReport, dict[str, TopicInfo]]:
        """Return the reader's report, and the topics with their number of messages, all by the index where that was read.

        Args:
            report: Of the messages read.
            topics: Of the messages read.
        """
        if self.overview is None:
            counted = {
                name: replace(topics.get(name, TopicInfo()), messages=number)
                for name, number in report.read.items()
            }
            return (replace(report, notes=(*report.notes, self.note)) if self.note else report), {
                **topics,
                **counted,
            }
        known = self.overview.topics
        undecodable = {
            topic: (known[topic].messages, why) for topic, why in self.overview.undecodable.items()
        }
        report = replace(
            report,
            read={name: topic.messages for name, topic in known.items()},
            undecodable={**report.undecodable, **undecodable},
        )
        return report, {
            name: TopicInfo(topic.schema, topic.messages, topic.first_ns, topic.last_ns, None, None)
            for name, topic in known.items()
        }


def read_log(log: LogFile, full: bool, config: MeasurementConfig) -> Reading:
    """Return how a log is read.

    Args:
        log: The log.
        full: Whether all of it is read, also where its index says much.
        config: How messages become observations.

    Raises:
        LogError: It cannot be read.
    """
    overview = "" if full else log.overview()
    if isinstance(overview, Overview):
        return Reading([block_of(list(overview.first))], overview)
    return Reading(
        log.blocks(partial(_may_state, config)),
        note=f"all of it was read: {overview}" if overview else "",
    )


def _may_state(config: MeasurementConfig, topic: str, schema: str) -> bool:
    """Return whether messages of a topic and schema can state something, or differ in what they are of."""
    mapped = any(entry.topic == topic for entry in config.map)
    return mapped or topic.rpartition("/")[2] in NAMED or may_state(schema, topic)


def count_alike(
    not_used: Counter[tuple[str, str]], report: LogReport, decoded: Mapping[str, int]
) -> None:
    """Add to each reason the messages that were not decoded because those of their topic and schema are all alike.

    Args:
        not_used: Number of messages by (topic, reason).
        report: Of the whole log.
        decoded: Number of messages decoded, by topic.
    """
    reasons: dict[str, str] = {}
    for topic, reason in not_used:
        reasons.setdefault(topic, reason)
    for topic, reason in reasons.items():
        undecodable, _ = report.undecodable.get(topic, (0, ""))
        not_used[topic, reason] += max(0, report.read[topic] - undecodable - decoded[topic])
