"""What is in a log, and what it can be used for."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from replay_kit.config.run import RunConfig
from replay_kit.core.geodesy import unwrap_longitude
from replay_kit.core.message import LogReport, Message
from replay_kit.core.observation import Observation, PathMean, VehicleState
from replay_kit.core.progress import Progress, silent
from replay_kit.estimator.update.screening import usable
from replay_kit.logs import open_log, open_logs
from replay_kit.logs.reader import LogFile
from replay_kit.measurements import NOT_A_KIND, Skipped, finish, initial_state, interpret
from replay_kit.measurements.mapping.suggest import NAMED, sample_key, suggested_entries


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """One topic of a log.

    Attributes:
        schema: Schema or message name.
        messages: Number of messages in the log, decoded or not.
        first_ns: Earliest time of a decoded message [ns, UTC]; None when none was.
        last_ns: Latest time of one.
    """

    schema: str = ""
    messages: int = 0
    first_ns: int | None = None
    last_ns: int | None = None

    def extended(self, message: Message) -> "TopicInfo":
        """Return the topic with the time of one more decoded message."""
        first_ns, last_ns = (message.time_ns if time_ns is None else time_ns for time_ns in (self.first_ns, self.last_ns))
        return TopicInfo(message.schema, self.messages, min(first_ns, message.time_ns), max(last_ns, message.time_ns))


@dataclass(frozen=True, slots=True)
class LogContent:
    """What the messages of a log measure, reduced as they come: a log may hold more positions than fit in memory.

    Attributes:
        profiles: Number of profiles of the current.
        bins: Number of usable bins in them.
        mean_currents: Number of mean currents between fixes.
        positions: Number of positions.
        box: West, south, east, north [degrees] of the positions, east above 180 when they cross the antimeridian; None without positions.
        depths: Shallowest and deepest usable bin [m]; None without bins.
        first_longitude: Of the first position [degrees]; the others are counted from it, so that a track across the antimeridian has a
            narrow box.
    """

    profiles: int = 0
    bins: int = 0
    mean_currents: int = 0
    positions: int = 0
    box: tuple[float, float, float, float] | None = None
    depths: tuple[float, float] | None = None
    first_longitude: float | None = None

    def extended(self, event: object) -> "LogContent":
        """Return the content with one more measurement; other events change nothing."""
        match event:
            case Observation():
                good = event.depth[usable(event.flags)]
                shallowest, deepest = self.depths or (np.inf, -np.inf)
                depths = (min(shallowest, float(good.min())), max(deepest, float(good.max()))) if good.size else self.depths
                return replace(self, profiles=self.profiles + 1, bins=self.bins + good.size, depths=depths)
            case PathMean():
                return replace(self, mean_currents=self.mean_currents + 1)
            case VehicleState():
                return self._with_position(event.longitude, event.latitude)
        return self

    def _with_position(self, longitude: float, latitude: float) -> "LogContent":
        first = longitude if self.first_longitude is None else self.first_longitude
        if abs(longitude - first) > 180.0:
            longitude = float(unwrap_longitude(longitude, first))
        west, south, east, north = self.box or (longitude, latitude, longitude, latitude)
        box = min(west, longitude), min(south, latitude), max(east, longitude), max(north, latitude)
        return replace(self, positions=self.positions + 1, box=box, first_longitude=first)


@dataclass(frozen=True, slots=True)
class LogInfo:
    """One log.

    Attributes:
        report: What the reader found.
        topics: By name.
        content: What the messages measure.
        dives: Number of dives begun.
        not_used: Topic to reason to count.
        unknown: Topic to the schema's name and the last payload, for topics that no known kind and no mapping covers.
        files: The files of the log.
    """

    report: LogReport
    topics: Mapping[str, TopicInfo]
    content: LogContent
    dives: int
    not_used: Mapping[str, Mapping[str, int]]
    unknown: Mapping[str, tuple[str, Mapping[str, Any]]]
    files: tuple[Path, ...] = ()

    @property
    def missing(self) -> str:
        """What a replay still needs; empty for a log that has it all."""
        content, lacks = self.content, []
        if not content.positions and not content.bins:
            lacks.append("positions")
        if not content.bins and not content.mean_currents:
            lacks.append("profiles of the current, or mean currents of dives with their fixes")
        return ", and ".join(lacks)

    @property
    def mappable(self) -> Mapping[str, str]:
        """Topics of unknown types in which something looks usable, and as what."""
        found = {}
        for key, entry in suggested_entries(self.unknown).items():
            kinds = [line.rpartition("= ")[2].strip('"') for line in entry.splitlines() if line.lstrip("# ").startswith("kind = ")]
            found[key.replace("\n", ", name ")] = kinds[0]
        return found

    @property
    def use(self) -> str:
        """What the log can be used for, in words."""
        if self.content.bins:
            return "replay: it has positions and profiles of the current"
        if self.content.mean_currents:
            return "replay: it has mean currents between fixes, which alone estimate a field; no usable profile of the current"
        if self.content.positions:
            return "positions only: no usable profile of the current"
        return "nothing yet: neither positions nor profiles of the current"


def inspect_logs(paths: Sequence[Path], config: RunConfig, progress: Progress = silent) -> list[LogInfo]:
    """Return what each log holds; every message is read.

    Args:
        paths: Files, and folders that stand for the logs in them.
        config: How logs are read and interpreted.
        progress: Is called with the number of logs read, their number, and the log that is next.

    Raises:
        LogError: A log cannot be opened.
    """
    found, logs = [], open_logs(paths, config.logs, several_missions=True)
    for k, log in enumerate(logs):
        # one log is no share of the work
        progress(k, len(logs) if len(logs) > 1 else 0, f"reading: {log.path}")
        found.append(_inspect(log, config))
    return found


def inspect_log(path: Path, config: RunConfig) -> LogInfo:
    """Return what one log holds; every message is read.

    Raises:
        LogError: The log cannot be opened.
    """
    return _inspect(open_log(path, 0, config.logs), config)


def _inspect(log: LogFile, config: RunConfig) -> LogInfo:
    state, content = initial_state(config.logs.system), LogContent()
    topics: dict[str, TopicInfo] = {}
    not_used: Counter[tuple[str, str]] = Counter()
    unknown: dict[str, tuple[str, Mapping[str, Any]]] = {}

    def count(events: Sequence[object]) -> bool:
        """Add events to the content; return whether the message they are of is of no known kind."""
        nonlocal content
        for event in events:
            content = content.extended(event)
        skipped = [event for event in events if isinstance(event, Skipped)]
        not_used.update((event.topic, event.reason) for event in skipped)
        return any(event.reason == NOT_A_KIND for event in skipped)

    with log:
        for message in log.messages():
            topics[message.topic] = topics.get(message.topic, TopicInfo()).extended(message)
            state, events = interpret(state, message, config.measurements)
            if count(events) and (not message.topic.startswith("mavlink/") or message.topic.endswith(NAMED)):
                unknown[sample_key(message.topic, message.payload)] = (message.schema, message.payload)
        count(finish(state, config.measurements))
        report = log.report()
    topics |= {name: replace(topics.get(name, TopicInfo()), messages=number) for name, number in report.read.items()}
    return LogInfo(report, dict(sorted(topics.items())), content, state.dive, by_topic(not_used), unknown, log.files)


def by_topic(counts: Mapping[tuple[str, str], int]) -> dict[str, dict[str, int]]:
    """Return counts by (topic, reason) as topic to reason to count."""
    found: dict[str, dict[str, int]] = {}
    for (topic, reason), count in counts.items():
        found.setdefault(topic, {})[reason] = count
    return found
