"""Every kind of page: no element takes the id of another, and links, controls and buttons find theirs."""

import numpy as np
import pytest

from replay_kit.show.figures.figure import Axis, Figure, Mark, Panel
from replay_kit.show.page.page import Section, page_html
from tests.show.page.checks import check_figures, check_ids
from tests.show.page.kinds import QUICK, SLOW


@pytest.mark.parametrize(
    "kind", [*QUICK, *(pytest.param(kind, marks=pytest.mark.full) for kind in SLOW)]
)
def test_ids_are_unique_and_figures_are_whole(kind, tmp_path, request):
    page = {**QUICK, **SLOW}[kind](tmp_path, request)
    check_ids(page)
    if kind not in ("show/status", "workflows/fleet"):
        assert check_figures(page)


def figure(key: str) -> Figure:
    panel = Panel("Title", Axis("x"), Axis("y"), [Mark("points", np.ones(1), np.ones(1))])
    return Figure(key, "Title", [panel], "Caption", "Words")


@pytest.mark.parametrize(
    "sections",
    [
        [Section("figures", "Taken by the data of the figures")],
        [Section("one", "Of two", figures=[figure("one")])],
        [
            Section("one", "Once", figures=[figure("a")]),
            Section("two", "Again", figures=[figure("a")]),
        ],
    ],
)
def test_a_page_with_an_id_twice_is_not_made(sections):
    with pytest.raises(AssertionError, match="ids of a page: expected each once"):
        page_html("Title", sections)
