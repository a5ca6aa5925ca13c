"""Contents of a log and its possible uses: its topics and their times, and what its messages hold."""

import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from replay_kit.config.run import MeasurementConfig, RunConfig
from replay_kit.core.files.inputs import check_unchanged, stamps_of
from replay_kit.core.geodesy import unwrap_longitude
from replay_kit.core.message import LogReport, Message
from replay_kit.core.observation import usable
from replay_kit.core.observation.table import Block, Columns
from replay_kit.core.words.progress import Progress, silent
from replay_kit.logs import merge, open_logs
from replay_kit.logs.blocks import Block as RawBlock
from replay_kit.logs.merge import FAR_NS, Settled, Settling, doubtful_times
from replay_kit.logs.reader import LogFile
from replay_kit.logs.tables.mapped import suggested_entries
from replay_kit.logs.tables.schemas import NOT_A_KIND, may_state
from replay_kit.measurements.observed import blocks, measure_messages, new_stream
from replay_kit.measurements.profiles.pings import NO_POSITION
from replay_kit.workflows.replay.inputs.scan import next_block


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

    def add(self, block: RawBlock) -> None:
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


def span_of(topics: Mapping[str, TopicInfo]) -> tuple[int, int] | None:
    """Return the first and last time of topics [ns, UTC]; None without times."""
    known = [at for one in topics.values() for at in (one.first_ns, one.last_ns) if at is not None]
    return (min(known), max(known)) if known else None


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
        not_used[topic, reason] += max(0, report.read.get(topic, 0) - undecodable - decoded[topic])


@dataclass(frozen=True, slots=True)
class LogContent:
    """Measured content of a log, reduced block by block: a log may hold more positions than fit in memory.

    Attributes:
        profiles: Profiles of the current.
        bins: Usable bins in them.
        mean_currents: DACs between fixes.
        surface: Currents measured by radar, drifters and other sensors.
        positions: How many there are.
        box: West, south, east, north [degrees] of the fixes, or of dead-reckoned positions without fixes; east above 180 across the
            antimeridian; None without positions.
        depths: Shallowest and deepest usable bin [m]; None without bins.
        first_longitude: Longitude of the first position [degrees], the origin of the others, so that the box stays narrow across the
            antimeridian.
        has_fix: Whether any position is a fix.
    """

    profiles: int = 0
    bins: int = 0
    mean_currents: int = 0
    surface: int = 0
    positions: int = 0
    box: tuple[float, float, float, float] | None = None
    depths: tuple[float, float] | None = None
    first_longitude: float | None = None
    has_fix: bool = False

    def extended(self, block: Block) -> "LogContent":
        """Return the content extended by another block."""
        position, ping, mean, linear = (
            block.events[block.events[:, 1] == kind, 2] for kind in range(4)
        )
        good = np.empty(0)
        if ping.size:
            good = block.ping["depth"][ping][usable(block.ping["flags"][ping])]
        depths = [*(self.depths or ()), *good.tolist()]
        found = replace(
            self,
            profiles=self.profiles + ping.size,
            bins=self.bins + good.size,
            mean_currents=self.mean_currents + mean.size,
            surface=self.surface + sum(block.linear[row].label.kind != "shear" for row in linear),
            positions=self.positions + position.size,
            depths=(min(depths), max(depths)) if depths else None,
        )
        return found._with_positions(block.position) if position.size else found

    def _with_positions(self, rows: Columns) -> "LogContent":
        longitude, fixes, box = rows["longitude"], ~rows["dead_reckoned"], self.box
        first = float(longitude[0]) if self.first_longitude is None else self.first_longitude
        far = np.abs(longitude - first) > 180.0
        longitude = np.where(far, unwrap_longitude(longitude, first), longitude)
        places = np.column_stack([longitude, rows["latitude"]])
        if has_fix := self.has_fix or bool(fixes.any()):
            places, box = places[fixes], box if self.has_fix else None
        if box is not None:
            places = np.vstack([places, box[:2], box[2:]])
        if places.size:
            box = (*places.min(axis=0).tolist(), *places.max(axis=0).tolist())
        return replace(self, box=box, first_longitude=first, has_fix=has_fix)


@dataclass(frozen=True, slots=True)
class LogInfo:
    """Description of one log.

    Attributes:
        report: Report of the reader.
        topics: Topics by name.
        content: Measured content.
        dives: Number of dives begun.
        not_used: Number of messages by topic and reason.
        unknown: Schema name and one payload by topic, for topics of unknown type without a mapping.
        sampled: Number of messages read, the first of each topic, when the index gives the rest; None if all were read.
        files: Its files.
        together: Content of all logs of the command, merged as in a replay; None for a separate log.
    """

    report: LogReport
    topics: Mapping[str, TopicInfo]
    content: LogContent
    dives: int
    not_used: Mapping[str, Mapping[str, int]]
    unknown: Mapping[str, tuple[str, Mapping[str, Any]]]
    sampled: int | None = None
    files: tuple[Path, ...] = ()
    together: LogContent | None = None

    @property
    def judged(self) -> LogContent:
        """Content of a replay of this log and those given with it."""
        return self.together or self.content

    @property
    def is_result(self) -> bool:
        """Whether the log is a result of ``replay`` or ``plan``."""
        return any(
            topic.schema in ("replay_kit.Innovations", "replay_kit.Estimate", "replay_kit.Plan")
            for topic in self.topics.values()
        )

    @property
    def missing(self) -> str:
        """Data missing for a replay; empty if complete, and for a result."""
        content, lacks = self.judged, []
        if self.is_result or content.surface:
            return ""
        if not content.positions and not content.bins:
            lacks.append("positions")
        unplaced = any(
            reason.startswith(NO_POSITION)
            for reasons in self.not_used.values()
            for reason in reasons
        )
        if not content.bins and not content.mean_currents and not unplaced:
            lacks.append("profiles of the current, or mean currents of dives with their fixes")
        return ", and ".join(lacks)

    @property
    def mappable(self) -> Mapping[str, str]:
        """Type of usable content by topic of unknown type."""
        entries = suggested_entries({} if self.is_result else self.unknown)
        return {topic: kind for topic, (kind, _) in entries.items()}

    @property
    def use(self) -> str:
        """Possible use of the log, as text."""
        if self.is_result and not (self.content.bins or self.content.mean_currents):
            return "a result of replay or plan, to be opened with status, report, plot or export"
        return use_of(self.content)


def use_of(content: LogContent) -> str:
    """Return the possible use of a log's content, as text."""
    if content.bins:
        found = "positions and current profiles" if content.positions else "placed current profiles"
        return f"ready for replay: {found} found"
    if content.mean_currents:
        return "ready for replay: mean currents between fixes found, no usable current profile"
    if content.surface:
        return "ready for replay: currents at the surface found"
    if content.positions:
        return "positions only: no usable profile of the current"
    return "nothing yet: neither positions nor profiles of the current"


def inspect_logs(
    paths: Sequence[Path], config: RunConfig, progress: Progress = silent, full: bool = False
) -> list[LogInfo]:
    """Return the contents of each log; large logs with an index are sampled.

    Args:
        paths: Log files and folders of logs.
        config: Settings of reading and interpretation.
        progress: Called with the amount read, the number of logs, and the current log.
        full: Whether every log is read completely.

    Raises:
        LogError: A log cannot be opened.
    """
    found, logs = [], open_logs(paths, config.logs, several_missions=True)
    for k, log in enumerate(logs):
        found.append(_inspect(log, config, full, partial(_advance, progress, k, len(logs), log)))
    alone = len({log.report.mission for log in found if log.report.mission}) > 1 or any(
        log.is_result or log.sampled is not None for log in found
    )
    if len(found) < 2 or alone or not any(log.missing for log in found):
        return found
    together = _together(logs, config)
    return [replace(log, together=together) for log in found]


def _together(logs: Sequence[LogFile], config: RunConfig) -> LogContent:
    """Return the content of logs that supply each other's positions, merged as in a replay."""
    content, settings = LogContent(), config.logs
    merged = merge(logs, settings.reorder_window, settings.start_ns, settings.end_ns)
    stream = new_stream(settings.system, settings.component)
    for block in blocks(merged, config.measurements, stream=stream):
        content = content.extended(block)
    return content


def _advance(progress: Progress, before: int, logs: int, log: LogFile) -> None:
    progress(before + log.share_read(), logs, f"reading: {log.path}")


def _inspect(
    log: LogFile, config: RunConfig, full: bool, advance: Callable[[], None] = lambda: None
) -> LogInfo:
    stream, content = new_stream(config.logs.system, config.logs.component), LogContent()
    spans = Spans()
    not_used: Counter[tuple[str, str]] = Counter()
    decoded: Counter[str] = Counter()
    unknown: dict[str, tuple[str, Mapping[str, Any]]] = {}
    samples: dict[str, Message] = {}

    def take(messages: Sequence[Message], last: bool = False) -> None:
        nonlocal stream, content
        since = stream.order
        stream, found = measure_messages(stream, messages, config.measurements, last)
        content = content.extended(found)
        for due, topic, reason in found.outcomes[found.outcomes[:, 2] >= 0].tolist():
            name, why = found.topics[topic], found.reasons[reason]
            not_used[name, why] += 1
            if why == NOT_A_KIND and not name.startswith("mavlink/"):
                message = messages[due - since]
                unknown[name] = message.schema, message.payload

    overview = "" if full else log.overview()
    # one block, and what the index does not tell is unknown; or why all of it is read
    sampled = len(overview.messages) if isinstance(overview, RawBlock) else None

    def messages() -> Iterator[Message]:
        """Yield the decoded messages of all blocks, and note what blocks hold."""
        wanted = partial(may_be_used, config.measurements)
        for block in [overview] if isinstance(overview, RawBlock) else log.blocks(wanted):
            spans.add(block)
            decoded.update(message.topic for message in block.messages)
            advance()
            for message in block.messages:
                samples.setdefault(message.topic, message)
                yield message

    before = stamps_of(log.files)
    with log:
        # blocks of a reader may be small, and each costs as much to measure as many messages
        read = messages()
        while together := next_block(read):
            take(together)
        take((), last=True)
        spans.finish()
        check_unchanged(before)
        report = log.report()
    if overview and sampled is None:
        report = replace(report, notes=(*report.notes, f"all of it was read: {overview}"))
    topics = spans.topics | {
        name: replace(spans.topics.get(name, TopicInfo()), messages=number)
        for name, number in report.read.items()
    }
    if span := span_of(topics):
        stated = [(message.time_ns, message.payload) for message in samples.values()]
        doubt = doubtful_times(span, stated, time.time_ns())
        report = replace(report, notes=(*filter(None, [doubt]), *report.notes))
    if sampled is None:
        count_alike(not_used, report, decoded)
    return LogInfo(
        report,
        dict(sorted(topics.items())),
        content,
        int(stream.memory.depths["dive"][0]),
        by_topic(not_used),
        unknown,
        sampled,
        log.files,
    )


def by_topic(counts: Mapping[tuple[str, str], int]) -> dict[str, dict[str, int]]:
    """Return counts by (topic, reason) as nested counts by topic and reason."""
    found: dict[str, dict[str, int]] = {}
    for (topic, reason), count in counts.items():
        found.setdefault(topic, {})[reason] = count
    return found
