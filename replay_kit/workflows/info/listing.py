"""Listing of logs for people and as JSON, and the next command."""

import math
import shlex
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from replay_kit.core.words.text import count_text
from replay_kit.logs.opening import pattern
from replay_kit.logs.payloads import gather
from replay_kit.logs.tables.schemas import NOT_A_KIND
from replay_kit.results.losses import (
    coded,
    iso_time,
    loss_json,
    loss_words,
    unchecked_lines,
    undecodable_json,
    undecodable_lines,
)
from replay_kit.show.text import (
    folded,
    iso,
    not_used_lines,
    print_lines,
    print_table,
    short_times,
)
from replay_kit.workflows.info.inspect import LogInfo, use_of
from replay_kit.workflows.info.reading import TopicInfo


def info_json(info: LogInfo) -> dict[str, Any]:
    """Return the description of a log for JSON."""
    content, whole = info.content, info.sampled is None
    return {
        "file": info.report.path,
        "format": info.report.format,
        "read": {
            "whole": whole,
            "messages": sum(info.report.read.values()) if info.sampled is None else info.sampled,
        },
        "mission": info.report.mission,
        "use": info.use,
        "missing": info.missing,
        "mappable": dict(info.mappable),
        "profiles": content.profiles if whole else None,
        "bins": content.bins if whole else None,
        "mean_currents": content.mean_currents if whole else None,
        "surface_currents": content.surface if whole else None,
        "positions": content.positions if whole else None,
        "dives": info.dives if whole else None,
        "box": content.box if whole else None,
        "depths": content.depths if whole else None,
        "topics": [topic_json(name, topic) for name, topic in info.topics.items()],
        "not_used": {topic: coded(reasons) for topic, reasons in info.not_used.items()},
        "undecodable": undecodable_json(info.report.undecodable),
        "notes": info.report.notes,
        "losses": [loss_json(loss) for loss in info.report.losses],
        "unchecked": dict(info.report.unchecked),
    }


def _ends(topics: Iterable[TopicInfo]) -> tuple[int, int] | None:
    """Return the first and last time of topics [ns, UTC]; None without times."""
    spans = [
        (topic.first_ns, topic.last_ns)
        for topic in topics
        if topic.first_ns is not None and topic.last_ns is not None
    ]
    return (min(first for first, _ in spans), max(last for _, last in spans)) if spans else None


def _span(topics: Iterable[TopicInfo]) -> str:
    """Return the time span of topics as text; empty without times."""
    ends = _ends(topics)
    return "" if ends is None else ", {} to {}".format(*map(iso, ends))


def _content_lines(log: LogInfo) -> Iterator[str]:
    """Yield lines on the content of the messages read."""
    content = log.content
    if log.sampled is not None:
        yield (
            f"Read: the index, and {log.sampled} messages, the first of each topic; --full counts profiles and positions, and what is not "
            "used or damaged"
        )
        yield f"Use, by the messages read: {log.use}"
        return
    yield f"Use: {log.use}. {content.profiles} profiles with {content.bins} usable bins, {content.positions} positions, {log.dives} dives"
    if content.box is not None:
        yield f"Positions: {content.box[0]:.4f}..{content.box[2]:.4f} E, {content.box[1]:.4f}..{content.box[3]:.4f} N"
    if content.mean_currents:
        yield f"Mean currents between fixes: {content.mean_currents}"
    if content.surface:
        yield f"Currents by radar, drifters or other sensors: {content.surface} measurements"
    if content.depths is not None:
        yield f"Bins: {content.depths[0]:.0f}..{content.depths[1]:.0f} m"


def print_infos(logs: Sequence[LogInfo], console: Console, verbose: bool = False) -> None:
    """Print the contents of logs: topics of a single log, of several one row each and their joint content, unless verbose."""
    if verbose or len(logs) == 1:
        for log in logs:
            print_info(log, console, verbose)
    elif logs:
        print_table(console, _heading(logs), _COLUMNS, _rows(logs))
        print_lines(console, _summary_lines(logs))
    print_lines(console, together_lines(logs))


_COLUMNS = ("log", "first", "last", "profiles", "mean currents", "positions", "dives")
# reasons, notes and losses of several logs that are printed; -v prints all
_MOST_LINES = 2


def _heading(logs: Sequence[LogInfo]) -> str:
    """Return the missions, formats, time span and region of logs."""
    missions, formats = (
        ", ".join(dict.fromkeys(filter(None, values)))
        for values in ([log.report.mission for log in logs], [log.report.format for log in logs])
    )
    span = _span([topic for log in logs for topic in log.topics.values()])
    return f"{missions or count_text(len(logs), 'log')} ({formats}){span}"


def _rows(logs: Sequence[LogInfo]) -> Iterator[tuple[str, ...]]:
    """Yield one row per log; figures unknown from an index alone are empty."""
    spans = [_ends(log.topics.values()) or (None, None) for log in logs]
    times = short_times([end for span in spans for end in span])
    for log, first, last in zip(logs, times[::2], times[1::2], strict=True):
        content = log.content
        counts = content.profiles, content.mean_currents, content.positions, log.dives
        numbers = map(str, counts) if log.sampled is None else [""] * len(counts)
        yield Path(log.report.path).name, first, last, *numbers


def _summary_lines(logs: Sequence[LogInfo]) -> Iterator[str]:
    """Yield the uses of several logs, data not used or lost, and the number of notes that ``-v`` prints."""
    uses = Counter(log.use for log in logs)
    yield from (
        f"Use: {use}" if count == len(logs) else f"Use of {count} of {len(logs)}: {use}"
        for use, count in uses.items()
    )
    boxes = [log.content.box for log in logs if log.content.box is not None]
    if boxes:
        west, south, east, north = (
            side(each)
            for side, each in zip((min, min, max, max), zip(*boxes, strict=True), strict=True)
        )
        yield f"Positions: {west:.4f}..{east:.4f} E, {south:.4f}..{north:.4f} N"
    not_used: dict[str, Counter[str]] = defaultdict(Counter)
    for log in logs:
        for topic, reasons in log.not_used.items():
            not_used[topic].update({why: n for why, n in reasons.items() if why != NOT_A_KIND})
    notes = gather(note for log in logs for note in log.report.notes)
    own = [f"Note: {note}" for note, found in notes.items() if len(found) < len(logs)]
    losses = [
        f"LOST: {log.report.path}: {loss_words(one)}" for log in logs for one in log.report.losses
    ]
    gaps = [line for log in logs for line in (*late_lines(log.topics), *gap_lines(log.topics))]
    missing = dict.fromkeys(log.missing for log in logs if log.missing and log.together is None)
    unchecked = sum(bool(log.report.unchecked) for log in logs)
    yield from few(losses)
    yield from few([*not_used_lines(not_used, whole=False)])
    yield from few(gaps)
    yield from (f"Missing for a replay: {one}" for one in missing)
    mappable = {(topic, kind) for log in logs for topic, kind in log.mappable.items()}
    yield from few(
        [f"Unknown type: {topic} looks like a {kind}" for topic, kind in sorted(mappable)]
    )
    if unchecked:
        yield f"Without a checksum, so that damage cannot be detected: {unchecked} of {len(logs)} logs"
    if notes:
        yield from few(own)
        yield f"Notes: {len(notes)}; -v prints them, and the topics of each log"


def few(lines: Sequence[str]) -> Iterator[str]:
    """Yield the first lines, and the number of the others."""
    yield from lines[:_MOST_LINES]
    if len(lines) > _MOST_LINES:
        yield f"{lines[0].partition(':')[0]}: {len(lines) - _MOST_LINES} more; -v prints all"


def together_lines(logs: Sequence[LogInfo]) -> Iterator[str]:
    """Yield the uses of logs that are judged together."""
    content = next((log.together for log in logs if log.together is not None), None)
    if content is not None:
        yield (
            f"Together: {use_of(content)}. {content.profiles} profiles with {content.bins} usable bins, {content.positions} positions, "
            f"{content.mean_currents} mean currents"
        )
        if missing := next((log.missing for log in logs if log.missing), ""):
            yield f"Missing for a replay: {missing}"


def print_info(log: LogInfo, console: Console, verbose: bool = False) -> None:
    """Print the contents of a log; topics that differ only in a number share a row unless verbose."""
    report, topics = log.report, log.topics
    times = short_times(
        [topic.first_ns for topic in topics.values()] + [topic.last_ns for topic in topics.values()]
    )
    cells = zip(topics.items(), times[: len(topics)], times[len(topics) :], strict=True)
    rows = (
        (name, topic.schema, str(topic.messages), first, last)
        for (name, topic), first, last in cells
    )
    columns = ("topic", "schema", "messages", "first", "last")
    print_table(
        console,
        f"{report.path} ({report.format}){_span(topics.values())}",
        columns,
        folded(rows, verbose),
    )
    if report.mission:
        console.print(f"Mission: {report.mission}")
    print_lines(console, late_lines(topics))
    print_lines(console, _content_lines(log))
    print_lines(console, gap_lines(topics))
    known = {
        topic: {why: count for why, count in reasons.items() if why != NOT_A_KIND}
        for topic, reasons in log.not_used.items()
    }
    print_lines(console, not_used_lines(known, verbose))
    print_lines(console, undecodable_lines(report.undecodable))
    print_lines(console, unchecked_lines(report))
    print_lines(console, (f"Note: {note}" for note in report.notes))
    print_lines(console, (f"LOST: {loss_words(loss)}" for loss in report.losses))
    if log.missing and log.together is None:
        print_lines(console, [f"Missing for a replay: {log.missing}"])
    mappable = log.mappable
    print_lines(
        console, (f"Unknown type: {topic} looks like a {kind}" for topic, kind in mappable.items())
    )
    others = (
        0
        if log.is_result
        else len(log.unknown)
        - len(mappable)
        - sum(" and " in topic.rpartition(", name ")[2] for topic in mappable)
    )
    if others:
        print_lines(
            console,
            [
                f"Unknown type: {others} more topics, in which nothing looks like a position, a depth or a velocity"
            ],
        )


def asks_for_replay(logs: Sequence[LogInfo]) -> bool:
    """Return whether logs are of one mission and measure a current, so that a replay can follow."""
    missions = {log.report.mission for log in logs if log.report.mission}
    held = (log.judged for log in logs)
    return len(missions) <= 1 and any(c.bins or c.mean_currents or c.surface for c in held)


def next_command(
    logs: Sequence[LogInfo],
    paths: Sequence[Path],
    ensemble: Sequence[Path] = (),
    options: Sequence[str] = (),
) -> list[str]:
    """Return the next command, and for some an instruction for afterwards; names in these lines may contain line breaks.

    Args:
        logs: The logs of a mission.
        paths: Paths as given.
        ensemble: Files of the forecast; empty without one.
        options: Words of the command line for the settings used.
    """
    missions: dict[str, list[Path]] = {}
    for log in logs:
        if log.report.mission:
            missions.setdefault(log.report.mission, []).extend(log.files)
    if len(missions) > 1:
        first, *others = (
            f"{shlex.quote(str(files[0].parent))}/{pattern(files)}" for files in missions.values()
        )
        rest = f"The logs are of {len(missions)} missions, of which this is one; the others: {', '.join(others)}"
        return [f"Next: replay-kit info {first}", rest]
    given, forecast = (
        " ".join(shlex.quote(str(path)) for path in files)
        for files in (paths, ensemble or [Path("FORECAST.nc")])
    )
    if asks_for_replay(logs):
        settings = "".join(f"{shlex.quote(word)} " for word in options)
        return [f"Next: replay-kit replay {given} --ensemble {forecast} {settings}-o RESULT.mcap"]
    if any(log.is_result for log in logs):
        return [f"Next: replay-kit report {given}"]
    if any(log.mappable for log in logs):
        return [
            f"Next: replay-kit info {given} --suggest map.toml",
            f"Correct map.toml, then: replay-kit info {given} --config map.toml",
        ]
    return [
        f"Next: replay-kit info {given} ANOTHER_LOG",
        "ANOTHER_LOG is a log of this mission with the missing data",
    ]


# printed; all are in the JSON
_MOST_GAPS = 5


def topic_json(name: str, topic: TopicInfo) -> dict[str, Any]:
    """Return a topic for JSON; unknown values are null."""
    return {
        "topic": name,
        "schema": topic.schema,
        "messages": topic.messages,
        "first": iso(topic.first_ns),
        "last": iso(topic.last_ns),
        "late": topic.late,
        "longest_gap_s": None if topic.gap_ns is None else topic.gap_ns / 1e9,
    }


def late_lines(topics: Mapping[str, TopicInfo]) -> Iterator[str]:
    """Yield lines on late messages, with the setting that keeps them."""
    late = {name: topic.late for name, topic in topics.items() if topic.late}
    if late:
        which = ", ".join(f"{count} x {name}" for name, count in late.items())
        seconds = math.ceil(1e-9 * max(topic.late_by_ns for topic in topics.values()))
        yield (
            f"Late, by more than the reorder window, so excluded from a replay: {which}; "
            f"logs.reorder_window = {seconds} keeps them"
        )


def gap_lines(topics: Mapping[str, TopicInfo]) -> Iterator[str]:
    """Yield lines on the longest of the conspicuous gaps."""
    gaps = sorted(
        (
            (topic.gap_ns or 0, name, topic.gap_from_ns or 0)
            for name, topic in topics.items()
            if topic.has_gap
        ),
        reverse=True,
    )
    for gap_ns, name, since_ns in gaps[:_MOST_GAPS]:
        yield f"Gap: {name} has no message for {gap_ns * 1e-9:.0f} s from {iso_time(since_ns, 's')}"
    if len(gaps) > _MOST_GAPS:
        yield f"Gaps on {len(gaps) - _MOST_GAPS} more topics; --json lists them"
