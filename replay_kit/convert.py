"""Any logs that can be read, merged into one MCAP log with JSON payloads."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from replay_kit.config import LogConfig
from replay_kit.errors import ConfigError
from replay_kit.job import check_paths
from replay_kit.logs import merge, open_log
from replay_kit.logs.losses import loss_json, loss_words
from replay_kit.logs.mcap_log_writer import open_mcap_log
from replay_kit.types import LogReport, Loss


@dataclass(frozen=True, slots=True)
class ConvertSummary:
    """What was converted.

    Attributes:
        out: The MCAP log.
        messages: Messages written, by topic.
        late: Messages left out because they came too late to be put in order, by topic.
        reports: What each reader met, in the order of the inputs.
    """

    out: Path
    messages: Mapping[str, int]
    late: Mapping[str, int]
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
    """Write the messages of all inputs, in order of (time, input, position), to one MCAP log and return what was written.

    Args:
        inputs: Logs of any format that ``open_log`` knows.
        out: The MCAP log.
        overwrite: Whether an existing output is replaced; an input never is.
        config: Clock, first and last time, reorder window.
        on_message: Called with each message's time [ns], for progress.

    Raises:
        ConfigError: The output is an input, or exists, or cannot be written; or there is no input.
        LogError: An input cannot be opened.
    """
    if not inputs:
        raise ConfigError("convert: expected at least one log, got none")
    check_paths(inputs, [out], overwrite)
    readers = [open_log(path, number, config) for number, path in enumerate(inputs)]
    merged = merge(readers, config.reorder_window, config.start_ns, config.end_ns)
    with open_mcap_log(out) as writer:
        for message in merged:
            writer.write(message)
            if on_message is not None:
                on_message(message.time_ns)
    return ConvertSummary(out, writer.written, merged.late, tuple(reader.report() for reader in readers))


def convert_json(summary: ConvertSummary) -> dict[str, Any]:
    """Return what was converted for JSON."""
    return {
        "messages": dict(summary.messages),
        "late": dict(summary.late),
        "undecodable": {topic: {"count": count, "reason": why} for topic, (count, why) in summary.undecodable.items()},
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
    for topic, count in summary.late.items():
        console.print(f"LOST: {count} x {topic}: later than the reorder window allows", soft_wrap=True)
    for topic, (count, why) in summary.undecodable.items():
        console.print(f"Cannot be decoded: {count} x {topic}: {why}", soft_wrap=True)
