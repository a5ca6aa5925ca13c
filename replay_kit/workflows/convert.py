"""Merging of logs of any known format into one MCAP log."""

import heapq
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

from rich.console import Console

from replay_kit.config.run import LogConfig
from replay_kit.core.errors import ConfigError
from replay_kit.core.files.inputs import check_unchanged, stamps_of
from replay_kit.core.files.paths import check_paths
from replay_kit.core.message import LogReport, Loss, RawMessage
from replay_kit.core.words.progress import Progress, silent
from replay_kit.logs import merge, open_logs
from replay_kit.logs.mcap.writer import McapLogWriter, open_mcap_log
from replay_kit.logs.opening import logs_in
from replay_kit.logs.reader import RawLog, reading
from replay_kit.results.losses import (
    loss_json,
    loss_lines,
    note_lines,
    unchecked_lines,
    undecodable_json,
    undecodable_lines,
)
from replay_kit.results.mcap.topics import check_written
from replay_kit.show.text import folded, print_lines, print_table


@dataclass(frozen=True, slots=True)
class ConvertSummary:
    """Summary of a conversion.

    Attributes:
        out: The log written.
        messages: Messages written, by topic.
        reports: Report of each reader, in the order of the inputs.
    """

    out: Path
    messages: Mapping[str, int]
    reports: tuple[LogReport, ...]

    @property
    def losses(self) -> tuple[tuple[str, Loss], ...]:
        """Damage found in the inputs: (path, loss)."""
        return tuple((report.path, loss) for report in self.reports for loss in report.losses)

    @property
    def undecodable(self) -> Mapping[str, tuple[int, str]]:
        """Number of undecodable messages in all inputs and the first reason, by topic."""
        merged: dict[str, tuple[int, str]] = {}
        for report in self.reports:
            for topic, (count, reason) in report.undecodable.items():
                before, first = merged.get(topic, (0, reason))
                merged[topic] = (before + count, first)
        return merged


def convert(
    inputs: Sequence[Path],
    out: Path,
    overwrite: bool,
    config: LogConfig,
    progress: Progress = silent,
) -> ConvertSummary:
    """Write the messages of all inputs to one MCAP log, ordered by (time, input, position), and return a summary.

    MCAP to MCAP keeps payloads, schemas, encodings, all stamps, sequences, attachments and metadata. Messages of other formats become
    JSON; the frames of a telemetry log are also kept unchanged. A message later than the reorder window is written in arrival order.

    Args:
        inputs: Logs of any format that ``open_log`` knows.
        out: The log.
        overwrite: Whether an existing output is replaced; an input never is replaced.
        config: Clock, first and last time, reorder window.
        progress: Called with the amount of input read.

    Raises:
        ConfigError: The output is an input, or exists, or cannot be written; or there is no input.
        LogError: An input cannot be opened, or changed while it was read; then ``OUT.part`` remains.
        ReplayKitError: The output does not read back as written; ``OUT.part`` remains.
    """
    if not inputs:
        raise ConfigError("convert: expected at least one log, got none")
    check_paths(inputs, [out], overwrite)
    read = stamps_of(file for path in inputs for file in logs_in(Path(path)))
    with ExitStack() as opened:
        logs = [opened.enter_context(log) for log in open_logs(inputs, config)]
        advance = reading(logs, progress, "converting")

        def check(part: Path, writer: McapLogWriter) -> None:
            check_unchanged(read)
            check_written(part, writer.written, writer.attachments)

        profiles = {log.profile() for log in logs}
        profile = (profiles.pop() if len(profiles) == 1 else None) or ""
        with open_mcap_log(out, profile, check) as writer:
            copies = [RawLog(log, writer.copy_extra) for log in logs]
            merged = merge(
                copies, config.reorder_window, config.start_ns, config.end_ns, keep_late=True
            )
            frames = heapq.merge(*(log.frames() for log in logs), key=_order)
            for message in chain(merged, (frame for frame in frames if _in_span(frame, config))):
                writer.copy(message)
                advance(1)
    return ConvertSummary(out, writer.written, tuple(log.report() for log in logs))


def _in_span(message: RawMessage, config: LogConfig) -> bool:
    return (config.start_ns or 0) <= message.time_ns and (
        config.end_ns is None or message.time_ns <= config.end_ns
    )


def _order(message: RawMessage) -> tuple[int, int, int]:
    """Return the key that merges streams by time; each stream keeps its own order, even if not by time."""
    return message.time_ns, message.input, message.position


def convert_json(summary: ConvertSummary) -> dict[str, Any]:
    """Return the summary of a conversion for JSON."""
    return {
        "messages": dict(summary.messages),
        "undecodable": undecodable_json(summary.undecodable),
        "notes": [
            {"file": report.path, "what": note}
            for report in summary.reports
            for note in report.notes
        ],
        "losses": [{"file": path} | loss_json(loss) for path, loss in summary.losses],
        "unchecked": [
            {"file": report.path, "what": kind, "count": n}
            for report in summary.reports
            for kind, n in report.unchecked.items()
        ],
    }


def print_converted(summary: ConvertSummary, console: Console, verbose: bool = False) -> None:
    """Print the summary of a conversion; topics that differ only in a number share a row unless verbose."""
    rows = ((topic, str(count)) for topic, count in sorted(summary.messages.items()))
    print_table(console, str(summary.out), ("topic", "messages"), folded(rows, verbose))
    for lines in (loss_lines, unchecked_lines, note_lines):
        print_lines(console, (line for report in summary.reports for line in lines(report)))
    print_lines(console, undecodable_lines(summary.undecodable))
