"""Cells off a turned grid are no land: they are told apart in what is taken out of a result, on its page and in its figures."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from replay_kit.core.geodesy import inside_grid
from replay_kit.results.views.contents import Contents
from replay_kit.results.views.current import on_grid, published_slices, slices_of
from replay_kit.show.figures.kinds import drawn_figure
from replay_kit.show.report.pages import report_html
from tests.results.cases import turned, write
from tests.show.figures.texts import notes_of
from tests.show.report.html_of import figures, unpacked
from tests.synthetic_flow import synthetic_flow


@pytest.fixture
def contents(tmp_path, innovation, plan):
    """Return a function that opens a result on a grid turned by 35 degrees, with or without an island or an estimate."""

    @cache
    def make(land: bool = True, **options: bool) -> Contents:
        flow, path = turned(synthetic_flow(n_modes=0), 35.0), tmp_path / f"{land}.mcap"
        wet = np.ones_like(flow.grid.wet)
        wet[:, 2, 2] = not land
        island = replace(flow, grid=replace(flow.grid, wet=wet))
        return write(path, island, [innovation] * 2, plan, **options)

    return make


def test_slices_know_which_cells_lie_off_the_grid(contents):
    slices, estimate = contents().slices, contents().estimate
    outside = ~inside_grid(estimate.grid, *np.meshgrid(slices.east, slices.north))
    np.testing.assert_array_equal(slices.outside, outside)
    np.testing.assert_array_equal(slices_of(estimate, np.array([5.0])).outside, outside)
    # the island
    assert np.isnan(slices.fields[0, -1, 0][~outside]).any()
    # what was published of another grid is not called outside
    published = published_slices(contents().result.reader)
    assert on_grid(published, synthetic_flow(spacing=1_000.0).grid).outside is None


@pytest.mark.full
def test_page_and_figures_call_them_outside_the_forecast(contents):
    page = report_html(contents().result)
    figure = figures(page)["current-map"]
    outside = np.isfinite(unpacked(figure["packed"]["outside"]))
    np.testing.assert_array_equal(outside, contents().slices.outside)
    for land, result in ((True, contents()), (False, contents(land=False))):
        figure = drawn_figure(result, "map")
        assert "Hatched: outside the forecast." in notes_of(figure)
        assert ("Grey: land, or below the bottom." in notes_of(figure)) == land


def test_without_an_estimate_nothing_is_called_land_that_may_lie_outside(contents):
    result = contents(estimate=False)
    said = "land, below the bottom, or outside the forecast"
    figure = figures(report_html(result.result))["current-map"]
    assert (figure["map"]["dry"], "outside" in figure["packed"]) == (said, False)
