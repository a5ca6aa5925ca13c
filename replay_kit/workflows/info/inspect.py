"""What is in a log, and what it can be used for."""

import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from replay_kit.config.run import RunConfig
from replay_kit.core.geodesy import unwrap_longitude
from replay_kit.core.message import LogReport, Message
from replay_kit.core.observation import Observation, PathMean, VehicleState
from replay_kit.core.progress import Progress, silent
from replay_kit.estimator.update.screening import usable
from replay_kit.logs import open_log, open_logs
from replay_kit.logs.reader import LogFile
from replay_kit.measurements import NOT_A_KIND, Skipped, finish, initial_state, interpret
from replay_kit.measurements.mapping.suggest import NAMED, sample_key, suggestion
from replay_kit.results.losses import loss_json, loss_words, unchecked_lines, undecodable_json, undecodable_lines
from replay_kit.results.text import coded, folded, iso, not_used_lines, print_lines, print_table, short_times


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
    """

    report: LogReport
    topics: Mapping[str, TopicInfo]
    content: LogContent
    dives: int
    not_used: Mapping[str, Mapping[str, int]]
    unknown: Mapping[str, tuple[str, Mapping[str, Any]]]

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
        for key, (schema, payload) in sorted(self.unknown.items()):
            topic = key.partition("\n")[0]
            if (entry := suggestion(topic, schema, payload)) is not None:
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
    found, logs = [], open_logs(paths, config.logs)
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
    return LogInfo(report, dict(sorted(topics.items())), content, state.dive, by_topic(not_used), unknown)


def by_topic(counts: Mapping[tuple[str, str], int]) -> dict[str, dict[str, int]]:
    """Return counts by (topic, reason) as topic to reason to count."""
    found: dict[str, dict[str, int]] = {}
    for (topic, reason), count in counts.items():
        found.setdefault(topic, {})[reason] = count
    return found


def info_json(info: LogInfo) -> dict[str, Any]:
    """Return a log's description for JSON."""
    content = info.content
    return {
        "file": info.report.path,
        "format": info.report.format,
        "use": info.use,
        "missing": info.missing,
        "mappable": dict(info.mappable),
        "profiles": content.profiles,
        "bins": content.bins,
        "mean_currents": content.mean_currents,
        "positions": content.positions,
        "dives": info.dives,
        "box": content.box,
        "depths": content.depths,
        "topics": [
            {"topic": name, "schema": topic.schema, "messages": topic.messages, "first": iso(topic.first_ns), "last": iso(topic.last_ns)}
            for name, topic in info.topics.items()
        ],
        "not_used": {topic: coded(reasons) for topic, reasons in info.not_used.items()},
        "undecodable": undecodable_json(info.report.undecodable),
        "notes": info.report.notes,
        "losses": [loss_json(loss) for loss in info.report.losses],
        "unchecked": dict(info.report.unchecked),
    }


def _span(topics: Mapping[str, TopicInfo]) -> str:
    """Return the time span of a log's topics in words; empty when no message has a time."""
    spans = [(topic.first_ns, topic.last_ns) for topic in topics.values() if topic.first_ns is not None and topic.last_ns is not None]
    return f", {iso(min(first for first, _ in spans))} to {iso(max(last for _, last in spans))}" if spans else ""


def print_info(log: LogInfo, console: Console, verbose: bool = False) -> None:
    """Print what a log holds; topics that differ in a number alone share a row unless whole tables are asked for."""
    report, content, topics = log.report, log.content, log.topics
    times = short_times([topic.first_ns for topic in topics.values()] + [topic.last_ns for topic in topics.values()])
    cells = zip(topics.items(), times[: len(topics)], times[len(topics) :], strict=True)
    rows = ((name, topic.schema, str(topic.messages), first, last) for (name, topic), first, last in cells)
    columns = ("topic", "schema", "messages", "first", "last")
    print_table(console, f"{report.path} ({report.format}){_span(topics)}", columns, folded(rows, verbose))
    console.print(
        f"Use: {log.use}. {content.profiles} profiles with {content.bins} usable bins, {content.positions} positions, {log.dives} dives"
    )
    if content.box is not None:
        console.print(f"Positions: {content.box[0]:.4f}..{content.box[2]:.4f} E, {content.box[1]:.4f}..{content.box[3]:.4f} N")
    if content.mean_currents:
        console.print(f"Mean currents between fixes: {content.mean_currents}")
    if content.depths is not None:
        console.print(f"Bins: {content.depths[0]:.0f}..{content.depths[1]:.0f} m")
    known = {topic: {why: count for why, count in reasons.items() if why != NOT_A_KIND} for topic, reasons in log.not_used.items()}
    print_lines(console, not_used_lines(known, verbose))
    print_lines(console, undecodable_lines(report.undecodable))
    print_lines(console, unchecked_lines(report))
    print_lines(console, (f"Note: {note}" for note in report.notes))
    print_lines(console, (f"LOST: {loss_words(loss)}" for loss in report.losses))
    if log.missing:
        print_lines(console, [f"Missing for a replay: {log.missing}"])
    mappable = log.mappable
    print_lines(console, (f"Unknown type: {topic} looks like a {kind}" for topic, kind in mappable.items()))
    others = len(log.unknown) - len(mappable)
    if others:
        print_lines(console, [f"Unknown type: {others} more topics, in which nothing looks like a position, a depth or a velocity"])


def next_command(logs: Sequence[LogInfo], paths: Sequence[Path], ensemble: Sequence[Path] = ()) -> str:
    """Return what to type next, in words.

    Args:
        logs: The logs of a mission.
        paths: As they were given.
        ensemble: The files of its forecast; empty without.
    """
    given, forecast = (" ".join(shlex.quote(str(path)) for path in files) for files in (paths, ensemble or [Path("FORECAST.nc")]))
    contents = [log.content for log in logs]
    if any(content.bins or content.mean_currents for content in contents):
        return f"Next: replay-kit replay {given} --ensemble {forecast} -o RESULT.mcap"
    if any(log.mappable for log in logs):
        return f"Next: replay-kit info {given} --suggest map.toml, correct map.toml, then replay-kit info {given} --config map.toml"
    return f"Next: replay-kit info {given} ANOTHER_LOG, with the log of this mission that has what is missing"
