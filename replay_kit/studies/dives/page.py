"""The predictions of dives on the console, as CSV and JSON, and as a page: how far the estimate helped to predict the next dive."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from replay_kit.results.outcome.from_run import surfacings_json
from replay_kit.show.page import Section
from replay_kit.show.words import surfacings_sentences
from replay_kit.studies.dives.run import DivePrediction, DivesResult
from replay_kit.studies.reports.charts import Axis, Chart, Series, chart_figure, series_by
from replay_kit.studies.reports.page import (
    PAGE,
    StudyReport,
    list_html,
    study_page,
    tables_html,
    words_html,
)
from replay_kit.studies.reports.tables import (
    Table,
    answer_of,
    number,
)
from replay_kit.studies.reports.tables import to_csv as table_to_csv
from replay_kit.workflows.replay.scoring import rms_length

TITLES = {
    "profiles": "RMS length of the error of profiles",
    "mean": "RMS length of the error of depth-averaged currents",
}


def sentences_of(result: DivesResult) -> list[str]:
    """Return calibration and surfacings in words; nothing of what the log does not have."""
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
    }


FILES = ("dives.csv", "dives.json", PAGE)
_DIVES = Axis("dive [number]")
_NAMES = {"profiles": "profiles of the current", "mean": "depth-averaged currents"}


def report_of(result: DivesResult) -> StudyReport:
    """Return what the predictions say so far: errors by dive and method, calibration, surfacings."""
    return StudyReport(
        "dives",
        to_json(result),
        [dive_table(result, kind) for kind in TITLES if result.rmse(kind)],
        sentences_of(result),
        {"dives.csv": to_csv(result)},
        None if result.unfinished else lambda: {PAGE: dives_page(result)},
    )


def dives_page(result: DivesResult) -> str:
    """Return the page of all dives predicted."""
    kinds = [kind for kind in TITLES if result.rmse(kind)]
    sentences = [
        *(_best(result, kind) for kind in kinds),
        *(f"{each}." for each in sentences_of(result)),
    ]
    lost = [
        f"No dive after the first has {_NAMES[kind]} to compare with."
        for kind in TITLES
        if kind not in kinds
    ]
    figures = [chart_figure(_errors(result, kind)) for kind in kinds]
    surfaced = [dive for dive in result.dives if dive.surfacing is not None]
    if surfaced:
        figures.append(chart_figure(_surfacings(surfaced)))
    conditions = (
        f"Each of {len(result.dives)} dives is predicted from the dives before it, on the ensemble `{result.ensemble}`. The baselines use "
        "the dives alone: the last one, or a mean of all."
    )
    sections = [
        Section(
            "answer", "In words", words_html([conditions]) + list_html(sentences), missing=lost
        ),
        Section(
            "dives",
            "Dive by dive",
            tables_html([dive_table(result, kind) for kind in kinds]),
            figures,
        ),
    ]
    answer = to_json(result)
    options = {name: answer[name] for name in ("ensemble", "oscillators", "versions")}
    return study_page("Each dive predicted from those before it", sections, options)


def _best(result: DivesResult, kind: str) -> str:
    rmse = result.rmse(kind)
    others = {method: value for method, value in rmse.items() if method != "estimate"}
    nearest = min(others, key=others.__getitem__)
    return (
        f"{_NAMES[kind].capitalize()}: the estimate errs by *{number(100.0 * rmse['estimate'], 1)} cm/s* (RMS length), the best of the "
        f"others, {nearest.replace('_', ' ')}, by {number(100.0 * others[nearest], 1)} cm/s."
    )


def _errors(result: DivesResult, kind: str) -> Chart:
    series = series_by(
        (method.replace("_", " "), dive.number, 100.0 * rmse)
        for dive in result.dives[1:]
        for method, rmse in rmse_of(dive, kind).items()
    )
    caption = "Lower is better. Where the estimate lies below the others, what it learned from earlier dives helped to predict this one."
    return Chart(
        f"errors-{kind}", TITLES[kind], caption, (_DIVES, Axis("RMS error [cm/s]")), series
    )


def _surfacings(dives: Sequence[DivePrediction]) -> Chart:
    found = [(dive.number, dive.surfacing) for dive in dives if dive.surfacing is not None]
    numbers = [number for number, _ in found]
    series = (
        Series("distance from the fix", numbers, [one.distance for _, one in found]),
        Series(
            "longer half axis of the ellipse",
            numbers,
            [one.forecast.outer.major for _, one in found],
        ),
        Series("shorter half axis", numbers, [one.forecast.outer.minor for _, one in found]),
    )
    caption = "How far off the dive surfaced from where the estimate expected it, beside the ellipse's half axes (90 %)."
    return Chart(
        "surfacings",
        "Predicted and real surfacings",
        caption,
        (_DIVES, Axis("distance [m]")),
        series,
    )
