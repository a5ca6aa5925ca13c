"""A section that is added as the README says: a function in a list, and the page shows it."""

import numpy as np

import replay_kit as rk
from replay_kit.results.views.contents import Contents
from replay_kit.show.figures.figure import Axis, Figure, Mark, Panel
from replay_kit.show.page.page import Section
from replay_kit.show.report import pages as report
from tests.show.page.checks import check_figures
from tests.show.report.html_of import elements, text_of


def _mine(contents: Contents) -> Section:
    depth = contents.track.depth
    axes = Axis("position", "number"), Axis("depth", "m")
    figure = Figure(
        "my-depths",
        "Depths",
        [Panel("Depths", *axes, [Mark("points", np.arange(depth.size), depth)])],
        "Each point: one position.",
        "The depth of each position of the track, one after the other.",
    )
    return Section(
        "mine",
        "Depths of mine",
        f"<p>{contents.track.depth.size} positions</p>",
        [figure],
        ["What is not there."],
    )


def test_an_added_section_is_on_the_page_with_its_figure(replayed, monkeypatch):
    monkeypatch.setattr(report, "SECTIONS", (*report.SECTIONS[1:2], _mine))
    page = report.report_html(rk.open_result(replayed.path))
    assert [attrs["id"] for attrs, _ in elements(page, "section")] == ["answer", "mine", "again"]
    assert f"{len(replayed.fixes)} positions" in text_of(page, "mine")
    assert "What is not there." in text_of(page, "mine")
    assert "my-depths" in check_figures(page)
