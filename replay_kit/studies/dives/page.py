"""The predictions of dives to files; their page says how far the estimate helped the next dive."""

from collections.abc import Sequence
from pathlib import Path

from replay_kit.show.page import Section
from replay_kit.studies.dives.report import (
    TITLES,
    dive_table,
    rmse_of,
    sentences_of,
    to_csv,
    to_json,
)
from replay_kit.studies.dives.run import DivePrediction, DivesResult
from replay_kit.studies.reports.charts import Axis, Chart, Series, chart_figure
from replay_kit.studies.reports.page import PAGE, list_html, study_page, tables_html, words_html
from replay_kit.studies.reports.write import json_text, number, write_files

FILES = ("dives.csv", "dives.json", PAGE)
_DIVES = Axis("dive [number]")
_NAMES = {"profiles": "profiles of the current", "mean": "depth-averaged currents"}


def write_dives(out: Path, result: DivesResult) -> None:
    """Write ``FILES`` into a folder that exists, each whole or not at all; of unfinished predictions all but the page."""
    page = {} if result.unfinished else {PAGE: dives_page(result)}
    write_files(
        out, {"dives.csv": to_csv(result), "dives.json": json_text(to_json(result)), **page}
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
    options = {name: answer[name] for name in ("ensemble", "fitted", "oscillators", "versions")}
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
    by_method: dict[str, list[tuple[float, float]]] = {method: [] for method in result.rmse(kind)}
    for dive in result.dives[1:]:
        for method, rmse in rmse_of(dive, kind).items():
            by_method[method].append((dive.number, 100.0 * rmse))
    series = tuple(
        Series(method.replace("_", " "), [x for x, _ in each], [y for _, y in each])
        for method, each in by_method.items()
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
