"""Quality control of a mission's logs: results of each test, and pings without a usable bin, as tables and for JSON."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from replay_kit.config.run import MeasurementConfig, RunConfig
from replay_kit.core.errors import MeasurementError
from replay_kit.core.message import LogReport, Message
from replay_kit.core.observation import Flag, Reason, usable
from replay_kit.core.observation.block import BinTest, Block
from replay_kit.logs import merge
from replay_kit.logs.tables.schemas import NOT_A_KIND
from replay_kit.measurements.observed import begun, blocks
from replay_kit.results.losses import coded, loss_json, loss_lines
from replay_kit.show.text import iso, not_used_lines, print_lines, print_table
from replay_kit.workflows.info.inspect import by_topic
from replay_kit.workflows.replay.inputs.scan import open_readers

_NO_PINGS = np.empty(0, np.int64)
# of a topic, printed; JSON has all
_LOST_SHOWN = 5


@dataclass(slots=True, eq=False)
class TestCount:
    """Results of one test for all bins of a topic with a velocity.

    Attributes:
        reason: Reason that the test assigns to bins.
        flags: Number of bins by QARTOD flag.
        not_evaluated: Number of untested bins by reason.
    """

    reason: Reason
    flags: Counter[int] = field(default_factory=Counter)
    not_evaluated: Counter[str] = field(default_factory=Counter)

    def add(self, test: BinTest, rows: NDArray[np.intp], present: NDArray[np.bool_]) -> None:
        """Count the bins of pings.

        Args:
            test: The test's results for all pings of a block.
            rows: Numbers of the pings in the block.
            present: shape (n, m), whether a bin has a velocity.
        """
        flags = test.flags[rows]
        self.flags.update(flags[present].tolist())
        skipped = np.sum((flags == Flag.NOT_EVALUATED) & present, axis=1)
        for k in np.flatnonzero(skipped):
            why = test.why_not[rows[k]] or "no number in the bin"
            self.not_evaluated[why] += int(skipped[k])

    def to_json(self, name: str, settings: MeasurementConfig) -> dict[str, Any]:
        """Return the counts with the thresholds of the test."""
        suspect, fail = _limits_of(name, settings)
        return {
            "test": name,
            "reason": str(self.reason.name).lower(),
            "bit": int(self.reason),
            "suspect_when": suspect or None,
            "fail_when": fail or None,
            "evaluated": self.flags.total() - self.flags[Flag.NOT_EVALUATED],
            "suspect": self.flags[Flag.SUSPECT],
            "failed": self.flags[Flag.FAIL],
            "not_evaluated": coded(self.not_evaluated),
        }


@dataclass(slots=True, eq=False)
class TopicQuality:
    """Quality of the pings of one topic.

    Attributes:
        pings: Number of pings tested.
        flags: Number of bins by QARTOD flag, after all tests.
        tests: Results by test, in the order of testing.
        lost: Pings without a usable bin: time, log, position in the log and the reasons of their bins.
    """

    pings: int = 0
    flags: Counter[int] = field(default_factory=Counter)
    tests: dict[str, TestCount] = field(default_factory=dict)
    lost: list[dict[str, Any]] = field(default_factory=list)

    def add(self, block: Block, rows: NDArray[np.intp]) -> None:
        """Count pings of a block."""
        columns = block.ping
        flags = columns["flags"][rows]
        real = np.arange(flags.shape[1]) < columns["bins"][rows, None]
        self.pings += rows.size
        self.flags.update(flags[real].tolist())
        for test in block.tests:
            made = np.array([why is not None for why in test.why_not[rows]])
            if made.any():
                count = self.tests.setdefault(test.name, TestCount(test.reason))
                count.add(test, rows[made], flags[made] != Flag.MISSING)
        for k in rows[~usable(flags).any(axis=1)]:
            of = Reason(int(np.bitwise_or.reduce(columns["reasons"][k])))
            ping = {
                "time": iso(int(columns["time"][k])),
                "input": int(columns["input"][k]),
                "position": int(columns["ordinal"][k]),
                "reasons": [str(one.name).lower() for one in Reason if one and one in of],
            }
            self.lost.append(ping)


@dataclass(frozen=True, slots=True, eq=False)
class QualityReport:
    """Quality control of logs.

    Attributes:
        logs: Reports of the readers.
        settings: Thresholds.
        topics: Quality by topic.
        not_used: Number of messages without a profile, by topic and reason.
        late: Number of messages excluded as later than the reorder window.
    """

    logs: tuple[LogReport, ...]
    settings: MeasurementConfig
    topics: Mapping[str, TopicQuality]
    not_used: Mapping[str, Mapping[str, int]]
    late: int

    @property
    def exit_code(self) -> int:
        """4 if part of the logs was lost, else 0."""
        return 4 if self.late or any(log.losses for log in self.logs) else 0


def check_quality(
    logs: Sequence[Path], config: RunConfig, on_message: Callable[[int], None] = lambda _: None
) -> QualityReport:
    """Return the results of each test on the pings of one mission's logs.

    Args:
        logs: Logs, read completely and merged by time.
        config: Settings; ``[logs]`` and ``[measurements]`` apply.
        on_message: Called with each message's time [ns], for progress.

    Raises:
        LogError: A log cannot be opened.
        MeasurementError: No ping can be tested.
    """
    readers = open_readers(logs, config)
    merged = merge(readers, config.logs.reorder_window, config.logs.start_ns, config.logs.end_ns)
    topics: dict[str, TopicQuality] = {}
    counts: Counter[tuple[str, str]] = Counter()
    stream = begun(config.logs.system, config.logs.component)
    for block in blocks(_told(merged, on_message), config.measurements, stream=stream):
        for number in np.unique(block.ping.get("topic", _NO_PINGS)).tolist():
            topic = topics.setdefault(block.topics[number], TopicQuality())
            topic.add(block, np.flatnonzero(block.ping["topic"] == number))
        said = block.counts().items()
        counts.update({key: n for key, n in said if key[1] not in ("", NOT_A_KIND)})
    reports, not_used = tuple(reader.report() for reader in readers), by_topic(counts)
    if not topics:
        raise MeasurementError(_nothing(logs, reports, counts))
    late = sum(merged.late.values())
    return QualityReport(reports, config.measurements, dict(sorted(topics.items())), not_used, late)


def _told(messages: Iterable[Message], on_message: Callable[[int], None]) -> Iterator[Message]:
    """Yield messages, after reporting their times."""
    for message in messages:
        on_message(message.time_ns)
        yield message


def _nothing(
    logs: Sequence[Path], reports: Sequence[LogReport], counts: Mapping[tuple[str, str], int]
) -> str:
    expected = f"{', '.join(map(str, logs))}: expected ADCP pings whose bins can be tested"
    if any("/dac" in report.read for report in reports):
        return f"{expected}, got mean currents only, which a replay uses unchanged"
    why = "; ".join(f"{count} x {topic}: {reason}" for (topic, reason), count in counts.items())
    return f"{expected}, got none; not used: {why or 'nothing that could be a ping'}"


def _limits_of(test: str, settings: MeasurementConfig) -> tuple[str, str]:
    """Return the thresholds of a test as text, suspect and fail; empty without thresholds."""
    quality = settings.quality
    edge = "edge > range x cos(beam angle)"
    surface = f"depth < {settings.surface_depth:g} m"
    special = {
        "above_surface": ("", "depth < 0 m"),
        "max_speed": ("", f"component > {settings.max_speed:g} m/s"),
        "bottom": ("", edge),
        "sidelobe": ("", edge if quality.sidelobe else ""),
        "at_surface": (
            surface if quality.at_surface == "suspect" else "",
            surface if quality.at_surface == "fail" else "",
        ),
    }
    return special[test] if test in special else quality.limits_in_words(test)


def quality_json(report: QualityReport) -> dict[str, Any]:
    """Return a quality control for JSON, with all its thresholds."""
    return {
        "exit_code": report.exit_code,
        "logs": [log.path for log in report.logs],
        "settings": report.settings.model_dump(mode="json", exclude={"map"}),
        "topics": [
            {
                "topic": name,
                "pings": topic.pings,
                "bins": {flag.name.lower(): topic.flags[flag] for flag in Flag},
                "tests": [test.to_json(k, report.settings) for k, test in topic.tests.items()],
                "pings_lost": topic.lost,
            }
            for name, topic in report.topics.items()
        ],
        "not_used": {topic: coded(reasons) for topic, reasons in report.not_used.items()},
        "late": report.late,
        "losses": [
            {"file": log.path, **loss_json(loss)} for log in report.logs for loss in log.losses
        ],
    }


def print_quality(report: QualityReport, console: Console) -> None:
    """Print a table per topic, then unused messages and losses."""
    for topic in quality_json(report)["topics"]:
        _print_topic(topic, report.settings.quality.use_suspect, console)
    print_lines(console, not_used_lines(report.not_used))
    for log in report.logs:
        print_lines(console, loss_lines(log))
    if report.late:
        console.print(
            f"LOST: {report.late} messages arrived later than the reorder window; widen logs.reorder_window",
        )


def _print_topic(topic: Mapping[str, Any], use_suspect: bool, console: Console) -> None:
    """Print a topic in its JSON form."""
    columns = ("test", "suspect when", "fails when", "tested", "suspect", "failed")
    keys = ("test", "suspect_when", "fail_when", "evaluated", "suspect", "failed")
    rows = [
        [str(test[key] or "") or "0" * (k > 2) for k, key in enumerate(keys)]
        for test in topic["tests"]
    ]
    title = f"{topic['topic']}: {topic['pings']} pings; number of bins of each test"
    print_table(console, title, columns, rows)
    lines = [
        f"Not tested: {test['test']}: "
        + ", ".join(f"{why['count']} {why['reason']}" for why in test["not_evaluated"])
        for test in topic["tests"]
        if test["not_evaluated"]
    ]
    bins, lost = topic["bins"], topic["pings_lost"]
    use = "used" if use_suspect else "not used, as quality.use_suspect is false"
    lines.append(
        f"Bins: {bins['good']} good, {bins['suspect']} suspect ({use}), {bins['fail']} failed, {bins['missing']} missing"
    )
    lines += [f"Pings that lose every bin: {len(lost)}"] if lost else []
    lines += [
        f"  {ping['time']} (log {ping['input']}, position {ping['position']}): {', '.join(ping['reasons'])}"
        for ping in lost[:_LOST_SHOWN]
    ]
    if len(lost) > _LOST_SHOWN:
        lines.append(f"  and {len(lost) - _LOST_SHOWN} more, all in --json")
    print_lines(console, lines)
