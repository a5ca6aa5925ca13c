"""Predictions of dives as tables and JSON."""

from dataclasses import asdict
from typing import Any

import numpy as np
from rich.console import Console

from replay_kit.results.outcome.figures import surfacings_json
from replay_kit.show.words import surfacings_sentences
from replay_kit.studies.dives.run import DivePrediction, DivesResult
from replay_kit.studies.reports.tables import Table
from replay_kit.studies.reports.write import answer_of, number, print_tables
from replay_kit.studies.reports.write import to_csv as table_to_csv
from replay_kit.workflows.replay.scoring import rms_length

TITLES = {
    "profiles": "RMS length of the error of profiles",
    "mean": "RMS length of the error of depth-averaged currents",
}


def print_dives(result: DivesResult, console: Console) -> None:
    """Print what a person reads: errors by dive and method, calibration, surfacings."""
    print_tables(console, [dive_table(result, kind) for kind in TITLES if result.rmse(kind)])
    for sentence in sentences_of(result):
        console.print(sentence, soft_wrap=True)


def sentences_of(result: DivesResult) -> list[str]:
    """Return calibration, surfacings and fitted settings in words; nothing of what the log does not have."""
    out = []
    if np.isfinite(result.nis_per_dof):
        covered = result.coverages().values()
        next_dive, held = (
            ", ".join(f"{value:.0%} of {share:.0%}" for share, value in shares.items())
            for shares in covered
        )
        out = [
            f"Next dives: NIS per degree of freedom {result.nis_per_dof:.2f}; bins inside their intervals: {next_dive}",
            f"Bins withheld from a dive, given its others, inside their intervals: {held}",
        ]
    surfacings = surfacings_of(result)
    if surfacings is not None:
        out.append(f"Surfacings: {'; '.join(surfacings_sentences(surfacings))}")
    if result.fitted:
        words = ", ".join(
            f"{name} {value:g}" for name, value in asdict(result.dives[-1].settings).items()
        )
        out.append(f"Fitted to the dives before the last: {words}")
    return out


def surfacings_of(result: DivesResult) -> dict[str, Any] | None:
    """Return hits, score and sharpness of the expected surfacings; None without any."""
    outcomes = [dive.surfacing for dive in result.dives if dive.surfacing is not None]
    return surfacings_json(outcomes, None) if outcomes else None


def dive_table(result: DivesResult, kind: str) -> Table:
    """Return the errors of one kind as people read them, dive by dive."""
    overall = result.rmse(kind)
    by_dive = [(str(dive.number), rmse_of(dive, kind)) for dive in result.dives[1:]]
    rows = tuple(
        (dive, *(number(100.0 * rmse[method], 1) if method in rmse else "" for method in overall))
        for dive, rmse in [*by_dive, ("all", overall)]
    )
    return Table(
        kind,
        f"{TITLES[kind]}, cm/s",
        ("dive", *(method.replace("_", " ") for method in overall)),
        rows,
    )


def rmse_of(dive: DivePrediction, kind: str) -> dict[str, float]:
    """Return the root mean square length of a dive's error vectors [m/s], by method."""
    return {method: rms_length(error) for method, error in dive.errors[kind].items()}


def to_csv(result: DivesResult) -> str:
    """Return the errors as CSV: a row for each dive, kind and method [m/s]."""
    rows = [
        (dive.number, kind, method, rmse)
        for dive in result.dives
        for kind in TITLES
        for method, rmse in rmse_of(dive, kind).items()
    ]
    return table_to_csv(
        Table("dives", "All errors", ("dive", "kind", "method", "rmse"), tuple(rows))
    )


def to_json(result: DivesResult) -> dict[str, Any]:
    """Return the result's figures for JSON; undefined ones are null, as is a scale that is infinite."""
    answer = {
        "rmse": {kind: result.rmse(kind) for kind in TITLES},
        "nis_per_dof": result.nis_per_dof,
        "coverage": {
            name: {f"{share:g}": value for share, value in shares.items()}
            for name, shares in result.coverages().items()
        },
        "surfacings": surfacings_of(result),
        "dives": [_dive_json(dive) for dive in result.dives],
        "ensemble": result.ensemble,
        "fitted": result.fitted,
        "oscillators": result.oscillators,
        "unfinished": result.unfinished,
    }
    return answer_of(answer, "numpy")


def _dive_json(dive: DivePrediction) -> dict[str, Any]:
    return {
        "dive": dive.number,
        "bins": len(dive.std),
        **{f"rmse_{kind}": rmse_of(dive, kind) for kind in TITLES},
        "nis_per_dof": dive.nis / dive.dof if dive.dof else None,
        "settings": asdict(dive.settings),
    }
