"""The outcome of a replay as the tables and sentences that are printed at the end of a run."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rich.console import Console

from replay_kit.core.errors import finding_line
from replay_kit.results.losses import lost_text
from replay_kit.results.outcome.outcome import Outcome, outcome_from
from replay_kit.show.text import folded, not_used_lines, print_lines, print_table
from replay_kit.show.vehicles import (
    ABOUT_VALUE,
    COLUMNS,
    vehicle_rows,
    vehicle_sentences,
)
from replay_kit.show.words import (
    evidence_sentence,
    flight_correction_sentence,
    outcomes_sentence,
    plan_sentence,
    referee_sentences,
    source_sentence,
    surfacings_sentences,
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
        print_lines(console, [*estimate_sentences(outcome), *_further_sentences(outcome)])
        if verbose:
            for name, values in outcome.vehicles.items():
                console.print(f"\n{name}", soft_wrap=True)
                print_summary(outcome_from(values), console, verbose)
        return
    rows = [
        (row["topic"], *(str(row[name]) for name in ("read", "used", "skipped"))) for row in topics
    ]
    print_table(console, "Messages", ("topic", "read", "used", "skipped"), folded(rows, verbose))
    why = {row["topic"]: {one["reason"]: one["count"] for one in row["reasons"]} for row in topics}
    print_lines(console, not_used_lines(why, verbose))
    print_lines(console, estimate_sentences(outcome))
    if verbose and outcome.by_dive:
        cells = map(_dive_cells, outcome.by_dive)
        print_table(console, "RMS innovation by dive [cm/s]", _DIVE_COLUMNS, cells)
    elif outcome.by_dive:
        print_lines(console, [_dive_sentence(outcome.by_dive)])
    print_lines(console, _further_sentences(outcome))


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
    bins = sum(row["bins"] for row in known)

    def rms(name: str) -> str:
        squares = sum(row["bins"] * row[f"rms_innovation_{name}"] ** 2 for row in known)
        return _cm(math.sqrt(squares / bins)) if bins else "none"

    worst = sorted(known, key=lambda row: -row["rms_innovation_predicted"])[:_WORST]
    named = ", ".join(f"{row['dive']} ({_cm(row['rms_innovation_predicted'])})" for row in worst)
    return (
        f"Dives: {len(dives)}; RMS innovation {rms('predicted')} predicted from earlier dives, {rms('prior')} by the prior forecast; "
        f"worst: {named}; -v shows all"
    )


def _further_sentences(outcome: Outcome) -> Iterator[str]:
    """Yield plan, surfacings, truth, times, notes and losses, each as a sentence."""
    plan = outcome.plan
    if plan is not None:
        # one that was never made has nothing but the reason
        made = "statistics" in plan
        yield "Plan: " + (plan_sentence(plan) if made else f"none; {plan['message']}")
    if outcome.surfacings is not None:
        yield f"Plan vs. actual surfacings: {outcomes_sentence(outcome.surfacings)}"
    if outcome.evidence is not None:
        yield f"Log evidence: {evidence_sentence(outcome.evidence)}"
    if outcome.referee is not None:
        yield from (f"Referee: {text}" for text in referee_sentences(outcome.referee))
    if outcome.expected_surfacings is not None:
        yield f"Predicted surfacings: {'; '.join(surfacings_sentences(outcome.expected_surfacings))}"
    if outcome.truth is not None:
        yield from _truth_sentences(outcome.truth)
    yield "Time: " + ", ".join(
        f"{stage} {seconds:.2f} s" for stage, seconds in outcome.seconds.items()
    )
    yield from (f"Note: {note}" for note in outcome.notes)
    yield from (f"LOST: {one['file']}: {lost_text(one)}" for one in outcome.losses)
    if outcome.late:
        yield f"LOST: {outcome.late} messages came later than the reorder window allows; widen logs.reorder_window"


def estimate_sentences(outcome: Outcome) -> Iterator[str]:
    """Yield what was used, how well it was predicted, and the flight model's correction, each as a sentence."""
    counts, rms = outcome.observations, outcome.rms_innovation
    rejected = ", ".join(f"{count} {name}" for name, count in counts["bins_rejected"].items())
    means = counts.get("mean_currents", 0)
    others, values = (
        sum(row[name] for row in counts.get("sources", ())) for name in ("used", "values")
    )
    own = counts["used"] - means - others
    profiles = f"{own} profiles used ({counts['bins_used'] - means - values // 2} bins)"
    currents = f"{means} mean {'current' if means == 1 else 'currents'} used"
    used = [
        *([profiles] if own or not means + others else []),
        *([currents] if means else []),
    ]
    yield f"Observations: {', '.join(used)}, {counts['rejected']} rejected; bins not used: {rejected or 'none'}"
    for row in counts.get("sources", ()):
        yield f"Also used: {source_sentence(row)}"
    nis = "none" if outcome.nis_per_dof is None else f"{outcome.nis_per_dof:.2f}"
    yield (
        f"RMS innovation: {_cm(rms['before'])} before each update, {_cm(rms['after'])} after it, "
        f"{_cm(rms['prior'])} by the prior forecast; NIS per degree of freedom {nis}"
    )
    if outcome.flight_correction is not None:
        yield f"Flight model: {flight_correction_sentence(outcome.flight_correction)}"


def _truth_sentences(truth: Mapping[str, Any]) -> Iterator[str]:
    yield (
        f"Against the truth over {truth['points']} grid points: RMSE {_cm(truth['rmse'])} (relative error {truth['rel_error']:.3f}); "
        f"ensemble mean {_cm(truth['ensemble_mean_rmse'])}"
    )
    if truth["closest_approach_m"] is not None:
        yield (
            f"Flown in the truth, the plan passes {truth['closest_approach_m']:.0f} m from the goal; "
            f"the ensemble mean's plan {truth['ensemble_mean_closest_approach_m']:.0f} m"
        )


def _cm(value: float | None) -> str:
    return "none" if value is None else f"{100.0 * value:.2f} cm/s"
