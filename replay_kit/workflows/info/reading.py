"""Topics of a log: their times, those that are decoded for its contents, and messages that are all alike."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.message import LogReport
from replay_kit.logs.blocks import Block
from replay_kit.logs.merge import FAR_NS, Settled, Settling
from replay_kit.logs.tables.schemas import may_state


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """Topic of a log.

    Attributes:
        schema: Schema or message name.
        messages: Messages in the log, decoded or not.
        first_ns: Earliest time of a message [ns, UTC]; None if unknown. If all were read, messages with distant stamps are excluded and
            clock jumps corrected, as in a replay.
        last_ns: Latest time of a message [ns, UTC].
    """

    schema: str = ""
    messages: int = 0
    first_ns: int | None = None
    last_ns: int | None = None


class Spans:
    """Topics of a log with their first and last times, accumulated block by block.

    Attributes:
        topics: Topics by name, without the number of messages, as some cannot be decoded.
    """

    def __init__(self) -> None:
        """Begin without messages."""
        self.topics: dict[str, TopicInfo] = {}
        self._settling: Settling[tuple[str, str]] = Settling()

    def add(self, block: Block) -> None:
        """Add the next block of the log."""
        if not block.kind.size:
            return
        since, times = self._settling.steady_since(), block.time_ns
        if since is None or np.any(np.abs(np.diff(times, prepend=np.int64(since))) > FAR_NS):
            for kind, time_ns in zip(block.kind.tolist(), times.tolist(), strict=True):
                topic, schema = block.kinds[kind]
                self._add_settled(self._settling.take((topic, schema), time_ns, topic))
            return
        self._settling.go_on(int(times[-1]))
        by_kind = np.argsort(block.kind, kind="stable")
        begins = np.searchsorted(block.kind[by_kind], found := np.unique(block.kind))
        ends = (end.reduceat(times[by_kind], begins).tolist() for end in (np.minimum, np.maximum))
        for kind, *times_ns in zip(found.tolist(), *ends, strict=True):
            self._extend(block.kinds[kind], *times_ns)

    def finish(self) -> None:
        """Add the messages still held back at the end of the log."""
        self._add_settled(self._settling.finish())

    def _add_settled(self, judged: Iterable[Settled[tuple[str, str]]]) -> None:
        for kind, time_ns, _ in judged:
            if time_ns is not None:
                self._extend(kind, time_ns, time_ns)

    def _extend(self, kind: tuple[str, str], *times_ns: int) -> None:
        """Extend a topic by messages of a kind, topic and schema, at some times."""
        topic, schema = kind
        known = self.topics.get(topic, TopicInfo())
        every = [*times_ns, *(at for at in (known.first_ns, known.last_ns) if at is not None)]
        self.topics[topic] = TopicInfo(schema, 0, min(every), max(every))


def may_be_used(config: MeasurementConfig, topic: str, schema: str) -> bool:
    """Return whether messages of a topic and schema can hold usable content."""
    mapped = any(entry.topic == topic for entry in config.map)
    return mapped or may_state(schema, topic)


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
