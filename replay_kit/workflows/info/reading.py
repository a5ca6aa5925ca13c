"""How much of a log is read to say what is in it: its index and first messages, or all, decoding what can be used."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.message import LogReport
from replay_kit.logs.reader import LogFile
from replay_kit.logs.shared.blocks import Block, Overview, block_of
from replay_kit.measurements.messages.kinds import may_state
from replay_kit.measurements.messages.suggest import NAMED
from replay_kit.results.losses import iso_time
from replay_kit.show.text import iso
from replay_kit.workflows.info.order import TopicInfo

# printed; all are in the JSON
_MOST_GAPS = 5


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


def topic_json(name: str, topic: TopicInfo) -> dict[str, Any]:
    """Return a topic for JSON; what is not known is null."""
    return {
        "topic": name,
        "schema": topic.schema,
        "messages": topic.messages,
        "first": iso(topic.first_ns),
        "last": iso(topic.last_ns),
        "late": topic.late,
        "longest_gap_s": None if topic.gap_ns is None else topic.gap_ns / 1e9,
    }


def late_and_gaps(topics: Mapping[str, TopicInfo]) -> Iterator[str]:
    """Yield what is late, and the longest of the gaps that stand out."""
    late = {name: topic.late for name, topic in topics.items() if topic.late}
    if late:
        which = ", ".join(f"{count} x {name}" for name, count in late.items())
        yield f"Late, by more than the reorder window, so that a replay leaves them out: {which}"
    gaps = sorted(
        (
            (topic.gap_ns or 0, name, topic.gap_from_ns or 0)
            for name, topic in topics.items()
            if topic.has_gap
        ),
        reverse=True,
    )
    for gap_ns, name, since_ns in gaps[:_MOST_GAPS]:
        yield f"Gap: {name} has no message for {gap_ns * 1e-9:.0f} s from {iso_time(since_ns, 's')}"
    if len(gaps) > _MOST_GAPS:
        yield f"Gaps on {len(gaps) - _MOST_GAPS} more topics; --json has them"
