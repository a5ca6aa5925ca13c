"""What is in a log, and what it can be used for."""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from replay_kit.config.run import RunConfig
from replay_kit.core.geodesy import unwrap_longitude
from replay_kit.core.message import LogReport
from replay_kit.core.observation import Observation, PathMean, VehicleState
from replay_kit.estimator.update.screening import usable
from replay_kit.logs import open_log
from replay_kit.logs.losses import loss_json, loss_words, unchecked_words
from replay_kit.measurements import NOT_A_KIND, Skipped, finish, initial_state, interpret


@dataclass(slots=True)
class TopicInfo:
    """One topic of a log.

    Attributes:
        schema: Schema or message name.
        messages: How many were met.
        first_ns: Time of the first decoded [ns, UTC]; None when none was.
        last_ns: Time of the last decoded.
    """

    schema: str = ""
    messages: int = 0
    first_ns: int | None = None
    last_ns: int | None = None


@dataclass(frozen=True, slots=True)
class LogInfo:
    """One log.

    Attributes:
        report: What the reader met.
        topics: By name.
        profiles: Profiles of the current it gives.
        bins: Usable bins in them.
        mean_currents: Mean currents between fixes that it gives.
        positions: Positions it gives.
        dives: Dives begun.
        box: West, south, east, north [degrees] of the positions, east above 180 when they cross the antimeridian; None without positions.
        depths: Shallowest and deepest usable bin [m]; None without bins.
        not_used: Topic to reason to count.
        not_known: Topic to the schema's name and the last payload, for topics that no known kind and no mapping covers.
    """

    report: LogReport
    topics: dict[str, TopicInfo]
    profiles: int
    bins: int
    mean_currents: int
    positions: int
    dives: int
    box: tuple[float, float, float, float] | None
    depths: tuple[float, float] | None
    not_used: dict[str, dict[str, int]]
    not_known: dict[str, tuple[str, Mapping[str, Any]]]

    @property
    def use(self) -> str:
        """What the log can be used for, in words."""
        if self.bins:
            return "replay: it has positions and profiles of the current"
        if self.mean_currents:
            return "mean currents between fixes, without profiles, for estimators that take them"
        if self.positions:
            return "positions only: no usable profile of the current"
        return "nothing yet: neither positions nor profiles of the current"


@dataclass(slots=True)
class _Found:
    profiles: int = 0
    bins: int = 0
    mean_currents: int = 0
    positions: int = 0
    # what is met is folded at once: a log may hold more positions than fit in memory
    depths: tuple[float, float] | None = None
    box: tuple[float, float, float, float] | None = None
    first_longitude: float | None = None
    not_used: dict[str, dict[str, int]] = field(default_factory=lambda: defaultdict(lambda: defaultdict(int)))

    def add(self, event: object) -> None:
        if isinstance(event, Observation):
            good = event.depth[usable(event.flags)]
            self.profiles += 1
            self.bins += good.size
            if good.size:
                low, high = self.depths or (np.inf, -np.inf)
                self.depths = min(low, float(good.min())), max(high, float(good.max()))
        elif isinstance(event, PathMean):
            self.mean_currents += 1
        elif isinstance(event, VehicleState):
            self.positions += 1
            self._extend_box(event.longitude, event.latitude)
        elif isinstance(event, Skipped):
            self.not_used[event.topic][event.reason] += 1

    def _extend_box(self, longitude: float, latitude: float) -> None:
        """Take one position in; longitudes stay near the first, so that a track across the antimeridian keeps a narrow box."""
        if self.first_longitude is None:
            self.first_longitude = longitude
        if abs(longitude - self.first_longitude) > 180.0:
            longitude = float(unwrap_longitude(longitude, self.first_longitude))
        west, south, east, north = self.box or (np.inf, np.inf, -np.inf, -np.inf)
        self.box = min(west, longitude), min(south, latitude), max(east, longitude), max(north, latitude)


def inspect_log(path: Path, config: RunConfig) -> LogInfo:
    """Return what a log holds; every message is read.

    Raises:
        LogError: The log cannot be opened.
    """
    reader, state, found = open_log(path, 0, config.logs), initial_state(config.logs.system), _Found()
    topics: dict[str, TopicInfo] = defaultdict(TopicInfo)
    not_known: dict[str, tuple[str, Mapping[str, Any]]] = {}
    for message in reader.messages():
        topic = topics[message.topic]
        topic.schema = message.schema
        topic.first_ns = message.time_ns if topic.first_ns is None else min(topic.first_ns, message.time_ns)
        topic.last_ns = message.time_ns if topic.last_ns is None else max(topic.last_ns, message.time_ns)
        state, events = interpret(state, message, config.measurements)
        for event in events:
            found.add(event)
            if isinstance(event, Skipped) and event.reason == NOT_A_KIND and not message.topic.startswith("mavlink/"):
                not_known[message.topic] = (message.schema, message.payload)
    for event in finish(state, config.measurements):
        found.add(event)
    report = reader.report()
    for name, count in report.read.items():
        topics[name].messages = count
    return LogInfo(
        report=report,
        topics=dict(sorted(topics.items())),
        profiles=found.profiles,
        bins=found.bins,
        mean_currents=found.mean_currents,
        positions=found.positions,
        dives=state.dive,
        box=found.box,
        depths=found.depths,
        not_used={topic: dict(reasons) for topic, reasons in found.not_used.items()},
        not_known=not_known,
    )


def info_json(info: LogInfo) -> dict[str, Any]:
    """Return a log's description for JSON."""
    return {
        "file": info.report.path,
        "format": info.report.format,
        "use": info.use,
        "profiles": info.profiles,
        "bins": info.bins,
        "mean_currents": info.mean_currents,
        "positions": info.positions,
        "dives": info.dives,
        "box": info.box,
        "depths": info.depths,
        "topics": [
            {"topic": name, "schema": topic.schema, "messages": topic.messages, "first": iso(topic.first_ns), "last": iso(topic.last_ns)}
            for name, topic in info.topics.items()
        ],
        "not_used": info.not_used,
        "undecodable": {topic: {"count": count, "reason": why} for topic, (count, why) in info.report.undecodable.items()},
        "notes": info.report.notes,
        "losses": [loss_json(loss) for loss in info.report.losses],
        "unchecked": dict(info.report.unchecked),
    }


def iso(time_ns: int | None) -> str | None:
    """Return a time as ISO 8601 UTC to the second; one later than 64 bits with a sign can hold is given as the last that they can."""
    return None if time_ns is None else f"{np.datetime_as_string(np.datetime64(min(time_ns, 2**63 - 1), 'ns'), unit='s')}Z"


def print_info(log: LogInfo, console: Console) -> None:
    """Print what a log holds."""
    table = Table("topic", "schema", "messages", "first", "last", title=f"{log.report.path} ({log.report.format})", title_justify="left")
    for name, topic in log.topics.items():
        table.add_row(name, topic.schema, str(topic.messages), iso(topic.first_ns) or "", iso(topic.last_ns) or "")
    console.print(table)
    console.print(f"Use: {log.use}. {log.profiles} profiles with {log.bins} usable bins, {log.positions} positions, {log.dives} dives")
    if log.box is not None:
        console.print(f"Positions: {log.box[0]:.4f}..{log.box[2]:.4f} E, {log.box[1]:.4f}..{log.box[3]:.4f} N")
    if log.mean_currents:
        console.print(f"Mean currents between fixes: {log.mean_currents}")
    if log.depths is not None:
        console.print(f"Bins: {log.depths[0]:.0f}..{log.depths[1]:.0f} m")
    for topic_name, reasons in log.not_used.items():
        for reason, count in reasons.items():
            if reason != NOT_A_KIND:
                console.print(f"Not used: {count} x {topic_name}: {reason}", soft_wrap=True)
    for topic_name, (count, why) in log.report.undecodable.items():
        console.print(f"Cannot be decoded: {count} x {topic_name}: {why}", soft_wrap=True)
    if log.report.unchecked:
        console.print(f"No checksum covers, so that damage would pass unseen: {unchecked_words(log.report)}", soft_wrap=True)
    for note in log.report.notes:
        console.print(f"Note: {note}", soft_wrap=True)
    for loss in log.report.losses:
        console.print(f"LOST: {loss_words(loss)}", soft_wrap=True)
