"""The report on the quality control of logs: tables for a person, JSON for a program."""

from collections.abc import Mapping
from typing import Any

from rich.console import Console

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.observation import Flag, Reason
from replay_kit.results.losses import coded, loss_json, loss_lines
from replay_kit.show.text import iso, not_used_lines, print_lines, print_table
from replay_kit.workflows.qc.check import QualityReport, TestCount, TopicQuality

# of a topic, printed; JSON has all
_LOST_SHOWN = 5


def limits_of(test: str, settings: MeasurementConfig) -> tuple[str, str]:
    """Return the thresholds of a test in words, suspect and fail; empty where it has none."""
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


def names_of(reasons: Reason) -> list[str]:
    """Return the names of the bits of a mask."""
    return [str(reason.name).lower() for reason in Reason if reason and reason in reasons]


def quality_json(report: QualityReport) -> dict[str, Any]:
    """Return a quality control for JSON, with every threshold it was made with."""
    return {
        "exit_code": report.exit_code,
        "logs": [log.path for log in report.logs],
        "settings": report.settings.model_dump(mode="json", exclude={"map"}),
        "topics": [
            _topic_json(name, topic, report.settings) for name, topic in report.topics.items()
        ],
        "not_used": {topic: coded(reasons) for topic, reasons in report.not_used.items()},
        "late": report.late,
        "losses": [
            {"file": log.path, **loss_json(loss)} for log in report.logs for loss in log.losses
        ],
    }


def _topic_json(name: str, topic: TopicQuality, settings: MeasurementConfig) -> dict[str, Any]:
    return {
        "topic": name,
        "pings": topic.pings,
        "bins": {flag.name.lower(): topic.flags.get(flag, 0) for flag in Flag},
        "tests": [_test_json(test, count, settings) for test, count in topic.tests.items()],
        "pings_lost": [
            {
                "time": iso(ping.time_ns),
                "input": ping.input,
                "position": ping.position,
                "reasons": names_of(ping.reasons),
            }
            for ping in topic.lost
        ],
    }


def _test_json(test: str, count: TestCount, settings: MeasurementConfig) -> dict[str, Any]:
    suspect, fail = limits_of(test, settings)
    return {
        "test": test,
        "reason": str(count.reason.name).lower(),
        "bit": int(count.reason),
        "suspect_when": suspect or None,
        "fail_when": fail or None,
        "evaluated": count.evaluated,
        "suspect": count.suspect,
        "failed": count.failed,
        "not_evaluated": coded(count.not_evaluated),
    }


def print_quality(report: QualityReport, console: Console) -> None:
    """Print a table for each topic, then messages not used and losses."""
    for name, topic in report.topics.items():
        _print_topic(name, topic, report.settings, console)
    print_lines(console, not_used_lines(report.not_used))
    for log in report.logs:
        print_lines(console, loss_lines(log))
    if report.late:
        console.print(
            f"LOST: {report.late} messages came later than the reorder window allows; widen logs.reorder_window",
        )


def _print_topic(
    name: str, topic: TopicQuality, settings: MeasurementConfig, console: Console
) -> None:
    columns = ("test", "suspect when", "fails when", "tested", "suspect", "failed")
    rows = (
        (
            test,
            *limits_of(test, settings),
            *(str(number) for number in (count.evaluated, count.suspect, count.failed)),
        )
        for test, count in topic.tests.items()
    )
    print_table(console, f"{name}: {topic.pings} pings; number of bins of each test", columns, rows)
    skipped = (
        (test, _counts(count.not_evaluated))
        for test, count in topic.tests.items()
        if count.not_evaluated
    )
    print_lines(console, (f"Not tested: {test}: {why}" for test, why in skipped))
    use = "used" if settings.quality.use_suspect else "not used, as quality.use_suspect is false"
    good, suspect, failed, missing = (
        topic.flags.get(flag, 0) for flag in (Flag.GOOD, Flag.SUSPECT, Flag.FAIL, Flag.MISSING)
    )
    console.print(
        f"Bins: {good} good, {suspect} suspect ({use}), {failed} failed, {missing} missing",
    )
    lines = [f"Pings that lose every bin: {len(topic.lost)}"] if topic.lost else []
    for ping in topic.lost[:_LOST_SHOWN]:
        lines.append(
            f"  {iso(ping.time_ns)} (log {ping.input}, position {ping.position}): {', '.join(names_of(ping.reasons))}"
        )
    if len(topic.lost) > _LOST_SHOWN:
        lines.append(f"  and {len(topic.lost) - _LOST_SHOWN} more, all in --json")
    print_lines(console, lines)


def _counts(counts: Mapping[str, int], nothing: str = "none") -> str:
    return ", ".join(f"{count} {what}" for what, count in counts.items() if count) or nothing
