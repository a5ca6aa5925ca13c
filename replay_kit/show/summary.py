"""The outcome of a replay as the tables and sentences that are printed at the end of a run."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rich.console import Console

from replay_kit.core.errors import finding_line
from replay_kit.results.losses import lost_text
from replay_kit.results.outcome.outcome import Outcome
from replay_kit.show.sentences import estimate_sentences, further_sentences
from replay_kit.show.text import folded, not_used_lines, print_lines, print_table
from replay_kit.show.vehicles import (
    ABOUT_VALUE,
    COLUMNS,
    vehicle_rows,
    vehicle_sentences,
)

# Dives that the summary names.
_WORST = 3
_DIVE_COLUMNS = (
    "dive",
    "profiles",
    "bins",
    "predicted from earlier dives",
    "prior forecast",
    "NIS/dof",
)


def print_summary(outcome: Outcome, console: Console, verbose: bool = False) -> None:
    """Print the tables and sentences of the end of a replay.

    Args:
        outcome: What is printed.
        console: Where to.
        verbose: Whether each topic and each dive has a row of its own.
    """
    bad_plan, topics = outcome.plan_alarm, outcome.messages or ()
    print_lines(console, [f"ALARM: {bad_plan.text}"] if bad_plan else [])
    decision = outcome.decision
    basis = [text for text in outcome.verdict if text not in decision.reasons]
    lines = [f"Verdict: {decision!s}", f"Basis: {'; '.join(basis)}"]
    print_lines(console, [*lines, *map(finding_line, outcome.consistency)])
    if outcome.vehicles:
        print_table(console, "Vehicles", COLUMNS, vehicle_rows(outcome))
        print_lines(console, [ABOUT_VALUE, *vehicle_sentences(outcome)])
        print_lines(console, map(str, [*estimate_sentences(outcome), *further_sentences(outcome)]))
        print_lines(console, _closing_lines(outcome))
        if verbose:
            for name, own in outcome.vehicles.items():
                console.print(f"\n{name}")
                print_summary(own, console, verbose)
        return
    rows = [
        (row["topic"], *(str(row[name]) for name in ("read", "used", "skipped"))) for row in topics
    ]
    print_table(console, "Messages", ("topic", "read", "used", "skipped"), folded(rows, verbose))
    why = {row["topic"]: {one["reason"]: one["count"] for one in row["reasons"]} for row in topics}
    print_lines(console, not_used_lines(why, verbose))
    print_lines(console, map(str, estimate_sentences(outcome)))
    if verbose and outcome.by_dive:
        cells = map(_dive_cells, outcome.by_dive)
        print_table(console, "RMS innovation by dive [cm/s]", _DIVE_COLUMNS, cells)
    elif outcome.by_dive:
        print_lines(console, [_dive_sentence(outcome.by_dive)])
    print_lines(console, [*map(str, further_sentences(outcome)), *_closing_lines(outcome)])


def _dive_cells(row: Mapping[str, Any]) -> tuple[str, ...]:
    rms = (
        "" if row[name] is None else f"{100.0 * row[name]:.2f}"
        for name in ("rms_innovation_predicted", "rms_innovation_prior")
    )
    counts = (str(row[name]) for name in ("dive", "profiles", "bins"))
    return *counts, *rms, "" if row["nis_per_dof"] is None else f"{row['nis_per_dof']:.2f}"


def _dive_sentence(dives: Sequence[Mapping[str, Any]]) -> str:
    """Return how well dives were predicted, and the worst of them."""
    known = [row for row in dives if row["bins"] and row["rms_innovation_predicted"] is not None]
    if not known:
        return f"Dives: {len(dives)}, none of them with measurements that were predicted"
    bins = sum(row["bins"] for row in known)

    def rms(name: str) -> str:
        squares = sum(row["bins"] * row[f"rms_innovation_{name}"] ** 2 for row in known)
        return _cm(math.sqrt(squares / bins))

    worst = sorted(known, key=lambda row: -row["rms_innovation_predicted"])[:_WORST]
    named = ", ".join(f"{row['dive']} ({_cm(row['rms_innovation_predicted'])})" for row in worst)
    return (
        f"Dives: {len(dives)}; RMS innovation {rms('predicted')} predicted from earlier dives, {rms('prior')} by the prior forecast; "
        f"worst: {named}; -v shows all"
    )


def _closing_lines(outcome: Outcome) -> Iterator[str]:
    """Yield times, notes and losses."""
    yield "Time: " + ", ".join(
        f"{stage} {seconds:.2f} s" for stage, seconds in outcome.seconds.items()
    )
    yield from (f"Note: {note}" for note in outcome.notes)
    yield from (f"LOST: {one['file']}: {lost_text(one)}" for one in outcome.losses)
    if outcome.late:
        yield f"LOST: {outcome.late} messages came later than the reorder window allows; widen logs.reorder_window"


def _cm(value: float | None) -> str:
    return "-" if value is None else f"{100.0 * value:.2f} cm/s"
