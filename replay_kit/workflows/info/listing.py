"""Listing of logs and of forecast files for people and as JSON, and the next command."""

import shlex
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.table import Table

from replay_kit.core.grid import Ensemble
from replay_kit.core.words.text import count_text
from replay_kit.logs.merge import BY_HEADER
from replay_kit.logs.opening import pattern
from replay_kit.logs.payloads import merged_notes
from replay_kit.logs.tables.schemas import NOT_A_KIND
from replay_kit.results.losses import (
    coded_reasons,
    loss_json,
    loss_lines,
    unchecked_lines,
    undecodable_json,
    undecodable_lines,
)
from replay_kit.show.text import folded, iso, not_used_lines, print_lines, print_table, short_times
from replay_kit.workflows.info.inspect import LogContent, LogInfo, span_of, use_of

# a log is listed without the libraries of forecasts
if TYPE_CHECKING:
    from replay_kit.forecast.describe import Description

_MOST_LABELS = 6


def ensemble_json(found: "Description") -> dict[str, Any]:
    """Return the description of an ensemble for JSON."""
    ensemble, check = found.ensemble, found.check
    return {
        "files": found.source,
        "grid_files": [path.name for path in found.grids],
        "use": found.use,
        "members_rule": found.rule or None,
        "members": [] if ensemble is None else list(ensemble.members),
        "velocities": list(found.names),
        "arrangement": found.arrangement,
        "axes": None
        if check is None
        else {"read_along": check.axes, "because": check.why, "largest_angle_degrees": check.angle},
        "axes_check": None
        if check is None
        else {
            "residual": check.residual,
            "geostrophic_phase_degrees": check.phase,
            "contradicted": check.contradicted,
        },
        "time": None if ensemble is None else _time(ensemble),
        "grid": None if ensemble is None else list(ensemble.grid.longitude.shape),
        "levels": [] if ensemble is None else ensemble.grid.levels.tolist(),
        "wet_share": None if ensemble is None else float(ensemble.grid.wet[0].mean()),
        "notes": [] if ensemble is None else list(ensemble.notes),
    }


def print_ensemble(found: "Description", console: Console) -> None:
    """Print the description of an ensemble."""
    table = Table("forecast", found.source, title_justify="left")
    for path in found.grids if found.ensemble is not None else ():
        table.add_row("file of the grid, no current", path.name)
    ensemble, check = found.ensemble, found.check
    if ensemble is not None and check is not None:
        grid = ensemble.grid
        table.add_row("velocities", f"{found.names[0]}, {found.names[1]}: {found.arrangement}")
        table.add_row(
            "axes",
            f"{_AXES[check.axes]} ({check.why}); grid turned by up to {check.angle:.1f} degrees; {check.figures}",
        )
        table.add_row(
            "members",
            f"{ensemble.n_members} by --members {found.rule}" if found.rule else "one field",
        )
        for label in _shortened(ensemble.members):
            table.add_row("", label)
        table.add_row("time", _time(ensemble) or "none stated")
        table.add_row(
            "grid",
            f"{grid.longitude.shape[0]} x {grid.longitude.shape[1]} points, {grid.longitude.min():.3f}..{grid.longitude.max():.3f} E, "
            f"{grid.latitude.min():.3f}..{grid.latitude.max():.3f} N, {100 * grid.wet[0].mean():.0f} % of the first level water",
        )
        table.add_row("levels", f"{grid.levels.size}, {grid.levels[0]:g} to {grid.levels[-1]:g} m")
        table.add_row("speed", f"{np.sqrt(2.0) * ensemble.component_rms:.3f} m/s rms")
    console.print(table)
    console.print(f"Use: {found.use}")
    for note in () if ensemble is None else ensemble.notes:
        console.print(f"Note: {note}")


_AXES = {"grid": "along the grid, turned to true east and north", "true": "true east and north"}


def _time(ensemble: Ensemble) -> str | None:
    return (
        None
        if ensemble.time_ns is None
        else f"{np.datetime_as_string(np.datetime64(ensemble.time_ns, 'ns'), unit='s')}Z"
    )


def _shortened(labels: tuple[str, ...]) -> list[str]:
    """Return the first and last labels, and the number between them."""
    if len(labels) <= _MOST_LABELS:
        return list(labels)
    half = _MOST_LABELS // 2
    return [*labels[:half], f"... {len(labels) - 2 * half} more ...", *labels[-half:]]


def info_json(info: LogInfo) -> dict[str, Any]:
    """Return the description of a log for JSON; what an index does not tell is null."""
    report, content, whole = info.report, info.content, info.sampled is None
    counts = {
        "profiles": content.profiles,
        "bins": content.bins,
        "mean_currents": content.mean_currents,
        "surface_currents": content.surface,
        "positions": content.positions,
        "dives": info.dives,
        "box": content.box,
        "depths": content.depths,
    }
    return {
        "file": report.path,
        "format": report.format,
        "read": {"whole": whole, "messages": info.sampled or sum(report.read.values())},
        "mission": report.mission,
        "use": info.use,
        "missing": info.missing,
        "mappable": dict(info.mappable),
        **(counts if whole else dict.fromkeys(counts)),
        "topics": [
            {
                "topic": name,
                "schema": topic.schema,
                "messages": topic.messages,
                "first": iso(topic.first_ns),
                "last": iso(topic.last_ns),
            }
            for name, topic in info.topics.items()
        ],
        "not_used": {topic: coded_reasons(reasons) for topic, reasons in info.not_used.items()},
        "undecodable": undecodable_json(report.undecodable),
        "notes": report.notes,
        "losses": [loss_json(loss) for loss in report.losses],
        "unchecked": dict(report.unchecked),
    }


def print_infos(logs: Sequence[LogInfo], console: Console, verbose: bool = False) -> None:
    """Print the contents of logs: of a single log its topics, of several one row each, unless verbose."""
    each = [[log] for log in logs] if verbose or len(logs) == 1 else [logs] if logs else []
    for some in each:
        columns, rows = _topics(some[0], verbose) if len(some) == 1 else _logs(some)
        print_table(console, _heading(some), columns, rows)
        print_lines(console, _lines(some, verbose))
    content = next((log.together for log in logs if log.together is not None), None)
    if content is not None:
        missing = (f"Missing for a replay: {log.missing}" for log in logs if log.missing)
        print_lines(
            console, [f"Together: {use_of(content)}. {_counts(content)}", *islice(missing, 1)]
        )


# reasons, notes and losses of several logs that are printed; -v prints all
_MOST_LINES = 2


def _heading(logs: Sequence[LogInfo]) -> str:
    """Return the missions, formats and time span of logs."""
    missions, formats = (
        ", ".join(dict.fromkeys(filter(None, values)))
        for values in ([log.report.mission for log in logs], [log.report.format for log in logs])
    )
    name = logs[0].report.path if len(logs) == 1 else missions or count_text(len(logs), "log")
    ends = [end for log in logs for end in span_of(log.topics) or ()]
    span = f", {iso(min(ends))} to {iso(max(ends))}" if ends else ""
    return f"{name} ({formats}){span}"


def _topics(log: LogInfo, verbose: bool) -> tuple[Sequence[str], list[tuple[str, ...]]]:
    """Return the table of a log's topics; those that differ only in a number share a row unless verbose."""
    topics = log.topics
    times = short_times([at for one in topics.values() for at in (one.first_ns, one.last_ns)])
    rows = (
        (name, topic.schema, str(topic.messages), first, last)
        for (name, topic), first, last in zip(topics.items(), times[::2], times[1::2], strict=True)
    )
    return ("topic", "schema", "messages", "first", "last"), folded(rows, verbose)


def _logs(logs: Sequence[LogInfo]) -> tuple[Sequence[str], list[tuple[str, ...]]]:
    """Return the table of several logs; figures unknown from an index alone are empty."""
    times = short_times([end for log in logs for end in span_of(log.topics) or (None, None)])
    rows = []
    for log, first, last in zip(logs, times[::2], times[1::2], strict=True):
        content = log.content
        counts = content.profiles, content.mean_currents, content.positions, log.dives
        numbers = map(str, counts) if log.sampled is None else [""] * len(counts)
        rows.append((Path(log.report.path).name, first, last, *numbers))
    return ("log", "first", "last", "profiles", "mean currents", "positions", "dives"), rows


def _lines(logs: Sequence[LogInfo], verbose: bool) -> Iterator[str]:
    """Yield lines on what logs hold, lack and lost; of several logs the first lines of each kind."""
    some = first_lines if len(logs) > 1 else iter
    if len(logs) == 1:
        yield from (f"Mission: {log.report.mission}" for log in logs if log.report.mission)
        yield from _content_lines(logs[0])
    else:
        yield from (
            f"Use: {use}" if count == len(logs) else f"Use of {count} of {len(logs)}: {use}"
            for use, count in Counter(log.use for log in logs).items()
        )
    if boxes := [log.content.box for log in logs if log.content.box is not None]:
        (west, south, *_), (*_, east, north) = np.min(boxes, axis=0), np.max(boxes, axis=0)
        yield f"Positions: {west:.4f}..{east:.4f} E, {south:.4f}..{north:.4f} N"
    not_used: dict[str, Counter[str]] = defaultdict(Counter)
    for log in logs:
        for topic, reasons in log.not_used.items():
            not_used[topic].update({why: n for why, n in reasons.items() if why != NOT_A_KIND})
    yield from some([line for log in logs for line in loss_lines(log.report)])
    yield from some([*not_used_lines(not_used, verbose)])
    yield from some([line for log in logs for line in undecodable_lines(log.report.undecodable)])
    yield from some([line for log in logs for line in unchecked_lines(log.report)])
    missing = dict.fromkeys(log.missing for log in logs if log.missing and log.together is None)
    yield from (f"Missing for a replay: {one}" for one in missing)
    mappable = {(topic, kind): None for log in logs for topic, kind in log.mappable.items()}
    yield from some([f"Unknown type: {topic} looks like a {kind}" for topic, kind in mappable])
    notes = merged_notes(note for log in logs for note in log.report.notes)
    yield from some([f"Note: {note}" for note in notes])


def first_lines(lines: Sequence[str]) -> Iterator[str]:
    """Yield the first lines, and the number of the others."""
    yield from lines[:_MOST_LINES]
    if len(lines) > _MOST_LINES:
        yield f"{lines[0].partition(':')[0]}: {len(lines) - _MOST_LINES} more; -v prints all"


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
    yield f"Use: {log.use}. {_counts(content)}, {log.dives} dives"
    if content.surface:
        yield f"Currents by radar, drifters or other sensors: {content.surface} measurements"
    if content.depths is not None:
        yield f"Bins: {content.depths[0]:.0f}..{content.depths[1]:.0f} m"
    elif content.profiles:
        yield "Bins: none usable; replay-kit qc names the tests that they fail"


def _counts(content: LogContent) -> str:
    profiles = f"{content.profiles} profiles with {content.bins} usable bins"
    return f"{profiles}, {content.positions} positions, {content.mean_currents} mean currents"


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
        notes = (note for log in logs for note in log.report.notes)
        mended = ("--clock", "header") * any(note.endswith(BY_HEADER) for note in notes)
        settings = "".join(f"{shlex.quote(word)} " for word in (*options, *mended))
        return [f"Next: replay-kit replay {given} --ensemble {forecast} {settings}-o RESULT.mcap"]
    if results := [log.files[0] for log in logs if log.is_result]:
        return [f"Next: replay-kit report {shlex.quote(str(results[0]))}"]
    if any(log.mappable for log in logs):
        return [
            f"Next: replay-kit info {given} --suggest map.toml",
            f"Correct map.toml, then: replay-kit info {given} --config map.toml",
        ]
    return [
        f"Next: replay-kit info {given} ANOTHER_LOG",
        "ANOTHER_LOG is a log of this mission with the missing data",
    ]
