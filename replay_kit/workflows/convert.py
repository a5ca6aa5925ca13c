"""Any logs that can be read, merged into one MCAP log or telemetry log that loses nothing which the format can hold."""

import heapq
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any, TypeVar

from pymavlink.dialects.v20 import ardupilotmega as dialect
from rich.console import Console
from rich.table import Table

from replay_kit.config.run import LogConfig
from replay_kit.core.atomic import atomic_file
from replay_kit.core.errors import ConfigError
from replay_kit.core.message import LogReader, LogReport, Loss, Message
from replay_kit.core.paths import check_paths
from replay_kit.logs import merge, open_log
from replay_kit.logs.copying import RawLog, header_of
from replay_kit.logs.losses import loss_json, loss_words
from replay_kit.logs.mavlink.writer import TlogFrames
from replay_kit.logs.mcap.writer import McapLogWriter, open_mcap_log
from replay_kit.logs.raw import RawMessage
from replay_kit.results.readback import check_written

_STAMP_BYTES = 8
_T = TypeVar("_T", bound=RawMessage | Message)


@dataclass(frozen=True, slots=True)
class ConvertSummary:
    """What was converted.

    Attributes:
        out: The log.
        messages: Messages written, by topic.
        reports: What each reader met, in the order of the inputs.
        left_out: How many messages by (topic, what the format of the log cannot hold of them).
    """

    out: Path
    messages: Mapping[str, int]
    reports: tuple[LogReport, ...]
    left_out: Mapping[tuple[str, str], int] = field(default_factory=dict)

    @property
    def losses(self) -> tuple[tuple[str, Loss], ...]:
        """Damage met in the inputs: (path, what was lost)."""
        return tuple((report.path, loss) for report in self.reports for loss in report.losses)

    @property
    def undecodable(self) -> Mapping[str, tuple[int, str]]:
        """Topic to (count over all inputs, first reason) for what no decoder could read."""
        merged: dict[str, tuple[int, str]] = {}
        for report in self.reports:
            for topic, (count, reason) in report.undecodable.items():
                before, first = merged.get(topic, (0, reason))
                merged[topic] = (before + count, first)
        return merged


def convert(
    inputs: Sequence[Path], out: Path, overwrite: bool, config: LogConfig, on_message: Callable[[int], None] | None = None
) -> ConvertSummary:
    """Write the messages of all inputs, in order of (time, input, position), to one log and return what was written.

    MCAP to MCAP keeps payloads, schemas, encodings, all stamps, sequences, attachments and metadata. What MCAP did not hold before
    becomes JSON; the frames of a telemetry log are kept beside it as they were, so that they can be written again. A message that
    comes later than the reorder window allows is written where it comes. A telemetry log holds the frames of the inputs that have them,
    and frames made of fixes and pings of the others; the summary counts what it cannot hold.

    Args:
        inputs: Logs of any format that ``open_log`` knows.
        out: The log: a telemetry log when its name ends in ``.tlog``, else MCAP.
        overwrite: Whether an existing output is replaced; an input never is.
        config: Clock, first and last time, reorder window.
        on_message: Called with each message's time [ns], for progress.

    Raises:
        ConfigError: The output is an input, or exists, or cannot be written; or there is no input.
        LogError: An input cannot be opened.
        ReplayKitError: What was written does not read back; it stays as ``OUT.part``.
    """
    if not inputs:
        raise ConfigError("convert: expected at least one log, got none")
    check_paths(inputs, [out], overwrite)
    logs = [RawLog(path, number, config) for number, path in enumerate(inputs)]
    if out.suffix.lower() == ".tlog":
        return _to_tlog(logs, out, config, on_message)
    headers = [header_of(path) for path in inputs]
    profiles = {header.profile for header in headers if header is not None}
    with open_mcap_log(out, profiles.pop() if len(profiles) == 1 and None not in headers else "", _check) as writer:
        logs = [RawLog(path, number, config, writer.copy_beside) for number, path in enumerate(inputs)]
        merged = merge(logs, config.reorder_window, config.start_ns, config.end_ns, keep_late=True)
        frames = _by_time([log.frames() for log in logs if log.has_own_frames()])
        for message in chain(merged, (frame for frame in frames if _in_span(frame, config))):
            writer.copy(message)
            if on_message is not None:
                on_message(message.time_ns)
    return ConvertSummary(out, writer.written, tuple(log.report() for log in logs))


def _check(part: Path, writer: McapLogWriter) -> None:
    check_written(part, writer.written, writer.attachments)


def _in_span(message: RawMessage | Message, config: LogConfig) -> bool:
    return (config.start_ns or 0) <= message.time_ns and (config.end_ns is None or message.time_ns <= config.end_ns)


def _to_tlog(logs: Sequence[RawLog], out: Path, config: LogConfig, on_message: Callable[[int], None] | None) -> ConvertSummary:
    """Write frames that the logs hold as they were, and frames made of fixes and pings that no such frame says."""
    framed = [next(log.frames(), None) is not None for log in logs]
    # frames that are not from the vehicle have a component, and so a clock, of their own
    made = TlogFrames(dialect.MAV_COMP_ID_ONBOARD_COMPUTER) if any(framed) else TlogFrames()
    readers = [None if log.has_own_frames() else open_log(log.path, number, config) for number, log in enumerate(logs)]
    said = [_said(reader, has, config) for reader, has in zip(readers, framed, strict=True) if reader is not None]
    streams: list[Iterator[RawMessage | Message]] = [*(log.frames() for log in logs), *said]
    count: Counter[str] = Counter()
    with atomic_file(out) as file:
        for message in _by_time(streams):
            if _in_span(message, config):
                for name, entry in [_entry(message)] if isinstance(message, RawMessage) else made.entries(message):
                    file.write(entry)
                    count[name] += 1
            if on_message is not None:
                on_message(message.time_ns)
    # the frames came without a report of their own
    for log in logs:
        if log.has_own_frames():
            for _ in log.messages():
                pass
    reports = tuple(log.report() if reader is None else reader.report() for log, reader in zip(logs, readers, strict=True))
    return ConvertSummary(out, dict(count), reports, made.left_out)


def _entry(frame: RawMessage) -> tuple[str, bytes]:
    return frame.topic, (frame.time_ns // 1000).to_bytes(_STAMP_BYTES, "big") + frame.data


def _said(reader: LogReader, has_frames: bool, config: LogConfig) -> Iterator[Message]:
    """Yield a log's messages by time, without those that were decoded of frames beside them, which are not made again."""
    for message in merge([reader], config.reorder_window, keep_late=True):
        if not (has_frames and message.topic.startswith("mavlink/")):
            yield message


def _by_time(streams: Sequence[Iterator[_T]]) -> Iterator[_T]:
    """Return several streams as one by time; each keeps its own order, also where that is not of time."""
    return heapq.merge(*streams, key=lambda message: (message.time_ns, message.input, message.position))


def convert_json(summary: ConvertSummary) -> dict[str, Any]:
    """Return what was converted for JSON."""
    return {
        "messages": dict(summary.messages),
        "undecodable": {topic: {"count": count, "reason": why} for topic, (count, why) in summary.undecodable.items()},
        "left_out": [{"topic": topic, "messages": count, "why": why} for (topic, why), count in sorted(summary.left_out.items())],
        "notes": [{"file": report.path, "what": note} for report in summary.reports for note in report.notes],
        "losses": [{"file": path} | loss_json(loss) for path, loss in summary.losses],
    }


def print_converted(summary: ConvertSummary, console: Console) -> None:
    """Print what was converted."""
    table = Table("topic", "messages", title=str(summary.out), title_justify="left")
    for topic, count in sorted(summary.messages.items()):
        table.add_row(topic, str(count))
    console.print(table)
    for path, loss in summary.losses:
        console.print(f"LOST: {path}: {loss_words(loss)}", soft_wrap=True)
    for report in summary.reports:
        for note in report.notes:
            console.print(f"Note: {report.path}: {note}", soft_wrap=True)
    for (topic, why), count in sorted(summary.left_out.items()):
        console.print(f"Left out: {count} x {topic}: {why}", soft_wrap=True)
    for topic, (count, why) in summary.undecodable.items():
        console.print(f"Cannot be decoded: {count} x {topic}: {why}", soft_wrap=True)
