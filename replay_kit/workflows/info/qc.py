"""Quality control of a mission's logs: results of each test, and pings without a usable bin, as JSON and tables."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from replay_kit.config.run import MeasurementConfig, RunConfig
from replay_kit.core.errors import MeasurementError
from replay_kit.core.observation import Flag, Reason, usable
from replay_kit.core.observation.table import Block
from replay_kit.core.words.progress import Progress, silent
from replay_kit.logs import merge
from replay_kit.logs.tables.schemas import NOT_A_KIND
from replay_kit.measurements.observed import blocks, new_stream
from replay_kit.results.losses import coded_reasons, loss_json, lost_text
from replay_kit.show.text import not_used_lines, print_lines, print_table
from replay_kit.workflows.info.inspect import by_topic
from replay_kit.workflows.replay.inputs.scan import open_readers

_NO_PINGS = np.empty(0, np.int64)


@dataclass(slots=True, eq=False)
class _TestCount:
    """Counts of one test for all bins of a topic with a velocity: by flag, and of untested bins by reason; mutable."""

    reason: Reason
    flags: Counter[int] = field(default_factory=Counter)
    not_evaluated: Counter[str] = field(default_factory=Counter)


@dataclass(slots=True, eq=False)
class _TopicCount:
    """Counts of the pings of one topic: bins by flag after all tests, tests in order, and pings without a usable bin; mutable."""

    pings: int = 0
    flags: Counter[int] = field(default_factory=Counter)
    tests: dict[str, _TestCount] = field(default_factory=dict)
    lost: int = 0

    def add(self, block: Block, rows: NDArray[np.intp]) -> None:
        """Count pings of a block."""
        flags = block.ping["flags"][rows]
        real = np.arange(flags.shape[1]) < block.ping["bins"][rows, None]
        self.pings += rows.size
        self.lost += int(np.sum(~usable(flags).any(axis=1)))
        self.flags.update(flags[real].tolist())
        for test in block.tests:
            made = np.array([why is not None for why in test.why_not[rows]])
            if not made.any():
                continue
            count = self.tests.setdefault(test.name, _TestCount(test.reason))
            found, present = test.flags[rows[made]], flags[made] != Flag.MISSING
            count.flags.update(found[present].tolist())
            skipped = np.sum((found == Flag.NOT_EVALUATED) & present, axis=1).tolist()
            for why, number in zip(test.why_not[rows[made]], skipped, strict=True):
                if number:
                    count.not_evaluated[why or "no number in the bin"] += number


def check_quality(
    logs: Sequence[Path], config: RunConfig, progress: Progress = silent
) -> dict[str, Any]:
    """Return the results of each test on the pings of one mission's logs, for JSON.

    Args:
        logs: Logs, read completely and merged by time.
        config: Settings; ``[logs]`` and ``[measurements]`` apply.
        progress: Called with each block of messages.

    Raises:
        LogError: A log cannot be opened.
        MeasurementError: No ping can be tested.
    """
    readers, settings = open_readers(logs, config), config.logs
    merged = merge(readers, settings.reorder_window, settings.start_ns, settings.end_ns)
    topics: dict[str, _TopicCount] = {}
    counts: Counter[tuple[str, str]] = Counter()
    stream = new_stream(settings.system, settings.component)
    for block in blocks(merged, config.measurements, stream=stream):
        progress(0, 0, "testing")
        for number in np.unique(block.ping.get("topic", _NO_PINGS)).tolist():
            topic = topics.setdefault(block.topics[number], _TopicCount())
            topic.add(block, np.flatnonzero(block.ping["topic"] == number))
        said = block.counts().items()
        counts.update({key: n for key, n in said if key[1] not in ("", NOT_A_KIND)})
    reports = [reader.report() for reader in readers]
    if not topics:
        why = "; ".join(f"{count} x {topic}: {reason}" for (topic, reason), count in counts.items())
        raise MeasurementError(
            f"{', '.join(map(str, logs))}: expected ADCP pings whose bins can be tested, got none; not used: "
            f"{why or 'nothing that could be a ping'}"
        )
    losses = [{"file": log.path, **loss_json(loss)} for log in reports for loss in log.losses]
    late = sum(merged.late.values())
    return {
        "exit_code": 4 if late or losses else 0,
        "logs": [log.path for log in reports],
        "settings": config.measurements.model_dump(mode="json", exclude={"map"}),
        "topics": [
            _topic_json(name, tested, config.measurements)
            for name, tested in sorted(topics.items())
        ],
        "not_used": {topic: coded_reasons(reasons) for topic, reasons in by_topic(counts).items()},
        "late": late,
        "losses": losses,
    }


def _topic_json(name: str, topic: _TopicCount, settings: MeasurementConfig) -> dict[str, Any]:
    """Return the counts of a topic with the thresholds of each test."""
    tests = []
    for test, count in topic.tests.items():
        suspect, fail = _limits_of(test, settings)
        tests.append(
            {
                "test": test,
                "reason": str(count.reason.name).lower(),
                "bit": int(count.reason),
                "suspect_when": suspect or None,
                "fail_when": fail or None,
                "evaluated": count.flags.total() - count.flags[Flag.NOT_EVALUATED],
                "suspect": count.flags[Flag.SUSPECT],
                "failed": count.flags[Flag.FAIL],
                "not_evaluated": coded_reasons(count.not_evaluated),
            }
        )
    return {
        "topic": name,
        "pings": topic.pings,
        "bins": {flag.name.lower(): topic.flags[flag] for flag in Flag},
        "tests": tests,
        "pings_lost": topic.lost,
    }


def _limits_of(test: str, settings: MeasurementConfig) -> tuple[str, str]:
    """Return the thresholds of a test as text, suspect and fail; empty without thresholds."""
    quality = settings.quality
    edge, surface = "edge > range x cos(beam angle)", f"depth < {settings.surface_depth:g} m"
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


def print_quality(answer: Mapping[str, Any], console: Console) -> None:
    """Print a table per topic of the answer of ``check_quality``, then unused messages and losses."""
    for topic in answer["topics"]:
        _print_topic(topic, answer["settings"]["quality"]["use_suspect"], console)
    reasons = {
        topic: {one["reason"]: one["count"] for one in each}
        for topic, each in answer["not_used"].items()
    }
    print_lines(console, not_used_lines(reasons))
    lost = [f"{loss['file']}: {lost_text(loss)}" for loss in answer["losses"]]
    if late := answer["late"]:
        lost.append(
            f"{late} messages arrived later than the reorder window; widen logs.reorder_window"
        )
    print_lines(console, [f"LOST: {text}" for text in lost])


def _print_topic(topic: Mapping[str, Any], use_suspect: bool, console: Console) -> None:
    columns = ("test", "suspect when", "fails when", "tested", "suspect", "failed")
    words, numbers = ("test", "suspect_when", "fail_when"), ("evaluated", "suspect", "failed")
    rows = [
        [*(test[key] or "" for key in words), *(str(test[key]) for key in numbers)]
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
    lines += [f"Pings that lose every bin: {lost}"] if lost else []
    print_lines(console, lines)
