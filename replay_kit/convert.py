"""Any logs that can be read, merged into one MCAP log or telemetry log that loses nothing which the format can hold."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from replay_kit.config import LogConfig
from replay_kit.errors import ConfigError
from replay_kit.job import check_paths
from replay_kit.logs import merge, open_log
from replay_kit.logs.atomic import atomic_file
from replay_kit.logs.copying import RawLog, header_of
from replay_kit.logs.losses import loss_json, loss_words
from replay_kit.logs.mcap_log_writer import McapLogWriter, open_mcap_log
from replay_kit.logs.raw import RawMessage
from replay_kit.logs.tlog_writer import write_tlog
from replay_kit.results.readback import check_written
from replay_kit.types import LogReport, Loss

_STAMP_BYTES = 8


@dataclass(frozen=True, slots=True)
class ConvertSummary:
    """What was converted.

    Attributes:
        out: The log.
        messages: Messages written, by topic.
        reports: What each reader met, in the order of the inputs.
    """

    out: Path
    messages: Mapping[str, int]
    reports: tuple[LogReport, ...]

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
    comes later than the reorder window allows is written where it comes.

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
    if out.suffix == ".tlog":
        return _to_tlog(logs, out, config, on_message)
    headers = [header_of(path) for path in inputs]
    profiles = {header.profile for header in headers if header is not None}
    with open_mcap_log(out, profiles.pop() if len(profiles) == 1 and None not in headers else "", _check) as writer:
        logs = [RawLog(path, number, config, writer.copy_beside) for number, path in enumerate(inputs)]
        merged = merge(logs, config.reorder_window, config.start_ns, config.end_ns, keep_late=True)
        frames = chain.from_iterable(log.frames() for log in logs if log.has_own_frames())
        for message in chain(merged, (frame for frame in frames if _in_span(frame, config))):
            writer.copy(message)
            if on_message is not None:
                on_message(message.time_ns)
    return ConvertSummary(out, writer.written, tuple(log.report() for log in logs))


def _check(part: Path, writer: McapLogWriter) -> None:
    check_written(part, writer.written, writer.attachments)


def _in_span(message: RawMessage, config: LogConfig) -> bool:
    return (config.start_ns or 0) <= message.time_ns and (config.end_ns is None or message.time_ns <= config.end_ns)


def _to_tlog(logs: Sequence[RawLog], out: Path, config: LogConfig, on_message: Callable[[int], None] | None) -> ConvertSummary:
    """Write frames that the logs hold as they were; where there are none, frames made of fixes and pings."""
    frames: Iterator[RawMessage] = chain.from_iterable(log.frames() for log in logs)
    first = next(frames, None)
    if first is None:
        readers = [open_log(log.path, number, config) for number, log in enumerate(logs)]
        written = write_tlog(out, merge(readers, config.reorder_window, config.start_ns, config.end_ns))
        return ConvertSummary(out, written, tuple(reader.report() for reader in readers))
    count: Counter[str] = Counter()
    with atomic_file(out) as file:
        for frame in chain((first,), frames):
            if _in_span(frame, config):
                file.write((frame.time_ns // 1000).to_bytes(_STAMP_BYTES, "big") + frame.data)
                count[frame.topic] += 1
            if on_message is not None:
                on_message(frame.time_ns)
    # the frames came without a report of their own
    for log in logs:
        for _ in log.messages():
            pass
    return ConvertSummary(out, dict(count), tuple(log.report() for log in logs))


def convert_json(summary: ConvertSummary) -> dict[str, Any]:
    """Return what was converted for JSON."""
    return {
        "messages": dict(summary.messages),
        "undecodable": {topic: {"count": count, "reason": why} for topic, (count, why) in summary.undecodable.items()},
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
    for topic, (count, why) in summary.undecodable.items():
        console.print(f"Cannot be decoded: {count} x {topic}: {why}", soft_wrap=True)
