"""The studies of planning to files: a page, a report in Markdown, a CSV for each table, JSON, pictures."""

from collections.abc import Sequence
from pathlib import Path

from replay_kit.show.page import Figure, Section
from replay_kit.studies.planning.job import PlanningResult, StudyReport
from replay_kit.studies.planning.report import all_tables, conditions, to_json, to_markdown
from replay_kit.studies.reports.charts import chart_figure, misses_chart
from replay_kit.studies.reports.page import (
    PAGE,
    list_html,
    picture_figures,
    study_page,
    tables_html,
    words_html,
)
from replay_kit.studies.reports.pictures import Drawn, drawn
from replay_kit.studies.reports.write import json_text, limits_text, to_csv, to_text, write_files


def replaced_files(out: Path, studies: tuple[str, ...]) -> list[Path]:
    """Return the files in a folder that a run of some studies would replace."""
    patterns = [
        PAGE,
        "report.md",
        "planning.json",
        *(f"{study}*.{ending}" for study in studies for ending in ("csv", "png")),
    ]
    return sorted(path for pattern in patterns for path in out.glob(pattern))


def write_planning(out: Path, result: PlanningResult) -> None:
    """Write everything into a folder that exists, each file whole or not at all; existing ones are replaced."""
    pictures = {
        picture.name: drawn(picture) for report in result.reports for picture in report.pictures
    }
    for report in result.reports:
        write_files(out, {f"{table.name}.csv": to_csv(table) for table in report.tables})
    write_files(out, {f"{name}.png": picture.files["png"] for name, picture in pictures.items()})
    write_files(
        out,
        {
            "planning.json": json_text(to_json(result)),
            "report.md": to_markdown(result),
            PAGE: planning_page(result, pictures),
        },
    )


def planning_page(result: PlanningResult, pictures: dict[str, Drawn]) -> str:
    """Return the page of the studies that are done.

    Args:
        result: The studies.
        pictures: Of all of them, by name.
    """
    done = {report.study for report in result.reports}
    missing = [
        f"Not done when this was written: {study}."
        for study in result.job.studies
        if study not in done
    ]
    sections = [
        Section(
            "answer",
            "In words",
            words_html([conditions(result)]) + _met(result.reports),
            missing=missing,
        )
    ]
    sections += [_section(report, pictures) for report in result.reports]
    return study_page(
        "Plans flown in truths that the estimates do not know", sections, to_json(result)
    )


def _met(reports: Sequence[StudyReport]) -> str:
    limited = [(report.title, one) for report in reports for one in report.criteria]
    not_met = [
        f"{title}: {one.what} is *{to_text(one.value)}*, required {limits_text(one.at_least, one.at_most)}"
        for title, one in limited
        if not one.met
    ]
    if not limited:
        return ""
    said = f"{len(limited) - len(not_met)} of {len(limited)} criteria are met{'; these are not:' if not_met else '.'}"
    return words_html([said]) + (list_html(not_met) if not_met else "")


def _section(report: StudyReport, pictures: dict[str, Drawn]) -> Section:
    missing = (f"The study failed: {report.failed}.",) if report.failed else ()
    figures = (
        *_misses(report),
        *picture_figures(
            [(each.name, each.caption, pictures[each.name]) for each in report.pictures]
        ),
    )
    return Section(
        report.study,
        report.title,
        words_html(report.findings) + tables_html(all_tables(report)),
        figures,
        missing,
    )


def _misses(report: StudyReport) -> tuple[Figure, ...]:
    """Return the distribution of the miss distances, where a study has a table of plans on several flows."""
    for table in report.tables:
        if {"planned on", "miss [m]"} <= set(table.columns):
            misses: dict[str, list[float]] = {}
            for row, miss in zip(table.rows, table.column("miss [m]"), strict=True):
                misses.setdefault(str(row[table.columns.index("planned on")]), []).append(
                    float(miss)
                )
            return (
                chart_figure(
                    misses_chart(
                        f"{report.study}-distribution", f"{report.title}: miss distances", misses
                    )
                ),
            )
    return ()
