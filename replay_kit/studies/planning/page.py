"""The studies of planning on the console, as CSV, JSON and Markdown, and as a page with its pictures."""

from collections.abc import Sequence
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

from rich.console import Console

from replay_kit.show.page import Figure, Section
from replay_kit.studies.planning.job import PlanningResult, StudyReport
from replay_kit.studies.reports.charts import chart_figure, misses_chart
from replay_kit.studies.reports.page import (
    PAGE,
    Drawn,
    criteria_html,
    drawn,
    picture_figures,
    study_page,
    tables_html,
    words_html,
)
from replay_kit.studies.reports.tables import (
    Table,
    answer_of,
    criteria_table,
    grouped,
    json_text,
    markdown,
    print_tables,
    to_csv,
    write_files,
)


def to_json(result: PlanningResult) -> dict[str, Any]:
    """Return the JSON object of ``planning.json`` and ``--json``; undefined figures are null."""
    figures = {
        field.name: getattr(result, field.name)
        for field in fields(result)
        if field.name not in ("reports", "seconds")
    }
    studies = {
        report.study: _study_json(report, result.seconds[report.study]) for report in result.reports
    }
    return answer_of(
        {"studies": studies, **figures, "job": asdict(result.job)},
        "numpy",
        "scipy",
        "casadi",
        "matplotlib",
    )


def _study_json(report: StudyReport, seconds: float) -> dict[str, Any]:
    return {
        "criteria": [{**asdict(one), "met": one.met} for one in report.criteria],
        "tables": {
            table.name: [dict(zip(table.columns, row, strict=True)) for row in table.rows]
            for table in report.tables
        },
        "findings": report.findings,
        "seconds": seconds,
        **({"failed": report.failed} if report.failed else {}),
    }


def to_markdown(result: PlanningResult) -> str:
    """Return the studies as Markdown."""
    parts = ["# Plans flown in truths that the estimates do not know", conditions(result)]
    for report in result.reports:
        parts += [
            f"## {report.title}",
            *(markdown(table) for table in all_tables(report) if table.shown),
            *report.findings,
        ]
        parts += [
            f"![{picture.caption}]({picture.name}.png)\n\n*{picture.caption}.*"
            for picture in report.pictures
        ]
    done = {report.study for report in result.reports}
    if left := [study for study in result.job.studies if study not in done]:
        parts.append(f"Not done when this was written: {', '.join(left)}.")
    return "\n\n".join(parts) + "\n"


def conditions(result: PlanningResult) -> str:
    """Return what the studies were made on."""
    job, modes = (
        result.job,
        "all modes" if result.modes is None else f"at most {result.modes} modes",
    )
    levels, truths = (
        ", ".join(f"{level:.4g}" for level in result.levels),
        ", ".join(f"`{truth}`" for truth in result.truths),
    )
    return (
        f"{result.n_members} members of `{result.ensemble}`, levels {levels} m; truths, in turn: {truths}. Each estimate is made from "
        f"{job.pings} pings at random places, noise {job.noise:g} m/s, with {modes}. Seed {job.seed}. Intervals hold 90 % of the "
        "medians of resampled cases. Cases of one truth share its estimates, which the intervals do not take into account."
    )


def print_study(result: PlanningResult, console: Console) -> None:
    """Print the tables, the criteria, and the findings."""
    for report in result.reports:
        print_tables(console, all_tables(report))
        for finding in report.findings:
            console.print(finding, soft_wrap=True, markup=not report.failed)


def all_tables(report: StudyReport) -> tuple[Table, ...]:
    """Return the tables of a study, and its criteria as one more."""
    return (
        *report.tables,
        criteria_table(f"Acceptance criteria of {report.study}", report.criteria),
    )


def files_of(studies: Sequence[str]) -> list[str]:
    """Return patterns of the names of the files that a run of some studies writes."""
    tables = [f"{study}*.{ending}" for study in studies for ending in ("csv", "png")]
    return [PAGE, "report.md", "planning.json", *tables]


def write_study(out: Path, result: PlanningResult) -> None:
    """Write all that is done into a folder that exists, each file whole or not at all; existing ones are replaced."""
    if not result.reports:
        return
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
            words_html([conditions(result)])
            + criteria_html(
                [
                    replace(one, what=f"{report.title}: {one.what}")
                    for report in result.reports
                    for one in report.criteria
                ]
            ),
            missing=missing,
        )
    ]
    sections += [_section(report, pictures) for report in result.reports]
    return study_page(
        "Plans flown in truths that the estimates do not know", sections, to_json(result)
    )


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
    named = [table for table in report.tables if {"planned on", "miss [m]"} <= set(table.columns)]
    if not named:
        return ()
    flow, miss = (named[0].columns.index(name) for name in ("planned on", "miss [m]"))
    misses = {
        str(name): [row[miss] for row in rows]
        for name, rows in grouped(named[0].rows, lambda row: row[flow]).items()
    }
    key, title = f"{report.study}-distribution", f"{report.title}: miss distances"
    return (chart_figure(misses_chart(key, title, misses)),)
