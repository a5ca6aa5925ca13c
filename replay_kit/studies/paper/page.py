"""The study to files: a page, a report in Markdown, CSV, JSON, figures."""

from pathlib import Path

from replay_kit.show.page import Section
from replay_kit.studies.paper import findings
from replay_kit.studies.paper.report import FIGURES, rows_to_csv, text_tables, to_json, to_markdown
from replay_kit.studies.paper.run import PaperTables, Shown
from replay_kit.studies.reports.charts import Axis, Chart, Series, chart_figure, misses_chart
from replay_kit.studies.reports.flows import LABELS
from replay_kit.studies.reports.page import (
    PAGE,
    picture_figures,
    study_page,
    tables_html,
    words_html,
)
from replay_kit.studies.reports.pictures import Drawn
from replay_kit.studies.reports.write import json_text, write_files

_TABLES = ("table1", "table2", "table3", "sparse")
FILES = (
    *(f"{name}.csv" for name in _TABLES),
    "paper.json",
    "report.md",
    PAGE,
    *(f"{name}.{ending}" for name in FIGURES for ending in ("png", "svg")),
)


def write_paper(out: Path, tables: PaperTables, shown: Shown) -> None:
    """Write ``FILES`` into a folder, each whole or not at all; existing ones are replaced.

    Of an unfinished study, these are ``paper.json`` and the tables that have rows.

    Args:
        out: The folder; it exists.
        tables: The results.
        shown: What the figures show.
    """
    write_files(
        out,
        {
            f"{name}.csv": rows_to_csv(getattr(tables, name))
            for name in _TABLES
            if getattr(tables, name)
        },
    )
    write_files(out, {"paper.json": json_text(to_json(tables))})
    if tables.unfinished:
        return
    # matplotlib takes half a second to load, and nothing but this needs it
    from replay_kit.studies.paper.figures import draw

    pictures = {}
    for name, picture in draw(tables, shown):
        write_files(out, {f"{name}.{ending}": content for ending, content in picture.files.items()})
        pictures[name] = picture
    write_files(out, {"report.md": to_markdown(tables), PAGE: paper_page(tables, pictures)})


def paper_page(tables: PaperTables, pictures: dict[str, Drawn]) -> str:
    """Return the page of the finished study.

    Args:
        tables: The results.
        pictures: By name.
    """
    table1, table2, sparse, table3 = text_tables(tables)
    where, *why = findings.sparse_logs(tables)
    shown = picture_figures(
        [
            (name, caption, pictures[name])
            for name, caption in FIGURES.items()
            if name != "sparse" and name in pictures
        ]
    )
    misses = {
        LABELS[row.flow]: row.closest_approach for row in tables.table3 if row.closest_approach
    }
    distribution = misses_chart("glides", "Closest approach of the glides to their targets", misses)
    sections = [
        Section(
            "answer",
            "In words",
            words_html([findings.conditions(tables), findings.errors(tables), where]),
        ),
        Section("errors", "Errors", tables_html([table1, table2])),
        Section(
            "few",
            "Sparse logs",
            words_html(why) + tables_html([sparse]),
            [chart_figure(_sparse(tables))],
        ),
        Section(
            "plans",
            "Glides",
            words_html([findings.glides(tables)]) + tables_html([table3]),
            [chart_figure(distribution)],
        ),
        Section("pictures", "Figures of the paper", figures=shown),
    ]
    return study_page("The paper's study on this ensemble", sections, to_json(tables))


def _sparse(tables: PaperTables) -> Chart:
    series = []
    for method in dict.fromkeys(row.method for row in tables.sparse):
        rows = [row for row in tables.sparse if row.method == method]
        series.append(
            Series(LABELS[method], [row.pings for row in rows], [row.rel_error for row in rows])
        )
    axes = Axis("pings", log=True), Axis("RMSE / RMS speed of the truth [1]", log=True)
    caption = (
        "Error on the way through the pings of Table II. Lower is better; at 1 (dotted) an "
        "estimate is no better than no current at all."
    )
    return Chart("sparse", FIGURES["sparse"], caption, axes, tuple(series), 1.0)
