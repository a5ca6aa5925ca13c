"""Terminal summary of a run: ten lines per vehicle, with ``verbose`` also tables and sentences."""

from collections.abc import Iterator, Mapping
from typing import Any

from rich.console import Console

from replay_kit.core.errors import finding_line
from replay_kit.results.losses import lost_text
from replay_kit.results.outcome.outcome import Outcome
from replay_kit.show.sentences import (
    COLUMNS,
    comparison_sentences,
    estimate_sentences,
    flown_sentences,
    trust_sentences,
    truth_sentences,
    vehicle_rows,
    vehicle_sentences,
)
from replay_kit.show.status.lines import detail_lines, lines, title
from replay_kit.show.status.status import Status
from replay_kit.show.text import not_used_lines, print_lines, print_table

_DIVE_COLUMNS = (
    "dive",
    "profiles",
    "bins",
    "DACs",
    "predicted from earlier dives",
    "prior forecast",
    "NIS/dof",
)


def print_summary(
    statuses: Mapping[str, Status],
    outcome: Outcome | None,
    console: Console,
    *,
    verbose: bool = False,
    titled: bool = False,
) -> None:
    """Print the summary of a result.

    Args:
        statuses: Status of each vehicle by name; the name of a single one is empty.
        outcome: Outcome of the run; None if unfinished.
        console: Output console.
        verbose: Whether to print tables, notes and sentences.
        titled: Whether to begin with a title of result, dive and last fix, and to omit the losses.
    """
    if "" not in statuses and outcome is not None:
        print_table(console, "Vehicles", COLUMNS, vehicle_rows(outcome))
        print_lines(console, [] if verbose else vehicle_alarms(outcome))
    for name, status in statuses.items():
        if name and not (titled or verbose):
            continue
        print_lines(console, [title(status)] if titled or name else [])
        print_lines(console, map(str, lines(status)))
        print_lines(console, detail_lines(status) if verbose else [])
    if outcome is None:
        return
    print_lines(console, [] if titled else _lost(outcome))
    if verbose:
        _print_tables(outcome, console)
    else:
        found = outcome.consistency
        severe = (one for one in found if one["severity"] != "warning")
        # evidence has the terms of statistics
        print_lines(console, (finding_line(one, evidence=False) for one in severe))
        asked = truth_sentences(outcome.truth) if outcome.truth is not None else ()
        print_lines(console, map(str, asked))
        compared = outcome.comparison
        print_lines(console, map(str, comparison_sentences(compared) if compared else ()))


def vehicle_alarms(outcome: Outcome) -> Iterator[str]:
    """Yield a line for each vehicle's alarm."""
    for name, of_vehicle in outcome.vehicles.items():
        yield from (f"ALARM      {name}: {alarm.text}" for alarm in of_vehicle.alarms)


def _print_tables(outcome: Outcome, console: Console) -> None:
    """Print the tables and sentences behind a summary."""
    print_lines(console, map(finding_line, outcome.consistency))
    if outcome.vehicles:
        print_lines(console, vehicle_sentences(outcome))
    topics = outcome.messages or ()
    rows = [
        (row["topic"], *(str(row[name]) for name in ("read", "used", "skipped"))) for row in topics
    ]
    if rows:
        columns = ("topic", "read", "used", "skipped")
        print_table(console, "Messages", columns, rows)
    why = {row["topic"]: {one["reason"]: one["count"] for one in row["reasons"]} for row in topics}
    print_lines(console, not_used_lines(why))
    print_lines(console, map(str, estimate_sentences(outcome)))
    if outcome.by_dive:
        cells = map(_dive_cells, outcome.by_dive)
        print_table(console, "RMS innovation by dive [cm/s]", _DIVE_COLUMNS, cells)
    print_lines(console, map(str, [*flown_sentences(outcome), *trust_sentences(outcome)]))
    if outcome.seconds:
        each = (f"{stage} {seconds:.2f} s" for stage, seconds in outcome.seconds.items())
        print_lines(console, [f"Time: {', '.join(each)}"])
    print_lines(console, (f"Note: {note}" for note in outcome.notes))
    for name, of_vehicle in outcome.vehicles.items():
        console.print()
        console.print(name)
        _print_tables(of_vehicle, console)


def _dive_cells(row: Mapping[str, Any]) -> tuple[str, ...]:
    rms = (
        "" if row[name] is None else f"{100.0 * row[name]:.2f}"
        for name in ("rms_innovation_predicted", "rms_innovation_prior")
    )
    counts = (str(row.get(name, "")) for name in ("dive", "profiles", "bins", "mean_currents"))
    return *counts, *rms, "" if row["nis_per_dof"] is None else f"{row['nis_per_dof']:.2f}"


def _lost(outcome: Outcome) -> Iterator[str]:
    """Yield a line for each loss in the logs."""
    yield from (f"LOST       {one['file']}: {lost_text(one)}" for one in outcome.losses)
    if outcome.late:
        yield f"LOST       {outcome.late} late messages: widen logs.reorder_window"
