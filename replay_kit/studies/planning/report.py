"""The studies of planning to the console, to Markdown and to JSON."""

from dataclasses import asdict, fields
from typing import Any

from rich.console import Console

from replay_kit.studies.planning.job import PlanningResult, StudyReport
from replay_kit.studies.reports.tables import Table
from replay_kit.studies.reports.write import answer_of, criteria_table, markdown, print_tables


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


def print_planning(result: PlanningResult, console: Console) -> None:
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
