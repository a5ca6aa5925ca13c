"""The studies on missions on the console, as CSV and JSON, and as a page: which figures keep to their limits."""

import re
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from replay_kit.show.page import Section
from replay_kit.studies.missions.follow import MissionRow
from replay_kit.studies.missions.run import MissionResult
from replay_kit.studies.reports.charts import Axis, Chart, Series, chart_figure
from replay_kit.studies.reports.page import (
    PAGE,
    StudyReport,
    criteria_html,
    study_page,
    tables_html,
    words_html,
)
from replay_kit.studies.reports.tables import (
    Criterion,
    Table,
    answer_of,
    grouped,
    limits_text,
    met_text,
    rows_to_csv,
)


def to_json(result: MissionResult) -> dict[str, Any]:
    """Return the JSON object of ``--json``; undefined figures are null."""
    return answer_of(asdict(result), "numpy", "scipy")


def study_table(result: MissionResult, study: str) -> Table:
    """Return the figures of one study as people read them."""
    times = f" of {result.times} times" if result.times > 1 else ""
    missions = f"{result.job.seeds} missions each, {result.job.pings} pings of {result.job.noise:g} m/s noise"
    rows = tuple(
        (
            row.method,
            row.figure,
            row.value,
            limits_text(row.at_least, row.at_most),
            met_text(row.met),
            row.by_mission,
        )
        for row in result.rows
        if row.study == study
    )
    title = f"{study}: {len(result.members)} truths{times}, {missions}"
    return Table(study, title, ("method", "figure", "value", "required", "", "by mission"), rows)


FILES = ("missions.csv", "missions.json", PAGE)
_TITLES = {
    "outliers": "Outliers",
    "bias": "Biases of compass and scale",
}
_CAPTION = "Dots: single missions; diamond: all missions together; bars: the limits required, where there are any."


def report_of(result: MissionResult) -> StudyReport:
    """Return what the studies say so far: a table each, and the missions that are left out."""
    return StudyReport(
        "missions",
        to_json(result),
        [study_table(result, study) for study in result.job.studies],
        [f"excluded: {why}" for why in result.lost],
        {"missions.csv": rows_to_csv(MissionRow, result.rows)},
        None if result.unfinished else lambda: {PAGE: missions_page(result)},
    )


def missions_page(result: MissionResult) -> str:
    """Return the page of finished studies: a section each."""
    sections = [
        Section(
            "answer",
            "In words",
            _answer(result),
            missing=[f"Excluded: {why}." for why in result.lost],
        )
    ]
    sections += [_section(result, study) for study in result.job.studies]
    return study_page("The estimator on simulated missions", sections, to_json(result))


def _answer(result: MissionResult) -> str:
    job = result.job
    flown = (
        f"Gliders fly through {len(result.members)} members of `{result.ensemble}` withheld from the estimator, {job.seeds} for each,"
        f" with {job.pings} pings of {job.noise:g} m/s noise."
    )
    return words_html([flown]) + criteria_html(
        [
            Criterion(
                f"{row.study}, {row.method}, {row.figure}", row.value, row.at_least, row.at_most
            )
            for row in result.rows
            if row.met is not None
        ]
    )


def _section(result: MissionResult, study: str) -> Section:
    rows = [row for row in result.rows if row.study == study]
    by_unit = grouped(rows, _unit)
    figures = [chart_figure(_chart(study, unit, alike)) for unit, alike in by_unit.items()]
    missing = () if rows else ("No mission of this study is left.",)
    return Section(
        study, _TITLES[study], tables_html([study_table(result, study)]), figures, missing
    )


def _unit(row: MissionRow) -> str:
    found = re.search(r"\[(.+)\]", row.figure)
    return found[1] if found else "1"


def _chart(study: str, unit: str, rows: Sequence[MissionRow]) -> Chart:
    labels = tuple(f"{row.method}: {row.figure.partition(' [')[0]}" for row in rows)
    missions = [(value, k) for k, row in enumerate(rows) for value in row.by_mission]
    limits = [
        (limit, k)
        for k, row in enumerate(rows)
        for limit in (row.at_least, row.at_most)
        if limit == limit
    ]
    whole = [(row.value, k) for k, row in enumerate(rows)]
    parts = (
        ("each mission", missions, "circle-open"),
        ("all missions", whole, "diamond"),
        ("limit", limits, "line-ns"),
    )
    series = tuple(
        Series(name, [x for x, _ in each], [y for _, y in each], "markers", symbol)
        for name, each, symbol in parts
        if each
    )
    key, title = (
        f"{study}-{re.sub('[^a-z0-9]+', '-', unit)}",
        f"{_TITLES[study]}: figures in {unit}" if unit != "1" else f"{_TITLES[study]}: ratios",
    )
    return Chart(
        key,
        title,
        _CAPTION,
        (Axis(f"value [{unit}]"), Axis("figure [name]", labels=labels)),
        series,
    )
